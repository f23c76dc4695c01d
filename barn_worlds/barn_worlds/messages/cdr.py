"""Serialized messages: the types of ROS 2 Jazzy, and templates with fields to fill.

Serializing a message from objects takes longer than a control cycle. The messages of a
trial differ only in a few numbers. So each kind is serialized once, and afterwards only
these numbers are written into its bytes.
"""

import struct
from collections.abc import Iterator, Sequence
from functools import cache
from operator import itemgetter
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

# Header in front of every CDR message. Alignment counts from its end.
ENCAPSULATION_BYTES = 4
Message: TypeAlias = Any  # of the class that rosbags makes of its type
_FORMATS = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}


@cache
def jazzy_types() -> Typestore:
    """Return the rosbags type store with the message types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def make_message(type_name: str, **fields: object) -> Message:
    """Return a new rosbags message object; fields that are not named are zero or empty.

    Args:
        type_name: Type, such as "geometry_msgs/msg/Twist".
        fields: Values by field name. All other fields are zero or empty.
    """
    values: dict[str, Any] = dict(fields)
    for name, kind in jazzy_types().fielddefs[type_name][1]:
        if name not in values:
            values[name] = _default(kind)
    return jazzy_types().types[type_name](**values)


def serialize(message: Message) -> bytes:
    """Return a message object as little-endian CDR, as Fast DDS writes it."""
    return bytes(jazzy_types().serialize_cdr(message, message.__msgtype__))


def deserialize(data: bytes, type_name: str) -> Message:
    """Return CDR bytes as a message object; malformed ones raise errors of any kind.

    Args:
        data: CDR with its encapsulation header.
        type_name: Type, such as "geometry_msgs/msg/Twist".
    """
    return jazzy_types().deserialize_cdr(data, type_name)


class Slot(NamedTuple):
    """The place of a field in a serialized message."""

    offset: int
    """Bytes from the beginning of the message."""

    format: str
    """Format of `struct`, without alignment."""

    def shifted(self, by: int) -> "Slot":
        """Return a copy with the offset increased by `by` bytes."""
        return Slot(self.offset + by, self.format)


def find_slots(message: Message) -> dict[str, Slot]:
    """Return byte offset and `struct` format of every numeric field, by dotted name.

    An array or sequence of numbers is one slot of bytes. The items of other sequences
    are "name.0", "name.1". The slots are valid for all messages of the type whose texts
    and sequences have the same lengths.
    """
    slots = {}
    position = 0
    for run in _runs(message, (Nodetype.NAME, message.__msgtype__), ""):
        # CDR aligns numbers to their own size. An empty sequence has no padding.
        if run.length:
            position += -position % run.size
        if run.format:
            slots[run.name] = Slot(position + ENCAPSULATION_BYTES, run.format)
        position += run.size * run.length
    return slots


class Layout:
    """Bytes in which some fields vary."""

    def __init__(self, data: bytes, slots: Sequence[Slot]) -> None:
        """Prepare one `struct` format that writes the fields and the bytes around them.

        Args:
            data: The bytes, with any values in the fields.
            slots: Where the fields lie, in the order of the values of `fill`.
        """
        self.data = data
        self.slots = tuple(slots)
        code = "<"
        constants: list[bytes] = []
        # Of each part its place among values and constants; zeros are padding.
        places: list[int] = []
        position = 0
        end = Slot(len(data), "")
        in_order = sorted(enumerate(self.slots), key=lambda item: item[1].offset)
        for index, slot in [*in_order, (0, end)]:
            between = data[position : slot.offset]
            if any(between):
                code += f"{len(between)}s"
                places.append(len(self.slots) + len(constants))
                constants.append(between)
            else:
                code += f"{len(between)}x"
            if slot.format:
                places.append(index)
            code += slot.format
            position = slot.offset + struct.calcsize("<" + slot.format)
        self._constants = tuple(constants)
        self._arrange = itemgetter(*places)
        self._pack = struct.Struct(code).pack

    def fill(self, *values: object) -> bytes:
        """Return the bytes with values for the fields, in order; arrays as bytes."""
        return self._pack(*self._arrange(values + self._constants))


class Template(Layout):
    """The bytes of a message in which some fields vary."""

    def __init__(self, message: Message, fields: Sequence[str]):
        """Serialize a message once; only the fields named here vary afterwards.

        Args:
            message: Message with the values of all fields that stay the same.
            fields: Dotted names of the other fields, in the order of `fill`.
        """
        self.type_name = message.__msgtype__
        slots = find_slots(message)
        super().__init__(serialize(message), [slots[name] for name in fields])


class _Run(NamedTuple):
    """Numbers of one size that follow each other in a serialized message."""

    size: int
    length: int = 1
    # Of the field that they are; lengths and texts have no name and no format.
    name: str = ""
    format: str = ""


def _runs(value: Any, kind: Any, name: str) -> Iterator[_Run]:
    """Yield each run of equal-sized numbers of a value, in the order of its bytes.

    Args:
        value: Message, text, number or sequence.
        kind: Its type as rosbags describes it: a node type and its details.
        name: Dotted name of the field, empty for the whole message.
    """
    node, detail = kind
    number = _number_format(kind)
    if number is not None:
        yield _Run(struct.calcsize(number), 1, name, number)
    elif node == Nodetype.NAME:
        for field, field_kind in jazzy_types().fielddefs[detail][1]:
            field_name = f"{name}.{field}" if name else field
            yield from _runs(getattr(value, field), field_kind, field_name)
    elif node == Nodetype.BASE:
        # A text is its length, its bytes and a zero.
        yield _Run(4)
        yield _Run(1, len(value.encode()) + 1)
    else:
        # Only a sequence has its length in front of its items.
        if node == Nodetype.SEQUENCE:
            yield _Run(4)
        item_kind = detail[0]
        number = _number_format(item_kind)
        if number is None:
            for index, item in enumerate(value):
                yield from _runs(item, item_kind, f"{name}.{index}")
        else:
            size = struct.calcsize(number)
            yield _Run(size, len(value), name, f"{size * len(value)}s")


def _number_format(kind: Any) -> str | None:
    """Return the `struct` format of a number's kind, None for any other kind."""
    node, detail = kind
    return _FORMATS.get(detail[0]) if node == Nodetype.BASE else None


def _default(kind: Any) -> Any:
    """Return the zero or empty value of a field by its kind in rosbags."""
    node, detail = kind
    if node == Nodetype.NAME:
        return make_message(detail)
    if node == Nodetype.BASE:
        type_name = detail[0]
        if type_name == "string":
            return ""
        if type_name == "bool":
            return False
        return 0.0 if type_name.startswith("float") else 0

    # An array has its length in its type, a sequence begins empty.
    item_kind, length = detail
    if node == Nodetype.SEQUENCE:
        length = 0
    number = _number_format(item_kind)
    if number is not None:
        return np.zeros(length, np.dtype("<" + number))
    return [_default(item_kind) for _ in range(length)]
