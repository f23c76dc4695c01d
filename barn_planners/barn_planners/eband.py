"""E-Band as a planner: the elastic band inside the navigation loop, with its presets."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from barn_planners.eband_control import EBandConfig, EBandController
from barn_planners.global_plan import GlobalPlanConfig
from barn_planners.navigation import NavigationConfig, NavigationPlanner
from barn_planners.recovery import RecoveryConfig
from barn_planners.registry import PlannerEntry
from barn_worlds.config import quantity


@dataclass(frozen=True)
class EBandPlannerConfig(NavigationConfig):
    """E-Band with all it needs."""

    prune_m: float = quantity(
        0.0, "points of the plan are passed until one is nearer than this; 0: none ever is", "m", minimum=0.0
    )
    band: EBandConfig = field(default_factory=EBandConfig)


def eband_planner(config: Any) -> NavigationPlanner:
    """Return an E-Band planner for an `EBandPlannerConfig`."""
    return NavigationPlanner(config, EBandController(config.band))


_QUIRKY_RECOVERY = RecoveryConfig(clearing_clears=False)

ENTRY = PlannerEntry(
    build=eband_planner,
    presets={
        "paper": EBandPlannerConfig(
            lidar_x_m=0.12,
            goal_republish_period_s=0.1,
            hold_s=0.15,
            global_plan=GlobalPlanConfig(half_cell_offset=False, zero_intermediate_yaw=True),
            recovery=_QUIRKY_RECOVERY,
            band=EBandConfig(reset_costmap_once=True),
        ),
        "challenge": EBandPlannerConfig(recovery=_QUIRKY_RECOVERY),
    },
    summary="elastic band of Quinlan and Khatib for a differential drive, as eband_local_planner has it",
)
