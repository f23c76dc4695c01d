"""The moving obstacles of a trial as its bag has them: poses ten times a second, and what lies between."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from barn_worlds.base.arrays import Bools, Floats, Points
from barn_worlds.geometry.bodies import Bodies
from barn_worlds.geometry.footprint import Footprint

TRAIL_S = 2.0
MAX_EXTRAPOLATION_S = 0.1  # the last poses are as much older than the last reading
# Nothing is taken for a motion that is this much faster than the same obstacle just before and just after.
_JUMP_MPS, _JUMP_RATIO = 3.0, 3.0


@dataclass(frozen=True, eq=False)
class RecordedMotions:
    """Moving obstacles over time, and the walls that stand between them, in the map frame."""

    times_s: Floats  # (m,) ascending, m at least 1
    places: Floats  # (m, n, 2) m
    bodies: Bodies
    walls: Bodies

    @cached_property
    def jumps(self) -> Bools:
        """Whether (m, n) an obstacle has jumped to a place from the one before; an obstacle does so as it repeats."""
        found = np.zeros(self.places.shape[:2], np.bool_)
        if len(self.times_s) > 1:
            steps = np.linalg.norm(np.diff(self.places, axis=0), axis=2)
            speeds = np.pad(steps / np.diff(self.times_s)[:, None], ((1, 1), (0, 0)))
            usual = np.maximum(speeds[:-2], speeds[2:])
            found[1:] = speeds[1:-1] > _JUMP_MPS + _JUMP_RATIO * usual
        return found

    def at(self, times_s: Floats) -> Floats:
        """Return places (t, n, 2) at times (t,): straight between two, and on for a moment after the last."""
        if len(self.times_s) == 1:
            return np.repeat(self.places, len(times_s), axis=0)
        before = np.clip(
            np.searchsorted(self.times_s, times_s + 1e-9, side="right") - 1,
            0,
            len(self.times_s) - 2,
        )
        after_s = np.clip(times_s - self.times_s[before], 0.0, None)
        period_s = self.times_s[before + 1] - self.times_s[before]
        share = np.minimum(after_s, period_s + MAX_EXTRAPOLATION_S) / period_s
        jump = self.jumps[before + 1]
        share = np.where(
            jump, np.floor(np.minimum(share, 1.0))[:, None], share[:, None]
        )[..., None]
        places: Floats = self.places[before] + share * (
            self.places[before + 1] - self.places[before]
        )
        return places

    def placed(self, time_s: float) -> Bodies:
        """Return the obstacles where they are at a time."""
        return self.bodies.move_to(self.at(np.array([time_s]))[0])

    def trails(self, time_s: float) -> list[Points]:
        """Return where each was in the last `TRAIL_S`, (k, 2) m, since it last jumped."""
        now = self.at(np.array([time_s]))[0]
        last = int(np.searchsorted(self.times_s, time_s + 1e-9, side="right"))
        first = int(np.searchsorted(self.times_s, time_s - TRAIL_S))
        begun = [
            max(np.flatnonzero(jumps), default=0) for jumps in self.jumps[first:last].T
        ]  # at the last jump
        return [
            np.vstack([self.places[first + begin : last, k], now[k]])
            for k, begin in enumerate(begun)
        ]

    def gaps(self, times_s: Floats, poses: Floats, outline: Footprint) -> Floats:
        """Return the distance (t,) in m from the robot's outline at poses (t, 3) to what is nearest, walls included."""
        return compute_gaps(self.bodies, self.walls, self.at(times_s), poses, outline)


def compute_gaps(
    bodies: Bodies, walls: Bodies, places: Floats, poses: Floats, outline: Footprint
) -> Floats:
    """Return the distance (t,) in m from the robot's outline at poses (t, 3) to the nearest of bodies and walls.

    places (t, n, 2): of the bodies.
    """
    rows = np.concatenate([bodies.shapes(), walls.shapes()])
    found = np.empty(len(poses))
    for k, (at, (x, y, yaw)) in enumerate(zip(places, poses.tolist(), strict=True)):
        rows[: len(at), :2] = at
        found[k] = outline.gaps(rows, x, y, yaw).min(initial=np.inf)
    return found
