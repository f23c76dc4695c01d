"""The elastic band as an object: the data of the compiled loops, and reasons of failures."""

import numpy as np

from barn_planners import eband_kernels as kernels
from barn_planners.costmap import INSCRIBED, LETHAL, Costmap
from barn_planners.eband_config import EBandConfig
from barn_planners.eband_forces import optimise
from barn_planners.interface import FloatArray
from barn_worlds.types import Pose2D

_FULL_COST = 252.0


def bubble_radii(cost_weight_per_m: float) -> FloatArray:
    """Return the radius in metres by cost, (256,): 0 for lethal and inscribed; free and unknown as for cost 1."""
    costs = np.maximum(np.arange(256, dtype=np.float64), 1.0)
    radii = -np.log(costs / _FULL_COST) / cost_weight_per_m
    radii[INSCRIBED : LETHAL + 1] = 0.0
    radii[255] = radii[0]
    return radii


class ElasticBand:
    """A chain of overlapping bubbles. An operation that fails leaves the band as it was and returns the reason."""

    def __init__(self, config: EBandConfig):
        self._gains = config.gains()
        self._sweeps = config.sweeps
        self._radii = bubble_radii(config.cost_weight_per_m)
        self._work = kernels.band_work(config.capacity)
        self._band = np.zeros((config.capacity, 3))
        self._trial = np.zeros((config.capacity, 3))
        self._count = 0

    @property
    def bubbles(self) -> FloatArray:
        """The bubbles (n, 3): x, y, radius in metres, robot first."""
        return self._band[: self._count]

    def clear(self) -> None:
        """Forget the band."""
        self._count = 0

    def follow_plan(self, points: FloatArray, costmap: Costmap) -> str:
        """Make the band from a plan (n, 2 or more), one bubble per point, refined; return why it failed."""
        if len(points) > len(self._trial):
            return kernels.REASONS[kernels.FULL]
        self._trial[: len(points), :2] = points[:, :2]
        return self._adopt(optimise(self._trial, len(points), *self._context(costmap), 0))

    def connect(self, pose: Pose2D, costmap: Costmap) -> str:
        """Connect the front of the band to the robot; return why it failed."""
        self._copy()
        return self._adopt(kernels.connect_front(self._trial, self._count, pose.x, pose.y, *self._context(costmap)))

    def append(self, points: FloatArray, costmap: Costmap) -> str:
        """Append points (n, 2 or more) to the band; return why it failed."""
        self._copy()
        ahead = np.ascontiguousarray(points[:, :2])
        return self._adopt(kernels.append_back(self._trial, self._count, ahead, *self._context(costmap)))

    def optimise(self, costmap: Costmap) -> str:
        """Adapt the band to the costmap; return why it failed."""
        self._copy()
        return self._adopt(optimise(self._trial, self._count, *self._context(costmap), self._sweeps))

    def _context(
        self, costmap: Costmap
    ) -> tuple[tuple[object, float, float, float, FloatArray], kernels.BandGains, kernels.BandWork]:
        return (costmap.costs, *costmap.grid, self._radii), self._gains, self._work

    def _copy(self) -> None:
        self._trial[: self._count] = self._band[: self._count]

    def _adopt(self, count: int) -> str:
        if count < 0:
            return kernels.REASONS[count]
        self._band, self._trial = self._trial, self._band
        self._count = count
        return ""
