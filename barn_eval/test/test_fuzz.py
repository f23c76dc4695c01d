"""Readers of files of strangers, under the corpus of what was trouble once and under fresh mutations of real files.

`python tools/fuzz.py --reader NAME --inputs N` goes on for longer; it bounds memory and time of each input.
"""

import re
import subprocess
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).resolve().parents[2] / "tools" / "fuzz.py"
READERS = (
    *("rows", "tracks", "run", "campaign", "protocol", "robot", "urdf", "csv", "parquet", "npy", "dataset", "policy"),
    *("weights", "world", "map", "image", "bag", "sqlite"),
)
pytestmark = pytest.mark.skipif(not TOOL.is_file(), reason="the repository's tools are not beside this package")


def fuzz(*arguments):
    return subprocess.run([sys.executable, TOOL, *arguments], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def fuzzed(tmp_path_factory):
    """What one process, which loads the suite once, says of all readers, and the folder of its findings."""
    out = tmp_path_factory.mktemp("findings")
    return fuzz("--corpus", "--seconds", "3", "--out", out), out


@pytest.mark.parametrize("reader", READERS)
def test_whatever_a_file_holds_it_is_read_or_refused_in_one_line(fuzzed, reader):
    ended, out = fuzzed
    found = "\n".join(path.read_text() for path in out.glob(f"{reader}-*.txt"))
    corpus, fresh = re.findall(rf"(?m)^{reader}: (.*)$", ended.stdout) or ("", "")
    assert re.fullmatch(r"\d+ files of the corpus, 0 findings", corpus), ended.stdout + ended.stderr + found
    assert re.fullmatch(r"[1-9]\d* inputs, .*, 0 findings", fresh), ended.stdout + ended.stderr + found


def test_all_readers_are_fuzzed(fuzzed):
    assert fuzzed[0].returncode == 0, fuzzed[0].stdout + fuzzed[0].stderr
    assert re.findall(r"(?m)^(\w+): \d+ inputs", fuzzed[0].stdout) == list(READERS)
    assert fuzz("--reader", "none").returncode == 2
