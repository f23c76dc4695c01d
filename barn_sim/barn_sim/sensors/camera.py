"""Pictures of a trial in three dimensions, drawn by PyBullet's software renderer: no display and no graphics card.

Nothing here takes part in a simulation: the scene is built anew, of shapes that only can be seen.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, repeat
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from barn_sim.body.bullet import PhysicsClient, bullet
from barn_sim.body.model import model_of
from barn_sim.config import LidarConfig
from barn_worlds.base.arrays import Floats, Points
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.base.types import Pose2D
from barn_worlds.geometry.bodies import Bodies
from barn_worlds.geometry.polygon import Corner
from barn_worlds.robots.robot import Chassis, Triple
from barn_worlds.robots.standard import STANDARD

Pixels = npt.NDArray[np.uint8]
Colour = tuple[float, float, float, float]

CAMERAS = ("chase", "top", "side")
# Width and height of a picture in pixels.
SIZES = {"chase": (640, 400), "top": (800, 336), "side": (800, 360)}
_SIDES, _IN_A_MESH = 14, 200  # of a pillar; pillars in one mesh
_GROUND, _LINE = (0.93, 0.94, 0.95, 1.0), (0.80, 0.82, 0.85, 1.0)
_OBSTACLE, _WALL = (0.36, 0.42, 0.52, 1.0), (0.70, 0.73, 0.78, 1.0)
_MOVING = (0.48, 0.35, 0.55, 1.0)  # as barn_worlds.geometry.bodies has it
_START, _GOAL, _TRAIL = (0.0, 0.45, 0.70, 1.0), (0.0, 0.62, 0.45, 1.0), (0.0, 0.45, 0.70, 1.0)
_YELLOW, _DARK, _BLACK = (0.98, 0.77, 0.06, 1.0), (0.20, 0.21, 0.23, 1.0), (0.08, 0.08, 0.09, 1.0)
_METAL, _LAMP, _TAIL = (0.62, 0.64, 0.67, 1.0), (0.95, 0.95, 0.9, 1.0), (0.8, 0.1, 0.1, 1.0)
_DISC_M, _DOT_M = 0.16, 0.05
_LIGHT_FROM = (-2.0, -3.0, 6.0)
_TRAIL_STEP_M, _TRAIL_WIDTH_M = 0.12, 0.05
_AROUND_M = 60.0  # of ground
_HIDDEN_M = -5.0  # below the ground


@dataclass(frozen=True)
class Camera:
    """Where the camera is, what it looks at, what is up in its picture (metres, map frame), and its opening angle."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    opening_deg: float = 50.0


class Part(NamedTuple):
    """A primitive of the robot at `centre` in base_link, turned by roll and pitch.

    sizes: full sizes of a box; radius and length of a cylinder, which stands along z before it is turned; radius of a
    ball; height of an upright prism, whose corners (k, 2) are about `centre`, counter-clockwise.
    """

    sizes: tuple[float, ...]
    centre: tuple[float, float, float]
    colour: Colour
    roll: float = 0.0
    pitch: float = 0.0
    corners: tuple[Corner, ...] = ()


