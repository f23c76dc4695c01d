"""The track of a trial: its trajectory thinned out and rounded to whole numbers, small enough to be always kept."""

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

from barn_eval.trials.trajectory import Trajectory, compute_clearances
from barn_eval.trials.trial import FinishedTrial
from barn_worlds.base.arrays import Bools, Floats
from barn_worlds.base.errors import ConfigError, format_value
from barn_worlds.base.text_files import parse_json
from barn_worlds.base.types import NANOSECONDS_PER_SECOND
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.robots.contact import contact_footprint

_NAMES = {"u": "Uint", "i": "Int", "f": "Float"}  # of JavaScript's typed arrays
_KINDS = {
    kind: f"{_NAMES[kind[0]]}{8 * int(kind[1])}Array"
    for kind in ("u1", "i2", "u2", "i4", "f4", "f8")
}
_TYPES = {name: np.dtype("<" + kind) for kind, name in _KINDS.items()}


def pack_arrays(arrays: Mapping[str, npt.NDArray[Any]]) -> dict[str, Any]:
    """Return arrays as plain data: zlib and base64, and where in it each array lies (kind, offset, length)."""
    parts: list[bytes] = []
    layout: dict[str, list[Any]] = {}
    offset = 0
    for name, array in arrays.items():
        kind = array.dtype.str[1:]
        data = np.ascontiguousarray(array, "<" + kind).tobytes()
        if offset % array.itemsize:  # where a typed array of 8 bytes could not begin
            parts.append(bytes(4))
            offset += 4
        layout[name] = [_KINDS[kind], offset, array.size]
        data += b"\0" * (-len(data) % 4)
        parts.append(data)
        offset += len(data)
    return {
        "zlib": base64.b64encode(zlib.compress(b"".join(parts), 6)).decode(),
        "arrays": layout,
    }


def unpack_arrays(
    content: Mapping[str, Any], most_bytes: int
) -> dict[str, npt.NDArray[Any]]:
    """Return the flat arrays of what `pack` has made; ValueError for anything else, or for more than `most_bytes`."""
    text, layout = content.get("zlib"), content.get("arrays")
    if not isinstance(text, str) or not isinstance(layout, dict):
        raise ValueError("holds no packed arrays")
    stream = zlib.decompressobj()
    try:
        data = stream.decompress(base64.b64decode(text, validate=True), most_bytes)
    except (binascii.Error, zlib.error) as error:
        raise ValueError(f"packed arrays are damaged: {error}") from None
    if not stream.eof:
        raise ValueError(
            f"packed arrays are cut off, or of more than {most_bytes} bytes"
        )
    try:
        return {
            str(name): np.frombuffer(data, _TYPES[kind], length, offset)
            for name, (kind, offset, length) in layout.items()
        }
    except (KeyError, TypeError, ValueError, OverflowError):
        raise ValueError(
            f"packed arrays do not hold what they say: {format_value(layout)}"
        ) from None


SCHEMA_VERSION = 1
PERIOD_S = 0.2
MAX_SAMPLES = 300
MISSING_SAMPLE = -32768
_LARGEST = 32767
_LARGEST_STEP = 1e30
# Smallest step of what a sample holds, in its own unit; a track that does not fit takes a multiple.
_STEPS = (0.01, 0.005, 0.005, 0.0005, 0.002, 0.002, 0.002, 0.002, 0.002)
CHANNELS = (
    "time",
    "x",
    "y",
    "yaw",
    "speed",
    "turn",
    "command_speed",
    "command_turn",
    "clearance",
)
_COMMANDS = slice(6, 8)
LARGEST_COMMAND = 65.0  # m/s or rad/s: what is beyond, up to infinity, is kept as this and costs the others no digit
# What a track may unpack to: a sample takes 2 bytes per channel and one for contact; the first comes on top.
_MOST_BYTES = (MAX_SAMPLES + 1) * (2 * len(CHANNELS) + 1) + 8


@dataclass(frozen=True, eq=False)
class Track:
    """What a robot did, thinned out: (n, 9) after `CHANNELS` (s, m, rad, m/s, rad/s; NaN: none), contact (n,)."""

    samples: Floats
    contact: Bools
    note: str = ""

    @property
    def steps(self) -> Floats:
        """What samples are rounded to when they are packed, one per channel."""
        largest = np.nanmax(np.abs(self.samples), axis=0, initial=0.0)
        steps = np.array(_STEPS)
        found: Floats = steps * np.maximum(
            1.0, np.ceil(largest / (steps * (_LARGEST - 1)))
        )
        return found

    @cached_property
    def packed(self) -> dict[str, Any]:
        """Differences of whole numbers, which pack well, the step of each channel, and the note."""
        steps = self.steps
        known = np.isfinite(self.samples)
        whole = np.where(
            known, np.round(np.where(known, self.samples, 0.0) / steps), MISSING_SAMPLE
        ).astype(np.int16)
        differences = np.diff(
            whole, axis=0, prepend=np.zeros((1, len(CHANNELS)), np.int16)
        )  # wraps around
        content = pack_arrays(
            {"samples": differences.T.ravel(), "contact": self.contact.astype(np.uint8)}
        )
        return content | {"steps": steps.tolist(), "note": self.note}


