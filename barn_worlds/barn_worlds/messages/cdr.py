"""Serialised messages: the message types of Jazzy, and templates whose varying fields are written in place.

Serialising a message from objects takes longer than the control cycle that it tells of. The messages of a trial
differ in a few numbers only, so each kind is serialised once and then only these numbers are written in place.
"""

import struct
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

ENCAPSULATION_BYTES = 4  # in front of every CDR message; alignment counts after them
Message: TypeAlias = Any  # of the class that rosbags makes of its type
_SMALL = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
}
_FORMATS = {
    **_SMALL,
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}


@cache
def jazzy_types() -> Typestore:
    """Return the message types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def make_message(type_name: str, **fields: object) -> Message:
    """Return a message of a type such as "geometry_msgs/msg/Twist": the fields given, all others zero or empty."""
    types = jazzy_types()
    values = {name: _default(kind) for name, kind in types.fielddefs[type_name][1]}
    unknown = sorted(set(fields) - set(values))
    if unknown:
        raise KeyError(f"{type_name} has no field {unknown[0]!r}")
    return types.types[type_name](**(values | fields))


def serialize(message: Message) -> bytes:
    """Return the bytes of a message made by `make`, little-endian CDR as Fast DDS writes it."""
    return bytes(jazzy_types().serialize_cdr(message, message.__msgtype__))


def deserialize(data: bytes, type_name: str) -> Message:
    """Return the message that the bytes hold."""
    return jazzy_types().deserialize_cdr(data, type_name)


class Slot(NamedTuple):
    """The position of a field in a serialised message: offset in bytes, struct format without alignment."""

    offset: int
    format: str


def find_slots(message: Message) -> dict[str, Slot]:
    """Return the slot of every field of a message that holds numbers, by dotted name.

    A field of numbers in an array or sequence is one slot of bytes; elements of other sequences are "name.0", "name.1".
    Texts have none. Offsets are valid for all messages of the same type with equal texts and sequence lengths.
    """
    slots: dict[str, Slot] = {}
    at = 0

    def take(size: int, count: int = 1) -> int:
        """Align to a primitive of that size, step over `count` of them and return where they begin."""
        nonlocal at
        begin = at + (-at % size if count else 0)
        at = begin + size * count
        return begin + ENCAPSULATION_BYTES

    def walk(value: Any, kind: Any, name: str) -> None:
        node, about = kind
        if node == Nodetype.NAME:
            for inner, its_kind in jazzy_types().fielddefs[about][1]:
                walk(
                    getattr(value, inner),
                    its_kind,
                    f"{name}.{inner}" if name else inner,
                )
        elif node == Nodetype.BASE and about[0] == "string":
            take(4)
            take(1, len(value.encode()) + 1)
        elif node == Nodetype.BASE:
            form = _FORMATS[about[0]]
            slots[name] = Slot(take(struct.calcsize(form)), form)
        else:
            if node == Nodetype.SEQUENCE:
                take(4)
            if (number := _number(about[0])) is not None:
                size = struct.calcsize(number)
                slots[name] = Slot(take(size, len(value)), f"{size * len(value)}s")
                return
            for index, one in enumerate(value):
                walk(one, about[0], f"{name}.{index}")

    walk(message, (Nodetype.NAME, message.__msgtype__), "")
    return slots


def _number(kind: Any) -> str | None:
    """Return the format of a kind of numbers, None for any other kind."""
    return _FORMATS.get(kind[1][0]) if kind[0] == Nodetype.BASE else None


class Template:
    """The bytes of a message in which some fields vary.

    fields: dotted names in the order in which `fill` takes their values; arrays are given as bytes.
    """

    def __init__(self, message: Message, fields: Sequence[str]) -> None:
        slots = find_slots(message)
        self.type_name: str = message.__msgtype__
        self._data = bytearray(serialize(message))
        self._parts: list[tuple[Callable[..., None], int, slice]] = []
        group, first = list[Slot](), 0
        for index, slot in enumerate([*(slots[name] for name in fields), None]):
            joined = (
                group
                and slot
                and group[-1].offset + struct.calcsize("<" + group[-1].format)
                == slot.offset
            )
            if group and not joined:
                packer = struct.Struct("<" + "".join(item.format for item in group))
                self._parts.append(
                    (packer.pack_into, group[0].offset, slice(first, index))
                )
                group, first = [], index
            if slot:
                group.append(slot)

    def fill(self, *values: object) -> bytes:
        """Return the message with these values of the varying fields."""
        data = self._data
        for pack_into, offset, part in self._parts:
            pack_into(data, offset, *values[part])
        return bytes(data)


def _default(kind: Any) -> Any:
    node, about = kind
    if node == Nodetype.NAME:
        return make_message(about)
    if node == Nodetype.BASE:
        return {"string": "", "bool": False}.get(
            about[0], 0.0 if about[0].startswith("float") else 0
        )
    element, length = about
    if (form := _number(element)) is not None:
        return np.zeros(length if node == Nodetype.ARRAY else 0, np.dtype("<" + form))
    return [_default(element) for _ in range(length)] if node == Nodetype.ARRAY else []
