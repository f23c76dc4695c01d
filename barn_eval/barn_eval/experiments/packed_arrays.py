"""Arrays as text, compressed: for lines of tracks, and for pages, whose scripts unpack them."""

import base64
import binascii
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_worlds.base.errors import shown

_KINDS = {
    "u1": "Uint8Array",
    "i2": "Int16Array",
    "u2": "Uint16Array",
    "i4": "Int32Array",
    "f4": "Float32Array",
    "f8": "Float64Array",
}
_TYPES = {name: np.dtype("<" + kind) for kind, name in _KINDS.items()}


def pack(arrays: Mapping[str, npt.NDArray[Any]]) -> dict[str, Any]:
    """Return arrays as plain data: zlib and base64, and where in it each array lies (kind, offset, length).

    Kinds are u1, i2, u2, i4, f4, f8; shapes are lost. `unpack` of the pages' script returns typed arrays.
    """
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
    return {"zlib": base64.b64encode(zlib.compress(b"".join(parts), 6)).decode(), "arrays": layout}


def unpack(content: Mapping[str, Any], most_bytes: int) -> dict[str, npt.NDArray[Any]]:
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
        raise ValueError(f"packed arrays are cut off, or of more than {most_bytes} bytes")
    return {str(name): _array(data, where) for name, where in layout.items()}


def _array(data: bytes, where: Any) -> npt.NDArray[Any]:
    try:
        kind, offset, length = where
        return np.frombuffer(data, _TYPES[kind], length, offset)
    except (KeyError, TypeError, ValueError, OverflowError):
        raise ValueError(f"packed arrays do not hold what they say: {shown(where)}") from None
