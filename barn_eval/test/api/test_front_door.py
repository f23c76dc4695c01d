"""`import barn_eval as barn`: experiments, results and worlds from Python."""

import json
import re
import subprocess
import sys
import textwrap
import threading
from base64 import b64decode
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from planners import SHORT, Steady, Straight, ahead, at_the_goal
from results.test_folder import GAP, keep

import barn_eval as barn
from barn_eval.api.results import Trial
from barn_eval.results.rows import results_table
from barn_eval.running.planner_objects import (
    UNKNOWN_SOURCE,
    FunctionPlanner,
    PlannerObject,
    fingerprint,
    split_planner_objects,
)
from barn_eval.trials.outcome import Outcome
from barn_planners.interface import Task
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.base.types import Pose2D, Velocity2D


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """Short trials of a function, a class, an object and a planner of the registry, by two workers."""
    out = tmp_path_factory.mktemp("front") / "out"
    planners = ["gap", ahead, Steady, {"slow": Steady(0.2)}]
    return barn.run([0, 60], planners, SHORT, workers=2, out=out, progress=False)


def test_planners_of_all_kinds_drive_side_by_side(driven):
    assert driven.planners == ["gap", "ahead", "Steady", "slow"]
    assert len(driven) == 8
    speeds = {trial.planner: trial.measures.mean_speed_mps for trial in driven.trials}
    assert speeds["slow"] < speeds["Steady"] < speeds["ahead"]
    assert {trial.wall_clock.worker for trial in driven.trials} == {
        "local-0",
        "local-1",
    }
    assert (
        repr(driven)
        == f"Results({str(driven.folder)!r}: 8 trials, gap, ahead, Steady, slow)"
    )


def test_tables_have_a_row_per_trial_planner_and_measure(driven):
    table = driven.table
    summary = driven.summary
    assert list(table) == results_table([]).column_names
    assert list(table["trial_id"]) == [trial.trial_id for trial in driven.trials]
    assert list(table["driven_m"]) == [
        trial.measures.driven_m for trial in driven.trials
    ]
    assert list(driven.timing["worker"]) == [
        trial.wall_clock.worker for trial in driven.trials
    ]
    assert (list(summary["planner"]), list(summary["trials"])) == (
        driven.planners,
        [2, 2, 2, 2],
    )
    assert (
        summary["success"]
        .between(summary["success_low"], summary["success_high"])
        .all()
    )
    compared = driven.compare().set_index(["a", "b", "measure"])
    assert len(compared.groupby(["a", "b"])) == 6
    clearance = compared.loc["ahead", "slow", "min_clearance_m"]
    gaps = table.groupby("planner")["min_clearance_m"].mean()
    assert [clearance["mean_a"], clearance["mean_b"]] == pytest.approx(
        [gaps["ahead"], gaps["slow"]]
    )
    assert clearance["difference"] == pytest.approx(gaps["ahead"] - gaps["slow"])


def test_columns_have_their_types_whatever_is_in_them(driven, tmp_path):
    def unmoved(observation):
        return None

    crash = barn.run(
        0, unmoved, SHORT, workers=1, out=tmp_path / "none", progress=False
    )
    assert crash.table["traversal_time_s"].isna().all()
    for first, other in (
        (driven.table, crash.table),
        (driven.timing, crash.timing),
        (driven.summary, crash.summary),
    ):
        assert first.dtypes.to_dict() == other.dtypes.to_dict()
        assert object not in set(first.dtypes)
    kinds = driven.compare().dtypes
    assert kinds.to_dict() == crash.compare(f"{driven.folder}:gap").dtypes.to_dict()
    assert (kinds["difference_low"], kinds["worlds"], kinds["a"]) == (
        np.float64,
        np.int64,
        pd.StringDtype(),
    )