def thin_samples(samples: Floats, contact: Bools) -> Track:
    """Return the track of samples (n, 9) after `CHANNELS`, n at least 1, and contact (n,): 5 a second, `MOST_SAMPLES`.

    Kept are the first sample, then every k-th and the last one; contact and smallest clearance are those since the one
    before.
    """
    samples = samples.copy()
    samples[:, _COMMANDS] = np.clip(
        samples[:, _COMMANDS], -LARGEST_COMMAND, LARGEST_COMMAND
    )
    times = samples[:, 0]
    period_s = float(np.median(np.diff(times))) if len(times) > 1 else PERIOD_S
    wished = round(PERIOD_S / period_s) if period_s > 0.0 else 1
    stride = max(1, wished, -(-len(samples) // MAX_SAMPLES))
    first = np.arange(0, len(samples), stride)
    last = np.minimum(first + stride - 1, len(samples) - 1)
    kept = samples[last]
    kept[:, -1] = np.minimum.reduceat(samples[:, -1], first)
    touched = np.logical_or.reduceat(contact, first)
    if last[0]:
        return Track(
            np.concatenate([samples[:1], kept]), np.concatenate([contact[:1], touched])
        )
    return Track(kept, touched)


def make_track(
    trajectory: Trajectory, cylinders_m: Floats, radius_m: float, outline: Footprint
) -> Track | None:
    """Return the track of a trajectory among cylinders (k, 2), m in the map frame; None where nothing was read."""
    if not len(trajectory.stamps_ns):
        return None
    times = (trajectory.stamps_ns - trajectory.stamps_ns[0]) / NANOSECONDS_PER_SECOND
    gaps = compute_clearances(trajectory.truth, cylinders_m, radius_m, outline)
    gaps = gaps if len(gaps) else np.full(len(times), np.nan)
    samples = np.column_stack(
        [times, trajectory.truth, trajectory.velocity, _held(trajectory.command), gaps]
    )
    return thin_samples(samples, trajectory.contact)


def track_line(finished: FinishedTrial) -> str | None:
    """Return the track of a finished trial as a line of JSON without the line's end; None where there is none."""
    world = finished.spec.world
    outline = contact_footprint(finished.spec.simulator.chassis)
    track = make_track(
        finished.trajectory, world.cylinders_m, world.cylinder_radius_m, outline
    )
    if track is None:
        return None
    content = {
        "trial_id": finished.result.trial_id,
        "schema_version": SCHEMA_VERSION,
    } | track.packed
    return json.dumps(content, allow_nan=False, separators=(",", ":"))


def parse_track_line(line: str, where: str) -> tuple[str, Track]:
    """Return a trial's name and track from a line of JSON; ConfigError, beginning with `where`, if it is not one."""
    content = parse_json(line, where)
    try:
        return _read(content)
    except ValueError as error:
        raise ConfigError(f"{where}: no track: {error}") from None


def _held(command: Floats) -> Floats:
    """Return commands (n, 2) with each NaN replaced by the last command before it, if there is one."""
    return command[
        np.maximum.accumulate(
            np.where(np.isnan(command[:, 0]), 0, np.arange(len(command)))
        )
    ]


def _read(content: object) -> tuple[str, Track]:
    if not isinstance(content, dict) or not isinstance(content.get("trial_id"), str):
        raise ValueError("trial_id is missing")
    if content.get("schema_version") != SCHEMA_VERSION:
        raise ValueError(
            f"schema_version must be {SCHEMA_VERSION}, got {format_value(content.get('schema_version'))}"
        )
    arrays, steps = unpack_arrays(content, _MOST_BYTES), content.get("steps", [])
    samples, contact = (
        arrays.get(name, np.empty(0)) for name in ("samples", "contact")
    )
    if (
        samples.dtype != np.int16
        or contact.dtype != np.uint8
        or samples.size != len(CHANNELS) * contact.size
    ):
        raise ValueError("samples and contact do not fit together")
    if (
        not contact.size
        or not finite_numbers(steps, len(CHANNELS))
        or max(map(abs, steps)) > _LARGEST_STEP
    ):
        least = f"one finite number per channel of at most {_LARGEST_STEP:g}"
        raise ValueError(f"there are no samples, or steps are not {least}")
    whole = np.cumsum(samples.reshape(len(CHANNELS), -1), axis=1, dtype=np.int16).T
    values = np.where(
        whole == MISSING_SAMPLE, np.nan, whole * np.array(steps, np.float64)
    )
    note = content.get("note", "")
    return content["trial_id"], Track(
        values, contact.astype(np.bool_), note if isinstance(note, str) else ""
    )


def finite_numbers(values: object, count: int) -> bool:
    """Tell whether something is a list of that many finite numbers."""
    return (
        isinstance(values, list)
        and len(values) == count
        and all(
            isinstance(value, (int, float)) and math.isfinite(value) for value in values
        )
    )
