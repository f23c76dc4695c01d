"""Choosing worlds by a short text."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from barn_worlds.base.errors import WorldError
from barn_worlds.worlds.dataset import select_worlds

SIXTH = tuple(range(0, 300, 6))


@pytest.mark.parametrize(
    ("spec", "indices", "chosen"),
    [
        ("0", range(300), [0]),
        ("0-3", range(300), [0, 1, 2, 3]),
        ("0:300:100", range(300), [0, 100, 200]),
        ("2:5", range(300), [2, 3, 4]),
        ("1,4,7-9", range(300), [1, 4, 7, 8, 9]),
        (" 9, 3-4 ,3", range(300), [9, 3, 4]),
        ("all", SIXTH, list(SIXTH)),
        ("0-20", SIXTH, [0, 6, 12, 18]),
        ("0:999999999", SIXTH, list(SIXTH)),
    ],
)
def test_choices(spec, indices, chosen):
    assert select_worlds(spec, indices) == chosen


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("", "is not a number"),
        ("x", "'x' is not a number, first-last"),
        ("-1", "'-1' is not a number"),
        ("1-", "is not a number"),
        ("0:10:0", "step in '0:10:0' must be at least 1"),
        ("1e3", "is not a number"),
        ("1", "no world 1 among the 50 from 0 to 294"),
        ("1-5", "no world 1-5 among"),
        ("5-1", "no world 5-1 among"),
        ("6,1", "no world 1 among"),
        ("9" * 10, "is not a number"),
        ("1," * 10_000, "at most 10000 characters"),
        ("all,?", "'\\?' is not"),
    ],
)
def test_mistakes_are_one_line(spec, message):
    with pytest.raises(WorldError, match=message) as caught:
        select_worlds(spec, SIXTH)
    assert len(str(caught.value)) < 300
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("spec", "missing"), [("0:999", "300 of 0:999"), ("298-301", "300 of 298-301"), ("0:400:100", "300")]
)
def test_a_range_beyond_a_set_without_gaps_is_refused(spec, missing):
    with pytest.raises(WorldError, match=f"no world {missing}"):
        select_worlds(spec, range(300))


@given(st.text(max_size=30))
def test_any_text_either_chooses_or_is_refused(spec):
    try:
        chosen = select_worlds(spec, SIXTH)
    except WorldError:
        return
    assert chosen
    assert len(set(chosen)) == len(chosen)
    assert set(chosen) <= set(SIXTH)


def test_no_worlds_no_choice():
    with pytest.raises(WorldError, match="no worlds to select from"):
        select_worlds("all", [])
