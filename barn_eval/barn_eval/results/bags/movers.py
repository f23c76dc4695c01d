"""Moving obstacles of a trial from its bag, which has ten poses a second."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from barn_worlds.base.arrays import Bools, Floats, Points
from barn_worlds.geometry.bodies import Bodies
from barn_worlds.geometry.footprint import Footprint

TRAIL_S = 2.0

# How long motion is extrapolated after the last recorded pose.
MAX_EXTRAPOLATION_S = 0.1

# A step is a jump, not a motion, if it is faster than `_JUMP_MPS` plus `_JUMP_RATIO` times
# the faster neighboring step.
_JUMP_MPS = 3.0
_JUMP_RATIO = 3.0

# Tolerance for rounded times [s].
ROUNDING_S = 1e-9


@dataclass(frozen=True, eq=False)
class RecordedMotions:
    """Moving obstacles over time, and the walls between them, in the map frame."""

    times_s: Floats  # (m,) ascending, m at least 1
    places: Floats  # (m, n, 2) m
    bodies: Bodies
    walls: Bodies

    @cached_property
    def jumps(self) -> Bools:
        """Mask (m, n): whether an obstacle jumped to a place from its previous one.

        An obstacle jumps when it begins its motion again.
        """
        jumps = np.zeros(self.places.shape[:2], np.bool_)
        if len(self.times_s) > 1:
            steps = np.linalg.norm(np.diff(self.places, axis=0), axis=2)
            speeds = np.pad(steps / np.diff(self.times_s)[:, None], ((1, 1), (0, 0)))
            neighbors = np.maximum(speeds[:-2], speeds[2:])
            jumps[1:] = speeds[1:-1] > _JUMP_MPS + _JUMP_RATIO * neighbors
        return jumps

    def at(self, times_s: Floats) -> Floats:
        """Return places (t, n, 2) [m] at times (t,), extrapolated by at most 0.1 s.

        Motion is linear between two poses, and goes on for a moment after the last one.
        """
        if len(self.times_s) == 1:
            return np.repeat(self.places, len(times_s), axis=0)
        after = np.searchsorted(self.times_s, times_s + ROUNDING_S, side="right")
        # No step begins at the last pose, so the previous step goes on.
        before = np.clip(after - 1, 0, len(self.times_s) - 2)
        after_s = np.clip(times_s - self.times_s[before], 0.0, None)
        period_s = self.times_s[before + 1] - self.times_s[before]
        share = np.minimum(after_s, period_s + MAX_EXTRAPOLATION_S) / period_s

        # An obstacle that jumps stays until the moment of the jump.
        stepped = np.floor(np.minimum(share, 1.0))
        share = np.where(self.jumps[before + 1], stepped[:, None], share[:, None])
        steps = self.places[before + 1] - self.places[before]
        return self.places[before] + share[..., None] * steps

    def trails(self, time_s: float) -> list[Points]:
        """Return each obstacle's places (k, 2) [m] in the last `TRAIL_S`, after any jump.

        Args:
            time_s: End of the trails.
        """
        places_now = self.at(np.array([time_s]))[0]
        end = int(np.searchsorted(self.times_s, time_s + ROUNDING_S, side="right"))
        start = int(np.searchsorted(self.times_s, time_s - TRAIL_S))
        trails = []
        for k, place in enumerate(places_now):
            last_jump = max(np.flatnonzero(self.jumps[start:end, k]), default=0)
            past = self.places[start + last_jump : end, k]
            trails.append(np.vstack([past, place]))
        return trails


def compute_gaps(
    bodies: Bodies, walls: Bodies, places: Floats, poses: Floats, outline: Footprint
) -> Floats:
    """Return the distance (t,) in m from the robot to the nearest body, inf without any.

    Args:
        bodies: Moving bodies, n of them.
        walls: Bodies that do not move.
        places: Centers (t, n, 2) of the moving bodies in m.
        poses: Poses (t, 3) of the robot: x, y m, yaw rad.
        outline: Outline of the robot in base_link.
    """
    shapes = np.concatenate([bodies.shapes(), walls.shapes()])
    gaps = np.empty(len(poses))
    for k, (x, y, yaw) in enumerate(poses.tolist()):
        shapes[: places.shape[1], :2] = places[k]
        gaps[k] = outline.gaps(shapes, x, y, yaw).min(initial=np.inf)
    return gaps
