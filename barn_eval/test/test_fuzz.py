"""Readers of files of strangers, under the corpus of what was trouble once and under fresh mutations of real files.

`python tools/fuzz.py --reader NAME --inputs N` goes on for longer; it bounds memory and time of each input.
"""

import subprocess
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).resolve().parents[2] / "tools" / "fuzz.py"
READERS = (
    *("rows", "tracks", "run", "campaign", "protocol", "csv", "parquet", "npy", "dataset", "policy", "weights"),
    *("world", "map", "image", "bag", "sqlite"),
)
pytestmark = pytest.mark.skipif(not TOOL.is_file(), reason="the repository's tools are not beside this package")


def fuzz(*arguments):
    return subprocess.run([sys.executable, TOOL, *arguments], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("reader", READERS)
def test_whatever_a_file_holds_it_is_read_or_refused_in_one_line(reader, tmp_path):
    ended = fuzz("--reader", reader, "--corpus", "--seconds", "3", "--out", tmp_path)
    found = "\n".join(path.read_text() for path in tmp_path.glob("*.txt"))
    assert ended.returncode == 0, ended.stdout + ended.stderr + found
    assert "files of the corpus, 0 findings" in ended.stdout
    assert " 0 inputs" not in ended.stdout


def test_all_readers_are_fuzzed():
    assert [name for name in READERS if name not in fuzz("--help").stdout] == []
    assert fuzz("--reader", "none").returncode == 2
