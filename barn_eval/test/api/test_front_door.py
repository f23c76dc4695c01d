"""`import barn_eval as barn`: experiments, results and worlds from Python."""

import re
import textwrap
import threading
from base64 import b64decode
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from planners import SHORT, Steady, Straight, ahead, at_the_goal
from refusals import refused
from results.test_folder import GAP, keep
from waiting import run_python

import barn_eval as barn
from barn_eval.api.results import Trial
from barn_eval.results.rows import results_table
from barn_eval.results.run_file import RunFile
from barn_eval.running.planner_objects import (
    UNKNOWN_SOURCE,
    FunctionPlanner,
    PlannerObject,
    fingerprint,
    split_planner_objects,
)
from barn_eval.running.request import read_request
from barn_eval.running.runner import RunError
from barn_eval.trials.result import Outcome
from barn_eval.verification.check import check_folder
from barn_planners.interface import Task
from barn_worlds.base.errors import BarnError
from barn_worlds.base.types import Pose2D, Velocity2D

PLANNERS = ["gap", ahead, Steady, {"slow": Steady(0.2)}]


def drive(planners, out, worlds=0, workers=1, **options):
    """Drive short trials, by default in one world in this process."""
    options |= {"workers": workers, "out": out, "progress": False}
    return barn.run(worlds, planners, SHORT, **options)


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """Trials of a name, a function, a class and an object, by two workers."""
    out = tmp_path_factory.mktemp("front") / "out"
    return drive(PLANNERS, out, [0, 60], workers=2)


def test_planners_of_all_kinds_drive_side_by_side(driven):
    assert driven.planners == ["gap", "ahead", "Steady", "slow"]
    assert len(driven) == 8
    speeds = {trial.planner: trial.measures.mean_speed_mps for trial in driven.trials}
    assert speeds["slow"] < speeds["Steady"] < speeds["ahead"]
    assert set(driven.timing["worker"]) == {"local-0", "local-1"}
    folder = repr(str(driven.folder))
    assert repr(driven) == f"Results({folder}: 8 trials, gap, ahead, Steady, slow)"


def test_one_planner_of_the_registry_drives_under_two_names(tmp_path):
    slow = barn.PlannerChoice("gap", overrides={"max_speed_mps": 0.2})
    results = drive(["gap", {"slow": slow}], tmp_path / "out")
    assert results.planners == ["gap", "slow"]
    first, second = results.trials
    assert first.planner_config != second.planner_config
    assert second.measures.mean_speed_mps < first.measures.mean_speed_mps
    assert check_folder(tmp_path / "out").problems == []


def test_tables_have_a_row_per_trial_planner_and_measure(driven):
    table = driven.table
    assert list(table) == results_table([]).column_names
    workers = driven.timing["worker"]
    for row, worker, trial in zip(table.iloc, workers, driven.trials, strict=True):
        assert row["trial_id"] == trial.trial_id
        assert row["driven_m"] == trial.measures.driven_m
        assert worker == trial.wall_clock.worker
    summary = driven.summary
    assert list(summary["planner"]) == driven.planners
    assert list(summary["trials"]) == [2, 2, 2, 2]
    share = summary["success"]
    assert share.between(summary["success_low"], summary["success_high"]).all()
    compared = driven.compare().set_index(["a", "b", "measure"])
    assert len(compared.groupby(["a", "b"])) == 6
    clearance = compared.loc["ahead", "slow", "min_clearance_m"]
    gaps = table.groupby("planner")["min_clearance_m"].mean()
    assert clearance["mean_a"] == pytest.approx(gaps["ahead"])
    assert clearance["mean_b"] == pytest.approx(gaps["slow"])
    assert clearance["difference"] == pytest.approx(gaps["ahead"] - gaps["slow"])


def test_columns_have_their_types_whatever_is_in_them(driven, tmp_path):
    def unmoved(observation):
        return None

    crash = drive(unmoved, tmp_path / "none")
    assert crash.table["traversal_time_s"].isna().all()
    for name in ("table", "timing", "summary"):
        kinds = getattr(driven, name).dtypes
        assert kinds.to_dict() == getattr(crash, name).dtypes.to_dict()
        assert object not in set(kinds)
    kinds = driven.compare().dtypes
    assert kinds.to_dict() == crash.compare(f"{driven.folder}:gap").dtypes.to_dict()
    assert kinds["difference_low"] == np.float64
    assert kinds["worlds"] == np.int64
    assert kinds["a"] == pd.StringDtype()


