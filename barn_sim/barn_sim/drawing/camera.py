"""Pictures of a trial in three dimensions, drawn by PyBullet's software renderer: no display and no graphics card.

Nothing here takes part in a simulation: the scene is built anew, of shapes that only can be seen.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, repeat
from typing import Any

import numpy as np
import numpy.typing as npt
from typing_extensions import Self

from barn_sim.body.model import model_of
from barn_sim.config import LidarConfig
from barn_sim.contact.bullet import PhysicsClient, bullet
from barn_sim.drawing.robot_parts import RobotPart, robot_parts
from barn_worlds.base.arrays import Floats, Points
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.base.types import Pose2D
from barn_worlds.drawing.palette import GOAL, MOVER, START, TRAIL
from barn_worlds.geometry.bodies import Bodies
from barn_worlds.geometry.polygon import Corner
from barn_worlds.robots.files import STANDARD
from barn_worlds.robots.robot import Chassis, Triple
from barn_worlds.worlds.scene import TrialScene

Pixels = npt.NDArray[np.uint8]

SIZES = {
    "chase": (640, 400),
    "top": (800, 336),
    "side": (800, 360),
}  # width and height of a picture in pixels
CAMERAS = tuple(SIZES)
# Light falls aslant and darkens, so that obstacles and walls begin lighter than on paper.
_GROUND, _LINE, _OBSTACLE, _WALL = "#edf0f2", "#ccd1d9", "#5c6b85", "#b3bac7"
_LIGHT_FROM = (-2.0, -3.0, 6.0)
_IN_A_MESH = 200  # pillars
_SIDES = 14  # of a pillar
_DISC_M, _DOT_M = 0.16, 0.05
_TRAIL_STEP_M, _TRAIL_WIDTH_M = 0.12, 0.05
_AROUND_M = 60.0  # of ground
_HIDDEN_M = (0.0, 0.0, -5.0)
_NOWHERE = np.empty((0, 2))


@dataclass(frozen=True)
class Camera:
    """Where the camera is, what it looks at, what is up in its picture (metres, map frame), and its opening angle."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    opening_deg: float = 50.0


def camera_at(name: str, pose: Pose2D, bounds_m: Sequence[float]) -> Camera:
    """Return the camera of a name: "chase" behind a pose, "top" and "side" on all of x_min, y_min, x_max, y_max.

    In the pictures of the latter two, the robot drives to the right. ConfigError for another name.
    """
    left, below, right, above = bounds_m
    middle_x, middle_y, wide, long = (
        0.5 * (left + right),
        0.5 * (below + above),
        right - left,
        above - below,
    )
    if name == "chase":
        ahead_x, ahead_y = math.cos(pose.yaw), math.sin(pose.yaw)
        eye = (pose.x - 1.45 * ahead_x, pose.y - 1.45 * ahead_y, 1.75)
        return Camera(
            eye, (pose.x + 0.8 * ahead_x, pose.y + 0.8 * ahead_y, 0.1), opening_deg=55.0
        )
    if name not in SIZES:
        raise ConfigError(
            f"camera must be one of {', '.join(CAMERAS)}, got {name!r}{suggest(name, CAMERAS)}"
        )
    slope, target = SIZES[name][1] / SIZES[name][0], (middle_x, middle_y, 0.0)
    if name == "top":
        opening = 2.0 * math.degrees(
            math.atan(1.03 * 0.5 * max(wide, long * slope) / (30.0 - 1.0))
        )
        return Camera((middle_x, middle_y, 30.0), target, (-1.0, 0.0, 0.0), opening)
    away, high = 1.1 * long, 0.8 * long
    opening = 2.0 * math.degrees(
        math.atan(0.56 * long / math.hypot(away, high) * slope)
    )
    return Camera((middle_x + away, middle_y, high), target, opening_deg=opening)


