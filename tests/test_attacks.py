"""Attacks on results are seen; `python qa/attacks/attacks.py` tries all."""

from repository import ROOT
from waiting import run_python

TOOL = ROOT / "qa" / "attacks" / "attacks.py"


def test_no_attack_succeeds():
    listed = run_python(TOOL, "--list").stdout.splitlines()
    assert len(listed) == len(set(listed)) > 60
    ended = run_python(TOOL, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.count("\n    ") == len(listed)
    assert "SUCCEEDS UNSEEN" not in ended.stdout


def test_the_search_beats_no_bound():
    search = ROOT / "qa" / "attacks" / "beat_the_bound.py"
    ended = run_python(search, "--seeds", "23:31", check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "seed 23: efficiency 0.9" in ended.stdout
