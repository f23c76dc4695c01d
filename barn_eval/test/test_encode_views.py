"""Bands, candidates and diagnostics against the messages of the planner's node."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.serialization import serialize_message

from barn_eval.bags.encode_views import (
    DIAGNOSTICS_TYPE,
    MARKERS_TYPE,
    encode_band,
    encode_candidates,
    encode_diagnostics,
)
from barn_eval.bags.messages import deserialise, serialise
from barn_planners.candidates import shown_candidates
from barn_planners.interface import Decision, PlannerStatus
from barn_planners.ros.views import to_band, to_candidates, to_diagnostics
from barn_worlds.types import STOP

STAMP = 3_250_000_000


def as_read(data: bytes, length: int, type_name: str) -> bytes:
    """Return a message of ROS with the bytes between its fields set to zero and those behind it cut off."""
    return serialise(deserialise(data[:length], type_name))


@pytest.mark.parametrize("count", [0, 1, 2, 7, 30])
def test_band(count):
    band = np.random.default_rng(count).uniform(-3.0, 3.0, (count, 3))
    ours = encode_band(band, STAMP, "odom")
    assert ours == as_read(serialize_message(to_band(band, STAMP, "odom")), len(ours), MARKERS_TYPE)


@pytest.mark.parametrize(("count", "length"), [(0, 5), (1, 1), (1, 80), (151, 2), (140, 80)])
def test_candidates(count, length):
    draw = np.random.default_rng(count)
    costs = np.where(draw.random(count) < 0.3, np.inf, draw.uniform(0.0, 9.0, count))
    shown = shown_candidates(draw.uniform(-3.0, 3.0, (count, length, 2)), costs)
    ours = encode_candidates(shown, STAMP, "odom")
    assert ours == as_read(serialize_message(to_candidates(shown, STAMP, "odom")), len(ours), MARKERS_TYPE)
    assert len(ours) < 9000


@pytest.mark.parametrize("status", list(PlannerStatus))
@pytest.mark.parametrize("reason", ["", "no way through"])
def test_diagnostics(status, reason):
    figures = {"cost": 12.3456789, "samples": 20.0, "unknown": np.nan}
    decision = Decision(STOP, status, reason, diagnostics=figures)
    ours = encode_diagnostics(decision, "planner", STAMP)
    theirs = serialize_message(to_diagnostics(decision, "planner", STAMP))
    assert ours == as_read(theirs, len(ours), DIAGNOSTICS_TYPE)