class Studio:
    """A scene with a robot in it, and a camera. Use it as a context manager.

    scene: its cylinders, boxes, start and goal. trail_m: (n, 2) positions that the robot goes through, shown as far as
    it has come. moving: what moves, shown where each picture has it. chassis: of the robot.
    """

    def __init__(
        self,
        scene: TrialScene,
        lidar: LidarConfig,
        *,
        trail_m: Floats = _NOWHERE,
        moving: Bodies | None = None,
        chassis: Chassis = STANDARD.chassis,
    ) -> None:
        self._client = PhysicsClient(draws=True)
        known = np.concatenate(
            [scene.cylinders_m, scene.ends_m(), *scene.boxes.outlines(), trail_m]
        )
        low, high = known.min(axis=0) - 0.5, known.max(axis=0) + 0.5
        self._add_ground(low, high)
        low, high = scene.view_m(low, high, trail_m)
        self.bounds_m = (*low.tolist(), *high.tolist())
        for centres_m, colour in (
            (scene.obstacles_m, _OBSTACLE),
            (scene.walls_m, _WALL),
        ):
            for first in range(0, len(centres_m), _IN_A_MESH):
                self._mesh(
                    colour,
                    **pillars(
                        centres_m[first : first + _IN_A_MESH],
                        scene.radius_m,
                        scene.height_m,
                    ),
                )
        for pose, colour in ((scene.start, START), (scene.goal, GOAL)):
            if pose is not None:
                self._mesh(
                    colour, **pillars(np.array([[pose.x, pose.y]]), _DISC_M, 0.008)
                )
        self._robot = [
            (self._add(self._shape(part)), part) for part in robot_parts(chassis, lidar)
        ]
        self._dots: list[int] = []
        self._moving = [] if moving is None else self._add_bodies(moving, MOVER)
        self._add_bodies(scene.boxes, _WALL)
        self._ground_m = float(model_of(chassis).footing[2])
        self._trail = self._add_trail(trail_m)

    def __enter__(self) -> Self:
        """Return the studio."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release the renderer."""
        self._client.close()

    def picture(
        self,
        pose: Pose2D,
        camera: Camera,
        size: tuple[int, int],
        *,
        driven: int = 0,
        finer: int = 2,
        places: Points = _NOWHERE,
        passed: Points = _NOWHERE,
    ) -> Pixels:
        """Return the picture (height, width, 3) of the robot at a pose, in the map frame.

        size: width, height. driven: points of the trail so far. finer: drawn so many times as large, for smooth edges.
        places (n, 2): where what moves is; without, it stays. passed (k, 2): where it just was, shown as dots.
        """
        self._put_robot(pose)
        self._put_moving(places, passed)
        for index, body, middle, yaw in self._trail:
            self._put(body, middle if index <= driven else _HIDDEN_M, yaw)
        width, height = size
        view = bullet.computeViewMatrix(camera.eye, camera.target, camera.up)
        lens = bullet.computeProjectionMatrixFOV(
            camera.opening_deg, width / height, 0.1, 80.0
        )
        look = {
            "lightDirection": _LIGHT_FROM,
            "shadow": 0,
            "renderer": bullet.ER_TINY_RENDERER,
        }
        size = finer * width, finer * height
        drawn = bullet.getCameraImage(
            *size, view, lens, **look, physicsClientId=self._client.id
        )
        fine = np.reshape(drawn[2], (height, finer, width, finer, 4))[..., :3]
        mean: Pixels = fine.mean(axis=(1, 3)).round().astype(np.uint8)
        return mean

    def _add_ground(self, low: Floats, high: Floats) -> None:
        middle, (wide, long) = (0.5 * (low + high)).tolist(), (high - low).tolist()
        self._put(
            self._add(
                self._primitive((wide + _AROUND_M, long + _AROUND_M, 0.02), _GROUND)
            ),
            (*middle, -0.011),
        )
        across, along = (
            self._primitive((0.012, long, 0.002), _LINE),
            self._primitive((wide, 0.012, 0.002), _LINE),
        )
        for x in range(math.ceil(low[0]), math.floor(high[0]) + 1):
            self._put(self._add(across), (float(x), middle[1], 0.0))
        for y in range(math.ceil(low[1]), math.floor(high[1]) + 1):
            self._put(self._add(along), (middle[0], float(y), 0.0))

    def _put_robot(self, pose: Pose2D) -> None:
        base = bullet.getQuaternionFromEuler((0.0, 0.0, pose.yaw))
        for body, part in self._robot:
            turn = bullet.getQuaternionFromEuler((part.roll, part.pitch, 0.0))
            where = bullet.multiplyTransforms(
                (pose.x, pose.y, -self._ground_m), base, part.centre, turn
            )
            bullet.resetBasePositionAndOrientation(
                body, *where, physicsClientId=self._client.id
            )

    def _put_moving(self, places: Points, passed: Points) -> None:
        for (body, yaw, height_m), (x, y) in zip(
            self._moving, places.tolist(), strict=False
        ):
            self._put(body, (x, y, 0.5 * height_m), yaw)
        while len(self._dots) < len(passed):
            self._dots.append(self._add(self._primitive((_DOT_M, 0.004), MOVER)))
        shown = [(x, y, 0.004) for x, y in passed.tolist()]
        for body, where in zip(
            self._dots, chain(shown, repeat(_HIDDEN_M)), strict=False
        ):
            self._put(body, where)

    def _add_trail(self, points_m: Floats) -> list[tuple[int, int, Triple, float]]:
        """Lay out pieces of the trail, below the ground until they are driven; each has the point that ends it."""
        pieces, last = [], 0
        for index in range(1, len(points_m)):
            step = points_m[index] - points_m[last]
            length = float(np.hypot(*step))
            if length < _TRAIL_STEP_M:
                continue
            x, y = (0.5 * (points_m[index] + points_m[last])).tolist()
            body = self._add(
                self._primitive((length + 0.02, _TRAIL_WIDTH_M, 0.004), TRAIL)
            )
            pieces.append((index, body, (x, y, 0.004), math.atan2(step[1], step[0])))
            last = index
        return pieces

    def _add_bodies(
        self, bodies: Bodies, colour: str
    ) -> list[tuple[int, float, float]]:
        """Add upright cylinders and boxes; return of each its number, heading and height."""
        placed = []
        for (x, y, yaw), radius, size, height in zip(
            *(part.tolist() for part in bodies), strict=True
        ):
            body = self._add(
                self._primitive((radius, height) if radius else (*size, height), colour)
            )
            self._put(body, (x, y, 0.5 * height), yaw)
            placed.append((body, yaw, height))
        return placed

    def _shape(self, part: RobotPart) -> int:
        if part.corners:
            return self._visual(
                bullet.GEOM_MESH, part.colour, **prism(part.corners, part.sizes[0])
            )
        return self._primitive(part.sizes, part.colour)

    def _mesh(self, colour: str, **mesh: Sequence[float]) -> None:
        """Add a mesh where its vertices are."""
        self._put(
            self._add(self._visual(bullet.GEOM_MESH, colour, **mesh)), (0.0, 0.0, 0.0)
        )

    def _primitive(self, sizes: Sequence[float], colour: str) -> int:
        """Make a box of three sizes, a cylinder of radius and length, or a ball of a radius."""
        if len(sizes) == 3:
            return self._visual(
                bullet.GEOM_BOX, colour, halfExtents=[0.5 * size for size in sizes]
            )
        if len(sizes) == 1:
            return self._visual(bullet.GEOM_SPHERE, colour, radius=sizes[0])
        return self._visual(
            bullet.GEOM_CYLINDER, colour, radius=sizes[0], length=sizes[1]
        )

    def _visual(self, kind: int, colour: str, **sizes: float | Sequence[float]) -> int:
        shine: dict[str, Any] = {
            "specularColor": (0.1, 0.1, 0.1),
            "physicsClientId": self._client.id,
        }
        red, green, blue = (int(colour[at : at + 2], 16) / 255.0 for at in (1, 3, 5))
        made: int = bullet.createVisualShape(
            kind, rgbaColor=(red, green, blue, 1.0), **shine, **sizes
        )
        return made

    def _add(self, shape: int) -> int:
        """Add a body, hidden below the ground."""
        at = {"baseVisualShapeIndex": shape, "basePosition": _HIDDEN_M}
        made: int = bullet.createMultiBody(**at, physicsClientId=self._client.id)
        return made

    def _put(self, body: int, where: Triple, yaw: float = 0.0) -> None:
        turn = bullet.getQuaternionFromEuler((0.0, 0.0, yaw))
        bullet.resetBasePositionAndOrientation(
            body, where, turn, physicsClientId=self._client.id
        )