def test_a_trial_has_its_trajectory(driven, tmp_path):
    trial = driven.trial("ahead_w0000_r00")
    (result,) = (row for row in driven.trials if row.trial_id == "ahead_w0000_r00")
    assert trial.result is result
    path = trial.trajectory
    times_s = path["time_s"]
    assert times_s.is_monotonic_increasing
    assert times_s.iloc[-1] == pytest.approx(result.scores.duration_s, abs=0.01)
    measures = result.measures
    driven_m = np.hypot(path["x_m"].diff(), path["y_m"].diff()).sum()
    assert driven_m == pytest.approx(measures.driven_m, abs=0.05)
    nearest_m = path["clearance_m"].min()
    assert nearest_m == pytest.approx(measures.min_clearance_m, abs=0.005)
    assert not path["contact"].any()
    written = np.loadtxt(trial.to_tum(tmp_path / "trial.txt"))
    assert written.shape == (len(path), 8)
    np.testing.assert_allclose(written[:, 1:3], path[["x_m", "y_m"]], atol=1e-9)
    z, w = written[:, 6:].T
    np.testing.assert_allclose(np.hypot(z, w), 1.0, atol=1e-8)
    np.testing.assert_allclose(2.0 * np.arctan2(z, w), path["yaw_rad"], atol=1e-7)
    assert driven.trial(0).result is driven.trials[0]
    empty = Trial(trial.result, None)
    assert empty.trajectory.dtypes.to_dict() == path.dtypes.to_dict()
    with refused("ahead_w0000_r00: no trajectory"):
        empty.to_tum(tmp_path / "none.txt")


def test_worlds_in_memory_are_driven_in_and_kept(tmp_path):
    first, second = barn.worlds.load("barn300", "0,100").values()
    out = tmp_path / "out"
    results = drive("gap", out, [first, second])
    for trial, world in zip(results.trials, (first, second), strict=True):
        assert (trial.world_name, trial.world_checksum) == (world.name, world.checksum)
    assert [trial.world for trial in results.trials] == [0, 1]
    assert len(drive("gap", out, [first, second])) == 2
    assert drive("gap", out, {0: first, 1: second}, dry_run=True).there == 2
    for choice in ([second, first], [first], first, {1: first, 0: second}):
        with refused(r"holds results of a different (checksum of world|configuration)"):
            drive("gap", out, choice)
    out = out.rename(tmp_path / "moved")
    loaded = barn.load(out)
    assert (barn.results.check(out).problems, loaded.rerun(1)) == ([], "")
    assert loaded.replay("gap_w0001_r00", tmp_path / "end.png").path.exists()
    assert second.name in Path(loaded.report(tmp_path / "report.html")).read_text()
    (trial,) = drive("gap", out, {7: second}, overwrite=True).trials
    assert (trial.world, trial.world_checksum) == (7, second.checksum)
    for wrong in (3.5, np.float64(10.0), [], [True], {"a": first}, {0: 1}, [first, 1]):
        with refused(
            "worlds must be (whole numbers or text|World objects by number), "
        ):
            barn.run(wrong, "gap", dry_run=True)


@pytest.mark.parametrize(
    "worlds",
    [
        [0, 60],
        np.array([0, 60]),
        pd.Series([0, 60]),
        range(0, 61, 60),
        (np.int64(0), np.uint8(60)),
        np.array("0,60"),
        ["0", 60],
    ],
)
def test_numbers_of_numpy_and_pandas_are_as_good_as_pythons(tmp_path, worlds):
    plan = barn.run(
        worlds,
        np.array(["gap"]),
        repetitions=np.int64(2),
        seed=np.uint32(7),
        settings={"gap.max_speed_mps": np.float32(0.5)},
        course=np.zeros(0),
        out=tmp_path,
        dry_run=True,
    )
    assert (plan.worlds, plan.trials) == ((0, 60), 4)


