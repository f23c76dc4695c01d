"""Attacks on results are seen; `python qa/attacks/attacks.py` tries all."""

from repository import ROOT
from waiting import run_python

TOOL = ROOT / "qa" / "attacks" / "attacks.py"
QUICK = ("folder/nudged-trial", "folder/environment*", "verdict/order", "room/*")
INSIDE = ("answer/*", "again/*", "name/*", "process/*", "folder/delays", "folder/older")
OUTSIDE = ("bound/*", "verdict/[cw]*", "computing/*", "terminal/*", "bag/*", "server/*")


def attacks(*arguments):
    return run_python(TOOL, *arguments, check=False)


def test_quick_attacks_do_not_succeed():
    ended = attacks(*(f"--only={pattern}" for pattern in QUICK))
    assert ended.returncode == 0, ended.stdout + ended.stderr
    lines = ended.stdout.splitlines()
    assert len(lines) == 2 * 13 and "SUCCEEDS UNSEEN" not in ended.stdout


def test_attacks_from_inside_do_not_succeed():
    ended = attacks(*(f"--only={pattern}" for pattern in INSIDE))
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.count("\n    ") == 10 and "UNSEEN" not in ended.stdout


def test_attacks_from_outside_do_not_succeed():
    ended = attacks(*(f"--only={pattern}" for pattern in OUTSIDE))
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.count("\n    ") == 10 and "UNSEEN" not in ended.stdout


def test_there_are_thirty_attacks():
    listed = attacks("--list").stdout.splitlines()
    assert len(listed) == len(set(listed)) >= 30


def test_the_search_beats_no_bound():
    search = ROOT / "qa" / "attacks" / "beat_the_bound.py"
    ended = run_python(search, "--seeds", "23:31", check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "seed 23: efficiency 0.9" in ended.stdout
