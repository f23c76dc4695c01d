"""Bands and diagnostics against the messages of the planner's node."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.serialization import serialize_message

from barn_eval.encode_views import BAND_TYPE, DIAGNOSTICS_TYPE, encode_band, encode_diagnostics
from barn_eval.messages import deserialise, serialise
from barn_planners.interface import Decision, PlannerStatus
from barn_planners.ros.views import to_band, to_diagnostics
from barn_worlds.types import STOP

STAMP = 3_250_000_000


def as_read(data: bytes, length: int, type_name: str) -> bytes:
    """Return a message of ROS with the bytes between its fields set to zero and those behind it cut off."""
    return serialise(deserialise(data[:length], type_name))


@pytest.mark.parametrize("count", [0, 1, 2, 7, 30])
def test_band(count):
    band = np.random.default_rng(count).uniform(-3.0, 3.0, (count, 3))
    ours = encode_band(band, STAMP, "odom")
    assert ours == as_read(serialize_message(to_band(band, STAMP, "odom")), len(ours), BAND_TYPE)


@pytest.mark.parametrize("status", list(PlannerStatus))
@pytest.mark.parametrize("reason", ["", "no way through"])
def test_diagnostics(status, reason):
    figures = {"cost": 12.3456789, "samples": 20.0, "unknown": np.nan}
    decision = Decision(STOP, status, reason, diagnostics=figures)
    ours = encode_diagnostics(decision, "planner", STAMP)
    theirs = serialize_message(to_diagnostics(decision, "planner", STAMP))
    assert ours == as_read(theirs, len(ours), DIAGNOSTICS_TYPE)
