"""What `import barn_eval as barn` offers: typed, explained and on its page; worlds, metrics and difficulty from it."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import barn_eval as barn
from barn_eval.commands.main import COMMANDS
from barn_worlds.base.errors import BarnError, ConfigError

PAGE = Path(__file__).resolve().parents[3] / "docs" / "python.md"

SCRIPT = """
import math

import barn_eval as barn


def mine(observation: barn.Observation, task: barn.Task) -> tuple[float, float]:
    return 0.5, math.atan2(task.goal.y - observation.pose.y, task.goal.x - observation.pose.x)


def ahead(observation: barn.Observation) -> barn.Velocity2D:
    return barn.Velocity2D(0.4, 0.0)


class Own(barn.Planner):
    def start(self, task: barn.Task, seed: int) -> None:
        self.task = task

    def step(self, observation: barn.Observation) -> barn.Decision:
        return barn.Decision(barn.Velocity2D(0.3, 0.0))


worlds = barn.worlds.load("barn300", "0:300:100")
results = barn.run(list(worlds.values()), ["gap", mine, ahead, Own, {"other": Own()}], workers=2, bags="none")
first: barn.TrialResult = results.trials[0]
trial = results.trial(first.trial_id)
print(results.table["planner"].tolist(), first.scores.success)
print(trial.trajectory["x_m"].max(), trial.to_tum("trial.txt"))
print(barn.run(worlds, "dwa", dry_run=True).trials, barn.robots.load("husky").name)
print(barn.compare(results, "out").columns)
"""

WRONG = """
import barn_eval as barn

barn.run("0", "dwa", repetition=2)
barn.rnu()
barn.worlds.generate(per_st=1)
barn.run("0", 3, workers="two")
barn.sweep({"dwa.path_weight": [1]}, worlds="0", planners="dwa", repetition=2)
"""


def test_importing_it_loads_nothing_and_offers_everything():
    script = "import sys, barn_eval as barn; print(*sys.modules); print(*dir(barn))"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    loaded, offered = (set(line.split()) for line in done.stdout.splitlines())
    assert (
        not {
            "numpy",
            "numba",
            "rich",
            "pandas",
            "matplotlib",
            "barn_eval.api.run",
            "barn_worlds.base.types",
        }
        & loaded
    )
    assert {
        "run",
        "load",
        "worlds",
        "difficulty",
        "Planner",
        "Protocol",
        "World",
        "Robot",
        "__version__",
    } <= offered
    for name in offered:
        assert getattr(barn, name)
    with pytest.raises(
        AttributeError, match="module 'barn_eval' has no attribute 'rnu'"
    ):
        barn.rnu  # noqa: B018


def offered():
    """Return all that the front door offers, by name."""
    members = {name: getattr(barn, name) for name in dir(barn) if name != "__version__"}
    for noun, module in [
        (name, member) for name, member in members.items() if inspect.ismodule(member)
    ]:
        names = getattr(
            module,
            "__all__",
            [name for name in vars(module) if not name.startswith("_")],
        )
        members |= {f"{noun}.{name}": getattr(module, name) for name in names}
    return {
        name: member for name, member in members.items() if not inspect.ismodule(member)
    }


def test_every_command_has_its_function():
    functions = {
        "demo": "run",
        "show": "draw",
        "worlds": "generate save resize datasets",
    }
    functions |= {"robots": "names load draw", "difficulty": "predict"}
    functions |= {
        "ab": "compare",
        "tune": "sweep",
    }  # which choose what to run; these run it
    names = {name.rpartition(".")[2] for name in offered()} | {
        member for member in vars(barn.Results) if member[0] != "_"
    }
    assert [
        name for name in COMMANDS if not {*functions.get(name, name).split()} <= names
    ] == []


@pytest.mark.timeout(900)
def test_a_users_script_passes_mypy_and_a_wrong_one_fails(tmp_path):
    for name, text in (("right.py", SCRIPT), ("wrong.py", WRONG)):
        (tmp_path / name).write_text(text)
    cache = (
        PAGE.parents[1] / "build" / "barn_eval" / "mypy"
    )  # of the last time: most of the work is the suite itself
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--strict",
        "--config-file=",
        f"--cache-dir={cache}",
        "--no-pretty",
    ]
    command += ["right.py", "wrong.py"]
    process = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, check=False
    ).stdout
    assert "right.py" not in process
    for words in (
        'No overload variant of "run" matches',
        'did you mean "repetitions"?',
        'has no attribute "rnu"',
        'did you mean "per_set"?',
        "expected",
    ):
        assert words in process


def test_worlds_are_listed_opened_generated_and_written(tmp_path):
    assert "barn300" in barn.worlds.datasets()
    assert list(barn.worlds.load("barn300", "0,7")) == [0, 7]
    worlds = barn.worlds.generate(
        tmp_path / "own.npz", per_set=2, seed=3, parameters={"initial_fill": 0.2}
    )
    assert list(worlds) == [0, 1]
    assert barn.worlds.load(tmp_path / "own.npz")[1].checksum == worlds[1].checksum
    again = barn.worlds.generate(per_set=2, seed=3, parameters={"initial_fill": 0.2})
    assert [world.checksum for world in again.values()] == [
        world.checksum for world in worlds.values()
    ]
    with pytest.raises(BarnError, match="exists already"):
        barn.worlds.save(worlds, tmp_path / "own.npz")
    with pytest.raises(
        ConfigError, match=r"unknown format 'sfd'; did you mean 'sdf'\?"
    ):
        barn.worlds.save(worlds, tmp_path / "x", "sfd")
    with pytest.raises(
        ConfigError, match="movable obstacles are for Gazebo worlds, not for map"
    ):
        barn.worlds.save(worlds, tmp_path / "x", "map", movable=True)


def test_metrics_and_difficulty_have_a_row_per_world():
    metrics = barn.worlds.metrics("barn300", "0:300:100")
    assert (metrics.columns[0], len(metrics.columns), list(metrics["world"])) == (
        "world",
        6,
        [0, 100, 200],
    )
    predicted = barn.difficulty.predict("barn300", "0,299")
    assert list(predicted["world"]) == [0, 299]
    assert predicted["difficulty_s_per_m"].is_monotonic_increasing
    assert {
        "name",
        "std_s_per_m",
        "dwa_s_per_m",
        "eband_s_per_m",
        "failure_probability",
    } <= set(predicted)


def test_everything_offered_is_explained():
    methods = {
        f"Results.{name}": member
        for name, member in vars(barn.Results).items()
        if not name.startswith("_")
    }
    for name, member in (offered() | methods).items():
        text = inspect.getdoc(member)
        assert text, name
        if (
            inspect.isfunction(member)
            and member.__module__.startswith("barn_eval")
            and "; as `barn." not in text
        ):
            taken = {
                parameter
                for parameter in inspect.signature(member).parameters
                if parameter != "self"
            }
            explained = set(
                re.findall(
                    r"(?m)^    (\w+): ", text.partition("Args:")[2].partition("\n\n")[0]
                )
            )
            assert explained == taken, name


def test_the_page_shows_what_there_is():
    text = PAGE.read_text("utf-8")
    names_on_page = set(re.findall(r"barn(?:\.\w+)+", text))
    public = [name for name, member in offered().items() if inspect.isfunction(member)]
    assert len(public) > 30
    assert [
        name
        for name in public
        if not {f"barn.{name}", f"barn.{name.partition('.')[2]}"} & names_on_page
    ] == []
    for block in re.findall(r"(?ms)^```python\n(.*?)^```", text):
        compile(block, str(PAGE), "exec")
