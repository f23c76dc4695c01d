"""Planners by name: built in, registered, announced by other packages."""

from dataclasses import dataclass

import pytest

from barn_planners import registry
from barn_planners.interface import Decision, Planner
from barn_planners.registry import PlannerEntry, make_planner, planner_config, planner_names, presets, register
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.types import STOP


@dataclass(frozen=True)
class StandConfig(Checked):
    patience_s: float = quantity(1.0, "how long", "s", minimum=0.0)


class Stand(Planner):
    def __init__(self, config: StandConfig):
        self.config = config

    def start(self, task, seed) -> None: ...

    def step(self, observation) -> Decision:
        return Decision(STOP)


ENTRY = PlannerEntry(Stand, {"default": StandConfig()}, "stands")


class Point:
    """What importlib.metadata gives for an entry point."""

    def __init__(self, name: str, target: object):
        self.name, self.value, self._target = name, "some.module:ENTRY", target

    def load(self) -> object:
        if isinstance(self._target, Exception):
            raise self._target
        return self._target


@pytest.fixture(autouse=True)
def _untouched(monkeypatch):
    monkeypatch.setattr(registry, "_registered", {})


@pytest.fixture
def announced(monkeypatch):
    def announce(name: str, target: object) -> None:
        monkeypatch.setattr(
            registry, "entry_points", lambda group: [Point(name, target)] if group == registry.GROUP else []
        )

    return announce


def test_every_built_in_planner_can_be_made_with_each_of_its_presets():
    assert {"dwa", "eband"} <= set(planner_names())
    for name in planner_names():
        for preset, config in presets(name).items():
            planner = make_planner(name, preset)
            assert isinstance(planner, Planner) and planner.config == config
        for protocol in ("challenge", "paper2020"):
            assert planner_config(name, protocol) in presets(name).values()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("dva",), "unknown planner 'dva'; did you mean 'dwa'?"),
        (("dwa", "papr2020"), "planner 'dwa': unknown preset 'papr2020'; did you mean 'paper2020'?"),
        (
            ("dwa", "paper2020", {"dwa.max_sped_mps": 1.0}),
            "unknown parameter 'dwa.max_sped_mps'; did you mean 'dwa.max_speed_mps'?",
        ),
        (
            ("dwa", "paper2020", {"dwa.max_speed_mps": -1.0}),
            "planner 'dwa': dwa.max_speed_mps must be from 0.01 to 10 m/s, got -1.0",
        ),
    ],
)
def test_mistakes_are_named_in_one_line(arguments, message):
    with pytest.raises(ConfigError) as caught:
        make_planner(*arguments)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_a_registered_planner_is_found_and_names_are_not_taken_twice():
    register("stand", ENTRY)
    assert "stand" in planner_names() and isinstance(make_planner("stand"), Stand)
    for name in ("stand", "dwa"):
        with pytest.raises(ConfigError, match="exists already"):
            register(name, ENTRY)


def test_a_planner_of_another_package_is_found_by_its_entry_point(announced):
    announced("stand", ENTRY)
    assert "stand" in planner_names()
    assert make_planner("stand", "challenge", {"patience_s": 2.0}).config == StandConfig(2.0)


def test_one_preset_named_default_serves_every_protocol(announced):
    announced("stand", ENTRY)
    assert planner_config("stand", "paper2020") == planner_config("stand", "challenge") == StandConfig()


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (ImportError("no module named x"), "planner 'stand': cannot load 'some.module:ENTRY': no module named x"),
        (Stand, "planner 'stand': its entry point must be a PlannerEntry"),
    ],
)
def test_a_broken_entry_point_is_named(announced, target, message):
    announced("stand", target)
    with pytest.raises(ConfigError) as caught:
        make_planner("stand")
    assert message in str(caught.value)


def test_a_planner_needs_a_preset():
    with pytest.raises(ConfigError, match="at least one preset"):
        PlannerEntry(Stand, {})
