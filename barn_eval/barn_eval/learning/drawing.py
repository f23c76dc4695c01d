"""Pictures of an episode from above, quick enough to make a film of."""

import math

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from barn_eval.learning.episodes import Episodes
from barn_eval.results.bags.messages import trial_scene
from barn_eval.results.bags.movers import TRAIL_S
from barn_eval.trials.spec import TrialSpec
from barn_worlds.base.arrays import Points
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

_NOSE = 0.1 / 0.43  # of the width, ahead of the robot, to tell its front
_PIXELS_PER_M = 50.0
_BEYOND_M = 0.6  # shown all round
_PASSED_STEP_S = 0.1  # between places where what moves was


class TopView:
    """Draws one episode from above; the world is drawn once."""

    def __init__(self, spec: TrialSpec) -> None:
        scene, bounds_m = trial_scene(spec), np.reshape(spec.world.bounds_m, (2, 2))
        seen = np.vstack([bounds_m, scene.ends_m()])
        (self._left, below), (right, self._top) = (
            seen.min(axis=0) - _BEYOND_M,
            seen.max(axis=0) + _BEYOND_M,
        )
        size = (
            math.ceil((right - self._left) * _PIXELS_PER_M),
            math.ceil((self._top - below) * _PIXELS_PER_M),
        )
        self._world = Image.new("RGB", size, WHITE)
        self._trail: list[tuple[float, float]] = []
        draw = ImageDraw.Draw(self._world)
        draw.line(self._pixels(scene.path_m), fill=FAINT, width=2)
        for centres_m, colour in ((scene.walls_m, WALL), (scene.obstacles_m, OBSTACLE)):
            for centre in self._pixels(centres_m):
                draw.circle(centre, scene.radius_m * _PIXELS_PER_M, fill=colour)
        self._fill(draw, scene.boxes, WALL)
        (goal,) = self._pixels(scene.ends_m()[-1:])
        draw.circle(goal, scene.goal_distance_m * _PIXELS_PER_M, outline=GOAL, width=2)
        draw.circle(goal, 4, fill=GOAL)

    def add(self, episodes: Episodes) -> None:
        """Lengthen the trail to where the robot is."""
        self._trail += self._pixels(episodes.readings.truths[:1, :2])

    def draw(self, episodes: Episodes) -> npt.NDArray[np.uint8]:
        """Return the picture (height, width, 3) of this instant: returns of the lidar, trail and robot."""
        picture = self._world.copy()
        draw = ImageDraw.Draw(picture)
        spec, scan = episodes.trial(0).spec, episodes.scan(0)
        pose = Pose2D(*episodes.readings.truths[0].tolist())
        motion_s = spec.phase_s + seconds(int(episodes.readings.stamps_ns[0]))
        passed_m, _ = spec.world.tracks.over(
            motion_s - np.arange(0.0, TRAIL_S, _PASSED_STEP_S)
        )
        for place in self._pixels(passed_m.reshape(-1, 2)):
            draw.circle(place, 2, fill=MOVER)
        self._fill(draw, moving_bodies(spec.world.tracks, motion_s), MOVER)
        if len(self._trail) > 1:
            draw.line(self._trail, fill=TRAIL, width=2)
        chassis, mount = spec.simulator.chassis, spec.simulator.lidar
        seen = np.isfinite(scan.ranges)
        ranges, angles = scan.ranges[seen].astype(np.float64), scan.angles()[seen]
        lidar = pose @ Pose2D(mount.mount_x_m, mount.mount_y_m, mount.mount_yaw_rad)
        hits = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1)
        draw.point(self._pixels(lidar.transform(hits)), fill=SCAN)
        _, right_m, front_m, left_m = chassis.extent_m
        nose = (front_m + _NOSE * (left_m - right_m), 0.0)
        draw.polygon(
            self._pixels(
                pose.transform(np.array(convex_hull([*chassis.hull_m, nose])))
            ),
            fill=ROBOT,
        )
        return np.asarray(picture)

    def _fill(self, draw: ImageDraw.ImageDraw, bodies: Bodies, colour: str) -> None:
        for outline in bodies.outlines():
            draw.polygon(self._pixels(outline), fill=colour)

    def _pixels(self, points_m: Points) -> list[tuple[float, float]]:
        return [
            ((x - self._left) * _PIXELS_PER_M, (self._top - y) * _PIXELS_PER_M)
            for x, y in points_m.tolist()
        ]
