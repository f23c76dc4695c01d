"""Pictures of an episode: from above, quick enough to make a film of, or in three dimensions."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from barn_eval.bags.movers import TRAIL_S
from barn_eval.learning.episode import Episode
from barn_sim.sensors.camera import SIZES, Studio, camera_at
from barn_worlds.base.arrays import Points
from barn_worlds.base.types import Pose2D, seconds
from barn_worlds.geometry.bodies import MOVING_COLOUR, Bodies, moving_bodies, wall_bodies
from barn_worlds.geometry.polygon import hull
from barn_worlds.moving.tracks import Tracks

_NOSE = 0.1 / 0.43  # of the width, ahead of the robot, to tell its front
_PIXELS_PER_M = 50.0
_BEYOND_M = 0.6  # shown all round
# Okabe and Ito's palette
_FREE, _OBSTACLE, _PATH, _GOAL = "#ffffff", "#4d4d4d", "#b0b0b0", "#009E73"
_ROBOT, _TRAIL, _HIT = "#0072B2", "#56B4E9", "#D55E00"
_WAY, _WAY_STEP_S = "#bdadc6", 0.1  # of what moves


class Picture:
    """Draws one episode; the world is drawn once."""

    def __init__(self, episode: Episode) -> None:
        spec = episode.spec
        x_min, y_min, x_max, y_max = spec.world.bounds_m
        ends = (spec.course.start, spec.course.goal)
        self._left = min(x_min, *(end.x for end in ends)) - _BEYOND_M
        self._top = max(y_max, *(end.y for end in ends)) + _BEYOND_M
        width = max(x_max, *(end.x for end in ends)) + _BEYOND_M - self._left
        height = self._top - min(y_min, *(end.y for end in ends)) + _BEYOND_M
        size = (math.ceil(width * _PIXELS_PER_M), math.ceil(height * _PIXELS_PER_M))
        self._world = Image.new("RGB", size, _FREE)
        self._trail: list[tuple[float, float]] = []
        self._draw_world(episode)

    def _draw_world(self, episode: Episode) -> None:
        world, goal = episode.spec.world, episode.spec.course.goal
        draw = ImageDraw.Draw(self._world)
        draw.line([self._pixel(x, y) for x, y in world.path_m().tolist()], fill=_PATH, width=2)
        radius = world.cylinder_radius_m * _PIXELS_PER_M
        for x, y in world.cylinders_m.tolist():
            draw.circle(self._pixel(x, y), radius, fill=_OBSTACLE)
        self._fill(draw, wall_bodies(world.walls), _OBSTACLE)
        reached = episode.spec.rules.goal_distance_m * _PIXELS_PER_M
        draw.circle(self._pixel(goal.x, goal.y), reached, outline=_GOAL, width=2)
        draw.circle(self._pixel(goal.x, goal.y), 4, fill=_GOAL)

    def add(self, episode: Episode) -> None:
        """Lengthen the trail to where the robot is."""
        pose = episode.sensors.truth.pose
        self._trail.append(self._pixel(pose.x, pose.y))

    def draw(self, episode: Episode) -> npt.NDArray[np.uint8]:
        """Return the picture (height, width, 3) of this instant: returns of the lidar, trail and robot."""
        picture = self._world.copy()
        draw = ImageDraw.Draw(picture)
        pose, scan = episode.sensors.truth.pose, episode.sensors.scan
        self._draw_moving(draw, episode)
        if len(self._trail) > 1:
            draw.line(self._trail, fill=_TRAIL, width=2)
        seen = np.isfinite(scan.ranges)
        ranges, angles = scan.ranges[seen].astype(np.float64), scan.angles()[seen]
        mount = episode.spec.simulator.lidar
        lidar = pose @ Pose2D(mount.mount_x_m, mount.mount_y_m, mount.mount_yaw_rad)
        hits = lidar.transform(np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1))
        for x, y in hits.tolist():
            draw.point(self._pixel(x, y), fill=_HIT)
        chassis = episode.spec.simulator.chassis
        _, right_m, front_m, left_m = chassis.extent_m
        nose = (front_m + _NOSE * (left_m - right_m), 0.0)
        outline = np.array(hull([*chassis.hull_m, nose]))
        draw.polygon([self._pixel(x, y) for x, y in pose.transform(outline).tolist()], fill=_ROBOT)
        return np.asarray(picture)

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    def _draw_moving(self, draw: ImageDraw.ImageDraw, episode: Episode) -> None:
        """Draw what moves, and dots where it was in the last seconds."""
        tracks = episode.spec.world.tracks
        if not len(tracks):
            return
        now_s = _motion_time_s(episode)
        for x, y in _passed(tracks, now_s).tolist():
            draw.circle(self._pixel(x, y), 2, fill=_WAY)
        self._fill(draw, moving_bodies(tracks, now_s), MOVING_COLOUR)

    def _fill(self, draw: ImageDraw.ImageDraw, bodies: Bodies, colour: str) -> None:
        for outline in bodies.outlines():
            draw.polygon([self._pixel(x, y) for x, y in outline.tolist()], fill=colour)

    def _pixel(self, x: float, y: float) -> tuple[float, float]:
        return (x - self._left) * _PIXELS_PER_M, (self._top - y) * _PIXELS_PER_M


class CameraPicture:
    """Draws one episode as a camera sees it; what does not move by itself stays where it stood at its beginning."""

    def __init__(self, episode: Episode, camera: str) -> None:
        spec = episode.spec
        world, course = spec.world, spec.course
        stands = (world.obstacles_m, world.containment_m, world.cylinder_radius_m, world.cylinder_height_m)
        self._camera = camera
        more: dict[str, Any] = {"start": course.start, "goal": course.goal}
        if world.moving or world.walls:
            more |= {"boxes": wall_bodies(world.walls), "moving": moving_bodies(world.tracks, spec.phase_s)}
        self._studio = Studio(*stands, spec.simulator.lidar, chassis=spec.simulator.chassis, **more)

    def add(self, episode: Episode) -> None:
        """Do nothing: a trail is not drawn."""

    def draw(self, episode: Episode) -> npt.NDArray[np.uint8]:
        """Return the picture (height, width, 3) of this instant."""
        pose = episode.sensors.truth.pose
        view = camera_at(self._camera, pose, self._studio.bounds_m)
        tracks = episode.spec.world.tracks
        more: dict[str, Any] = {}
        if len(tracks):
            now_s = _motion_time_s(episode)
            more = {"places": tracks.at(now_s)[0], "passed": _passed(tracks, now_s)}
        return self._studio.picture(pose, view, SIZES[self._camera], finer=1, **more)

    def close(self) -> None:
        """Release the renderer."""
        self._studio.close()


def _passed(tracks: Tracks, now_s: float) -> Points:
    """Return where moving obstacles were in the last seconds (k, 2)."""
    return tracks.over(now_s - np.arange(0.0, TRAIL_S, _WAY_STEP_S))[0].reshape(-1, 2)


def _motion_time_s(episode: Episode) -> float:
    """Return how far into their motions what moves is."""
    return episode.spec.phase_s + seconds(episode.sensors.stamp_ns)
