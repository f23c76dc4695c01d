"""`import barn_eval as barn`: experiments, results and worlds from Python."""

import importlib.util
import inspect
import json
import re
import subprocess
import sys
import textwrap
import threading
from base64 import b64decode
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pytest
from planners import Straight
from test_folder import BOTH, GAP, keep, make_schema_1, schema_1_campaign, schema_1_plan

import barn_eval as barn
from barn_eval.commands.main import COMMANDS
from barn_eval.experiments.live import NO_SOURCE, FunctionPlanner, LivePlanner, fingerprint, split_planners
from barn_eval.experiments.tables import results_table
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.protocol import CHALLENGE
from barn_planners.interface import Task
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.base.types import Pose2D, Velocity2D

SHORT = replace(CHALLENGE, name="short", limit_s=3.0, timeout_time_s=3.0, first_motion_limit_s=3.0)
PAGE = Path(__file__).resolve().parents[2] / "docs" / "python.md"


def ahead(observation):
    return 0.4, 0.0


def at_the_goal(observation, task):
    return Velocity2D(0.4, 0.0 if task.goal.x > 0.0 else 0.1)


class Steady(barn.Planner):
    """Drives straight on at a speed that it is made with."""

    def __init__(self, speed_mps=0.3):
        self.speed_mps = speed_mps

    def start(self, task, seed):
        self.task = task

    def step(self, observation):
        return barn.Decision(barn.Velocity2D(self.speed_mps, 0.0))


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """Short trials of a function, a class, an object and a planner of the registry, by two workers."""
    out = tmp_path_factory.mktemp("front") / "out"
    planners = ["gap", ahead, Steady, {"slow": Steady(0.2)}]
    return barn.run([0, 60], planners, SHORT, workers=2, out=out, progress=False)


def test_importing_it_loads_nothing_and_offers_everything():
    asked = "import sys, barn_eval as barn; print(*sys.modules); print(*dir(barn)); print(*barn.__all__)"
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    loaded, offered, names = (set(line.split()) for line in done.stdout.splitlines())
    assert not {"numpy", "numba", "rich", "pyarrow", "matplotlib", "barn_eval.api", "barn_worlds.base.types"} & loaded
    assert names <= offered
    assert {"run", "load", "worlds", "metrics", "difficulty", "Planner", "__version__"} <= names
    for name in names:
        assert getattr(barn, name)
    with pytest.raises(AttributeError, match="module 'barn_eval' has no attribute 'rnu'"):
        barn.rnu  # noqa: B018


def test_every_command_has_its_function():
    functions = {
        **dict.fromkeys(("demo", "run", "campaign"), "run"),
        "worlds": "generate_worlds sample_worlds save_worlds order_worlds resize_worlds draw datasets",
        "difficulty": "difficulty train_difficulty evaluate_difficulty check_difficulty",
        "show": "draw",
    }
    offered = {*barn.__all__, *(name for name in vars(barn.Results) if not name.startswith("_"))}
    assert [name for name in COMMANDS if not {*functions.get(name, name).split()} <= offered] == []


def test_what_is_installed_is_said():
    said = barn.info()
    assert said["versions"]["barn_eval"] == barn.__version__
    assert {"dwa", "eband"} <= {*said["planners"]}
    assert "barn300" in said["data_sets"]


def test_what_a_difficulty_model_predicts_is_checked_against_trials(tmp_path):
    worlds = barn.generate_worlds(tmp_path / "worlds.npz", per_set=1, seed=3)
    lines = [f"{number},{one.path_length_m:.9f},8.0,9.0" for number, one in worlds.items()]
    table = tmp_path / "times.csv"
    table.write_text("\n".join(["world,path_length_m,dwa_1,eband_1", *lines]) + "\n")
    found = barn.check_difficulty(table, dataset=str(tmp_path / "worlds.npz"))
    assert (found.worlds, found.trials) == (len(worlds), 2 * len(worlds))
    with pytest.raises(BarnError, match=r"weights\.bin: must end in \.npz"):
        barn.train_difficulty(table, tmp_path / "weights.bin")


