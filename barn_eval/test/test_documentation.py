"""The README says what the code does."""

from __future__ import annotations

from pathlib import Path

import pytest

from barn_eval.documentation import main, updated
from barn_eval.trials.outcome import Outcome

README = Path(__file__).parents[1] / "README.md"


def test_the_tables_in_the_readme_are_those_of_the_code(tmp_path):
    text = README.read_text("utf-8")
    assert updated(text) == text, "run python -m barn_eval.documentation README.md"
    copy = tmp_path / "README.md"
    copy.write_text(text.replace("0.316", "0.5"), "utf-8")
    assert main([str(copy)]) == 0
    assert copy.read_text("utf-8") == text


def test_every_outcome_is_explained():
    text = README.read_text("utf-8")
    assert [outcome.value for outcome in Outcome if f"| `{outcome.value}` |" not in text] == []


def test_a_text_without_markers_is_refused():
    with pytest.raises(ValueError, match="no <!-- commands: begin -->"):
        updated("nothing here")


def test_the_example_of_the_library_runs(monkeypatch):
    """The indented block under 'As a library', with fewer worlds."""
    section = README.read_text("utf-8").split("## As a library")[1].split("##")[0]
    code = "\n".join(line[4:] for line in section.splitlines() if line.startswith("    "))
    shown: list[tuple[object, ...]] = []
    exec(compile(code.replace("0-9", "0"), str(README), "exec"), {"print": lambda *what: shown.append(what)})
    assert len(shown) == 1
    assert shown[0][0] is Outcome.SUCCESS
