"""The README's lines lead from nothing to a score with the locked releases.

The tutorial on one's own robot works, too.
"""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from repository import ROOT
from test_repository import text_of
from waiting import run_python

from barn_eval.commands.main import main


def test_the_readme_leads_to_the_score_of_its_planner(tmp_path):
    if not (ROOT / ".git").exists():
        pytest.skip("this is no repository, so it cannot be cloned")
    probe = f"-m pip download --quiet --no-deps -d {tmp_path} wheel"
    if run_python(*probe.split(), check=False).returncode:
        pytest.skip("no packages can be had from here")
    pins = re.findall(
        r"(?m)^([\w.-]+)(?:\[\w+\])?(==\S+(?: ; [^\\\n]+)?)",
        text_of("requirements/base.lock"),
    )
    lines = [f"{name}{version}\n" for name, version in pins]
    (tmp_path / "pins.txt").write_text("".join(lines))
    variables = {
        "PIP_CONSTRAINT": str(tmp_path / "pins.txt"),
        "PIP_BUILD_CONSTRAINT": os.devnull,
        # which is yes: most modules of the libraries are not imported here
        "PIP_NO_COMPILE": "no",
    }
    way = [ROOT / "qa" / "release" / "way_in.sh", tmp_path / "way", sys.executable]
    done = subprocess.run(
        way, check=False, env=os.environ | variables, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    rows = (tmp_path / "way/out/simple/results.jsonl").read_text("utf-8")
    (row,) = map(json.loads, rows.splitlines())
    assert row["outcome"] == "success"
    rows = (tmp_path / "way/demo/results.jsonl").read_text("utf-8")
    assert len(rows.splitlines()) == 3


def test_the_readme_shows_what_its_comparison_prints(tmp_path):
    text = (ROOT / "README.md").read_text("utf-8")
    section = text.split("## Compare two planners")[1].split("\nBoth planners share")[0]
    command, *shown = re.findall(r"(?m)^    (.*)$", section)
    words = shlex.split(command)[1:]
    environment = os.environ | {"COLUMNS": "80"}
    done = run_python("-m", "barn_eval", *words, cwd=tmp_path, env=environment)
    printed = [line.strip() for line in done.stdout.splitlines()]
    assert list(filter(None, printed)) == [line.strip() for line in shown if line]
    lines = [*done.stdout.splitlines(), *done.stderr.splitlines()]
    assert len(lines) <= 40
    assert lines[-1] == "next: barn report out/first"


PAGE = ROOT / "docs/tutorials/own_robot.md"


def test_the_tutorial_works_as_it_is_written(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    text = PAGE.read_text("utf-8")
    (robot,) = re.findall(r"(?ms)^```yaml\n(.*?)^```", text)
    Path("mine.yaml").write_text(robot)
    commands = [shlex.split(line) for line in re.findall(r"(?m)^    (barn .*)$", text)]
    assert len(commands) == 9
    for words in commands:
        with pytest.raises(SystemExit) as ended:
            main(words[1:])
        assert ended.value.code in (0, None), (words, capfd.readouterr().err)
    output = capfd.readouterr().out
    assert "robot mine, " in output
    for file in (
        "mine.png",
        "mine.npz",
        "out/mine_dwa.html",
        "out/mine/results.parquet",
    ):
        assert Path(file).stat().st_size > 1000
    for folder in ("out/mine_dwa", "out/mine"):
        rows = Path(folder, "results.jsonl").read_text("utf-8").splitlines()
        outcomes = {row["trial_id"]: row["outcome"] for row in map(json.loads, rows)}
        assert outcomes["dwa_w0000_r00"] == "success"
