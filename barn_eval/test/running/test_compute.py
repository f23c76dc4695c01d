"""What trials charge for a planner's computing, and what is said where they charge nothing."""

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import barn_eval as barn
from barn_eval.analysis.leaderboard import make_boards
from barn_eval.analysis.sources import assumption_text
from barn_eval.pages.report.page import build_report, plot
from barn_eval.results.run_file import RunFile
from barn_eval.running import direct
from barn_eval.running.direct import Stopwatch
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.result import WallClock, pack_delays, unpack_delays
from barn_eval.trials.run_config import PlannerChoice, RunConfig
from barn_planners.gap.planner import ENTRY
from barn_planners.interface import Decision, Observation, Planner, Task
from barn_worlds.base.compute import Compute, CycleTimer
from barn_worlds.base.errors import ConfigError

Command = Callable[..., tuple[int, str, str]]
FAST = 60.0  # pace of the machine that this one is taken for, so that little has to be burnt


class Busy(Planner):
    """The planner gap that burns 5 ms of this computer's time in each cycle, 0.3 s of the reference computer's."""

    def __init__(self) -> None:
        self._gap = ENTRY.build(ENTRY.presets["default"])

    def start(self, task: Task, seed: int) -> None:
        self._gap.start(task, seed)

    def step(self, observation: Observation) -> Decision:
        until = time.thread_time() + 0.3 / FAST
        while time.thread_time() < until:
            pass
        return self._gap.step(observation)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, barn.Results]:
    """Busy without a declaration, with one, and measured; and gap itself."""
    folder = tmp_path_factory.mktemp("compute")
    common = {"worlds": "60", "engine": "inline", "progress": False}
    gap = barn.run(planners="gap", out=folder / "gap", **common)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(direct, "pace", lambda: FAST)
        return {
            "gap": gap,
            "free": barn.run(planners={"busy": Busy}, out=folder / "free", **common),
            "measured": barn.run(
                planners={"busy": Busy},
                compute="measured",
                out=folder / "measured",
                **common,
            ),
            "declared": barn.run(
                planners="gap",
                settings={"gap.compute.delay_s": 0.3},
                out=folder / "declared",
                **common,
            ),
        }


def metric(results: barn.Results) -> float:
    return sum(trial.scores.challenge for trial in results.trials)


def test_a_slow_planner_without_declaration_is_marked(
    runs: dict[str, barn.Results],
) -> None:
    free = runs["free"].trials[0]
    gap = runs["gap"].trials[0]
    assert free.scores.traversal_time_s == gap.scores.traversal_time_s
    assert (free.compute, gap.compute) == ("free", "declared")
    assert free.wall_clock.computer is not None and free.wall_clock.computer > 5.0
    assert "its score assumes a computer" in free.wall_clock.note
    assert "busy in" in assumption_text(runs["free"].folder, runs["free"].trials)


def test_what_is_charged_makes_the_score_worse(runs: dict[str, barn.Results]) -> None:
    assert metric(runs["measured"]) < metric(runs["free"])
    assert metric(runs["declared"]) < metric(runs["gap"])
    assert [runs[name].trials[0].compute for name in ("measured", "declared")] == [
        "measured",
        "declared",
    ]


def test_a_measured_trial_is_repeated_to_the_bit(runs: dict[str, barn.Results]) -> None:
    again = barn.load(runs["measured"].folder, planners={"busy": Busy})
    assert again.trials[0].delays
    assert again.rerun(0) == ""  # at this machine's own pace


def test_a_board_does_not_mix_ways_of_computing(runs: dict[str, barn.Results]) -> None:
    boards = make_boards([item.folder for item in runs.values()])
    assert sorted(len(item.places) for item in boards) == [
        1,
        1,
        2,
    ]  # what gap declares, and what was set for it
    assert sum("faster computer" in item.title for item in boards) == 1


def test_the_declaration_is_in_the_fingerprint(runs: dict[str, barn.Results]) -> None:
    assert (
        runs["declared"].trials[0].planner_config
        != runs["gap"].trials[0].planner_config
    )
    assert runs["declared"].trials[0].task == runs["gap"].trials[0].task


