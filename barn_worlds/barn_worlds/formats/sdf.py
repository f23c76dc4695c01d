"""Writing worlds as SDF: 1.6 for Gazebo Classic, 1.9 for current Gazebo (gz sim)."""

import gzip
from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

from barn_worlds.base.arrays import Points
from barn_worlds.base.errors import WorldError, suggest
from barn_worlds.base.files import write_bytes
from barn_worlds.formats import sdf_motion
from barn_worlds.worlds.world import World

FLAVOURS = ("classic", "gz")
MOVABLE_MASS_KG = 1.0  # of each obstacle in the paper's trials

_VERSIONS = {"classic": "1.6", "gz": "1.9"}
_SYSTEMS = ("physics", "user-commands", "scene-broadcaster", "sensors", "imu", "contact")
_SUN = """  <light name="sun" type="directional">
    <cast_shadows>true</cast_shadows>
    <pose>0 0 10 0 0 0</pose>
    <diffuse>0.8 0.8 0.8 1</diffuse>
    <specular>0.1 0.1 0.1 1</specular>
    <direction>-0.5 0.5 -1</direction>
  </light>"""
_GROUND = """  <model name="ground_plane">
    <static>true</static>
    <link name="link">
      <collision name="collision">
        <geometry><plane><normal>0 0 1</normal><size>100 100</size></plane></geometry>
        <surface><friction><ode><mu>100</mu><mu2>50</mu2></ode></friction></surface>
      </collision>
      <visual name="visual">
        <geometry><plane><normal>0 0 1</normal><size>100 100</size></plane></geometry>
        <material><ambient>0.6 0.6 0.6 1</ambient><diffuse>0.7 0.7 0.7 1</diffuse></material>
      </visual>
    </link>
  </model>"""
_MATERIAL = "<material><ambient>0.15 0.38 0.72 1</ambient><diffuse>0.15 0.38 0.72 1</diffuse></material>"


def write_sdf(world: World, path: Path, flavour: str = "classic", *, movable: bool = False) -> None:
    """Write a world as `sdf_text` gives it; gzipped if the name ends in .gz (equal worlds give equal files).

    Beside it, for current Gazebo, the meshes of its moving obstacles.
    """
    content = sdf_text(world, flavour, movable=movable).encode()
    write_bytes(path, gzip.compress(content, mtime=0) if path.suffix == ".gz" else content)
    if flavour == "gz":
        for name, one in {sdf_motion.mesh_name(one): one for one in world.moving}.items():
            write_bytes(path.parent / name, sdf_motion.mesh(one).encode())


def sdf_text(world: World, flavour: str = "classic", *, movable: bool = False) -> str:
    """Return a world as SDF for Gazebo Classic (`classic`) or current Gazebo (`gz`).

    The cylinders stand on the ground plane. movable: the obstacles, 1 kg each as in the paper's trials, can be pushed;
    the containment cannot. With `gz` the static cylinders are one model, which is faster to simulate; with `classic`
    each is a model of its own, named as in the original files. Moving obstacles are actors (`formats.sdf_motion`).
    """
    if flavour not in FLAVOURS:
        raise WorldError(f"unknown flavour of SDF {flavour!r}{suggest(flavour, FLAVOURS)}")
    parts = [f"<sdf version={quoteattr(_VERSIONS[flavour])}>", f"<world name={quoteattr(world.name)}>"]
    parts += [_physics(flavour), "  <gravity>0 0 -9.8</gravity>", _SUN, _GROUND]
    containment, obstacles = world.containment_m, world.obstacles_m
    if flavour == "classic":
        walls = [_single(world, f"unit_cylinder_{k}", centre, 0.0) for k, centre in enumerate(containment.tolist())]
        first = len(containment)
        mass = MOVABLE_MASS_KG if movable else 0.0
        parts += walls
        parts += [_single(world, f"unit_cylinder_{first + k}", at, mass) for k, at in enumerate(obstacles.tolist())]
    else:
        if len(containment):
            parts.append(_compound(world, "containment", containment))
        if movable:
            parts += [_single(world, f"obstacle_{k}", at, MOVABLE_MASS_KG) for k, at in enumerate(obstacles.tolist())]
        elif len(obstacles):
            parts.append(_compound(world, "obstacles", obstacles))

    parts += [sdf_motion.wall_model(wall, k) for k, wall in enumerate(world.walls)]
    parts += [sdf_motion.actor(one, flavour) for one in world.moving]
    return '<?xml version="1.0"?>\n' + "\n".join([*parts, "</world>", "</sdf>"]) + "\n"


def _physics(flavour: str) -> str:
    if flavour == "classic":
        step = "<max_step_size>0.001</max_step_size><real_time_update_rate>1000</real_time_update_rate>"
        return f'  <physics name="default_physics" default="true" type="ode">{step}</physics>'
    physics = '  <physics name="1ms" type="ignored"><max_step_size>0.001</max_step_size></physics>'
    classes = ((name, name.title().replace("-", "")) for name in _SYSTEMS)
    plugins = (f'  <plugin filename="gz-sim-{name}-system" name="gz::sim::systems::{cls}"/>' for name, cls in classes)
    return "\n".join([physics, *plugins])


def _single(world: World, name: str, centre: Sequence[float], mass_kg: float) -> str:
    """Return a model of one cylinder, static if it has no mass."""
    inertial = ""
    if mass_kg:
        radius, height = world.cylinder_radius_m, world.cylinder_height_m
        across, along = mass_kg * (3.0 * radius**2 + height**2) / 12.0, mass_kg * radius**2 / 2.0
        inertia = f"<ixx>{across:.9g}</ixx><iyy>{across:.9g}</iyy><izz>{along:.9g}</izz>"
        inertial = f"<inertial><mass>{mass_kg:g}</mass><inertia>{inertia}</inertia></inertial>"
    return (
        f'  <model name="{name}">\n    <static>{"false" if mass_kg else "true"}</static>\n'
        f'    <pose>{_pose(world, centre)}</pose>\n    <link name="link">{inertial}\n'
        f"{_cylinder(world, '', '')}\n    </link>\n  </model>"
    )


def _compound(world: World, name: str, centres: Points) -> str:
    parts = [
        _cylinder(world, f"_{k}", f"<pose>{_pose(world, centre)}</pose>") for k, centre in enumerate(centres.tolist())
    ]
    inside = "\n".join(parts)
    return (
        f'  <model name="{name}">\n    <static>true</static>\n    <link name="link">\n{inside}\n    </link>\n  </model>'
    )


def _cylinder(world: World, suffix: str, pose: str) -> str:
    size = f"<radius>{world.cylinder_radius_m:.9g}</radius><length>{world.cylinder_height_m:g}</length>"
    geometry = f"<geometry><cylinder>{size}</cylinder></geometry>"
    return (
        f'      <collision name="collision{suffix}">{pose}{geometry}</collision>\n'
        f'      <visual name="visual{suffix}">{pose}{geometry}{_MATERIAL}</visual>'
    )


def _pose(world: World, centre: Sequence[float]) -> str:
    return f"{centre[0]:.6f} {centre[1]:.6f} {world.cylinder_height_m / 2.0:g} 0 0 0"