def test_planners_of_all_kinds_drive_side_by_side(driven):
    assert driven.planners == ["gap", "ahead", "Steady", "slow"]
    assert len(driven) == 8
    speeds = {one.planner: one.measures.mean_speed_mps for one in driven.trials}
    assert speeds["slow"] < speeds["Steady"] < speeds["ahead"]
    assert {one.wall_clock.worker for one in driven.trials} == {"local-0", "local-1"}
    assert repr(driven) == f"Results({str(driven.folder)!r}: 8 trials, gap, ahead, Steady, slow)"


def columns(table):
    """Return the columns of a DataFrame or pyarrow Table as lists."""
    return table.to_pydict() if isinstance(table, pa.Table) else {name: list(table[name]) for name in table}


def test_tables_have_a_row_per_trial_planner_and_measure(driven):
    table = columns(driven.table)
    assert list(table) == results_table([]).column_names
    assert table["trial_id"] == [one.trial_id for one in driven.trials]
    assert table["driven_m"] == [one.measures.driven_m for one in driven.trials]
    assert columns(driven.timing)["worker"] == [one.wall_clock.worker for one in driven.trials]
    summary = columns(driven.summary)
    assert summary["planner"] == driven.planners
    assert summary["trials"] == [2, 2, 2, 2]
    assert all(
        low <= mean <= high
        for low, mean, high in zip(*(summary[f"success{end}"] for end in ("_low", "", "_high")), strict=True)
    )
    compared = columns(driven.compare())
    pairs = list(dict.fromkeys(zip(compared["a"], compared["b"], strict=True)))
    assert len(pairs) == 6
    first = next(
        place
        for place, row in enumerate(zip(compared["a"], compared["b"], compared["measure"], strict=True))
        if row == ("ahead", "slow", "min_clearance_m")
    )
    gaps = [
        sum(one.measures.min_clearance_m for one in driven.trials if one.planner == name) / 2
        for name in ("ahead", "slow")
    ]
    assert [compared["mean_a"][first], compared["mean_b"][first]] == pytest.approx(gaps)
    assert compared["difference"][first] == pytest.approx(gaps[0] - gaps[1])


@pytest.mark.skipif(importlib.util.find_spec("pandas") is None, reason="pandas, an optional extra, is not installed")
def test_tables_are_data_frames_where_pandas_is_installed(driven):
    assert list(driven.table.columns) == results_table([]).column_names
    assert driven.table.groupby("planner").size().to_dict() == {"gap": 2, "ahead": 2, "Steady": 2, "slow": 2}


def test_results_say_who_is_better_and_how_many_worlds_it_would_take(driven):
    text = driven.verdict()
    assert text == driven.verdict()
    assert text.endswith("hardly any difference is clear.")
    assert "Only 2 worlds" in text
    assert "have the same challenge metric, 0.000 (2 worlds, 2 pairs of trials)" in text
    found = columns(driven.precision(0.1, 0.2, planners=["gap", "slow"], repetitions=1))
    assert found["of"] == ["gap", "slow", "gap - slow"]
    assert found["kind"] == ["half_width", "half_width", "difference"]
    assert found["wanted"] == [0.1, 0.1, 0.2]
    with pytest.raises(ConfigError, match="has no planner 'slo'; did you mean 'slow'"):
        driven.precision(planners=["slo"])
    with pytest.raises(ConfigError, match="a difference needs two planners; there are 4"):
        driven.precision(difference=0.2)


def test_tables_are_of_pyarrow_where_it_is_not(driven, monkeypatch):
    monkeypatch.setattr("barn_eval.results.find_spec", lambda _name: None)
    assert isinstance(barn.load(driven.folder).table, pa.Table)


def test_the_same_call_resumes_and_other_objects_are_refused(driven):
    planners = ["gap", ahead, Steady, {"slow": Steady(0.2)}]
    before = (driven.folder / "results.jsonl").read_bytes()
    again = barn.run([0, 60], planners, SHORT, workers=1, out=driven.folder, progress=False)
    assert again.trials == driven.trials
    assert (driven.folder / "results.jsonl").read_bytes() == before
    planners[3] = {"slow": Steady(0.1)}
    with pytest.raises(ConfigError, match=r"planners\.3\.source is '[0-9a-f]{64}' there, '[0-9a-f]{64}' here"):
        barn.run([0, 60], planners, SHORT, out=driven.folder, progress=False)


