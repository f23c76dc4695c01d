"""Planners by name: built in, registered, announced by other packages."""

import re
from dataclasses import dataclass
from importlib.metadata import EntryPoint, EntryPoints

import pytest
import yaml
from refusals import refused

from barn_planners import registry
from barn_planners.interface import Decision, Planner
from barn_planners.registry import (
    PlannerEntry,
    make_planner,
    planner_config,
    planner_entry,
    planner_names,
    register,
)
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.types import STOP


@dataclass(frozen=True)
class StandConfig(Checked):
    patience_s: float = quantity(1.0, "how long", "s", minimum=0.0)


class Stand(Planner):
    def __init__(self, config):
        self.config = config

    def start(self, task, seed): ...

    def step(self, observation):
        return Decision(STOP)


ENTRY = PlannerEntry(Stand, {"default": StandConfig()}, "stands")


@pytest.fixture(autouse=True)
def _untouched(monkeypatch):
    monkeypatch.setattr(registry, "_loaded_entries", {})


@pytest.fixture
def announced(monkeypatch):
    """Return the function by which a package announces what it has under a name in a module as the planner 'stand'."""

    def announce(value):
        every = EntryPoints([EntryPoint("stand", value, registry.GROUP)])
        monkeypatch.setattr(registry, "entry_points", every.select)

    return announce


def test_every_planner_can_be_built_with_every_preset():
    assert {"dwa", "eband"} <= set(planner_names())
    for name in planner_names():
        for preset, config in planner_entry(name).presets.items():
            planner = make_planner(name, preset)
            assert isinstance(planner, Planner) and planner.config == config
        for protocol in ("challenge", "paper2020"):
            assert (
                planner_config(name, protocol) in planner_entry(name).presets.values()
            )


MISTAKES = """
- - [dva]
  - unknown planner 'dva'; did you mean 'dwa'?
- - [dwa, papr2020]
  - "planner 'dwa': unknown preset 'papr2020'; did you mean 'paper2020'?"
- - [dwa, paper2020, {dwa.max_sped_mps: 1.0}]
  - unknown parameter 'dwa.max_sped_mps'; did you mean 'dwa.max_speed_mps'?
- - [dwa, paper2020, {dwa.max_speed_mps: -1.0}]
  - "planner 'dwa': dwa.max_speed_mps must be from 0.01 to 10 m/s, got -1.0"
"""


@pytest.mark.parametrize("arguments, message", yaml.safe_load(MISTAKES))
def test_mistakes_are_named_in_one_line(arguments, message):
    with refused(re.escape(message)):
        make_planner(*arguments)


CANNOT_WORK = yaml.safe_load("""
dwa.min_speed_mps must be at most max_speed_mps = 0.5:
  [dwa, {dwa.min_speed_mps: 0.6}]
band.min_speed_mps must be at most max_speed_mps = 0.5:
  [eband, {band.min_speed_mps: 0.6}]
"min_speed_mps must be at least -0.5: no faster than max_speed_mps":
  [mppi, {mppi.min_speed_mps: -0.6}]
samples must be at most 10000000 divided by steps = 1000, got 100000:
  [mppi, {mppi.samples: 100000, mppi.steps: 1000}]
step_s must keep a step's turn to at most 0.5 rad:
  [mppi, {mppi.step_s: 0.5}]
at most 16000000 cells:
  [dwa, {local_costmap.resolution_m: 0.005, local_costmap.size_m: 100.0}]
footprint must be corners:
  [dwa, {local_costmap.footprint: "[[1, 1], [1, -1], [-1, 0]]"}]
must leave a footprint:
  - dwa
  - local_costmap.footprint_half_width_m: 0.05
    local_costmap.footprint_padding_m: -0.06
""")


@pytest.mark.parametrize("message", CANNOT_WORK)
def test_values_that_cannot_work_are_refused(message):
    name, values = CANNOT_WORK[message]
    with refused(re.escape(message)):
        make_planner(name, overrides=values)


def test_a_registered_planner_is_found_and_names_are_unique():
    register("stand", ENTRY)
    assert "stand" in planner_names() and isinstance(make_planner("stand"), Stand)
    for name in ("stand", "dwa"):
        with refused("already exists"):
            register(name, ENTRY)


def test_a_planner_is_found_by_its_entry_point(announced):
    announced(f"{__name__}:ENTRY")
    assert "stand" in planner_names()
    planner = make_planner("stand", "challenge", {"patience_s": 2.0})
    assert planner.config == StandConfig(2.0)


def test_one_preset_named_default_serves_every_protocol(announced):
    announced(f"{__name__}:ENTRY")
    for protocol in ("paper2020", "challenge"):
        assert planner_config("stand", protocol) == StandConfig()


@pytest.mark.parametrize(
    "value, message",
    [
        (
            "no_module:ENTRY",
            "planner 'stand': cannot load 'no_module:ENTRY': No module named 'no_module'",
        ),
        (
            f"{__name__}:Stand",
            "planner 'stand': its entry point must be a PlannerEntry",
        ),
    ],
)
def test_a_broken_entry_point_is_named(announced, value, message):
    announced(value)
    with refused(re.escape(message)):
        make_planner("stand")


def test_a_planner_needs_a_preset():
    with refused("at least one preset"):
        PlannerEntry(Stand, {})