@pytest.mark.parametrize("text", ["0", "[0]", "[0, 0]", "['0']", "'0'"])
def test_worlds_in_a_file_are_numbers_and_lists(tmp_path, text):
    file = tmp_path / "run.yaml"
    file.write_text(f"schema_version: 1\nworlds: {text}\nplanners: [gap]\n")
    assert read_request(file, {}).config.worlds == text.strip("[]'").replace(" ", "")


def test_the_same_call_resumes_and_other_objects_are_refused(driven):
    rows = driven.folder / "results.jsonl"
    before = rows.read_bytes()
    assert drive(PLANNERS, driven.folder, [0, 60]).trials == driven.trials
    assert rows.read_bytes() == before
    slower = [*PLANNERS[:3], {"slow": Steady(0.1)}]
    with refused(r"planners\.3\.source is '[0-9a-f]{64}' there, '[0-9a-f]{64}' here"):
        drive(slower, driven.folder, [0, 60])


def test_objects_are_recorded_by_a_hash_of_their_source(driven):
    choices = RunFile.read(driven.folder).run_config().planners
    assert [bool(choice.source) for choice in choices] == [False, True, True, True]
    assert fingerprint(ahead) != fingerprint(at_the_goal)

    def make_function(speed_mps):
        return lambda observation: (speed_mps, 0.0)

    for make in (Steady, make_function):
        slow, same, fast = (fingerprint(make(speed)) for speed in (0.2, 0.2, 0.3))
        assert slow == same != fast
    namespace = {}
    exec("def f(observation): return 0.0, 0.0", namespace)
    assert fingerprint(namespace["f"]) == UNKNOWN_SOURCE


def test_one_worker_drives_live_planners_in_this_process(tmp_path):
    class Counting(Steady):
        cycles = 0

        def step(self, observation):
            Counting.cycles += 1
            return super().step(observation)

    (inline,) = drive(Counting(), tmp_path / "a").trials
    assert Counting.cycles > 50
    assert inline.wall_clock.worker == "inline"
    (elsewhere,) = drive(Counting(), tmp_path / "b", engine="local").trials
    assert elsewhere.repeatable() == inline.repeatable()