def test_objects_are_recorded_by_a_hash_of_their_source(driven):
    choices = json.loads((driven.folder / "run.json").read_text())["experiment"]["planners"]
    assert [bool(one["source"]) for one in choices] == [False, True, True, True]
    assert fingerprint(Steady(0.2)) == fingerprint(Steady(0.2)) != fingerprint(Steady(0.3))
    assert fingerprint(ahead) != fingerprint(at_the_goal)

    def made(speed_mps):
        return lambda observation: (speed_mps, 0.0)

    assert fingerprint(made(0.1)) == fingerprint(made(0.1)) != fingerprint(made(0.2))
    namespace = {}
    exec("def f(observation): return 0.0, 0.0", namespace)
    assert fingerprint(namespace["f"]) == NO_SOURCE


def test_one_worker_drives_live_planners_in_this_process(tmp_path):
    class Counting(Steady):
        cycles = 0

        def step(self, observation):
            Counting.cycles += 1
            return super().step(observation)

    inline = barn.run(0, Counting(), SHORT, workers=1, out=tmp_path / "a", progress=False)
    assert Counting.cycles > 50
    assert inline.trials[0].wall_clock.worker == "inline"
    elsewhere = barn.run(0, Counting(), SHORT, workers=1, engine="local", out=tmp_path / "b", progress=False)
    assert elsewhere.trials[0].repeatable() == inline.trials[0].repeatable()


