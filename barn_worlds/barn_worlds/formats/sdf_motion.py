"""Walls and moving obstacles as SDF: walls are static models, moving obstacles are actors that follow a script.

An actor of Gazebo goes where its script says, touches nothing and is seen by cameras and GPU lidars. Current Gazebo
shows an actor only by a mesh, which is a file beside the world; in Gazebo Classic its shape is part of the world.
"""

import math
from xml.sax.saxutils import quoteattr

import numpy as np

from barn_worlds.moving.motion import MovingObstacle, Wall
from barn_worlds.moving.tracks import Tracks

STEP_S = 0.1  # between waypoints where a motion is not one that Gazebo interpolates itself
_SIDES = 32  # of the mesh of a cylinder
_WALL = "<material><ambient>0.5 0.5 0.5 1</ambient><diffuse>0.6 0.6 0.6 1</diffuse></material>"
_MOVING = "<material><ambient>0.6 0.3 0.1 1</ambient><diffuse>0.84 0.37 0 1</diffuse></material>"
Waypoints = list[tuple[float, float, float]]


def wall_model(wall: Wall, number: int) -> str:
    """Return a static model of a wall."""
    geometry = _box(wall.size_x_m, wall.size_y_m, wall.height_m)
    pose = f"{wall.x_m:.9g} {wall.y_m:.9g} {wall.height_m / 2.0:.9g} 0 0 {wall.yaw_rad:.9g}"
    return (
        f'  <model name="wall_{number}">\n    <static>true</static>\n    <pose>{pose}</pose>\n    <link name="link">\n'
        f'      <collision name="collision">{geometry}</collision>\n'
        f'      <visual name="visual">{geometry}{_WALL}</visual>\n    </link>\n  </model>'
    )


def actor(obstacle: MovingObstacle, flavour: str) -> str:
    """Return an actor that moves as the obstacle does from time 0 on, and repeats."""
    if flavour == "classic":
        size = f"<radius>{obstacle.radius_m:.9g}</radius><length>{obstacle.height_m:.9g}</length>"
        shape = f"<geometry><cylinder>{size}</cylinder></geometry>"
        if obstacle.shape == "box":
            shape = _box(obstacle.size_x_m, obstacle.size_y_m, obstacle.height_m)
        body = (
            f'    <link name="link">\n      <collision name="collision">{shape}</collision>\n'
            f'      <visual name="visual">{shape}{_MOVING}</visual>\n    </link>'
        )
    else:
        body = f"    <skin><filename>{mesh_name(obstacle)}</filename><scale>1</scale></skin>"
    parts = [
        f'      <trajectory id="{number}" type="path" tension="0">\n{_waypoints(obstacle, points)}\n      </trajectory>'
        for number, points in enumerate(trajectories(obstacle))
    ]
    script = "<loop>true</loop><delay_start>0</delay_start><auto_start>true</auto_start>"
    scripted = "\n".join(["    <script>", f"      {script}", *parts, "    </script>"])
    return f"  <actor name={quoteattr(obstacle.name)}>\n{body}\n{scripted}\n  </actor>"


def trajectories(obstacle: MovingObstacle) -> list[Waypoints]:
    """Return the waypoints (s, m, m) of an actor's trajectories, which follow each other; each starts at 0 s.

    The keys themselves where Gazebo's own spline makes the motion of them. Otherwise waypoints every `STEP_S`, in two
    trajectories if time 0 is in the midst of the motion, so that its jump stays one.
    """
    motion = obstacle.motion
    period_s, start_s = motion.period_s, obstacle.phase_s % motion.period_s
    if motion.kind == "gazebo" and start_s == 0.0 and motion.keys[0][0] == 0.0 and motion.keys[-1][0] == period_s:
        return [list(motion.keys)]
    spans = [(start_s, period_s), (0.0, start_s)] if start_s else [(0.0, period_s)]
    return [_sampled(obstacle, begin_s, end_s) for begin_s, end_s in spans]


def mesh_name(obstacle: MovingObstacle) -> str:
    """Return the name of the file with an obstacle's mesh, the same for equal shapes."""
    sizes = [obstacle.radius_m] if obstacle.shape == "cylinder" else [obstacle.size_x_m, obstacle.size_y_m]
    return "_".join([obstacle.shape, *(f"{size:g}" for size in (*sizes, obstacle.height_m))]) + ".obj"


def mesh(obstacle: MovingObstacle) -> str:
    """Return a closed mesh of an obstacle as Wavefront OBJ, its centre at the origin."""
    if obstacle.shape == "cylinder":
        turns = [2.0 * math.pi * k / _SIDES for k in range(_SIDES)]
        rim = [(obstacle.radius_m * math.cos(turn), obstacle.radius_m * math.sin(turn)) for turn in turns]
    else:
        x, y = obstacle.size_x_m / 2.0, obstacle.size_y_m / 2.0
        rim = [(x, y), (-x, y), (-x, -y), (x, -y)]
    half, sides = obstacle.height_m / 2.0, len(rim)
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for z in (-half, half) for x, y in rim]
    for k in range(1, sides + 1):
        after = k % sides + 1
        lines.append(f"f {k} {after} {after + sides} {k + sides}")
    lines.append("f " + " ".join(str(k) for k in range(sides, 0, -1)))
    lines.append("f " + " ".join(str(k + sides) for k in range(1, sides + 1)))
    return "\n".join(lines) + "\n"


def _sampled(obstacle: MovingObstacle, begin_s: float, end_s: float) -> Waypoints:
    """Return waypoints from one time of the motion to a later one, without its jump at the end."""
    times_s = np.linspace(begin_s, end_s, max(2, math.ceil((end_s - begin_s) / STEP_S) + 1))
    within_s = np.minimum(times_s, obstacle.motion.period_s * (1.0 - 1e-12)) - obstacle.phase_s
    positions, _ = Tracks([obstacle]).over(within_s)
    return [(time_s - begin_s, *at) for time_s, at in zip(times_s.tolist(), positions[:, 0].tolist(), strict=True)]


def _waypoints(obstacle: MovingObstacle, points: Waypoints) -> str:
    height = f"{obstacle.height_m / 2.0:.9g} 0 0 {obstacle.yaw_rad:.9g}"
    return "\n".join(
        f"        <waypoint><time>{time_s:.9g}</time><pose>{x:.9g} {y:.9g} {height}</pose></waypoint>"
        for time_s, x, y in points
    )


def _box(x_m: float, y_m: float, z_m: float) -> str:
    return f"<geometry><box><size>{x_m:.9g} {y_m:.9g} {z_m:.9g}</size></box></geometry>"
