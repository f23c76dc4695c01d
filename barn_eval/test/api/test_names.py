"""What `import barn_eval as barn` offers: typed, explained and on its page.

Worlds, metrics and difficulty from it.
"""

import inspect
import re

import pytest
from refusals import refused
from waiting import ROOT, run_python

import barn_eval as barn
from barn_eval.commands.main import COMMANDS
from barn_worlds.base.errors import BarnError

PAGE = ROOT / "docs" / "python.md"

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
    done = run_python("-c", script)
    loaded, offered = (set(line.split()) for line in done.stdout.splitlines())
    libraries = "numpy numba rich pandas matplotlib"
    unneeded = f"{libraries} barn_eval.api.run barn_worlds.base.types"
    assert not set(unneeded.split()) & loaded
    names = "run load worlds difficulty Planner Protocol World Robot __version__"
    assert set(names.split()) <= offered
    for name in offered:
        assert getattr(barn, name)
    with pytest.raises(
        AttributeError, match="module 'barn_eval' has no attribute 'rnu'"
    ):
        barn.rnu  # noqa: B018


def offered():
    """Return all that the front door offers, by name."""
    members = {}
    for name in set(dir(barn)) - {"__version__"}:
        member = getattr(barn, name)
        if not inspect.ismodule(member):
            members[name] = member
            continue
        public = [inner for inner in vars(member) if not inner.startswith("_")]
        for inner in getattr(member, "__all__", public):
            members[f"{name}.{inner}"] = getattr(member, inner)
    return members


def test_every_command_has_its_function():
    functions = {
        "demo": "run",
        "show": "draw",
        "worlds": "generate save resize datasets",
        "course": "plan survey",
        "planners": "run",
        "protocols": "run",
        "try": "run",
        "robots": "names load draw",
        "difficulty": "predict",
        # which choose what to run; these run it
        "ab": "compare",
        "tune": "sweep",
    }
    names = {name.rpartition(".")[2] for name in offered()} | set(vars(barn.Results))
    for name in COMMANDS:
        assert set(functions.get(name, name).split()) <= names


@pytest.mark.timeout(900)
def test_a_users_script_passes_mypy_and_a_wrong_one_fails(tmp_path):
    pytest.importorskip("mypy")
    for name, text in (("right.py", SCRIPT), ("wrong.py", WRONG)):
        (tmp_path / name).write_text(text)
    # of the last time: most of the work is the suite itself
    cache = PAGE.parents[1] / "build" / "barn_eval" / "mypy"
    options = f"--strict --config-file= --cache-dir={cache} --no-pretty"
    words = f"-m mypy {options} right.py wrong.py".split()
    output = run_python(*words, check=False, cwd=tmp_path).stdout
    assert "right.py" not in output
    for words in (
        'No overload variant of "run" matches',
        'did you mean "repetitions"?',
        'has no attribute "rnu"',
        'did you mean "per_set"?',
        "expected",
    ):
        assert words in output


def test_worlds_are_listed_opened_generated_and_written(tmp_path):
    assert "barn300" in barn.worlds.datasets()
    assert list(barn.worlds.load("barn300", "0,7")) == [0, 7]
    options = {"per_set": 2, "seed": 3, "parameters": {"initial_fill": 0.2}}
    own = tmp_path / "own.npz"
    worlds = barn.worlds.generate(own, **options)
    assert list(worlds) == [0, 1]
    assert barn.worlds.load(own)[1].checksum == worlds[1].checksum
    again = barn.worlds.generate(**options)
    for number, world in worlds.items():
        assert world.checksum == again[number].checksum
    with refused("exists already", BarnError):
        barn.worlds.save(worlds, own)
    with refused(r"unknown format 'sfd'; did you mean 'sdf'\?"):
        barn.worlds.save(worlds, tmp_path / "x", "sfd")
    with refused("movable obstacles are for Gazebo worlds, not for map"):
        barn.worlds.save(worlds, tmp_path / "x", "map", movable=True)


def test_metrics_and_difficulty_have_a_row_per_world():
    metrics = barn.worlds.metrics("barn300", "0:300:100")
    assert (metrics.columns[0], len(metrics.columns)) == ("world", 6)
    assert list(metrics["world"]) == [0, 100, 200]
    predicted = barn.difficulty.predict("barn300", "0,299")
    assert list(predicted["world"]) == [0, 299]
    assert predicted["difficulty_s_per_m"].is_monotonic_increasing
    names = "name std_s_per_m dwa_s_per_m eband_s_per_m"
    # It has no share of failures, which was half of the truth in the hardest worlds.
    assert set(predicted) == {"world", "difficulty_s_per_m", *names.split()}


def test_everything_offered_is_explained():
    members = offered()
    for name, member in vars(barn.Results).items():
        if not name.startswith("_"):
            members[f"Results.{name}"] = member
    for name, member in members.items():
        text = inspect.getdoc(member)
        assert text, name
        is_own = inspect.isfunction(member) and member.__module__.startswith(
            "barn_eval"
        )
        if is_own and "; as `barn." not in text:
            taken = set(inspect.signature(member).parameters) - {"self"}
            arguments = text.partition("Args:")[2].partition("\n\n")[0]
            assert set(re.findall(r"(?m)^    (\w+): ", arguments)) == taken, name


def test_the_page_shows_what_there_is():
    text = PAGE.read_text("utf-8")
    names_on_page = set(re.findall(r"barn(?:\.\w+)+", text))
    public = [name for name, member in offered().items() if inspect.isfunction(member)]
    assert len(public) > 30
    for name in public:
        shown = {f"barn.{name}", f"barn.{name.partition('.')[2]}"}
        assert shown & names_on_page, name
    for block in re.findall(r"(?ms)^```python\n(.*?)^```", text):
        compile(block, str(PAGE), "exec")
