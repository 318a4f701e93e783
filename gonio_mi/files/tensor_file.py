"""Mitsuba's tensor files, in which its plugin `measured` keeps materials.

Little-endian: ``tensor_file`` and a zero byte, two bytes of version, the number of
fields; for each field the length of its name, the name, the number of axes, a type, the
place of its values in the file and its shape; then the values.
"""

import math
import struct
from typing import Any, BinaryIO

import numpy as np

from ..array_types import Numbers
from .header import require, size_of

__all__ = ["read", "write"]

MAGIC = b"tensor_file\0"
VERSION = (1, 0)
ALIGNMENT = 8

# Numbers of the types, in the order of Mitsuba's `Struct`.
TYPES = dict(
    enumerate(
        ["u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8"], 1
    )
)
NUMBERS = {np.dtype(name): number for number, name in TYPES.items()}

# More than any material has.
MOST_FIELDS, MOST_AXES = 1000, 32


def write(fields: dict[str, Numbers], stream: BinaryIO) -> None:
    """Write a dictionary of arrays to a binary stream."""
    names = {name: name.encode() for name in fields}
    fields = {name: np.ascontiguousarray(array) for name, array in fields.items()}
    place = (
        len(MAGIC)
        + 2
        + 4
        + sum(
            2 + len(names[name]) + 2 + 1 + 8 + 8 * array.ndim
            for name, array in fields.items()
        )
    )
    head = MAGIC + bytes(VERSION) + struct.pack("<I", len(fields))
    body = b""
    for name, array in fields.items():
        body += bytes(-(place + len(body)) % ALIGNMENT)
        head += struct.pack("<H", len(names[name])) + names[name]
        head += struct.pack("<HB", array.ndim, NUMBERS[array.dtype])
        head += struct.pack(f"<Q{array.ndim}Q", place + len(body), *array.shape)
        body += array.tobytes()
    stream.write(head + body)


def read(stream: BinaryIO) -> dict[str, Numbers]:
    """Read a dictionary of arrays from a binary file.

    Raises
    ------
    FileFormatError
        If the file is something else, is truncated, or announces more than it holds.
    """
    size = size_of(stream)
    require(_bytes(stream, len(MAGIC)) == MAGIC, "it is no tensor file of Mitsuba")
    version = tuple(_bytes(stream, 2))
    require(version[0] == 1, f"it has the unknown version {version[0]}.{version[1]}")
    (n,) = _numbers(stream, "<I")
    require(n <= MOST_FIELDS, f"it announces {n} fields")
    headers = {}
    for _ in range(n):
        (length,) = _numbers(stream, "<H")
        name = _bytes(stream, length).decode("utf-8", "replace")
        n_axes, kind, place = _numbers(stream, "<HBQ")
        require(n_axes <= MOST_AXES, f"its field {name:.40} has {n_axes} axes")
        require(kind in TYPES, f"its field {name:.40} has the unknown type {kind}")
        shape = _numbers(stream, f"<{n_axes}Q")
        n_bytes = math.prod(shape) * np.dtype(TYPES[kind]).itemsize
        require(
            place + n_bytes <= size,
            f"its field {name:.40} of shape {shape} does not fit into {size} bytes",
        )
        headers[name] = place, n_bytes, TYPES[kind], shape
    fields = {}
    for name, (place, n_bytes, kind, shape) in headers.items():
        stream.seek(place)
        fields[name] = np.frombuffer(_bytes(stream, n_bytes), kind).reshape(shape)
    return fields


def _numbers(stream: BinaryIO, layout: str) -> tuple[Any, ...]:
    return struct.unpack(layout, _bytes(stream, struct.calcsize(layout)))


def _bytes(stream: BinaryIO, n: int) -> bytes:
    """Exactly `n` bytes, of which the size of the file was checked, or a few."""
    data = stream.read(n)
    require(len(data) == n, "it is truncated")
    return data