def test_a_trial_has_its_trajectory(driven, tmp_path):
    trial = driven.trial("ahead_w0000_r00")
    assert trial.result is next(
        trial_row
        for trial_row in driven.trials
        if trial_row.trial_id == "ahead_w0000_r00"
    )
    path = trial.trajectory
    assert path["time_s"].is_monotonic_increasing
    assert path["time_s"].iloc[-1] == pytest.approx(
        trial.result.scores.duration_s, abs=0.01
    )
    measures = trial.result.measures
    assert np.hypot(path["x_m"].diff(), path["y_m"].diff()).sum() == pytest.approx(
        measures.driven_m, abs=0.05
    )
    assert path["clearance_m"].min() == pytest.approx(
        measures.min_clearance_m, abs=0.005
    )
    assert not path["contact"].any()
    written = np.loadtxt(trial.to_tum(tmp_path / "trial.txt"))
    assert written.shape == (len(path), 8)
    np.testing.assert_allclose(written[:, 1:3], path[["x_m", "y_m"]], atol=1e-9)
    np.testing.assert_allclose(np.hypot(written[:, 6], written[:, 7]), 1.0, atol=1e-8)
    np.testing.assert_allclose(
        2.0 * np.arctan2(written[:, 6], written[:, 7]), path["yaw_rad"], atol=1e-7
    )
    assert driven.trial(0).result is driven.trials[0]
    empty = Trial(trial.result, None)
    assert empty.trajectory.dtypes.to_dict() == path.dtypes.to_dict()
    with pytest.raises(ConfigError, match="ahead_w0000_r00: has no trajectory"):
        empty.to_tum(tmp_path / "none.txt")


def test_worlds_in_memory_are_driven_in_and_kept(tmp_path):
    first, second = barn.worlds.load("barn300", "0,100").values()
    out = tmp_path / "out"
    results = barn.run(
        [first, second], "gap", SHORT, engine="inline", out=out, progress=False
    )
    driven = [
        (trial.world, trial.world_name, trial.world_checksum)
        for trial in results.trials
    ]
    assert driven == [
        (0, first.name, first.checksum),
        (1, second.name, second.checksum),
    ]
    assert len(barn.run([first, second], "gap", SHORT, out=out, progress=False)) == 2
    assert (
        barn.run({0: first, 1: second}, "gap", SHORT, out=out, dry_run=True).there == 2
    )
    for choice in ([second, first], [first], first, {1: first, 0: second}):
        with pytest.raises(
            ConfigError,
            match=r"holds results of another (checksum of world|configuration)",
        ):
            barn.run(choice, "gap", SHORT, out=out, progress=False)
    out = out.rename(tmp_path / "moved")
    loaded = barn.load(out)
    assert (barn.results.check(out).problems, loaded.rerun(1)) == ([], "")
    assert loaded.replay("gap_w0001_r00", tmp_path / "end.png").path.exists()
    assert second.name in Path(loaded.report(tmp_path / "report.html")).read_text()
    (trial,) = barn.run(
        {7: second},
        "gap",
        SHORT,
        out=out,
        overwrite=True,
        engine="inline",
        progress=False,
    ).trials
    assert (trial.world, trial.world_checksum) == (7, second.checksum)
    for wrong in (3.5, [], ["0"], {"a": first}, {0: 1}, [first, 1]):
        with pytest.raises(
            ConfigError, match="worlds must be numbers, a text or worlds, got"
        ):
            barn.run(wrong, "gap", dry_run=True)


def test_the_same_call_resumes_and_other_objects_are_refused(driven):
    planners = ["gap", ahead, Steady, {"slow": Steady(0.2)}]
    before = (driven.folder / "results.jsonl").read_bytes()
    again = barn.run(
        [0, 60], planners, SHORT, workers=1, out=driven.folder, progress=False
    )
    assert again.trials == driven.trials
    assert (driven.folder / "results.jsonl").read_bytes() == before
    planners[3] = {"slow": Steady(0.1)}
    with pytest.raises(
        ConfigError,
        match=r"planners\.3\.source is '[0-9a-f]{64}' there, '[0-9a-f]{64}' here",
    ):
        barn.run([0, 60], planners, SHORT, out=driven.folder, progress=False)


def test_objects_are_recorded_by_a_hash_of_their_source(driven):
    choices = json.loads((driven.folder / "run.json").read_text())["experiment"][
        "planners"
    ]
    assert [bool(choice["source"]) for choice in choices] == [False, True, True, True]
    assert (
        fingerprint(Steady(0.2)) == fingerprint(Steady(0.2)) != fingerprint(Steady(0.3))
    )
    assert fingerprint(ahead) != fingerprint(at_the_goal)

    def make_planner(speed_mps):
        return lambda observation: (speed_mps, 0.0)

    assert (
        fingerprint(make_planner(0.1))
        == fingerprint(make_planner(0.1))
        != fingerprint(make_planner(0.2))
    )
    namespace = {}
    exec("def f(observation): return 0.0, 0.0", namespace)
    assert fingerprint(namespace["f"]) == UNKNOWN_SOURCE


