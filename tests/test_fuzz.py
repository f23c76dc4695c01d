"""Readers of files of strangers, under the corpus of what was trouble once and under mutations of real files.

`python qa/fuzz.py --reader NAME --inputs N` goes on for longer, and bounds the time of each input.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from fuzz_readers import READERS

TOOL = Path(__file__).resolve().parents[1] / "qa" / "fuzz.py"
INPUTS = 400  # the same in every run, which qa/fuzz.py goes beyond


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """What the tool says of each reader."""
    out = tmp_path_factory.mktemp("fuzz")
    command = [sys.executable, TOOL, "--corpus", "--inputs", str(INPUTS), "--seconds", "3600", "--out", out, "--json"]
    patient = {**os.environ, "FUZZ_LIMIT_S": "60"}
    ended = subprocess.run(command, capture_output=True, text=True, check=False, env=patient)
    told = {one["reader"]: one for one in map(json.loads, ended.stdout.splitlines())}
    assert told.keys() == READERS.keys(), ended.stderr
    return told


@pytest.mark.parametrize("reader", READERS)
def test_whatever_a_file_holds_it_is_read_or_refused_in_one_line(found, reader):
    assert found[reader]["findings"] == []
    assert found[reader]["inputs"] == INPUTS
    assert 0 < found[reader]["read"] < INPUTS