def prism(corners: Sequence[Corner], height_m: float) -> dict[str, list[Any]]:
    """Return an upright prism of convex corners (k, 2) about its middle as a closed mesh with a normal to each face."""
    around = np.asarray(corners, np.float64)
    low, high = (
        np.column_stack([around, np.full(len(around), level)])
        for level in (-0.5 * height_m, 0.5 * height_m)
    )
    faces = [low[::-1], high]
    following = np.roll(np.arange(len(around)), -1)
    faces += [
        np.array([low[k], low[n], high[n], high[k]]) for k, n in enumerate(following)
    ]
    made: dict[str, list[Any]] = {"vertices": [], "indices": [], "normals": []}
    for face in faces:
        across, first = (
            np.cross(face[1] - face[0], face[2] - face[1]),
            len(made["vertices"]),
        )
        made["indices"] += [
            i
            for k in range(1, len(face) - 1)
            for i in (first, first + k, first + k + 1)
        ]
        made["vertices"] += face.tolist()
        made["normals"] += [(across / np.linalg.norm(across)).tolist()] * len(face)
    return made


def pillars(
    centres_m: Floats, radius_m: float, height_m: float
) -> dict[str, list[Any]]:
    """Return upright cylinders at centres (k, 2) as one mesh of sides and tops, with vertices, indices and normals."""
    angles = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    around = np.column_stack([np.cos(angles), np.sin(angles)])
    low, high = np.zeros((_SIDES, 1)), np.full((_SIDES, 1), height_m)
    rim = [np.hstack([radius_m * around, level]) for level in (low, high, high)]
    one = np.vstack([*rim, [[0.0, 0.0, height_m]]])
    outwards, upwards = (
        np.hstack([around, low]),
        np.tile([0.0, 0.0, 1.0], (_SIDES + 1, 1)),
    )
    normals = np.vstack([outwards, outwards, upwards])
    here = np.arange(_SIDES)
    after, last = (here + 1) % _SIDES, np.full(_SIDES, 3 * _SIDES)
    sides = [(here, after, after + _SIDES), (here, after + _SIDES, here + _SIDES)]
    tops = [(here + 2 * _SIDES, after + 2 * _SIDES, last)]
    faces = np.vstack([np.column_stack(corners) for corners in sides + tops])
    shifts = np.column_stack([centres_m, np.zeros(len(centres_m))])
    return {
        "vertices": (shifts[:, None] + one).reshape(-1, 3).tolist(),
        "indices": (len(one) * np.arange(len(centres_m))[:, None, None] + faces)
        .ravel()
        .tolist(),
        "normals": np.tile(normals, (len(centres_m), 1)).tolist(),
    }
