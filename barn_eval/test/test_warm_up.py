"""Preparing a run: planners are tried out, and one that fails there is left to fail its trials."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from barn_eval.experiments import warm_up as module
from barn_eval.experiments.runs import RunPlan
from barn_eval.experiments.warm_up import warm_up
from barn_worlds.formats.own import write_own

from planners import Faulty, Straight  # isort: skip


@pytest.fixture
def plan(tmp_path: Path, open_world) -> RunPlan:
    write_own(tmp_path / "one.npz", "one", {0: open_world})
    return RunPlan(dataset=str(tmp_path / "one.npz"), planner="dwa")


class Counting(Straight):
    steps = 0

    def step(self, observation):
        self.steps += 1
        return super().step(observation)


def test_the_planner_has_decided_before_the_first_trial(plan, monkeypatch):
    planner = Counting()
    monkeypatch.setattr(module, "make_planner", lambda *_: planner)
    warm_up(plan)
    assert planner.steps > 0


def test_a_planner_that_fails_is_left_to_its_trials(plan, monkeypatch):
    planner = Faulty("raises", after=0)
    monkeypatch.setattr(module, "make_planner", lambda *_: planner)
    warm_up(plan)
    assert planner.cycle == 1


def test_a_foreign_planner_is_not_made_here(plan, monkeypatch):
    monkeypatch.setattr(module, "make_planner", lambda *_: pytest.fail("there is no such planner here"))
    warm_up(replace(plan, mode="ros", planner="mine", planner_command="python3 mine.py"))