def test_a_script_without_a_main_guard_runs_once(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        textwrap.dedent("""
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
    )
    (tmp_path / "helper.py").write_text("GAIN = 0.4\n")
    (tmp_path / "protocol.yaml").write_text(
        "schema_version: 1\nbase: challenge\nname: short\nlimit_s: 3.0\nfirst_motion_limit_s: 3.0\n"
    )
    (tmp_path / "short.yaml").write_text("schema_version: 1\nprotocol: protocol.yaml\nrepetitions: 2\n")
    done = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "8 ['local-0', 'local-1'] ['mine', 'Own']"
    assert done.stderr == ""
    assert (tmp_path / "imported").read_text() == "once\n"


def test_what_cannot_be_handed_to_a_worker_is_said(tmp_path):
    class Locked(Steady):
        def __init__(self):
            super().__init__()
            self.lock = threading.Lock()

    locked = Locked()
    with pytest.raises(ConfigError, match=r"a planner cannot be handed to a worker .* workers=1 needs none"):
        barn.run(0, {"locked": locked}, SHORT, workers=2, out=tmp_path / "a", progress=False)
    (one,) = barn.run(0, {"locked": locked}, SHORT, workers=1, out=tmp_path / "a", progress=False).trials
    assert one.outcome is Outcome.TIMEOUT


def test_what_goes_wrong_in_a_planner_of_ones_own_is_an_outcome(tmp_path):
    def broken(observation):
        raise KeyError("speed")

    def talks(observation):
        return "left"

    results = barn.run(0, [broken, talks], SHORT, workers=1, out=tmp_path, progress=False)
    told = {one.planner: (one.outcome, one.detail) for one in results.trials}
    assert told["broken"] == (Outcome.PLANNER_DIED, "KeyError: 'speed'")
    assert told["talks"] == (
        Outcome.PLANNER_DIED,
        "TypeError: a planner's function must return (m/s, rad/s), got 'left'",
    )

    class Unmade(Steady):
        def __init__(self):
            raise OSError("no weights")

    with pytest.raises(BarnError, match="planner 'Unmade' cannot be made: OSError: no weights"):
        barn.run(0, Unmade, SHORT, workers=1, out=tmp_path / "unmade", progress=False)


@pytest.mark.parametrize(
    ("planners", "words"),
    [
        (3, "a planner must be a name, a Planner class or object, or a function of the observation, got 3"),
        (lambda observation: None, "has no name; give it one, as {'name': planner}"),
        ({"dwa": ahead}, "planner 'dwa': is one of the registry's; give yours another name"),
        (dict, "planner dict: must be derived from barn_planners.interface.Planner"),
        ([ahead, ahead], "names 'ahead' twice"),
        ({"a/b": ahead}, "planner 'a/b': a name must be 1 to 60 letters"),
        ("daw", "unknown planner 'daw'; did you mean 'dwa'?"),
        ([{"name": "x", "comand": "y"}], "did you mean 'command'?"),
    ],
)
def test_planners_that_are_none_are_refused_in_one_line(tmp_path, planners, words):
    with pytest.raises(BarnError) as caught:
        barn.run(0, planners, SHORT, out=tmp_path / "out", progress=False)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"repetition": 2}, "unknown key 'repetition'; did you mean 'repetitions'?"),
        ({"repetitions": 0}, "repetitions must be from 1 to 99, got 0"),
        ({"mode": "ros"}, "planner 'ahead': a Python object drives in mode direct only"),
        ({"ros": {"lockstep": False}}, "settings of ros need mode ros"),
        ({"settings": {"ahead": {"a": 1}}}, "presets and parameters are for planners of the registry"),
    ],
)
def test_options_that_are_none_are_refused_in_one_line(tmp_path, options, words):
    with pytest.raises(BarnError) as caught:
        barn.run(0, ahead, SHORT, out=tmp_path / "out", progress=False, **options)
    assert words in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_functions_may_ask_for_the_task_and_send_nothing():
    task = Task(Pose2D(-1.0, 0.0, 0.0))
    planner = FunctionPlanner(at_the_goal)
    planner.start(task, 0)
    assert planner.step(None).command == Velocity2D(0.4, 0.1)
    assert FunctionPlanner(lambda observation: None).step(None).command is None
    assert isinstance(LivePlanner("x", Straight).make(), Straight)
    chosen, live = split_planners(["dwa", {"name": "eband", "preset": "paper"}, {"mine": ahead}])
    assert (chosen[:2], list(live)) == (["dwa", {"name": "eband", "preset": "paper"}], ["mine"])


def test_a_notebook_shows_results_figures_and_pages(driven, tmp_path):
    shown = driven._repr_html_()
    assert shown.count("<tr>") == 5
    assert b"<svg" in b64decode(re.search(r'src="data:image/svg\+xml;base64,([^"]+)"', shown)[1])
    assert "Steady" in shown
    identifiers = [
        set(re.findall(r'\bid="([^"]+)"', driven.plot(what)._repr_svg_()))
        for what in ("worlds", "outcomes", "overview")
    ]
    assert all(identifiers)
    assert not identifiers[0] & identifiers[1]
    assert driven.plot("distributions").save(tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ConfigError, match=r"unknown figure 'world'; did you mean 'worlds'\?"):
        driven.plot("world")
    page = driven.report(tmp_path / "report.html")
    assert "<iframe" in page._repr_html_()
    assert "slow" in Path(page).read_text()
    picture = driven.replay("gap_w0000_r00", tmp_path / "end.png")
    assert picture._repr_png_().startswith(b"\x89PNG")
    assert picture._repr_html_() is None is page._repr_png_()
    bag = driven.folder / "replays" / "bags" / "gap_w0000_r00"
    film = barn.replay(bag, tmp_path / "trial.gif", frames_per_s=2.0, speed=4.0)
    assert '<img alt="trial" style="max-width: 100%" src="data:image/gif;base64,' in film._repr_html_()
    for draw in (driven.replay, barn.replay):
        with pytest.raises(ConfigError, match=r"out 'trial.jpg': must end in \.html, \.png, \.gif, \.mp4"):
            draw("gap_w0000_r00", "trial.jpg")


def test_folders_are_ranked_compared_and_reported_together(driven, tmp_path):
    other = barn.run([0, 60], {"quick": Steady(0.5)}, SHORT, out=tmp_path / "other", workers=1, progress=False)
    board = columns(barn.leaderboard([driven, other.folder], by="time", out=tmp_path / "board.md"))
    assert set(board["planner"]) == {"gap", "ahead", "Steady", "slow", "quick"}
    assert board["rank"][0] == 1
    assert sorted(board["normalised_time_s_per_m"]) == board["normalised_time_s_per_m"]
    assert set(columns(driven.summary)) < set(board)
    assert "| quick |" in (tmp_path / "board.md").read_text()
    with pytest.raises(ConfigError, match="unknown ranking 'tme'; did you mean 'time'"):
        barn.leaderboard(driven, by="tme")
    with pytest.raises(ConfigError, match=r"out 'board.pdf': must end in \.md or \.html"):
        barn.leaderboard(driven, out="board.pdf")
    compared = columns(barn.compare(f"{driven.folder}:ahead", other))
    assert {*compared["a"]} | {*compared["b"]} == {"ahead", "quick"}
    assert compared["trials"][compared["measure"].index("success")] == 2
    page = barn.report([driven, other], tmp_path / "both.html", assets=tmp_path / "assets", hardest=1)
    assert all(name in Path(page).read_text() for name in ("Steady", "quick"))
    assert list((tmp_path / "assets").glob("*.csv"))


def test_a_replay_without_a_bag_drives_the_trial_again_and_says_so(driven, capfd):
    page = driven.replay("Steady_w0060_r00")
    assert page.path == driven.folder / "replays" / "Steady_w0060_r00.html"
    said = capfd.readouterr().err
    assert "no bag of Steady_w0060_r00 was kept: it is driven once more" in said
    assert "otherwise" not in said
    driven.replay("Steady_w0060_r00")
    assert "once more" not in capfd.readouterr().err
    loaded = barn.load(driven.folder)
    loaded.replay("gap_w0000_r00")
    with pytest.raises(
        ConfigError, match=r"planner 'ahead' was a Python object: barn\.load\(folder, planners=\.\.\.\)"
    ):
        loaded.replay("ahead_w0000_r00")
    with pytest.raises(ConfigError, match="planner 'slow' is not the one of these results"):
        barn.load(driven.folder, {"slow": Steady(0.5)}).replay("slow_w0000_r00")
    barn.load(driven.folder, ahead).replay("ahead_w0000_r00", driven.folder / "mine.html")
    assert (driven.folder / "mine.html").stat().st_size > 10_000
    with pytest.raises(ConfigError, match="has no trial 'gap_w0001_r00'; did you mean 'gap_w0060_r00'"):
        driven.replay("gap_w0001_r00")


def test_a_replay_of_a_planner_that_does_not_repeat_says_so(tmp_path, capfd):
    class Drifting(Steady):
        def start(self, task, seed):
            self.speed_mps += 0.1

    results = barn.run(0, Drifting(), SHORT, workers=1, out=tmp_path, progress=False)
    results._live["Drifting"].given.speed_mps = 0.3  # what it was hashed with
    results._live["Drifting"].given.start = lambda *_: None
    with pytest.raises(ConfigError, match="is not the one of these results"):
        results.replay("Drifting_w0000_r00")
    del results._live["Drifting"].given.start
    results._live["Drifting"].given.speed_mps = 0.3
    before = results.trials[0].measures.mean_speed_mps
    Drifting.start = lambda self, task, seed: setattr(self, "speed_mps", 0.1)
    results.replay("Drifting_w0000_r00")
    assert before > 0.2
    assert "Drifting_w0000_r00 went otherwise this time" in capfd.readouterr().err


@pytest.mark.parametrize(("schema", "experiment"), [(schema_1_plan, GAP), (schema_1_campaign, BOTH)])
def test_folders_of_the_schemas_before_are_loaded(tmp_path, schema, experiment):
    keep(tmp_path, experiment, 3)
    make_schema_1(tmp_path, schema(experiment))
    results = barn.load(tmp_path)
    total = 4 * len(experiment.planners)
    assert f"3 of {total} trials" in repr(results)
    assert len(columns(results.table)["trial_id"]) == 3
    with pytest.raises(BarnError, match=r"run\.json: No such file"):
        barn.load(tmp_path / "nowhere")


def test_a_comparison_needs_two(tmp_path, driven):
    keep(tmp_path / "gap", GAP)
    with pytest.raises(ConfigError, match="has one planner only; give other results to compare with"):
        barn.load(tmp_path / "gap").compare()
    keep(tmp_path / "both", BOTH)
    found = columns(barn.load(tmp_path / "gap").compare(tmp_path / "both"))
    assert set(found["a"]) == {"gap (gap)"}
    assert set(found["b"]) == {"gap (both)"}
    assert found["difference"][0] == 0.0


def test_a_plan_says_what_would_run_and_writes_nothing(tmp_path, driven):
    found = barn.plan("0:300:60", ["gap", ahead], repetitions=2, workers=2, bags="all", out=tmp_path / "out")
    assert (found.trials, found.there, found.planners, found.worlds) == (
        20,
        0,
        ("gap", "ahead"),
        (0, 60, 120, 180, 240),
    )
    assert found.wall_s == 20.0
    assert found.disk_bytes > 20 * 1_000_000
    assert not (tmp_path / "out").exists()
    planners = ["gap", ahead, Steady, {"slow": Steady(0.2)}]
    there = barn.plan([0, 60], planners, SHORT, out=driven.folder)
    assert (there.trials, there.there, there.wall_s, there.disk_bytes) == (8, 8, 0.0, 0)
    assert there.basis == "8 trials in the folder"


def test_worlds_are_listed_opened_generated_and_written(tmp_path):
    assert "barn300" in barn.datasets()
    assert list(barn.worlds("barn300", "0,7")) == [0, 7]
    made = barn.generate_worlds(tmp_path / "own.npz", per_set=2, seed=3, parameters={"initial_fill": 0.2})
    assert list(made) == [0, 1]
    assert barn.worlds(tmp_path / "own.npz")[1].checksum == made[1].checksum
    again = barn.generate_worlds(per_set=2, seed=3, parameters={"initial_fill": 0.2})
    assert [one.checksum for one in again.values()] == [one.checksum for one in made.values()]
    for form in ("sdf", "map", "original", "png", "npz"):
        assert barn.save_worlds(made, tmp_path / form, form).exists()
    with pytest.raises(BarnError, match="exists already"):
        barn.save_worlds(made, tmp_path / "sdf", "sdf")
    with pytest.raises(ConfigError, match=r"unknown format 'sfd'; did you mean 'sdf'\?"):
        barn.save_worlds(made, tmp_path / "x", "sfd")
    with pytest.raises(ConfigError, match="movable obstacles are for Gazebo worlds, not for map"):
        barn.save_worlds(made, tmp_path / "x", "map", movable=True)


def test_metrics_and_difficulty_have_a_row_per_world():
    found = columns(barn.metrics("barn300", "0:300:100"))
    assert next(iter(found)) == "world"
    assert found["world"] == [0, 100, 200]
    assert len(found) == 6
    predicted = columns(barn.difficulty("barn300", "0,299"))
    assert predicted["world"] == [0, 299]
    assert predicted["difficulty_s_per_m"][0] < predicted["difficulty_s_per_m"][1]
    assert {"name", "std_s_per_m", "dwa_s_per_m", "eband_s_per_m", "failure_probability"} <= set(predicted)


def test_worlds_are_sampled_ordered_and_drawn(tmp_path):
    pair = barn.save_worlds(barn.worlds("barn300", "3,290"), tmp_path / "pair.npz")
    limit = max(columns(barn.difficulty(pair))["difficulty_s_per_m"])
    (hard,) = barn.sample_worlds(tmp_path / "hard.npz", limit, source=pair, count=1).values()
    assert hard.grid.tolist() == barn.worlds(pair)[290].grid.tolist()
    with pytest.raises(BarnError, match="exists already"):
        barn.sample_worlds(tmp_path / "hard.npz", limit, source=pair, count=1)
    (tmp_path / "scores.csv").write_text("world,slowness\n3,2.0\n290,1.0\n")
    ordered = barn.order_worlds(pair, tmp_path / "ordered.npz", tmp_path / "scores.csv", "slowness")
    assert ordered[0].grid.tolist() == hard.grid.tolist()
    assert barn.worlds(tmp_path / "ordered.npz")[1].checksum == ordered[1].checksum
    for figure in (barn.draw(ordered), barn.draw(hard), barn.draw(hard, metrics=True)):
        assert "<svg" in figure._repr_svg_()
    with pytest.raises(ConfigError, match="metrics are drawn of one world, not of several"):
        barn.draw(ordered, metrics=True)


def test_everything_offered_is_explained():
    for name in barn.__all__:
        if name != "__version__":
            assert inspect.getdoc(getattr(barn, name)), name


def test_the_page_shows_what_there_is():
    if not PAGE.is_file():
        pytest.skip("the repository's docs are not beside this package")
    text = PAGE.read_text("utf-8")
    assert [name for name in barn.__all__ if not name.startswith("_") and f"barn.{name}" not in text] == []
    for block in re.findall(r"(?ms)^```python\n(.*?)^```", text):
        compile(block, str(PAGE), "exec")
