"""What trials charge for a planner's computing, and what is said where they charge
nothing.
"""

import itertools
import time
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from planners import run_inline
from refusals import refused

import barn_eval as barn
from barn_eval.analysis.leaderboard import make_boards
from barn_eval.analysis.notes import assumption_text
from barn_eval.pages.report.page import build_report, plot
from barn_eval.results.run_file import RunFile
from barn_eval.running import direct
from barn_eval.running.direct import NOMINAL_S, Stopwatch, measure_pace
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.result import WallClock, pack_delays, unpack_delays
from barn_eval.trials.run_config import PlannerChoice, RunConfig
from barn_planners.gap.planner import ENTRY
from barn_planners.interface import Planner
from barn_worlds.base.compute import Compute, CycleTimer
from barn_worlds.base.errors import ExitCode

FAST = 60.0  # pace of the machine that this one is taken for, so that little has to be burnt


class Busy(Planner):
    """The planner gap that burns 5 ms of this computer's time in each cycle, 0.3 s of
    the reference computer's.
    """

    def __init__(self):
        self._gap = ENTRY.build(ENTRY.presets["default"])

    def start(self, task, seed):
        self._gap.start(task, seed)

    def step(self, observation):
        until = time.thread_time() + 0.3 / FAST
        while time.thread_time() < until:
            pass
        return self._gap.step(observation)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Busy without a declaration, with one, and measured; and gap itself."""
    folder = tmp_path_factory.mktemp("compute")

    def drive(name, planners, **options):
        return run_inline("60", planners, CHALLENGE, out=folder / name, **options)

    gap = drive("gap", "gap")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(direct, "pace", lambda: FAST)
        return {
            "gap": gap,
            "free": drive("free", {"busy": Busy}),
            "measured": drive("measured", {"busy": Busy}, compute="measured"),
            "declared": drive("declared", "gap", settings={"gap.compute.delay_s": 0.3}),
        }


def metric(results):
    return sum(trial.scores.challenge for trial in results.trials)


def test_a_slow_planner_without_declaration_is_marked(runs):
    free = runs["free"].trials[0]
    gap = runs["gap"].trials[0]
    assert free.scores.traversal_time_s == gap.scores.traversal_time_s
    assert (free.compute, gap.compute) == ("free", "declared")
    assert free.wall_clock.computer is not None and free.wall_clock.computer > 5.0
    assert "its score assumes a computer" in free.wall_clock.note
    assert "busy in" in assumption_text(runs["free"].folder, runs["free"].trials)


def test_what_is_charged_makes_the_score_worse(runs):
    assert metric(runs["measured"]) < metric(runs["free"])
    assert metric(runs["declared"]) < metric(runs["gap"])
    for name in ("measured", "declared"):
        assert runs[name].trials[0].compute == name


def test_a_measured_trial_is_repeated_to_the_bit(runs):
    again = barn.load(runs["measured"].folder, planners={"busy": Busy})
    assert again.trials[0].delays
    assert again.rerun(0) == ""  # at this machine's own pace


def test_a_board_does_not_mix_ways_of_computing(runs):
    boards = make_boards([item.folder for item in runs.values()])
    # what gap declares, and what was set for it
    assert sorted(len(item.places) for item in boards) == [1, 1, 2]
    assert sum("faster computer" in item.title for item in boards) == 1


def test_the_declaration_is_in_the_fingerprint(runs):
    declared, plain = (runs[name].trials[0] for name in ("declared", "gap"))
    assert declared.planner_config != plain.planner_config
    assert declared.task == plain.task


def test_the_shell_takes_a_declaration_and_measuring(succeed, tmp_path):
    run = "run --planner gap --worlds 0 --workers 1 --out out"
    settings = "--set compute.delay_s=0.2 --set compute.period_s=0.25"
    succeed(f"{run} {settings} --execution engine=inline")
    (choice,) = RunFile.read(tmp_path / "out").config["planners"]
    assert (choice["delay_s"], choice["period_s"]) == (0.2, 0.25)
    succeed(f"{run} --execution compute=measured --dry-run --overwrite")


@pytest.mark.parametrize(
    "settings, named",
    [
        ({"gap.compute.dely_s": 0.1}, "delay_s"),
        ({"gap.compute.delay_p95_s": 0.1}, "delay_p95_s"),
    ],
)
def test_a_wrong_declaration_is_refused(settings, named):
    with refused(named):
        barn.run(planners="gap", worlds=0, settings=settings, dry_run=True)


def test_measuring_is_refused_over_ros():
    with refused("measured needs mode direct"):
        RunConfig(mode="ros", compute="measured")


def test_a_choice_overrides_what_the_registry_declares():
    assert PlannerChoice("gap").compute == ENTRY.compute
    assert PlannerChoice("gap", delay_s=0.1).compute == Compute(delay_s=0.1)
    assert PlannerChoice("mine", command="run me", delay_s=0.1).compute == Compute(
        delay_s=0.1
    )


def test_no_cycle_begins_before_the_last_one_has_taken_effect():
    cycle_timer = CycleTimer(Compute(delay_s=0.12, period_s=0.2), 1)
    starts_ns = []
    for now_ns in range(0, 500_000_000, 50_000_000):
        if cycle_timer.is_free(now_ns):
            cycle_timer.start_cycle(now_ns)
            starts_ns.append(now_ns)
    assert starts_ns == [0, 200_000_000, 400_000_000]
    assert cycle_timer.delays_ns == [120_000_000] * 3


def test_delays_are_drawn_with_the_declared_quantiles():
    def draw_delays(seed):
        cycle_timer = CycleTimer(Compute(delay_s=0.05, delay_p95_s=0.1), seed)
        return [cycle_timer.start_cycle(0) for _ in range(20_000)]

    assert draw_delays(1) == draw_delays(1) != draw_delays(2)
    quantiles = np.quantile(draw_delays(1), [0.5, 0.95])
    assert quantiles == pytest.approx([5e7, 1e8], rel=0.03)


def test_delays_are_kept_in_whole_microseconds():
    delays_ns = (1_000, 5_000_000, 2_000)
    assert unpack_delays(pack_delays(list(delays_ns))) == delays_ns
    with refused("delays of a row"):
        unpack_delays("no")


def test_a_wait_is_charged_as_it_is_at_any_pace():
    stopwatch = Stopwatch()
    time.sleep(0.02)
    taken = stopwatch.elapsed()
    assert taken.waited_s > 0.01
    assert taken.reference_s(3.0) == 3.0 * taken.processor_s + taken.waited_s


def test_the_pace_is_that_of_the_processors_clock():
    readings = itertools.count(step=NOMINAL_S / 2.0)
    assert measure_pace(readings.__next__) == pytest.approx(2.0)


def test_a_faster_machine_finds_the_same_planner_too_slow():
    clock = WallClock.from_answer_times(1.0, None, [0.04] * 20)
    slow = [0.08] * 20
    note = "its score assumes a computer 1.6 times as fast"
    assert clock.with_pace(2.0, slow, 0.05, "free").note == note
    assert clock.with_pace(1.0, [0.04] * 20, 0.05, "free").note == ""
    assert clock.with_pace(2.0, slow, 0.1, "declared").computer == pytest.approx(0.8)
    assert clock.with_pace(2.0, slow, 0.05, "measured") == replace(clock, pace=2.0)


def test_latency_drives_each_planner_at_each_delay(command, printed, tmp_path):
    run = "run --planners gap,dwa --worlds 60 --out late"
    content = printed(f"{run} --execution engine=inline --latency 0,0.3")
    settings = content["settings"]
    cases = [(setting["planner"], setting["latency"]) for setting in settings]
    assert cases == list(product(("dwa", "gap"), (0.0, 0.3)))
    late = tmp_path / "late"
    options = {"worlds": 60, "out": late, "engine": "inline", "progress": False}
    again = barn.sweep({"latency": [0, 0.3]}, planners=["gap", "dwa"], **options)
    assert list(again["challenge"]) == [setting["challenge"] for setting in settings]
    assert len(set(again["challenge"])) == 4
    report = build_report([late], hardest=0)
    assert report.names == ["gap", "DWA"]
    panels = plot("sweep", report.entries)
    assert [axes.get_xlabel() for axes in panels] == ["delay of commands [s]"] * 3
    gap, dwa = (line for line in panels[0].lines if line.get_linestyle() == "-")
    assert [*dwa.get_ydata(), *gap.get_ydata()] == list(again["challenge"])
    assert command(run, "--latency", "0,x")[0] == ExitCode.REFUSED


def test_lockstep_over_ros_charges_what_one_process_does(tmp_path):
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    settings = {"gap.compute.delay_s": 0.12, "gap.compute.delay_p95_s": 0.3}
    short = replace(CHALLENGE, name="short", limit_s=4.0, timeout_time_s=4.0)
    options = {"protocol": short, "settings": settings, "workers": 1, "progress": False}
    rows = []
    tracks = []
    for mode in ("direct", "ros"):
        out = tmp_path / mode
        (trial,) = barn.run(60, "gap", mode=mode, out=out, **options).trials
        rows.append(trial.repeatable() | {"mode": "either"})
        tracks.append((out / "tracks.jsonl").read_text())
    assert rows[0] == rows[1]
    assert tracks[0] == tracks[1]
