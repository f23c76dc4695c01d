"""The mutation check finds what tests miss.

What it changes, what it takes as killed, and what is known to survive.
"""

import json

import pytest
from repository import ROOT
from waiting import run_python

TOOL = ROOT / "qa" / "checks" / "mutate"


@pytest.fixture
def tool(monkeypatch):
    """Modules of the tool, which are no package: it runs as a folder."""
    monkeypatch.syspath_prepend(TOOL)
    import changes  # noqa: PLC0415
    import report  # noqa: PLC0415
    import runner  # noqa: PLC0415

    return changes, report, runner


def run(*arguments):
    """Run the tool and return its exit code and what it found."""
    ended = run_python(TOOL, "--json", *arguments, check=False)
    assert ended.stdout, ended.stderr
    return ended.returncode, json.loads(ended.stdout)


SOURCE = '''
"""A 1 in a docstring."""
from math import floor

@decorated(2)
def f(x: int = 3) -> "float":
    """A 4 in another."""
    if x <= 5 or x:
        self.y = -x
        raise ValueError("6", 7)
    return f"{8}" + g(x, key="z")
'''


MUTANTS = """
6 def f(x: int = 2) -> "float":
6 def f(x: int = 4) -> "float":
8 if (x < 5) or x:
8 if (x > 5) or x:
8 if x <= 4 or x:
8 if x <= 6 or x:
8 if (x <= 5 and x):
8 if (not (x <= 5 or x)):
8 if y <= 5 or x:
8 if x <= 5 or y:
9 pass
9 self.y = x
9 self.y = -y
10 pass
11 return None
11 return (f'{8}' - g(x, key='z'))
11 return f"{8}" + g(y, key="z")
11 return f"{8}" + g(x, key='z_')
"""


def test_changes_are_small_and_leave_words_alone(tool):
    changes, _, _ = tool
    mutants = changes.mutants_of(SOURCE)
    assert {mutant.where for mutant in mutants} == {"f"}
    lines = {f"{mutant.line} {mutant.now}" for mutant in mutants}
    assert lines == set(MUTANTS.strip().splitlines())


def test_good_tests_kill_and_weak_tests_are_found_out(tmp_path):
    weak = tmp_path / "test_weak.py"
    weak.write_text(
        "from barn_eval.trials.seeds import planner_seed\ndef test(): assert planner_seed(1, 1, 1, 'dwa') > 0\n"
    )
    sample = ("trials.seeds", "--sample", 5, "--seed", 2)
    summary = "5 mutants, 5 killed, 0 survived (100.0%)"
    assert run(*sample) == (0, {"summary": summary, "survivors": []})
    code, report = run(*sample, "--tests", weak)
    assert code == 1
    assert 0 < len(report["survivors"]) < 5
    for survivor in report["survivors"]:
        assert survivor["was"] != survivor["now"]
        assert survivor["reason"] is None


def test_a_hang_counts_as_killed():
    """In a process of its own.

    The tool forks, which is not for a process that runs tests.
    """
    code = (
        f"import sys; sys.path.insert(0, {str(TOOL)!r}); import runner; runner.prepare();"
        "tests = [runner.ROOT / 'barn_eval/test/trials/test_result.py'];"
        "print(*runner.survivals('barn_eval.trials.seeds', ['while True: pass'], tests, 1, 1))"
    )
    ended = run_python("-c", code)
    assert ended.stdout.split() == ["False"]


def test_every_mutant_that_is_known_to_survive_is_there(tool):
    changes, report, runner = tool
    reasons = report.load_reasons()
    present = {
        (module, mutant.where, mutant.was, mutant.now)
        for module in {change[0] for change in reasons}
        for mutant in changes.mutants_of(runner.source_of(module).read_text("utf-8"))
    }
    assert reasons.keys() - present == set(), (
        "the code has changed: look at these in qa/checks/mutate/survivors.yaml again"
    )
    assert all(reason.endswith(".") for reason in reasons.values())


def test_the_page_gets_the_table_of_modules(tool, tmp_path):
    changes, report, _ = tool
    mutants = changes.mutants_of("x = 1\n")
    killed = report.Tried("trials.seeds", mutants[0], killed=True)
    alive = report.Tried("trials.seeds", mutants[1], killed=False)
    page = tmp_path / "page.md"
    page.write_text(f"# Page\n\n{report.BEGIN}\n\nold\n")
    report.write_page(page, [killed, alive])
    text = page.read_text()
    assert text.startswith(f"# Page\n\n{report.BEGIN}\n\n| module |")
    assert "| `trials.seeds` | 2 | 1 | 1 | 50.0 |\n" in text
    assert text.endswith(f"| all | 2 | 1 | 1 | 50.0 |\n\n{report.END}\n")
