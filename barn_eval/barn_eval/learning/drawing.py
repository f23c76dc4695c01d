"""Pictures of an episode from above, fast enough for films."""

import math

import numpy as np
from PIL import Image, ImageDraw

from barn_eval.learning.episodes import Episodes
from barn_eval.results.bags.messages import trial_scene
from barn_eval.results.bags.movers import TRAIL_S
from barn_eval.trials.spec import TrialSpec
from barn_planners.navigation.scan_planner import scan_points
from barn_worlds.base.arrays import Bytes, Points
from barn_worlds.base.types import Pose2D, seconds
from barn_worlds.drawing.palette import (
    FAINT,
    GOAL,
    MOVER,
    OBSTACLE,
    ROBOT,
    SCAN,
    TRAIL,
    WALL,
    WHITE,
)
from barn_worlds.geometry.bodies import Bodies, moving_bodies
from barn_worlds.geometry.polygon import convex_hull

_PIXELS_PER_M = 50.0
_MARGIN_M = 0.6
# A tip ahead of the robot shows where its front is; as a share of the robot's width.
_NOSE_SHARE = 0.1 / 0.43
# Time between the points of a mover's trail.
_TRAIL_STEP_S = 0.1


class TopView:
    """Draws one episode from above. The world is drawn once."""

    def __init__(self, spec: TrialSpec, index: int = 0):
        """Draw what never moves: the world, its path and the goal's circle.

        Args:
            spec: The trial.
            index: Row of its robot among the episodes.
        """
        self._index = index
        scene = trial_scene(spec)
        bounds_m = np.reshape(spec.world.bounds_m, (2, 2))
        extent_m = np.vstack([bounds_m, scene.ends_m()])
        self._left_m, bottom_m = extent_m.min(axis=0) - _MARGIN_M
        right_m, self._top_m = extent_m.max(axis=0) + _MARGIN_M
        width = math.ceil((right_m - self._left_m) * _PIXELS_PER_M)
        height = math.ceil((self._top_m - bottom_m) * _PIXELS_PER_M)
        self._world = Image.new("RGB", (width, height), WHITE)
        self._trail: list[tuple[float, float]] = []

        draw = ImageDraw.Draw(self._world)
        draw.line(self._to_pixels(scene.path_m), fill=FAINT, width=2)
        for centers_m, color in ((scene.walls_m, WALL), (scene.obstacles_m, OBSTACLE)):
            for center in self._to_pixels(centers_m):
                draw.circle(center, scene.radius_m * _PIXELS_PER_M, fill=color)
        self._draw_bodies(draw, scene.boxes, WALL)
        (goal,) = self._to_pixels(scene.ends_m()[-1:])
        draw.circle(goal, scene.goal_distance_m * _PIXELS_PER_M, outline=GOAL, width=2)
        draw.circle(goal, 4, fill=GOAL)

    def extend_trail(self, episodes: Episodes) -> None:
        """Append the robot's true position, in pixels, to the trail; never clears it."""
        self._trail += self._to_pixels(episodes.readings.truths[[self._index], :2])

    def draw(self, episodes: Episodes) -> Bytes:
        """Return the robot and all movers now as an RGB picture (height, width, 3)."""
        picture = self._world.copy()
        draw = ImageDraw.Draw(picture)
        spec = episodes.trial(self._index).spec
        motion_s = spec.phase_s + seconds(int(episodes.readings.stamps_ns[self._index]))
        times_s = motion_s - np.arange(0.0, TRAIL_S, _TRAIL_STEP_S)
        # Motions are known for all times, so trails begin before the trial does.
        trails_m, _ = spec.world.tracks.over(times_s)
        for point in self._to_pixels(trails_m.reshape(-1, 2)):
            draw.circle(point, 2, fill=MOVER)
        self._draw_bodies(draw, moving_bodies(spec.world.tracks, motion_s), MOVER)
        if len(self._trail) > 1:
            draw.line(self._trail, fill=TRAIL, width=2)

        pose = Pose2D(*episodes.readings.truths[self._index].tolist())
        # The returns of the last scan, as seen from the true pose.
        lidar = spec.simulator.lidar
        mount = Pose2D(lidar.mount_x_m, lidar.mount_y_m, lidar.mount_yaw_rad)
        hits_m = scan_points(episodes.scan(self._index), mount, math.inf)
        draw.point(self._to_pixels(pose.transform(hits_m)), fill=SCAN)
        chassis = spec.simulator.chassis
        _, right_m, front_m, left_m = chassis.extent_m
        nose = (front_m + _NOSE_SHARE * (left_m - right_m), 0.0)
        outline_m = pose.transform(np.array(convex_hull([*chassis.hull_m, nose])))
        draw.polygon(self._to_pixels(outline_m), fill=ROBOT)
        return np.asarray(picture)

    def _draw_bodies(
        self, draw: ImageDraw.ImageDraw, bodies: Bodies, color: str
    ) -> None:
        """Fill the outlines of bodies, which are in the map frame in m."""
        for outline in bodies.outlines():
            draw.polygon(self._to_pixels(outline), fill=color)

    def _to_pixels(self, points_m: Points) -> list[tuple[float, float]]:
        """Return pixels (right, down) of points (n, 2) in the map frame in m."""
        # Rows of a picture count from its top, but y from below.
        return [
            ((x - self._left_m) * _PIXELS_PER_M, (self._top_m - y) * _PIXELS_PER_M)
            for x, y in points_m.tolist()
        ]
