"""JSON: whatever a file holds there is content or one line, and what is written is JSON."""

import json
import math

import pytest

from barn_worlds.errors import ConfigError
from barn_worlds.plain_json import finite, read_json


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"{", "not JSON: "),
        (b"\xff\xfe\x00", "not JSON: "),
        (b"[" * 100_000, "not JSON: "),
        (b"[" + b" " * 100, "more than the allowed 100 bytes"),
    ],
)
def test_what_is_no_json_is_one_line(tmp_path, content, complaint):
    path = tmp_path / "file.json"
    path.write_bytes(content)
    limit = 100 if "allowed" in complaint else 1_000_000
    with pytest.raises(ConfigError) as raised:
        read_json(path, limit)
    assert str(raised.value).startswith(f"{path}: {complaint}")
    assert "\n" not in str(raised.value)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.json: No such file or directory$"):
        read_json(tmp_path / "none.json")


def test_numbers_without_a_word_in_json_become_null(tmp_path):
    content = {1: [math.nan, (math.inf, 2.5)], "a": {"b": -math.inf, "c": True, "d": None}}
    path = tmp_path / "file.json"
    path.write_text(json.dumps(finite(content), allow_nan=False))
    assert read_json(path) == {"1": [None, [None, 2.5]], "a": {"b": None, "c": True, "d": None}}