def jackal_parts(chassis: Chassis, lidar: LidarConfig) -> list[Part]:
    """Return what a Jackal looks like: dark body, yellow fenders, wheels with hubs, lamps, lidar and antennas."""
    model = model_of(chassis)
    radius, half_track = model.wheel_radius_m, 0.5 * model.track_m
    parts = [
        Part((0.40, 0.30, 0.17), (0.0, 0.0, 0.095), _DARK),
        Part((0.42, 0.28, 0.012), (0.0, 0.0, 0.187), _BLACK),
        Part((0.012, 0.20, 0.004), (-0.06, 0.0, 0.195), _METAL),
        Part((0.012, 0.20, 0.004), (0.04, 0.0, 0.195), _METAL),
    ]
    for end in (1.0, -1.0):
        parts.append(Part((0.02, 0.34, 0.085), (end * 0.236, 0.0, 0.085), _YELLOW))
        parts.append(Part((0.012, 0.20, 0.03), (end * 0.249, 0.0, 0.085), _BLACK))
        for side in (1.0, -1.0):
            middle = side * (half_track + 0.003)
            parts.append(Part((0.17, 0.066, 0.014), (end * 0.118, middle, 0.150), _YELLOW))
            parts.append(Part((0.082, 0.066, 0.014), (end * 0.228, middle, 0.125), _YELLOW, pitch=end * 0.68))
            parts.append(Part((0.006, 0.045, 0.018), (end * 0.247, side * 0.13, 0.10), _LAMP if end > 0 else _TAIL))
    for x, y, z in model.wheels.tolist():
        outside = 0.022 * math.copysign(1.0, y)
        parts.append(Part((radius, 0.042), (x, y, z), _BLACK, roll=0.5 * math.pi))
        parts.append(Part((0.55 * radius, 0.010), (x, y + outside, z), _METAL, roll=0.5 * math.pi))
        parts.append(Part((0.25 * radius, 0.012), (x, y + 1.1 * outside, z), _YELLOW, roll=0.5 * math.pi))
    top, height = 0.193, lidar.mount_z_m
    parts.append(
        Part((0.09, 0.09, max(0.01, height - 0.03 - top)), (lidar.mount_x_m, 0.0, 0.5 * (top + height - 0.03)), _DARK)
    )
    parts.append(Part((0.042, 0.022), (lidar.mount_x_m, 0.0, height - 0.019), _METAL))
    parts.append(Part((0.041, 0.034), (lidar.mount_x_m, 0.0, height + 0.009), _BLACK))
    parts.append(Part((0.042, 0.008), (lidar.mount_x_m, 0.0, height + 0.030), _METAL))
    return parts + [Part((0.006, 0.16), (-0.16, side * 0.09, 0.27), _BLACK) for side in (1.0, -1.0)]


def robot_parts(chassis: Chassis, lidar: LidarConfig) -> list[Part]:
    """Return what a robot looks like: a Jackal as it is, others as the body that the physics has.

    That is a box, cylinder or prism, with wheels and casters; front and lidar are marked. A caster is a ball of half
    the radius of the wheels: its place is all that is known of it.
    """
    if chassis.description == "jackal.urdf":
        return jackal_parts(chassis, lidar)
    low, high = (edge - chassis.base_height_m for edge in (chassis.ground_clearance_m, chassis.body_height_m))
    x_min, y_min, x_max, y_max = chassis.extent_m
    long, wide, tall = x_max - x_min, y_max - y_min, high - low
    middle = (0.5 * (x_min + x_max), 0.5 * (y_min + y_max), 0.5 * (low + high))
    small, z, ball = 0.04 * long, lidar.mount_z_m, 0.5 * chassis.wheel_radius_m
    tip = [y for x, y in chassis.hull_m if x > x_max - small] if not chassis.round else [0.0]
    front = (x_max, 0.5 * (min(tip) + max(tip)), middle[2])
    foot, top = min(high, z), max(high, z)  # a mast where the lidar stands over the body
    parts = [
        _body(chassis, (long, wide, tall), middle),
        Part((small, 0.3 * wide, 0.2 * tall), front, _YELLOW),
        Part((small, top - foot + 2.0 * small), (lidar.mount_x_m, lidar.mount_y_m, 0.5 * (foot + top)), _BLACK),
    ]
    rim = (chassis.wheel_radius_m, chassis.wheel_width_m)
    parts += [Part(rim, hub, _BLACK, roll=0.5 * math.pi) for hub in chassis.wheels_m]
    return parts + [Part((ball,), (x, y, ball - chassis.base_height_m), _METAL) for x, y in chassis.casters_m]


def _body(chassis: Chassis, sizes: Triple, middle: Triple) -> Part:
    """Return the body of a robot; sizes: of the box around it."""
    if chassis.round:
        return Part((chassis.footprint_radius_m, sizes[2]), middle, _DARK)
    if chassis.rectangular:
        return Part(sizes, middle, _DARK)
    corners = tuple((x - middle[0], y - middle[1]) for x, y in chassis.hull_m)
    return Part((sizes[2],), middle, _DARK, corners=corners)


def prism(corners: Sequence[Corner], height_m: float) -> dict[str, list[Any]]:
    """Return an upright prism of convex corners (k, 2) about its middle as a closed mesh with a normal to each face."""
    around = np.asarray(corners, np.float64)
    low, high = (np.column_stack([around, np.full(len(around), level)]) for level in (-0.5 * height_m, 0.5 * height_m))
    faces = [low[::-1], high]
    following = np.roll(np.arange(len(around)), -1)
    faces += [np.array([low[k], low[n], high[n], high[k]]) for k, n in enumerate(following)]
    vertices: list[list[float]] = []
    indices: list[int] = []
    normals: list[list[float]] = []
    for face in faces:
        across = np.cross(face[1] - face[0], face[2] - face[1])
        first = len(vertices)
        indices += [i for k in range(1, len(face) - 1) for i in (first, first + k, first + k + 1)]
        vertices += face.tolist()
        normals += [(across / np.linalg.norm(across)).tolist()] * len(face)
    return {"vertices": vertices, "indices": indices, "normals": normals}


