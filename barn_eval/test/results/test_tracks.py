"""Tracks: the trajectory to within their steps, small, kept beside every row whatever
happens in between.
"""

import json
import math

import numpy as np
import pytest
import yaml
from refusals import refused
from report_work import recorded_track

from barn_eval.analysis.sources import read_source
from barn_eval.results.rows import TRACKS_FILE, TrialLines, append_line, seal_line
from barn_eval.results.run_file import RunFile
from barn_eval.results.tracks import (
    LARGEST_COMMAND,
    MAX_SAMPLES,
    MISSING_SAMPLE,
    make_track,
    pack_arrays,
    parse_track_line,
    thin_samples,
    unpack_arrays,
)
from barn_eval.trials.run_config import RunConfig
from barn_eval.trials.trajectory import Trajectory


def samples(count, period_s=0.05):
    draw = np.random.default_rng(count)
    rows = draw.normal(size=(count, 9))
    rows[:, 0] = period_s * np.arange(count)
    return rows


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 401, 1015, 100_000])
def test_tracks_have_five_samples_a_second_and_extremes(count):
    rows = samples(count)
    contact = np.zeros(count, bool)
    contact[count // 2] = True
    track = thin_samples(rows, contact)
    thin = track.samples
    assert len(thin) <= MAX_SAMPLES + 1
    if 1 < count <= 4 * MAX_SAMPLES:
        assert len(thin) == 1 + math.ceil(count / 4)
    assert count > 1 or len(thin) == 1
    for end in (0, -1):
        np.testing.assert_array_equal(thin[end, :8], rows[end, :8])
    assert min(thin[:, 8]) == min(rows[:, 8])
    assert track.contact.any()
    assert set(thin[:, 0]) <= set(rows[:, 0])


def test_samples_that_are_further_apart_are_all_kept():
    rows = samples(50, period_s=0.5)
    np.testing.assert_array_equal(thin_samples(rows, np.zeros(50, bool)).samples, rows)


@pytest.mark.parametrize("command", [np.inf, -np.inf, 1e308, -1e308, np.nan])
def test_an_infinite_command_in_a_row(command):
    rows = samples(50)
    rows[7, 6:8] = command
    named = {"trial_id": "x", "schema_version": 1} | thin_samples(
        rows, np.zeros(50, bool)
    ).packed
    _, track = parse_track_line(json.dumps(named, allow_nan=False), "line")
    assert np.nanmax(np.abs(track.samples[:, 6:8])) <= LARGEST_COMMAND
    # the others keep their digits: rounded to half the smallest step
    last = np.minimum(np.arange(0, 50, 4) + 3, 49)
    np.testing.assert_allclose(track.samples[1:, 4], rows[last, 4], atol=0.001)
    np.testing.assert_allclose(track.samples[3:, 6], rows[last[2:], 6], atol=0.001)


def test_a_trial_without_a_reading_has_no_track():
    empty = np.empty((0, 2))
    nothing = Trajectory(
        np.empty(0, np.int64),
        np.empty((0, 3)),
        empty,
        empty,
        np.empty(0, bool),
        np.empty(0),
        np.empty(0, np.int64),
    )
    (spec,) = RunConfig(worlds="0").trials()
    assert make_track(nothing, spec) is None


def test_the_line_of_a_trial_is_what_its_bag_holds(run):
    source = read_source(run)
    (result,) = source.results
    name, track = parse_track_line(source.tracks[result.trial_id], "line")
    assert name == result.trial_id
    (spec,) = RunFile.read(run).run_config().trials()
    recorded = recorded_track(source.bag(name), spec.world)
    steps = np.array(track.packed["steps"])
    np.testing.assert_array_equal(np.isnan(track.samples), np.isnan(recorded.samples))
    apart = np.abs(track.samples - recorded.samples)
    assert (np.isnan(apart) | (apart <= 0.51 * steps)).all()
    np.testing.assert_array_equal(track.contact, recorded.contact)
    nearest_m = min(track.samples[:, 8])
    assert nearest_m == pytest.approx(result.measures.min_clearance_m, abs=0.001)
    # of 26 if it were not compressed
    assert len(source.tracks[name]) < 18 * len(track.samples) + 300


def test_the_last_track_counts_and_torn_ones_do_not(run, tmp_path):
    path = tmp_path / "tracks.jsonl"
    assert TrialLines(path) == {}
    line = next(iter(TrialLines(run / TRACKS_FILE).values()))
    content = json.loads(line)
    lines = [
        json.dumps(content | {"trial_id": name, "note": note})
        for name, note in (("b", "1"), ("a", ""), ("b", "2"))
    ]
    for entry in lines:
        append_line(path, entry)
    with path.open("a") as file:
        file.write(lines[1][:50])
    assert TrialLines(path) == {"b": lines[2], "a": lines[1]}
    TrialLines(path).arrange(["a", "never", "b"])
    assert path.read_text() == f"{seal_line(lines[1])}\n{seal_line(lines[2])}\n"
    append_line(path, lines[0])
    assert TrialLines(path)["b"] == lines[0]


def test_a_line_of_something_else_is_refused_by_its_number(tmp_path):
    lines = [
        seal_line(json.dumps({"trial_id": "a"})),
        seal_line(json.dumps({"what": "else"})),
    ]
    path = tmp_path / "tracks.jsonl"
    path.write_text("".join(f"{line}\n" for line in lines))
    with refused(r"tracks.jsonl, line 2: no track: trial_id is missing"):
        TrialLines(path)


DAMAGED = """
- [{schema_version: 2}, 'schema_version must be 1, got 2']
- [{trial_id: 5}, trial_id is missing]
- [{zlib: '?'}, packed arrays are damaged]
- [{zlib: AAAA}, packed arrays are damaged]
- [{arrays: {samples: [Int16Array, 0, 1000000000]}}, do not match their layout]
- [{arrays: {samples: [Int16Array, -4, 9]}}, do not match their layout]
- [{arrays: {}}, do not fit together]
- [{steps: [1, 1, 1, 1, 1, 1, 1, 1]}, 'steps must be one number per channel, each']
- [{steps: [[1], 1, 1, 1, 1, 1, 1, 1, 1]}, 'steps must be one number per channel, each']
- - {steps: [1, 1, 1, 1, 1, 1, 1, 1, 1.0e+31]}
  - steps must be one number per channel, each
- [{steps: [.nan, .nan, .nan]}, 'numbers must be finite, got NaN']
"""


@pytest.mark.parametrize(
    "changes, words",
    [
        *yaml.safe_load(DAMAGED),
        (
            pack_arrays({"samples": np.zeros(9_000_000, "i2")}),
            "cut off, or have more than",
        ),
        (
            pack_arrays({"samples": np.zeros(0, "i2"), "contact": np.zeros(0, "u1")}),
            "samples must not be empty",
        ),
    ],
)
def test_a_damaged_track_is_refused_in_one_line(run, changes, words):
    line = next(iter(TrialLines(run / TRACKS_FILE).values()))
    with refused(rf"^here: (no track|not JSON): .*{words}"):
        parse_track_line(json.dumps(json.loads(line) | changes), "here")


def test_packed_arrays_come_back():
    arrays = {
        "a": np.arange(5, dtype="u1"),
        "b": np.array([MISSING_SAMPLE, 7], "i2"),
        "c": np.array([0.5, 1e9], "f4"),
    }
    arrays["d"] = np.array([1e-300, 0.1])
    packed = pack_arrays(arrays)
    assert packed["arrays"]["d"][1] % 8 == 0
    back = unpack_arrays(packed, 1000)
    assert list(back) == list(arrays)
    for name, array in arrays.items():
        assert back[name].tolist() == array.tolist()
    packed["zlib"] = packed["zlib"][:8]
    with pytest.raises(ValueError, match="cut off"):
        unpack_arrays(packed, 1000)
