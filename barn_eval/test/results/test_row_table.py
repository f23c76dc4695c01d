"""Rows in columns: what is read at once is what is read line by line, or nothing is."""

import json
from dataclasses import replace

import numpy as np
import pytest
from refusals import refused
from results.test_rows import result
from text_tables import rows_of

from barn_eval.results import row_table
from barn_eval.results.row_table import RowTable, column, join, parse_rows, take
from barn_eval.results.rows import RowFile
from barn_eval.trials.encounters import Encounters
from barn_eval.trials.result import (
    SCHEMA_VERSION,
    Outcome,
    WallClock,
    from_json_line,
    to_json_line,
)
from barn_eval.trials.system import ObservedTrial

FIRST = result(0)
ROWS = [
    FIRST,
    replace(result(1), motion=Encounters(1.0, 0.5, None, 0.0, None, None)),
    replace(result(2), observed=ObservedTrial("robot", "mocap", "", "", "", None)),
    replace(result(3), outcome=Outcome.TIMEOUT, detail='é ":{', recoveries=3),
    replace(result(4), scores=replace(FIRST.scores, challenge=None)),
    replace(result(5), wall_clock=WallClock(1.0, None, 0.5, missed_share=0.1)),
]
PATHS = (
    "trial_id",
    "world",
    "outcome",
    "scores.success",
    "scores.challenge",
    "motion.phase_s",
    "recoveries",
    "path_ratio",
    "waited_s",
    "wall_clock.missed_share",
)


def test_rows_come_back_from_columns_as_from_their_lines():
    table = parse_rows(list(map(to_json_line, ROWS)))
    assert table == ROWS == RowTable.of(ROWS)
    assert list(table) == [from_json_line(to_json_line(row), "") for row in ROWS]
    assert (table[3], table[-1], table[1:3]) == (ROWS[3], ROWS[5], ROWS[1:3])
    assert take(table, np.array([4, 0])) == take(ROWS, np.array([4, 0]))
    assert join([table[:2], table[2:]]) == ROWS
    assert join([table, RowTable.of([FIRST])]) == [*ROWS, FIRST]
    for path in PATHS:
        np.testing.assert_array_equal(column(table, path), column(ROWS, path))


# NOW stands for the current schema, NEXT for the one after it.
CHANGES = r"""
"challenge":0.29,    |
"challenge":0.29     | "challenge": null
"challenge":0.29     | "challenge":NaN
"challenge":0.29     | "challenge":99999999999999999999
"challenge":0.29     | "challenge":0.29,"score":1
"challenge":0.29     | "challenge":"0.29"
"scored_time_s":10.1 | "scored_time_s":null
"task":"",           |
"task":""            | "task":"\ud800"
"metric":""          | "metric":"","delays":null
"outcome":"success"  | "outcome":"won"
"schema_version":NOW | "schema_version":2
"schema_version":NOW | "schema_version":NEXT
{"trial_id"          | {}{"trial_id"
"""
CHANGES = CHANGES.replace("NOW", str(SCHEMA_VERSION))
CHANGES = CHANGES.replace("NEXT", str(SCHEMA_VERSION + 1))


@pytest.mark.parametrize("old, new", rows_of(CHANGES))
def test_what_may_be_anything_else_is_read_line_by_line(old, new):
    line = to_json_line(FIRST)
    assert line.count(old) == 1
    assert parse_rows([line]) == [FIRST]
    assert parse_rows([line, line.replace(old, new)]) is None


def test_rows_of_earlier_schemas_have_the_defaults_of_what_they_lack():
    content = json.loads(to_json_line(FIRST)) | {"schema_version": 3}
    for key in ("planner_config", "task"):
        del content[key]
    del content["wall_clock"]["attempts"]
    line = json.dumps(content, separators=(",", ":"))
    table = parse_rows([line, line])
    assert table == 2 * [from_json_line(line, "")]
    assert table[0].wall_clock.attempts == WallClock.attempts


def test_a_table_is_read_with_few_rows_alive(tmp_path, monkeypatch):
    made = []
    make_rows = row_table._make_rows

    def counting(table):
        made.append(table.num_rows)
        return make_rows(table)

    monkeypatch.setattr(row_table, "_make_rows", counting)
    monkeypatch.setattr("barn_eval.results.rows.BATCH_ROWS", 10)
    monkeypatch.setattr("barn_eval.results.row_table.BATCH_ROWS", 10)
    file = RowFile(tmp_path)
    file.replace([result(number) for number in range(35)])
    rows = file.read()
    assert column(rows, "world").tolist() == list(range(35))
    assert not made
    assert [row.world for row in rows] == list(range(35))
    assert made == [10, 10, 10, 5]
    line = json.loads(to_json_line(result(12)))
    file.append(from_json_line(json.dumps(line), ""))
    with refused(r"line 36: trial dwa_w0012_r00 is listed twice"):
        file.read()