def test_a_script_without_a_main_guard_runs_once(tmp_path):
    script = tmp_path / "script.py"
    code = """
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

        results = barn.run(
            [0, 60], [mine, Own], workers=2, out="out", file="short.yaml", progress=False
        )
        workers = sorted({trial.wall_clock.worker for trial in results.trials})
        print(len(results), workers, results.planners)
    """
    script.write_text(textwrap.dedent(code))
    (tmp_path / "helper.py").write_text("GAIN = 0.4\n")
    protocol = "schema_version: 1\nbase: challenge\nname: short\nlimit_s: 3.0\nfirst_motion_limit_s: 3.0\n"
    (tmp_path / "protocol.yaml").write_text(protocol)
    (tmp_path / "short.yaml").write_text(
        "schema_version: 1\nprotocol: protocol.yaml\nrepetitions: 2\n"
    )
    done = run_python(script, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    # A limit of 3 s is hard to meet, as is said once.
    assert done.stderr.count("of the limit is needed") == 1
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout.strip() == "8 ['local-0', 'local-1'] ['mine', 'Own']"
    assert (tmp_path / "imported").read_text() == "once\n"


def test_what_cannot_be_handed_to_a_worker_is_said(tmp_path):
    class Locked(Steady):
        def __init__(self):
            super().__init__()
            self.lock = threading.Lock()

    locked = {"locked": Locked()}
    with refused(
        r"a planner cannot be sent to a worker process .* use workers=1, which starts no worker process"
    ):
        drive(locked, tmp_path, workers=2)
    (trial,) = drive(locked, tmp_path).trials
    assert trial.outcome is Outcome.TIMEOUT


def test_what_goes_wrong_in_a_planner_of_ones_own_is_an_outcome(tmp_path, caplog):
    def broken(observation):
        raise KeyError("speed")

    def talks(observation):
        return "left"

    options = {"workers": 1, "repetitions": 2}
    results = barn.run(0, [broken, talks], SHORT, out=tmp_path, **options)
    details = {trial.planner: trial.detail for trial in results.trials}
    line = broken.__code__.co_firstlineno + 1
    assert {trial.outcome for trial in results.trials} == {Outcome.PLANNER_DIED}
    assert details["broken"] == f"KeyError: 'speed' (test_front_door.py, line {line})"
    assert details["talks"].startswith(
        "TypeError: a planner's function must return (m/s, rad/s), got 'left' ("
    )
    where = f'test_front_door.py", line {line}, in broken\n'
    raised = '    raise KeyError("speed")'
    assert caplog.text.count(f"{where}  {raised}") == 1
    kept = tmp_path / "tracebacks" / "broken_w0000_r01.txt"
    assert where + raised in kept.read_text("utf-8")

    class Unmade(Steady):
        def __init__(self):
            raise OSError("no weights")

    with refused("planner 'Unmade' cannot be created: OSError: no weights", RunError):
        drive(Unmade, tmp_path / "unmade")


@pytest.mark.parametrize(
    "planners, options, words",
    [
        (
            3,
            {},
            "a planner must be a name, a Planner class or object, or a function of the observation, got 3",
        ),
        (
            lambda observation: None,
            {},
            "no name; give it one, as {'name': planner}",
        ),
        (
            {"dwa": ahead},
            {},
            "planner 'dwa': is a registered planner; give your planner a different name",
        ),
        (
            dict,
            {},
            "planner dict: must be derived from barn_planners.interface.Planner",
        ),
        ([ahead, ahead], {}, "names 'ahead' twice"),
        ({"a/b": ahead}, {}, "planner 'a/b': a name must be 1 to 60 letters"),
        (ahead, {"mode": "ros"}, "planner 'ahead': a Python object needs mode direct"),
        (
            ahead,
            {"settings": {"ahead": {"a": 1}}},
            "only registered planners have presets and parameters",
        ),
    ],
)
def test_what_cannot_be_run_is_refused_in_one_line(tmp_path, planners, options, words):
    with refused(re.escape(words), BarnError):
        drive(planners, tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_functions_may_ask_for_the_task_and_send_nothing():
    task = Task(Pose2D(-1.0, 0.0, 0.0))
    planner = FunctionPlanner(at_the_goal)
    planner.start(task, 0)
    assert planner.step(None).command == Velocity2D(0.4, 0.1)
    assert FunctionPlanner(lambda observation: None).step(None).command is None
    assert isinstance(PlannerObject("x", Straight).make_planner(), Straight)
    named = ["dwa", {"name": "eband", "preset": "paper2020"}]
    choices, live = split_planner_objects([*named, {"mine": ahead}])
    assert (choices[:2], list(live)) == (named, ["mine"])


def test_a_notebook_shows_results_figures_and_pages(driven, tmp_path):
    markup = driven._repr_html_()
    assert markup.count("<tr>") == 5
    picture = re.search(r'src="data:image/svg\+xml;base64,([^"]+)"', markup)[1]
    assert b"<svg" in b64decode(picture)
    assert "Steady" in markup
    axes = Figure().subplots()
    assert driven.plot(ax=axes) == [axes]
    drawings = (driven.plot(name)._repr_svg_() for name in ("worlds", "outcomes"))
    first, other = (set(re.findall(r'\bid="([^"]+)"', svg)) for svg in drawings)
    assert first and other and not first & other
    figure = driven.plot("distributions").save(tmp_path / "figure.png")
    assert figure.read_bytes().startswith(b"\x89PNG")
    with refused(r"unknown figure 'world'; did you mean 'worlds'\?"):
        driven.plot("world")
    page = driven.report(tmp_path / "report.html")
    assert "<iframe" in page._repr_html_()
    assert "slow" in Path(page).read_text()
    picture = driven.replay("gap_w0000_r00", tmp_path / "end.png")
    assert picture._repr_png_().startswith(b"\x89PNG")
    assert picture._repr_html_() is None is page._repr_png_()
    bag = driven.folder / "replays" / "bags" / "gap_w0000_r00"
    film = barn.replay(bag, tmp_path / "trial.gif", frames_per_s=2.0, speed=4.0)
    image = '<img alt="trial" style="max-width: 100%" src="data:image/gif;base64,'
    assert image in film._repr_html_()
    for draw in (driven.replay, barn.replay):
        with refused(r"out 'trial.jpg': must end in \.html, \.png, \.gif, \.mp4"):
            draw("gap_w0000_r00", "trial.jpg")


def test_folders_are_ranked_compared_and_reported_together(driven, tmp_path):
    other = drive({"quick": Steady(0.5)}, tmp_path / "other", [0, 60])
    file = tmp_path / "board.md"
    board = barn.results.leaderboard([driven, other.folder], by="time", out=file)
    assert set(board["planner"]) == {"gap", "ahead", "Steady", "slow", "quick"}
    assert board["rank"][0] == 1
    assert board["normalised_time_s_per_m"].is_monotonic_increasing
    assert set(driven.summary) < set(board)
    assert "| quick |" in file.read_text()
    with refused("unknown ranking 'tme'; did you mean 'time'"):
        barn.results.leaderboard(driven, by="tme")
    with refused(r"out 'board.pdf': must end in \.md or \.html"):
        barn.results.leaderboard(driven, out="board.pdf")
    compared = barn.compare(f"{driven.folder}:ahead", other).set_index("measure")
    assert {*compared["a"]} | {*compared["b"]} == {"ahead", "quick"}
    assert compared["trials"]["success"] == 2
    assets = tmp_path / "assets"
    page = barn.report([driven, other], tmp_path / "a.html", assets=assets, hardest=1)
    assert all(name in Path(page).read_text() for name in ("Steady", "quick"))
    assert list(assets.glob("*.csv"))


def test_a_replay_without_a_bag_drives_the_trial_again(driven, caplog):
    page = driven.replay("Steady_w0060_r00")
    assert page.path == driven.folder / "replays" / "Steady_w0060_r00.html"
    assert "Steady_w0060_r00 has no bag: running the trial again" in caplog.text
    assert "differs from its row" not in caplog.text
    caplog.clear()
    driven.replay("Steady_w0060_r00")
    assert "driven again" not in caplog.text
    loaded = barn.load(driven.folder)
    loaded.replay("gap_w0000_r00")
    with refused(r"'ahead' was a Python object: pass it to barn\.load\(folder, plan"):
        loaded.replay("ahead_w0000_r00")
    with refused(
        "planner 'slow': its source differs from the source that gave these results"
    ):
        barn.load(driven.folder, {"slow": Steady(0.5)}).replay("slow_w0000_r00")
    mine = driven.folder / "mine.html"
    barn.load(driven.folder, ahead).replay("ahead_w0000_r00", mine)
    assert mine.stat().st_size > 10_000
    with refused("no trial 'gap_w0001_r00'; did you mean 'gap_w0060_r00'"):
        driven.replay("gap_w0001_r00")


def test_a_replay_of_a_planner_that_does_not_repeat_says_so(tmp_path, caplog):
    class Drifting(Steady):
        """Its source, by which it is known, stays the same."""

    results = drive(Drifting, tmp_path)
    Drifting.step = lambda self, observation: barn.Decision(barn.Velocity2D(0.1, 0.0))
    results.replay("Drifting_w0000_r00")
    assert "Drifting_w0000_r00 differs from its row" in caplog.text


def test_a_folder_that_is_not_finished_is_loaded(tmp_path):
    keep(tmp_path, GAP, 3)
    results = barn.load(tmp_path)
    assert "3 of 4 trials" in repr(results)
    assert len(results.table) == 3
    with refused(r"nowhere: holds no results of a run", BarnError):
        barn.load(tmp_path / "nowhere")


def test_a_comparison_needs_two(tmp_path):
    keep(tmp_path / "gap", GAP)
    with refused("has only one planner; give other results to compare it with"):
        barn.load(tmp_path / "gap").compare()


def test_a_dry_run_says_what_would_run_and_writes_nothing(tmp_path, driven):
    options = {"repetitions": 2, "workers": 2, "bags": "all", "dry_run": True}
    out = tmp_path / "out"
    estimate = barn.run("0:300:60", ["gap", ahead], out=out, **options)
    assert estimate.planners == ("gap", "ahead")
    assert estimate.worlds == (0, 60, 120, 180, 240)
    assert (estimate.trials, estimate.there, estimate.wall_s) == (20, 0, 20.0)
    assert estimate.disk_bytes > 20 * 1_000_000
    assert not out.exists()
    resumed = drive(PLANNERS, driven.folder, [0, 60], dry_run=True)
    assert (resumed.trials, resumed.there) == (8, 8)
    assert (resumed.wall_s, resumed.disk_bytes) == (0.0, 0)
    assert resumed.basis == "8 trials in the folder"