def test_one_worker_drives_live_planners_in_this_process(tmp_path):
    class Counting(Steady):
        cycles = 0

        def step(self, observation):
            Counting.cycles += 1
            return super().step(observation)

    inline = barn.run(
        0, Counting(), SHORT, workers=1, out=tmp_path / "a", progress=False
    )
    assert Counting.cycles > 50
    assert inline.trials[0].wall_clock.worker == "inline"
    elsewhere = barn.run(
        0,
        Counting(),
        SHORT,
        workers=1,
        engine="local",
        out=tmp_path / "b",
        progress=False,
    )
    assert elsewhere.trials[0].repeatable() == inline.trials[0].repeatable()


def test_a_script_without_a_main_guard_runs_once(tmp_path):
    script = tmp_path / "script.py"
    code = textwrap.dedent("""
        from pathlib import Path
        import helper
        import barn_eval as barn

        with Path("imported").open("a") as file:
            file.write("once\\n")

        GAIN = helper.GAIN

        def mine(observation, task):
            return GAIN, 0.0

        class Own(barn.Planner):
            def start(self, task, seed):
                self.draw = seed

            def step(self, observation):
                return barn.Decision(barn.Velocity2D(GAIN / 2.0, 0.0))

        results = barn.run([0, 60], [mine, Own], workers=2, out="out", file="short.yaml", progress=False)
        print(len(results), sorted({one.wall_clock.worker for one in results.trials}), results.planners)
    """)
    script.write_text(code)
    (tmp_path / "helper.py").write_text("GAIN = 0.4\n")
    protocol = "schema_version: 1\nbase: challenge\nname: short\nlimit_s: 3.0\nfirst_motion_limit_s: 3.0\n"
    (tmp_path / "protocol.yaml").write_text(protocol)
    (tmp_path / "short.yaml").write_text(
        "schema_version: 1\nprotocol: protocol.yaml\nrepetitions: 2\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.strip() == "8 ['local-0', 'local-1'] ['mine', 'Own']"
    assert (tmp_path / "imported").read_text() == "once\n"


def test_what_cannot_be_handed_to_a_worker_is_said(tmp_path):
    class Locked(Steady):
        def __init__(self):
            super().__init__()
            self.lock = threading.Lock()

    locked = Locked()
    with pytest.raises(
        ConfigError,
        match=r"a planner cannot be handed to a worker .* workers=1 needs none",
    ):
        barn.run(
            0, {"locked": locked}, SHORT, workers=2, out=tmp_path / "a", progress=False
        )
    (trial,) = barn.run(
        0, {"locked": locked}, SHORT, workers=1, out=tmp_path / "a", progress=False
    ).trials
    assert trial.outcome is Outcome.TIMEOUT


def test_what_goes_wrong_in_a_planner_of_ones_own_is_an_outcome(tmp_path, caplog):
    def broken(observation):
        raise KeyError("speed")

    def talks(observation):
        return "left"

    results = barn.run(
        0, [broken, talks], SHORT, workers=1, out=tmp_path, repetitions=2
    )
    details = {trial.planner: trial.detail for trial in results.trials}
    line = broken.__code__.co_firstlineno + 1
    assert {trial.outcome for trial in results.trials} == {Outcome.PLANNER_DIED}
    assert details["broken"] == f"KeyError: 'speed' (test_front_door.py, line {line})"
    assert details["talks"].startswith(
        "TypeError: a planner's function must return (m/s, rad/s), got 'left' ("
    )
    output = caplog.text
    where = (
        f'test_front_door.py", line {line}, in broken\n      raise KeyError("speed")'
    )
    assert output.count(where) == 1
    assert where.replace("\n  ", "\n") in (
        tmp_path / "tracebacks" / "broken_w0000_r01.txt"
    ).read_text("utf-8")

    class Unmade(Steady):
        def __init__(self):
            raise OSError("no weights")

    with pytest.raises(
        BarnError, match="planner 'Unmade' cannot be made: OSError: no weights"
    ):
        barn.run(0, Unmade, SHORT, workers=1, out=tmp_path / "unmade", progress=False)


@pytest.mark.parametrize(
    ("planners", "options", "words"),
    [
        (
            3,
            {},
            "a planner must be a name, a Planner class or object, or a function of the observation, got 3",
        ),
        (
            lambda observation: None,
            {},
            "has no name; give it one, as {'name': planner}",
        ),
        (
            {"dwa": ahead},
            {},
            "planner 'dwa': is one of the registry's; give yours another name",
        ),
        (
            dict,
            {},
            "planner dict: must be derived from barn_planners.interface.Planner",
        ),
        ([ahead, ahead], {}, "names 'ahead' twice"),
        ({"a/b": ahead}, {}, "planner 'a/b': a name must be 1 to 60 letters"),
        (
            ahead,
            {"mode": "ros"},
            "planner 'ahead': a Python object drives in mode direct only",
        ),
        (
            ahead,
            {"settings": {"ahead": {"a": 1}}},
            "presets and parameters are for planners of the registry",
        ),
    ],
)
def test_what_cannot_be_run_is_refused_in_one_line(tmp_path, planners, options, words):
    with pytest.raises(BarnError) as caught:
        barn.run(0, planners, SHORT, out=tmp_path / "out", progress=False, **options)
    assert words in str(caught.value) and "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_functions_may_ask_for_the_task_and_send_nothing():
    task = Task(Pose2D(-1.0, 0.0, 0.0))
    planner = FunctionPlanner(at_the_goal)
    planner.start(task, 0)
    assert planner.step(None).command == Velocity2D(0.4, 0.1)
    assert FunctionPlanner(lambda observation: None).step(None).command is None
    assert isinstance(PlannerObject("x", Straight).make_planner(), Straight)
    choices, live = split_planner_objects(
        ["dwa", {"name": "eband", "preset": "paper2020"}, {"mine": ahead}]
    )
    assert (choices[:2], list(live)) == (
        ["dwa", {"name": "eband", "preset": "paper2020"}],
        ["mine"],
    )


def test_a_notebook_shows_results_figures_and_pages(driven, tmp_path):
    markup = driven._repr_html_()
    assert markup.count("<tr>") == 5
    assert b"<svg" in b64decode(
        re.search(r'src="data:image/svg\+xml;base64,([^"]+)"', markup)[1]
    )
    assert "Steady" in markup
    axes = Figure().subplots()
    assert driven.plot(ax=axes) == [axes]
    first, other = (
        set(re.findall(r'\bid="([^"]+)"', driven.plot(what)._repr_svg_()))
        for what in ("worlds", "outcomes")
    )
    assert first and other and not first & other
    assert (
        driven.plot("distributions")
        .save(tmp_path / "figure.png")
        .read_bytes()
        .startswith(b"\x89PNG")
    )
    with pytest.raises(
        ConfigError, match=r"unknown figure 'world'; did you mean 'worlds'\?"
    ):
        driven.plot("world")
    page = driven.report(tmp_path / "report.html")
    assert "<iframe" in page._repr_html_()
    assert "slow" in Path(page).read_text()
    picture = driven.replay("gap_w0000_r00", tmp_path / "end.png")
    assert picture._repr_png_().startswith(b"\x89PNG")
    assert picture._repr_html_() is None is page._repr_png_()
    bag = driven.folder / "replays" / "bags" / "gap_w0000_r00"
    film = barn.replay(bag, tmp_path / "trial.gif", frames_per_s=2.0, speed=4.0)
    assert (
        '<img alt="trial" style="max-width: 100%" src="data:image/gif;base64,'
        in film._repr_html_()
    )
    for draw in (driven.replay, barn.replay):
        with pytest.raises(
            ConfigError,
            match=r"out 'trial.jpg': must end in \.html, \.png, \.gif, \.mp4",
        ):
            draw("gap_w0000_r00", "trial.jpg")


def test_folders_are_ranked_compared_and_reported_together(driven, tmp_path):
    other = barn.run(
        [0, 60],
        {"quick": Steady(0.5)},
        SHORT,
        out=tmp_path / "other",
        workers=1,
        progress=False,
    )
    board = barn.results.leaderboard(
        [driven, other.folder], by="time", out=tmp_path / "board.md"
    )
    assert set(board["planner"]) == {"gap", "ahead", "Steady", "slow", "quick"}
    assert (
        board["rank"][0] == 1
        and board["normalised_time_s_per_m"].is_monotonic_increasing
    )
    assert set(driven.summary) < set(board)
    assert "| quick |" in (tmp_path / "board.md").read_text()
    with pytest.raises(ConfigError, match="unknown ranking 'tme'; did you mean 'time'"):
        barn.results.leaderboard(driven, by="tme")
    with pytest.raises(
        ConfigError, match=r"out 'board.pdf': must end in \.md or \.html"
    ):
        barn.results.leaderboard(driven, out="board.pdf")
    compared = barn.compare(f"{driven.folder}:ahead", other).set_index("measure")
    assert {*compared["a"]} | {*compared["b"]} == {"ahead", "quick"}
    assert compared["trials"]["success"] == 2
    page = barn.report(
        [driven, other], tmp_path / "both.html", assets=tmp_path / "assets", hardest=1
    )
    assert all(name in Path(page).read_text() for name in ("Steady", "quick"))
    assert list((tmp_path / "assets").glob("*.csv"))


def test_a_replay_without_a_bag_drives_the_trial_again_and_says_so(driven, caplog):
    page = driven.replay("Steady_w0060_r00")
    assert page.path == driven.folder / "replays" / "Steady_w0060_r00.html"
    assert "no bag of Steady_w0060_r00 was kept: it is driven once more" in caplog.text
    assert "otherwise" not in caplog.text
    caplog.clear()
    driven.replay("Steady_w0060_r00")
    assert "once more" not in caplog.text
    loaded = barn.load(driven.folder)
    loaded.replay("gap_w0000_r00")
    with pytest.raises(
        ConfigError,
        match=r"planner 'ahead' was a Python object: barn\.load\(folder, planners=",
    ):
        loaded.replay("ahead_w0000_r00")
    with pytest.raises(
        ConfigError, match="planner 'slow' is not the one of these results"
    ):
        barn.load(driven.folder, {"slow": Steady(0.5)}).replay("slow_w0000_r00")
    barn.load(driven.folder, ahead).replay(
        "ahead_w0000_r00", driven.folder / "mine.html"
    )
    assert (driven.folder / "mine.html").stat().st_size > 10_000
    with pytest.raises(
        ConfigError, match="has no trial 'gap_w0001_r00'; did you mean 'gap_w0060_r00'"
    ):
        driven.replay("gap_w0001_r00")


def test_a_replay_of_a_planner_that_does_not_repeat_says_so(tmp_path, caplog):
    class Drifting(Steady):
        """Its source, by which it is known, stays the same."""

    results = barn.run(0, Drifting, SHORT, workers=1, out=tmp_path, progress=False)
    Drifting.step = lambda self, observation: barn.Decision(barn.Velocity2D(0.1, 0.0))
    results.replay("Drifting_w0000_r00")
    assert "Drifting_w0000_r00 went otherwise this time" in caplog.text


def test_a_folder_that_is_not_finished_is_loaded(tmp_path):
    keep(tmp_path, GAP, 3)
    results = barn.load(tmp_path)
    assert "3 of 4 trials" in repr(results)
    assert len(results.table) == 3
    with pytest.raises(BarnError, match=r"run\.json: No such file"):
        barn.load(tmp_path / "nowhere")


def test_a_comparison_needs_two(tmp_path):
    keep(tmp_path / "gap", GAP)
    with pytest.raises(
        ConfigError, match="has one planner only; give other results to compare with"
    ):
        barn.load(tmp_path / "gap").compare()


def test_a_dry_run_says_what_would_run_and_writes_nothing(tmp_path, driven):
    estimate = barn.run(
        "0:300:60",
        ["gap", ahead],
        repetitions=2,
        workers=2,
        bags="all",
        out=tmp_path / "out",
        dry_run=True,
    )
    assert (estimate.planners, estimate.worlds) == (
        ("gap", "ahead"),
        (0, 60, 120, 180, 240),
    )
    assert (estimate.trials, estimate.there, estimate.wall_s) == (20, 0, 20.0)
    assert estimate.disk_bytes > 20 * 1_000_000
    assert not (tmp_path / "out").exists()
    planners = ["gap", ahead, Steady, {"slow": Steady(0.2)}]
    resumed = barn.run([0, 60], planners, SHORT, out=driven.folder, dry_run=True)
    assert (resumed.trials, resumed.there, resumed.wall_s, resumed.disk_bytes) == (
        8,
        8,
        0.0,
        0,
    )
    assert resumed.basis == "8 trials in the folder"
