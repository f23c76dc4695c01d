"""Pictures of a trial in three dimensions, without a display or a graphics card.

PyBullet's software renderer draws them. Nothing here takes part in a simulation: the
scene is built anew, of shapes that can only be seen.
"""

import math
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from barn_sim.config import LidarConfig
from barn_sim.contact.bullet import bullet, connect, disconnect
from barn_sim.drawing.meshes import Mesh, pillars, prism
from barn_sim.drawing.robot_parts import RobotPart, robot_parts
from barn_worlds.base.arrays import Floats, Points
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.base.types import Pose2D
from barn_worlds.drawing.palette import GOAL, MOVER, START, TRAIL
from barn_worlds.geometry.bodies import Bodies
from barn_worlds.robots.files import STANDARD_ROBOT
from barn_worlds.robots.robot import Chassis, Vector3
from barn_worlds.worlds.scene import TrialScene

Pixels = npt.NDArray[np.uint8]

SIZES = {"chase": (640, 400), "top": (800, 336), "side": (800, 360)}
"""Width and height in pixels of each camera's picture."""

CAMERAS = tuple(SIZES)

# Light falls aslant and darkens, so obstacles and walls begin lighter than on paper.
_GROUND = "#edf0f2"
_LINE = "#ccd1d9"
_OBSTACLE = "#5c6b85"
_WALL = "#b3bac7"
_LIGHT_FROM = (-2.0, -3.0, 6.0)

# Pillars in one mesh; the renderer limits the number of vertices.
_PILLARS = 200
_DISC_M = 0.16
_DOT_M = 0.05
_TRAIL_STEP_M = 0.12
_TRAIL_WIDTH_M = 0.05
# Ground beyond the scene.
_MARGIN_M = 60.0
_HIDDEN_M = (0.0, 0.0, -5.0)
_NO_POINTS = np.empty((0, 2))


@dataclass(frozen=True)
class Camera:
    """Place and lens of a camera, in the map frame."""

    eye: Vector3
    """Position, m."""

    target: Vector3
    """Point in the middle of the picture, m."""

    up: Vector3 = (0.0, 0.0, 1.0)
    """Direction that points up in the picture."""

    opening_deg: float = 50.0
    """Vertical opening angle."""


def camera_at(name: str, pose: Pose2D, bounds_m: Sequence[float]) -> Camera:
    """Return the camera "chase", "top" or "side"; an unknown name is a ConfigError.

    In "top" and "side" the robot drives to the right.

    Args:
        name: "chase" behind the robot, "top" or "side" for the whole scene.
        pose: Pose of the robot in the map frame, for "chase".
        bounds_m: x_min, y_min, x_max, y_max of the scene.

    Raises:
        ConfigError: If there is no camera of that name.
    """
    if name not in SIZES:
        raise ConfigError(
            f"camera must be one of {', '.join(CAMERAS)}, got {name!r}"
            f"{suggest(name, CAMERAS)}"
        )
    if name == "chase":
        cosine = math.cos(pose.yaw)
        sine = math.sin(pose.yaw)
        # Behind and above the robot, looking ahead of it: obstacles in front stay in
        # the picture while it turns.
        eye = (pose.x - 1.45 * cosine, pose.y - 1.45 * sine, 1.75)
        target = (pose.x + 0.8 * cosine, pose.y + 0.8 * sine, 0.1)
        return Camera(eye, target, opening_deg=55.0)

    left, low, right, high = bounds_m
    width = right - left
    length = high - low
    x = 0.5 * (left + right)
    y = 0.5 * (low + high)
    pixels_wide, pixels_high = SIZES[name]
    aspect = pixels_high / pixels_wide
    if name == "top":
        height = 30.0
        # Whichever side of the scene is tighter in the picture decides, with 3% to
        # spare.
        half = 1.03 * 0.5 * max(width, length * aspect)
        # From 30 m up, the tops of obstacles (1 m) lean outwards by little; they are
        # what has to fit.
        distance = height - 1.0
        opening = 2.0 * math.degrees(math.atan(half / distance))
        return Camera((x, y, height), (x, y, 0.0), (-1.0, 0.0, 0.0), opening)

    distance = 1.1 * length
    height = 0.8 * length
    # The whole length fits into the width; 0.56 instead of 0.5 leaves a margin for the
    # near end, which looks larger.
    slope = 0.56 * length / math.hypot(distance, height) * aspect
    opening = 2.0 * math.degrees(math.atan(slope))
    return Camera((x + distance, y, height), (x, y, 0.0), opening_deg=opening)


