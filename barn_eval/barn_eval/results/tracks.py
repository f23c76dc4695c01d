"""Tracks of trials: trajectories with fewer samples, rounded to whole numbers.

A track is so small that it is always kept.
"""

import base64
import binascii
import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trajectory import Trajectory
from barn_eval.trials.trial import FinishedTrial
from barn_worlds.base.arrays import Bools, Floats
from barn_worlds.base.errors import ConfigError, format_value
from barn_worlds.base.files import as_mapping, parse_json
from barn_worlds.base.types import NANOSECONDS_PER_SECOND

# Names of JavaScript's typed arrays by NumPy's kinds, because pages unpack the data.
_ARRAY_NAMES = {
    "u1": "Uint8Array",
    "i2": "Int16Array",
    "u2": "Uint16Array",
    "i4": "Int32Array",
    "f4": "Float32Array",
    "f8": "Float64Array",
}
_DTYPES = {name: np.dtype(f"<{kind}") for kind, name in _ARRAY_NAMES.items()}


def pack_arrays(arrays: Mapping[str, npt.NDArray[Any]]) -> dict[str, Any]:
    """Return arrays by name as JSON-ready data, flat and compressed; shapes are lost.

    Returns:
        "zlib" has the content of all arrays, compressed, as base64; "arrays" has kind,
        offset in bytes and length of each array in that content.
    """
    data = bytearray()
    layout = {}
    for name, array in arrays.items():
        # A typed array with items of 8 bytes must begin at a multiple of 8.
        if len(data) % array.itemsize:
            data += bytes(4)
        kind = array.dtype.str[1:]
        layout[name] = [_ARRAY_NAMES[kind], len(data), array.size]
        data += np.ascontiguousarray(array, f"<{kind}").tobytes()
        # The next array may have items of 4 bytes, which must begin at a multiple of 4.
        data += bytes(-len(data) % 4)
    return {
        "zlib": base64.b64encode(zlib.compress(data, 6)).decode(),
        "arrays": layout,
    }


def unpack_arrays(
    content: Mapping[str, Any], max_bytes: int
) -> dict[str, npt.NDArray[Any]]:
    """Return flat arrays by name from data of `pack_arrays`; ValueError if damaged.

    Args:
        content: Plain data, which anybody may have written.
        max_bytes: Largest number of bytes that they may unpack to.

    Raises:
        ValueError: If they hold no arrays, or too many bytes.
    """
    text = content.get("zlib")
    layout = content.get("arrays")
    if not isinstance(text, str) or not isinstance(layout, dict):
        raise ValueError("holds no packed arrays")
    stream = zlib.decompressobj()
    try:
        data = stream.decompress(base64.b64decode(text, validate=True), max_bytes)
    except (binascii.Error, zlib.error) as error:
        raise ValueError(f"packed arrays are damaged: {error}") from None
    if not stream.eof:
        raise ValueError(
            f"packed arrays are cut off, or have more than {max_bytes} bytes"
        )
    try:
        return {
            # NumPy refuses arrays that reach beyond the data.
            str(name): np.frombuffer(data, _DTYPES[kind], length, offset)
            for name, (kind, offset, length) in layout.items()
        }
    except (KeyError, TypeError, ValueError, OverflowError):
        raise ValueError(
            f"packed arrays do not match their layout: {format_value(layout)}"
        ) from None


SCHEMA_VERSION = 1
PERIOD_S = 0.2
MAX_SAMPLES = 300

# Channels of a sample, and the rounding step of each in its own unit (s, m, rad, m/s,
# rad/s). A track with larger values uses a multiple of the step.
_STEPS = {
    "time": 0.01,
    "x": 0.005,
    "y": 0.005,
    "yaw": 0.0005,
    "speed": 0.002,
    "turn": 0.002,
    "command_speed": 0.002,
    "command_turn": 0.002,
    "clearance": 0.002,
}
CHANNELS = tuple(_STEPS)
_COMMANDS = slice(6, 8)
SPEEDS = [CHANNELS.index("speed"), CHANNELS.index("command_speed")]
_CLEARANCE = -1

