"""From nothing to a score by the README's own lines, in an environment of its own, with the locked releases."""

import json
import os
import re
import subprocess
import sys

import pytest
from test_repository import ROOT, text_of


def test_the_readme_leads_from_nothing_to_the_score_of_its_planner(tmp_path):
    if not (ROOT / ".git").exists():
        pytest.skip("this is no repository, so it cannot be cloned")
    asked = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "-d", tmp_path, "wheel"]
    if subprocess.run(asked, check=False).returncode:
        pytest.skip("no packages can be had from here")
    pins = re.findall(r"(?m)^([\w.-]+)(?:\[\w+\])?(==\S+(?: ; [^\\\n]+)?)", text_of("requirements.lock"))
    (tmp_path / "pins.txt").write_text("".join(f"{name}{version}\n" for name, version in pins))
    environment = {**os.environ, "PIP_CONSTRAINT": str(tmp_path / "pins.txt"), "PIP_BUILD_CONSTRAINT": os.devnull}
    way = [ROOT / "qa" / "way_in.sh", tmp_path / "way", sys.executable]
    done = subprocess.run(way, check=False, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [json.loads(line) for line in (tmp_path / "way/out/simple/results.jsonl").read_text("utf-8").splitlines()]
    assert [row["outcome"] for row in rows] == ["success"]
    assert len((tmp_path / "way/demo/results.jsonl").read_text("utf-8").splitlines()) == 3