def pillars(centres_m: Floats, radius_m: float, height_m: float) -> dict[str, list[Any]]:
    """Return upright cylinders at centres (k, 2) as one mesh of sides and tops, with vertices, indices and normals."""
    angles = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    around = np.column_stack([np.cos(angles), np.sin(angles)])
    low, high = np.zeros((_SIDES, 1)), np.full((_SIDES, 1), height_m)
    rim = [np.hstack([radius_m * around, level]) for level in (low, high, high)]
    one = np.vstack([*rim, [[0.0, 0.0, height_m]]])
    outwards, upwards = np.hstack([around, low]), np.tile([0.0, 0.0, 1.0], (_SIDES + 1, 1))
    normals = np.vstack([outwards, outwards, upwards])
    here = np.arange(_SIDES)
    after, last = (here + 1) % _SIDES, np.full(_SIDES, 3 * _SIDES)
    sides = [(here, after, after + _SIDES), (here, after + _SIDES, here + _SIDES)]
    tops = [(here + 2 * _SIDES, after + 2 * _SIDES, last)]
    faces = np.vstack([np.column_stack(corners) for corners in sides + tops])
    shifts = np.column_stack([centres_m, np.zeros(len(centres_m))])
    return {
        "vertices": (shifts[:, None] + one).reshape(-1, 3).tolist(),
        "indices": (len(one) * np.arange(len(centres_m))[:, None, None] + faces).ravel().tolist(),
        "normals": np.tile(normals, (len(centres_m), 1)).tolist(),
    }


def camera_at(name: str, pose: Pose2D, bounds_m: Sequence[float]) -> Camera:
    """Return the camera of a name: "chase" behind a pose, "top" and "side" on all of x_min, y_min, x_max, y_max.

    In the pictures of the latter two, the robot drives to the right. ConfigError for another name.
    """
    left, below, right, above = bounds_m
    middle_x, middle_y, wide, long = 0.5 * (left + right), 0.5 * (below + above), right - left, above - below
    if name == "chase":
        ahead_x, ahead_y = math.cos(pose.yaw), math.sin(pose.yaw)
        eye = (pose.x - 1.45 * ahead_x, pose.y - 1.45 * ahead_y, 1.75)
        return Camera(eye, (pose.x + 0.8 * ahead_x, pose.y + 0.8 * ahead_y, 0.1), opening_deg=55.0)
    if name == "top":
        width, height = SIZES[name]
        half = 0.5 * max(wide, long * height / width)
        high = 30.0
        opening = 2.0 * math.degrees(math.atan(1.03 * half / (high - 1.0)))
        return Camera((middle_x, middle_y, high), (middle_x, middle_y, 0.0), (-1.0, 0.0, 0.0), opening)
    if name == "side":
        width, height = SIZES[name]
        away, high = 1.1 * long, 0.8 * long
        opening = 2.0 * math.degrees(math.atan(0.56 * long / math.hypot(away, high) * height / width))
        eye = (middle_x + away, middle_y, high)
        return Camera(eye, (middle_x, middle_y, 0.0), opening_deg=opening)
    raise ConfigError(f"camera must be one of {', '.join(CAMERAS)}, got {name!r}{suggest(name, CAMERAS)}")