MISSING_SAMPLE = -32768  # NaN as a whole number
_LARGEST = 32767
_LARGEST_STEP = 1e30

# In m/s or rad/s. Larger commands, up to infinity, are clipped to this, so that others
# keep their digits.
LARGEST_COMMAND = 65.0

# Bytes that a track may unpack to. A sample takes 2 bytes per channel and one for
# contact; the first sample comes on top of `MAX_SAMPLES`.
_MAX_BYTES = (MAX_SAMPLES + 1) * (2 * len(CHANNELS) + 1) + 8


_PACKED = ("zlib", "arrays", "steps", "note")


@dataclass(frozen=True, eq=False)
class Track:
    """What a robot did, in about five samples a second."""

    samples: Floats  # (n, 9) in the order of `CHANNELS`, NaN for missing values
    contact: Bools  # (n,) since the previous sample
    note: str = ""

    content: Mapping[str, Any] | None = None
    """The data that the track was read from, for `packed`."""

    @property
    def steps(self) -> Floats:
        """Rounding step (9,) of each channel when packed, in its own unit."""
        largest = np.nanmax(np.abs(self.samples), axis=0, initial=0.0)
        steps = np.array(list(_STEPS.values()))
        # One number less than possible leaves room for rounding.
        factors = np.ceil(largest / (steps * (_LARGEST - 1)))
        scaled: Floats = steps * np.maximum(1.0, factors)
        return scaled

    @cached_property
    def packed(self) -> dict[str, Any]:
        """JSON-ready samples, contact, steps and note: as read, or packed now."""
        if self.content is not None:
            return {key: self.content[key] for key in _PACKED}
        steps = self.steps
        is_number = np.isfinite(self.samples)
        rounded = np.round(np.where(is_number, self.samples, 0.0) / steps)
        whole = np.where(is_number, rounded, MISSING_SAMPLE).astype(np.int16)

        # Differences between neighbors pack well; they may wrap around.
        first = np.zeros((1, len(CHANNELS)), np.int16)
        differences = np.diff(whole, axis=0, prepend=first)
        arrays = {
            "samples": differences.T.ravel(),
            "contact": self.contact.astype(np.uint8),
        }
        return pack_arrays(arrays) | {"steps": steps.tolist(), "note": self.note}


def thin_samples(samples: Floats, contact: Bools) -> Track:
    """Return a track of every k-th sample: about 5 a second, at most `MAX_SAMPLES` + 1.

    The first and the last sample are kept. Contact and smallest clearance are since the
    previous sample.

    Args:
        samples: Samples (n, 9) in the order of `CHANNELS`, at least one.
        contact: Whether (n,) the robot touched an obstacle.
    """
    samples = samples.copy()
    commands = samples[:, _COMMANDS]
    samples[:, _COMMANDS] = np.clip(commands, -LARGEST_COMMAND, LARGEST_COMMAND)

    count = len(samples)
    period_s = PERIOD_S
    if count > 1:
        # Single gaps between readings do not change the median.
        period_s = float(np.median(np.diff(samples[:, 0])))
    stride = round(PERIOD_S / period_s) if period_s > 0.0 else 1
    stride = max(1, stride, math.ceil(count / MAX_SAMPLES))

    # Each group of samples is kept as its last one.
    first = np.arange(0, count, stride)
    last = np.minimum(first + stride - 1, count - 1)
    thinned = samples[last]
    thinned[:, _CLEARANCE] = np.fmin.reduceat(samples[:, _CLEARANCE], first)
    touched = np.logical_or.reduceat(contact, first)
    # If the first group has several samples, its last one is too late for the start.
    if last[0]:
        thinned = np.concatenate([samples[:1], thinned])
        touched = np.concatenate([contact[:1], touched])
    return Track(thinned, touched)


