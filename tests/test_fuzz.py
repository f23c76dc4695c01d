"""Readers of files of strangers, under the corpus of what was trouble once and under fresh mutations of real files.

`python qa/fuzz.py --reader NAME --inputs N` goes on for longer; it bounds memory and time of each input.
"""

import re
import subprocess
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).resolve().parents[1] / "qa" / "fuzz.py"
READERS = (
    *("rows", "tracks", "run", "campaign", "protocol", "robot", "urdf", "csv", "parquet", "npy", "dataset", "policy"),
    *("weights", "world", "map", "image", "bag", "sqlite"),
)


def fuzz(*arguments):
    return subprocess.run([sys.executable, TOOL, *arguments], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("reader", READERS)
def test_whatever_a_file_holds_it_is_read_or_refused_in_one_line(tmp_path, reader):
    ended = fuzz("--reader", reader, "--corpus", "--seconds", "10", "--out", tmp_path)
    said = ended.stdout + ended.stderr + "\n".join(path.read_text() for path in tmp_path.glob(f"{reader}-*.txt"))
    corpus, fresh = re.findall(rf"(?m)^{reader}: (.*)$", ended.stdout) or ("", "")
    assert re.fullmatch(r"\d+ files of the corpus, 0 findings", corpus), said
    assert re.fullmatch(r"[1-9]\d* inputs, .*, 0 findings", fresh), said
    assert ended.returncode == 0, said


def test_all_readers_are_fuzzed():
    ended = fuzz("--reader", "none")
    assert ended.returncode == 2
    assert tuple(re.findall(r"'(\w+)'", ended.stderr.replace("'none'", ""))) == READERS, ended.stderr