class Studio:
    """A scene of cylinders with a robot in it, and a camera. Use it as a context manager.

    obstacles_m, walls_m: centres (k, 2) of cylinders in the map frame, of one radius and height. start: where the robot
    sets out. goal: where it is to go. trail_m: (n, 2) positions that it goes through, shown as far as it has come.
    boxes: walls beside those. moving: what moves, shown where each picture has it. chassis: of the robot.
    """

    def __init__(
        self,
        obstacles_m: Floats,
        walls_m: Floats,
        radius_m: float,
        height_m: float,
        lidar: LidarConfig,
        *,
        start: Pose2D | None = None,
        goal: Pose2D | None = None,
        trail_m: Floats | None = None,
        boxes: Bodies | None = None,
        moving: Bodies | None = None,
        chassis: Chassis = STANDARD.chassis,
    ) -> None:
        self._client = PhysicsClient(draws=True)
        self._id = self._client.id
        points = [obstacles_m, walls_m] + [np.array([[one.x, one.y]]) for one in (start, goal) if one is not None]
        if boxes is not None and len(boxes.poses):
            points += boxes.outlines()
        known = np.concatenate([*points, np.zeros((0, 2)) if trail_m is None else trail_m])
        low, high = known.min(axis=0) - 0.5, known.max(axis=0) + 0.5
        self.bounds_m = (*low.tolist(), *high.tolist())
        self._add_ground(low, high)
        for centres_m, colour in ((obstacles_m, _OBSTACLE), (walls_m, _WALL)):
            for first in range(0, len(centres_m), _IN_A_MESH):
                mesh = pillars(centres_m[first : first + _IN_A_MESH], radius_m, height_m)
                self._place(self._visual(bullet.GEOM_MESH, colour, **mesh), (0.0, 0.0, 0.0))
        for pose, colour in ((start, _START), (goal, _GOAL)):
            if pose is not None:
                mesh = pillars(np.array([[pose.x, pose.y]]), _DISC_M, 0.008)
                self._place(self._visual(bullet.GEOM_MESH, colour, **mesh), (0.0, 0.0, 0.0))
        self._robot = [
            (self._place(self._shape(part), (0.0, 0.0, _HIDDEN_M)), part) for part in robot_parts(chassis, lidar)
        ]
        self._dots: list[int] = []
        self._moving = [] if moving is None else self._add_bodies(moving, _MOVING)
        if boxes is not None:
            self._add_bodies(boxes, _WALL)
        self._ground_m = float(model_of(chassis).footing[2])
        self._trail = self._add_trail(np.zeros((0, 2)) if trail_m is None else trail_m)

    def __enter__(self) -> "Studio":
        """Return the studio."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release the renderer."""
        self.close()

    def close(self) -> None:
        """Release the renderer; closing again does nothing."""
        self._client.close()

    def picture(
        self,
        pose: Pose2D,
        camera: Camera,
        size: tuple[int, int],
        *,
        driven: int = 0,
        finer: int = 2,
        places: Points | None = None,
        passed: Points | None = None,
    ) -> Pixels:
        """Return the picture (height, width, 3) of the robot at a pose, in the map frame.

        size: width, height. driven: points of the trail so far. finer: drawn so many times as large, for smooth edges.
        places (n, 2): where what moves is; without, it stays. passed (k, 2): where it just was, shown as dots.
        """
        self._put_robot(pose)
        self._put_moving(places, passed)
        self._show_trail(driven)
        width, height = size
        view = bullet.computeViewMatrix(camera.eye, camera.target, camera.up)
        lens = bullet.computeProjectionMatrixFOV(camera.opening_deg, width / height, 0.1, 80.0)
        drawn = bullet.getCameraImage(
            finer * width,
            finer * height,
            view,
            lens,
            lightDirection=_LIGHT_FROM,
            shadow=0,
            renderer=bullet.ER_TINY_RENDERER,
            physicsClientId=self._id,
        )
        fine = np.reshape(drawn[2], (height, finer, width, finer, 4))[..., :3]
        mean: Pixels = fine.mean(axis=(1, 3)).round().astype(np.uint8)
        return mean

    def _add_ground(self, low: Floats, high: Floats) -> None:
        middle, (wide, long) = (0.5 * (low + high)).tolist(), (high - low).tolist()
        self._place(self._box((wide + _AROUND_M, long + _AROUND_M, 0.02), _GROUND), (*middle, -0.011))
        lines = (self._box((0.012, long, 0.002), _LINE), self._box((wide, 0.012, 0.002), _LINE))
        for x in range(math.ceil(low[0]), math.floor(high[0]) + 1):
            self._place(lines[0], (float(x), middle[1], 0.0))
        for y in range(math.ceil(low[1]), math.floor(high[1]) + 1):
            self._place(lines[1], (middle[0], float(y), 0.0))

    def _put_robot(self, pose: Pose2D) -> None:
        base = bullet.getQuaternionFromEuler((0.0, 0.0, pose.yaw))
        for body, part in self._robot:
            turn = bullet.getQuaternionFromEuler((part.roll, part.pitch, 0.0))
            where = bullet.multiplyTransforms((pose.x, pose.y, -self._ground_m), base, part.centre, turn)
            bullet.resetBasePositionAndOrientation(body, *where, physicsClientId=self._id)

    def _put_moving(self, places: Points | None, passed: Points | None) -> None:
        for (body, yaw, height_m), (x, y) in zip(self._moving, [] if places is None else places.tolist(), strict=False):
            turn = bullet.getQuaternionFromEuler((0.0, 0.0, yaw))
            where = (x, y, 0.5 * height_m)
            bullet.resetBasePositionAndOrientation(body, where, turn, physicsClientId=self._id)
        dots = [] if passed is None else [(x, y, 0.004) for x, y in passed.tolist()]
        while len(self._dots) < len(dots):
            shape = self._visual(bullet.GEOM_CYLINDER, _MOVING, radius=_DOT_M, length=0.004)
            self._dots.append(self._place(shape, (0.0, 0.0, _HIDDEN_M)))
        for body, at in zip(self._dots, chain(dots, repeat((0.0, 0.0, _HIDDEN_M))), strict=False):
            bullet.resetBasePositionAndOrientation(body, at, (0.0, 0.0, 0.0, 1.0), physicsClientId=self._id)

    def _add_trail(self, points_m: Floats) -> list[tuple[int, int, tuple[float, float, float], float]]:
        """Lay out pieces of the trail, below the ground until they are driven; each has the point that ends it."""
        pieces, last = [], 0
        for index in range(1, len(points_m)):
            step = points_m[index] - points_m[last]
            length = float(np.hypot(*step))
            if length < _TRAIL_STEP_M:
                continue
            middle = 0.5 * (points_m[index] + points_m[last])
            body = self._place(self._box((length + 0.02, _TRAIL_WIDTH_M, 0.004), _TRAIL), (0.0, 0.0, _HIDDEN_M))
            pieces.append((index, body, (*middle.tolist(), 0.004), math.atan2(step[1], step[0])))
            last = index
        return pieces

    def _show_trail(self, driven: int) -> None:
        for index, body, middle, yaw in self._trail:
            where = middle if index <= driven else (0.0, 0.0, _HIDDEN_M)
            bullet.resetBasePositionAndOrientation(
                body, where, bullet.getQuaternionFromEuler((0.0, 0.0, yaw)), physicsClientId=self._id
            )

    def _add_bodies(self, bodies: Bodies, colour: Colour) -> list[tuple[int, float, float]]:
        """Place upright cylinders and boxes; return of each its number, heading and height."""
        placed = []
        for (x, y, yaw), radius, size, height in zip(*(part.tolist() for part in bodies), strict=True):
            if radius:
                shape = self._visual(bullet.GEOM_CYLINDER, colour, radius=radius, length=height)
            else:
                shape = self._box((*size, height), colour)
            body, turn = self._place(shape, (0.0, 0.0, 0.0)), bullet.getQuaternionFromEuler((0.0, 0.0, yaw))
            where = (x, y, 0.5 * height)
            bullet.resetBasePositionAndOrientation(body, where, turn, physicsClientId=self._id)
            placed.append((body, yaw, height))
        return placed

    def _shape(self, part: Part) -> int:
        if part.corners:
            return self._visual(bullet.GEOM_MESH, part.colour, **prism(part.corners, part.sizes[0]))
        if len(part.sizes) == 3:
            return self._box(part.sizes, part.colour)
        if len(part.sizes) == 1:
            return self._visual(bullet.GEOM_SPHERE, part.colour, radius=part.sizes[0])
        radius_m, length_m = part.sizes
        return self._visual(bullet.GEOM_CYLINDER, part.colour, radius=radius_m, length=length_m)

    def _box(self, sizes: Sequence[float], colour: Colour) -> int:
        halves = [0.5 * size for size in sizes]
        return self._visual(bullet.GEOM_BOX, colour, halfExtents=halves)

    def _visual(self, kind: int, colour: Colour, **sizes: Any) -> int:
        made: int = bullet.createVisualShape(
            kind, rgbaColor=colour, specularColor=(0.1, 0.1, 0.1), physicsClientId=self._id, **sizes
        )
        return made

    def _place(self, shape: int, where: tuple[float, float, float]) -> int:
        made: int = bullet.createMultiBody(baseVisualShapeIndex=shape, basePosition=where, physicsClientId=self._id)
        return made
