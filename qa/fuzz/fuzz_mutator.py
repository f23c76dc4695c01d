"""Mutations of bytes and of plain data, all from a generator that is passed in."""

import json
import random
import re
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

LONGEST = 1 << 20
_NUMBER = re.compile(rb"[0-9][0-9.]*")
NUMBERS: tuple[Any, ...] = (
    0, -1, 1, 2, 127, 255, 256, 32767, 65535, 2**31 - 1, -(2**31), 2**32, 2**53, 2**63 - 1, 2**63, -(2**63) - 1, 10**30,
    10**400, 0.0, -0.0, 0.1, 1e-320, 1e30, 1e308, -1e308, float("inf"), float("-inf"), float("nan"),
)  # fmt: skip
_HOSTILE = json.loads(Path(__file__).with_name("hostile_texts.json").read_text("utf-8"))
TEXTS = (*_HOSTILE["texts"], "a" * 300, "x" * 6000, "9" * 5000)
_LONG_TOKENS = (
    "0x" + "f" * 4000,
    "1:" * 50 + "1",
    "9" * 4400,
    "[" * 80,
    "{a: " * 80,
    "<a>" * 120,
)
TOKENS = tuple(token.encode() for token in (*_HOSTILE["tokens"], *_LONG_TOKENS))


def mutate_bytes(draw: random.Random, data: bytes, donors: Sequence[bytes]) -> bytes:
    """Return bytes with one to eight changes.

    `others` is contents of the same kind, from which parts are taken.
    """
    content = bytearray(data)
    for _ in range(1 + int(draw.random() ** 3 * 8)):
        _change(draw, content, donors)
    return bytes(content[:LONGEST])


def _change(draw: random.Random, data: bytearray, donors: Sequence[bytes]) -> None:
    at = draw.randrange(len(data) + 1)
    end = min(len(data), at + 1 + int(draw.random() ** 4 * 200))
    kind = draw.randrange(9)
    if kind == 0 and at < len(data):
        data[at] ^= 1 << draw.randrange(8)
    elif kind == 1 and at < len(data):
        data[at] = draw.randrange(256)
    elif kind == 2:
        del data[at:end]
    elif kind == 3:
        data[at:at] = data[at:end] * draw.choice((1, 2, 50))
    elif kind == 4:
        data[at:at] = draw.choice(TOKENS)
    elif kind == 5:
        packed = struct.pack(draw.choice("<>") + "Q", draw.choice(NUMBERS[:17]) % 2**64)
        size = draw.choice((1, 2, 4, 8))
        data[at : at + size] = packed[:size] if draw.random() < 0.5 else packed[-size:]
    elif kind == 6:
        other = draw.choice(donors)
        begin = draw.randrange(len(other) + 1)
        data[at:end] = other[begin : begin + draw.randrange(200)]
    elif kind == 7 and draw.random() < 0.3:
        del data[at:]
    else:
        _change_number(draw, data, at)


def _change_number(draw: random.Random, data: bytearray, at: int) -> None:
    """Replace the next number in a text."""
    number = _NUMBER.search(data, at)
    if number:
        data[slice(*number.span())] = repr(draw.choice(NUMBERS)).encode()


def mutate_plain(draw: random.Random, content: Any) -> Any:
    """Return plain data with one to four changes, made in place.

    Plain data are mappings, lists, texts and numbers.
    """
    holder = [content]
    for _ in range(1 + int(draw.random() ** 2 * 4)):
        _change_plain(draw, holder)
    return holder[0]


def _change_plain(draw: random.Random, holder: Any) -> None:
    parent = holder
    key = 0
    while (
        isinstance(parent[key], (dict, list)) and parent[key] and draw.random() < 0.85
    ):
        parent = parent[key]
        key = (
            draw.choice(list(parent))
            if isinstance(parent, dict)
            else draw.randrange(len(parent))
        )
    kind = draw.randrange(8)
    if kind == 0 and parent is not holder:
        del parent[key]
    elif kind == 1 and isinstance(parent, dict):
        parent[draw.choice((*TEXTS, *map(str, parent)))] = parent[key]
    elif kind == 2 and isinstance(parent, list) and parent is not holder:
        parent.extend([parent[key]] * draw.choice((1, 3, 300)))
    elif kind == 3:
        parent[key] = draw.choice(([], {}, None, True, False, [[]], [None], {"": None}))
    elif kind == 4:
        parent[key] = [parent[key]] if draw.random() < 0.5 else {"a": parent[key]}
    elif kind == 5:
        for _ in range(draw.choice((3, 70, 400))):
            parent[key] = [parent[key]]
    elif kind == 6:
        parent[key] = draw.choice(TEXTS)
    else:
        parent[key] = draw.choice(NUMBERS)