class Studio(AbstractContextManager["Studio"]):
    """A scene with a robot in it; a context manager that ends the renderer."""

    bounds_m: tuple[float, float, float, float]
    """x_min, y_min, x_max, y_max of the scene in the map frame."""

    def __init__(
        self,
        scene: TrialScene,
        lidar: LidarConfig,
        *,
        trail_m: Floats = _NO_POINTS,
        moving: Bodies | None = None,
        chassis: Chassis = STANDARD_ROBOT.chassis,
    ):
        """Start a renderer and build the scene with robot, trail and movers in it.

        Args:
            scene: Cylinders, boxes, start and goal.
            lidar: Mounting of the robot's lidar.
            trail_m: Positions (n, 2) of the robot, shown as far as it has come.
            moving: Moving obstacles, shown where each picture has them.
            chassis: The robot.
        """
        self._client = connect(renders=True)
        outlines = scene.boxes.outlines()
        # Everything that is ever seen counts, since bounds that grew would move the
        # camera.
        points = np.concatenate([scene.cylinders_m, scene.ends_m(), *outlines, trail_m])
        low = points.min(axis=0) - 0.5
        high = points.max(axis=0) + 0.5
        self._add_ground(low, high)
        low, high = scene.view_m(low, high, trail_m)
        self.bounds_m = (*low.tolist(), *high.tolist())

        self._add_pillars(scene.obstacles_m, scene, _OBSTACLE)
        self._add_pillars(scene.walls_m, scene, _WALL)
        for pose, color in ((scene.start, START), (scene.goal, GOAL)):
            if pose is not None:
                disc = pillars(np.array([pose.position]), _DISC_M, 0.008)
                self._add_mesh(disc, color)

        self._robot: list[tuple[int, RobotPart]] = []
        for part in robot_parts(chassis, lidar):
            self._robot.append((self._add(self._part_shape(part)), part))
        self._base_height_m = chassis.base_height_m

        self._moving = [] if moving is None else self._add_bodies(moving, MOVER)
        # Dots are created when a picture first needs them, and hidden when it needs
        # fewer.
        self._dots: list[int] = []
        self._add_bodies(scene.boxes, _WALL)
        self._trail = self._add_trail(trail_m)

    def __exit__(self, *_: object) -> None:
        """Release the renderer."""
        disconnect(self._client)

    def picture(
        self,
        pose: Pose2D,
        camera: Camera,
        size: tuple[int, int],
        *,
        driven: int = 0,
        finer: int = 2,
        places: Points = _NO_POINTS,
        passed: Points = _NO_POINTS,
    ) -> Pixels:
        """Return an RGB image of the scene with the robot at a pose; writes no file.

        Args:
            pose: Pose of base_link in the map frame.
            camera: Camera to look through.
            size: Width and height in pixels.
            driven: Number of points of the trail that are behind the robot.
            finer: Factor by which the picture is drawn larger, for smooth edges.
            places: Positions (n, 2) of the moving obstacles; by default they stay.
            passed: Their earlier positions (k, 2), shown as dots.

        Returns:
            Red, green and blue (height, width, 3).
        """
        self._put_robot(pose)
        self._put_moving(places)
        self._put_dots(passed)
        for index, body, middle, yaw in self._trail:
            self._put(body, middle if index <= driven else _HIDDEN_M, yaw)

        width, height = size
        view = bullet.computeViewMatrix(camera.eye, camera.target, camera.up)
        lens = bullet.computeProjectionMatrixFOV(
            camera.opening_deg, width / height, 0.1, 80.0
        )
        image = bullet.getCameraImage(
            finer * width,
            finer * height,
            view,
            lens,
            lightDirection=_LIGHT_FROM,
            shadow=0,
            renderer=bullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        # The mean over blocks of pixels smooths edges, which the renderer itself does
        # not.
        fine = np.reshape(image[2], (height, finer, width, finer, 4))[..., :3]
        pixels: Pixels = fine.mean(axis=(1, 3)).round().astype(np.uint8)
        return pixels

    def _add_ground(self, low: Floats, high: Floats) -> None:
        """Add a plane, and lines 1 m apart between two corners of the scene."""
        x, y = (0.5 * (low + high)).tolist()
        width, length = (high - low).tolist()
        # Far beyond the scene, so that the chase camera sees no edge of the ground. Its
        # top lies just below the lines, or both would flicker.
        plane = (width + _MARGIN_M, length + _MARGIN_M, 0.02)
        self._put(self._add(self._primitive(plane, _GROUND)), (x, y, -0.011))

        along_y = self._primitive((0.012, length, 0.002), _LINE)
        along_x = self._primitive((width, 0.012, 0.002), _LINE)
        for line_x in range(math.ceil(low[0]), math.floor(high[0]) + 1):
            self._put(self._add(along_y), (float(line_x), y, 0.0))
        for line_y in range(math.ceil(low[1]), math.floor(high[1]) + 1):
            self._put(self._add(along_x), (x, float(line_y), 0.0))

    def _add_pillars(self, centers_m: Points, scene: TrialScene, color: str) -> None:
        """Add upright cylinders at centers (n, 2) in m, in meshes of up to 200."""
        # A body per group instead of one per pillar: worlds have hundreds.
        for first in range(0, len(centers_m), _PILLARS):
            group = centers_m[first : first + _PILLARS]
            self._add_mesh(pillars(group, scene.radius_m, scene.height_m), color)

    def _add_trail(self, points_m: Floats) -> list[tuple[int, int, Vector3, float]]:
        """Add trail pieces, hidden; return point, body, center (m) and yaw of each.

        Returns:
            Of each piece the point that ends it, its body, its center and its yaw.
        """
        pieces = []
        last = 0
        for index in range(1, len(points_m)):
            step = points_m[index] - points_m[last]
            length = float(np.hypot(*step))
            if length < _TRAIL_STEP_M:
                continue
            x, y = (0.5 * (points_m[index] + points_m[last])).tolist()
            # Pieces overlap by 2 cm, so that bends show no gaps.
            sizes = (length + 0.02, _TRAIL_WIDTH_M, 0.004)
            body = self._add(self._primitive(sizes, TRAIL))
            yaw = math.atan2(step[1], step[0])
            pieces.append((index, body, (x, y, 0.004), yaw))
            last = index
        return pieces

    def _add_bodies(self, bodies: Bodies, color: str) -> list[tuple[int, float, float]]:
        """Add upright cylinders and boxes; return body, yaw and height of each."""
        placed = []
        columns = [column.tolist() for column in bodies]
        for (x, y, yaw), radius, size, height in zip(*columns, strict=True):
            # A body without a radius is a box, as in `barn_worlds.geometry.kernels`.
            sizes = (radius, height) if radius else (*size, height)
            body = self._add(self._primitive(sizes, color))
            self._put(body, (x, y, 0.5 * height), yaw)
            placed.append((body, yaw, height))
        return placed

    def _put_robot(self, pose: Pose2D) -> None:
        """Move all parts of the robot to a pose of base_link in the map frame."""
        position = (*pose.position, self._base_height_m)
        attitude = bullet.getQuaternionFromEuler((0.0, 0.0, pose.yaw))
        for body, part in self._robot:
            # Parts are separate bodies without joints: the renderer needs only their
            # poses.
            turn = bullet.getQuaternionFromEuler((part.roll, part.pitch, 0.0))
            place = bullet.multiplyTransforms(position, attitude, part.center, turn)
            self._set_pose(body, *place)

    def _put_moving(self, places: Points) -> None:
        """Move moving obstacles to positions (n, 2) in m; those beyond n stay."""
        bodies = zip(self._moving, places.tolist(), strict=False)
        for (body, yaw, height_m), (x, y) in bodies:
            self._put(body, (x, y, 0.5 * height_m), yaw)

    def _put_dots(self, points: Points) -> None:
        """Show a dot at each position (k, 2) in m; add missing, hide spare dots."""
        while len(self._dots) < len(points):
            self._dots.append(self._add(self._primitive((_DOT_M, 0.004), MOVER)))
        for body in self._dots[len(points) :]:
            self._put(body, _HIDDEN_M)
        for body, (x, y) in zip(self._dots, points.tolist(), strict=False):
            self._put(body, (x, y, 0.004))

    def _part_shape(self, part: RobotPart) -> int:
        """Create the shape of a robot part; return PyBullet's number of it."""
        if part.corners:
            mesh = prism(part.corners, part.sizes[0])
            return self._visual(bullet.GEOM_MESH, part.color, **mesh)
        return self._primitive(part.sizes, part.color)

    def _add_mesh(self, mesh: Mesh, color: str) -> None:
        """Add a body of a mesh whose vertices are in the map frame."""
        body = self._add(self._visual(bullet.GEOM_MESH, color, **mesh))
        self._put(body, (0.0, 0.0, 0.0))

    def _primitive(self, sizes: Sequence[float], color: str) -> int:
        """Create a box (3 sizes), cylinder (2) or ball (1); return its number."""
        if len(sizes) == 3:
            half_sizes = [0.5 * size for size in sizes]
            return self._visual(bullet.GEOM_BOX, color, halfExtents=half_sizes)
        if len(sizes) == 2:
            radius, length = sizes
            return self._visual(
                bullet.GEOM_CYLINDER, color, radius=radius, length=length
            )
        return self._visual(bullet.GEOM_SPHERE, color, radius=sizes[0])

    def _visual(self, kind: int, color: str, **sizes: object) -> int:
        """Create a visual shape of a color #rrggbb; return PyBullet's number of it."""
        red, green, blue = bytes.fromhex(color[1:])
        shape: int = bullet.createVisualShape(
            kind,
            rgbaColor=(red / 255.0, green / 255.0, blue / 255.0, 1.0),
            specularColor=(0.1, 0.1, 0.1),
            physicsClientId=self._client,
            **sizes,
        )
        return shape

    def _add(self, shape: int) -> int:
        """Add a body of a shape, hidden below the ground; return PyBullet's number."""
        body: int = bullet.createMultiBody(
            baseVisualShapeIndex=shape,
            basePosition=_HIDDEN_M,
            physicsClientId=self._client,
        )
        return body

    def _put(self, body: int, position: Vector3, yaw: float = 0.0) -> None:
        """Move a body to a position in m, upright, at a yaw in rad."""
        attitude = bullet.getQuaternionFromEuler((0.0, 0.0, yaw))
        self._set_pose(body, position, attitude)

    def _set_pose(
        self, body: int, position: Sequence[float], attitude: Sequence[float]
    ) -> None:
        """Set a body's position (m) and attitude (quaternion x, y, z, w)."""
        bullet.resetBasePositionAndOrientation(
            body, position, attitude, physicsClientId=self._client
        )
