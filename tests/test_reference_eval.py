"""README and parameter files are what the code says."""

from pathlib import Path

import reference as tool
import yaml

from barn_eval.experiments.ros_config import EvaluatorConfig
from barn_eval.trials.outcome import Outcome
from barn_worlds.base.config import replace_dotted

PACKAGE = Path(__file__).resolve().parents[1] / "barn_eval"


def test_readme_and_parameter_files_are_those_of_the_code():
    assert tool.evaluator().outdated(PACKAGE) == [], "run make generated"


def test_every_outcome_is_explained():
    text = (PACKAGE / "README.md").read_text("utf-8")
    assert [outcome.value for outcome in Outcome if f"| `{outcome.value}` |" not in text] == []


def test_the_example_of_the_library_runs():
    """The indented block under 'As a library', with fewer worlds."""
    section = (PACKAGE / "README.md").read_text("utf-8").split("## As a library")[1].split("##")[0]
    code = "\n".join(line[4:] for line in section.splitlines() if line.startswith("    "))
    shown: list[tuple[object, ...]] = []
    exec(compile(code.replace("0-9", "0"), "README.md", "exec"), {"print": lambda *what: shown.append(what)})
    assert len(shown) == 1
    assert shown[0][0] is Outcome.SUCCESS


def test_the_file_holds_the_defaults_but_for_what_a_supervisor_sets():
    values = yaml.safe_load(tool.evaluator().files["evaluator.yaml"])["/**/evaluator"]["ros__parameters"]
    assert not {"supervisor_fd", "simulator_fd"} & set(values)
    assert values["patience.start_s"] == 180.0
    assert replace_dotted(EvaluatorConfig(), values, "file") == EvaluatorConfig()