def make_track(trajectory: Trajectory, spec: TrialSpec) -> Track | None:
    """Return the track of a trajectory, with clearances; None if it has no readings.

    Args:
        trajectory: What the robot did.
        spec: The trial, for the robot's outline and the cylinders of its world.
    """
    stamps_ns = trajectory.stamps_ns
    if not len(stamps_ns):
        return None
    times_s = (stamps_ns - stamps_ns[0]) / NANOSECONDS_PER_SECOND
    clearance = trajectory.clearance_m
    if clearance is None:
        clearance = spec.clearances(trajectory.truth)
    if not len(clearance):
        clearance = np.full(len(times_s), np.nan)

    # Without a new command, the previous one holds.
    has_command = ~np.isnan(trajectory.command[:, 0])
    sources = np.where(has_command, np.arange(len(times_s)), 0)
    command = trajectory.command[np.maximum.accumulate(sources)]
    channels = [times_s, trajectory.truth, trajectory.velocity, command, clearance]
    return thin_samples(np.column_stack(channels), trajectory.contact)


def track_line(finished: FinishedTrial) -> str | None:
    """Return a trial's track as a line without checksum; None if it has no readings."""
    track = make_track(finished.trajectory, finished.spec)
    if track is None:
        return None
    trial_id = finished.result.trial_id
    content = {"trial_id": trial_id, "schema_version": SCHEMA_VERSION} | track.packed
    return json.dumps(content, allow_nan=False, separators=(",", ":"))


def parse_trial_line(line: str, where: str, what: str) -> tuple[str, dict[str, Any]]:
    """Return (trial name, JSON object) of a line; ConfigError if it names no trial.

    Args:
        line: The line without its checksum.
        where: File and line, for messages.
        what: Name of the content, for messages.

    Raises:
        ConfigError: If the line names no trial.
    """
    content = parse_json(line, where)
    trial_id = as_mapping(content).get("trial_id")
    if not isinstance(trial_id, str):
        raise ConfigError(f"{where}: no {what}: trial_id is missing")
    return trial_id, content


def parse_track_line(line: str, where: str) -> tuple[str, Track]:
    """Return (trial name, track) of a line of tracks.jsonl; ConfigError if it is none.

    Args:
        line: The line without its checksum.
        where: File and line, for messages.

    Raises:
        ConfigError: If the line is not a track.
    """
    trial_id, content = parse_trial_line(line, where, "track")
    try:
        return trial_id, _read_track(content)
    except ValueError as error:
        raise ConfigError(f"{where}: no track: {error}") from None


def _read_track(content: Mapping[str, Any]) -> Track:
    """Return the track in a line's JSON object; ValueError if it is not valid."""
    version = content.get("schema_version")
    if version != SCHEMA_VERSION:
        raise ValueError(
            f"schema_version must be {SCHEMA_VERSION}, got {format_value(version)}"
        )

    arrays = unpack_arrays(content, _MAX_BYTES)
    samples = arrays.get("samples", np.empty(0))
    contact = arrays.get("contact", np.empty(0))
    has_types = samples.dtype == np.int16 and contact.dtype == np.uint8
    if not has_types or samples.size != len(CHANNELS) * contact.size:
        raise ValueError("samples and contact do not fit together")
    steps = content.get("steps")
    are_numbers = (
        isinstance(steps, list)
        and len(steps) == len(CHANNELS)
        # The bound keeps products with steps finite, and excludes NaN.
        and all(type(step) in (int, float) for step in steps)
        and all(abs(step) <= _LARGEST_STEP for step in steps)
    )
    if not contact.size or not are_numbers:
        raise ValueError(
            "samples must not be empty, and steps must be one number per channel, each"
            f" from {-_LARGEST_STEP:g} to {_LARGEST_STEP:g}"
        )

    # The sums wrap around where the differences did.
    whole = np.cumsum(samples.reshape(len(CHANNELS), -1), axis=1, dtype=np.int16).T
    values = np.where(
        whole == MISSING_SAMPLE, np.nan, whole * np.array(steps, np.float64)
    )
    note = content.get("note")
    if not isinstance(note, str):
        note = ""
    content = {**content, "note": note}
    return Track(values, contact.astype(np.bool_), note, content)