def test_the_shell_takes_a_declaration_and_measuring(
    command: Command, tmp_path: Path
) -> None:
    arguments = [
        "run",
        "--planner",
        "gap",
        "--worlds",
        "0",
        "--workers",
        "1",
        "--out",
        "out",
    ]
    settings = ["--set", "compute.delay_s=0.2", "--set", "compute.period_s=0.25"]
    assert command(*arguments, *settings, "--execution", "engine=inline")[0] == 0
    (choice,) = RunFile.read(tmp_path / "out").config["planners"]
    assert (choice["delay_s"], choice["period_s"]) == (0.2, 0.25)
    assert (
        command(
            *arguments, "--execution", "compute=measured", "--dry-run", "--overwrite"
        )[0]
        == 0
    )


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"gap.compute.dely_s": 0.1}, "delay_s"),
        ({"gap.compute.delay_p95_s": 0.1}, "delay_p95_s"),
    ],
)
def test_a_wrong_declaration_is_refused(settings: dict[str, float], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        barn.run(planners="gap", worlds=0, settings=settings, dry_run=True)


def test_measuring_is_refused_over_ros() -> None:
    with pytest.raises(ConfigError, match="measured needs mode direct"):
        RunConfig(mode="ros", compute="measured")


def test_a_choice_overrides_what_the_registry_declares() -> None:
    assert PlannerChoice("gap").compute == ENTRY.compute
    assert PlannerChoice("gap", delay_s=0.1).compute == Compute(delay_s=0.1)
    assert PlannerChoice("mine", command="run me", delay_s=0.1).compute == Compute(
        delay_s=0.1
    )


def test_no_cycle_begins_before_the_last_one_has_taken_effect() -> None:
    cycle_timer = CycleTimer(Compute(delay_s=0.12, period_s=0.2), 1)
    starts_s = [
        k * 50_000_000
        for k in range(10)
        if cycle_timer.is_free(k * 50_000_000)
        and cycle_timer.start_cycle(k * 50_000_000)
    ]
    assert starts_s == [0, 200_000_000, 400_000_000]
    assert cycle_timer.delays_ns == [120_000_000] * 3


def test_delays_are_drawn_with_the_declared_quantiles() -> None:
    def draw_delays(seed: int) -> list[int]:
        cycle_timer = CycleTimer(Compute(delay_s=0.05, delay_p95_s=0.1), seed)
        return [cycle_timer.start_cycle(0) for _ in range(20_000)]

    assert draw_delays(1) == draw_delays(1) != draw_delays(2)
    assert np.quantile(draw_delays(1), [0.5, 0.95]) == pytest.approx(
        [5e7, 1e8], rel=0.03
    )


def test_delays_are_kept_in_whole_microseconds() -> None:
    assert unpack_delays(pack_delays([1_000, 5_000_000, 2_000])) == (
        1_000,
        5_000_000,
        2_000,
    )
    with pytest.raises(ConfigError, match="delays of a row"):
        unpack_delays("no")


def test_a_planner_that_waits_is_charged_the_wait() -> None:
    stopwatch = Stopwatch()
    time.sleep(0.02)
    assert stopwatch.elapsed_s() >= 0.02


def test_a_faster_machine_finds_the_same_planner_too_slow() -> None:
    clock = WallClock.from_answer_times(1.0, None, [0.04] * 20)
    assert (
        clock.with_pace(2.0, 0.05, "free").note
        == "its score assumes a computer 1.6 times as fast"
    )
    assert clock.with_pace(1.0, 0.05, "free").note == ""
    assert clock.with_pace(2.0, 0.1, "declared").computer == pytest.approx(0.8)
    assert clock.with_pace(2.0, 0.05, "measured") == replace(clock, pace=2.0)


def test_latency_drives_each_planner_at_each_delay(
    command: Command, tmp_path: Path
) -> None:
    arguments = [
        "run",
        "--planners",
        "gap,dwa",
        "--worlds",
        "60",
        "--out",
        str(tmp_path / "late"),
    ]
    code, out, _ = command(
        *arguments, "--execution", "engine=inline", "--latency", "0,0.3", "--json"
    )
    assert code == 0
    settings = json.loads(out)["settings"]
    assert [(setting["planner"], setting["latency"]) for setting in settings] == [
        ("dwa", 0.0), ("dwa", 0.3), ("gap", 0.0), ("gap", 0.3),
    ]  # fmt: skip
    options = {
        "worlds": 60,
        "out": tmp_path / "late",
        "engine": "inline",
        "progress": False,
    }
    again = barn.sweep({"latency": [0, 0.3]}, planners=["gap", "dwa"], **options)
    assert list(again["challenge"]) == [setting["challenge"] for setting in settings]
    assert len(set(again["challenge"])) == 4
    panels = plot(
        "sweep", (late_report := build_report([tmp_path / "late"], hardest=0)).entries
    )
    assert [axes.get_xlabel() for axes in panels] == ["delay of commands [s]"] * 3
    lines = [
        line.get_ydata() for line in panels[0].lines if line.get_linestyle() == "-"
    ]
    assert late_report.names == ["gap", "DWA"] and [*lines[1], *lines[0]] == list(
        again["challenge"]
    )
    assert command(*arguments, "--latency", "0,x")[0] == 1


def test_lockstep_over_ros_charges_what_one_process_does(tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    settings = {"gap.compute.delay_s": 0.12, "gap.compute.delay_p95_s": 0.3}
    short = replace(CHALLENGE, name="short", limit_s=4.0, timeout_time_s=4.0)
    options = {"protocol": short, "settings": settings, "workers": 1, "progress": False}
    runs = [
        barn.run(60, "gap", mode=mode, out=tmp_path / mode, **options)
        for mode in ("direct", "ros")
    ]
    direct_row, ros_row = (run.trials[0].repeatable() for run in runs)
    assert direct_row | {"mode": "ros"} == ros_row
    tracks = [
        (tmp_path / mode / "tracks.jsonl").read_text() for mode in ("direct", "ros")
    ]
    assert tracks[0] == tracks[1]
