"""Mitsuba's tensor files, in which its plugin `measured` keeps materials.

Little-endian: ``tensor_file`` and a zero byte, two bytes of version, the number of
fields; for each field the length of its name, the name, the number of axes, a type, the
place of its values in the file and its shape; then the values.

The plugin maps the file into memory and reads wherever the headers point, so that a
damaged one ends the process: what it needs is checked here, with fields and shapes as
in its source, ``src/bsdfs/measured.cpp``.
"""

import math
import os
import struct
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..array_types import Numbers
from ..errors import FileFormatError
from .checks import require, size_of

MAGIC = b"tensor_file\0"
VERSION = (1, 0)
ALIGNMENT = 8

# Numbers of the types, in the order of Mitsuba's `Struct`.
NAMES = "u1 i1 <u2 <i2 <u4 <i4 <u8 <i8 <f2 <f4 <f8"
TYPES = dict(enumerate(NAMES.split(), 1))
NUMBERS = {np.dtype(name): number for number, name in TYPES.items()}

# More than any material has.
MAX_FIELDS, MAX_AXES = 1000, 32

# Type and axes of each field; the same name is the same length.
FIELDS = {
    "description": ("u1", ("letters",)),
    "jacobian": ("u1", ("one",)),
    "theta_i": ("f4", ("polar",)),
    "phi_i": ("f4", ("azimuth",)),
    "ndf": ("f4", ("ndf rows", "ndf columns")),
    "sigma": ("f4", ("sigma rows", "sigma columns")),
    "vndf": ("f4", ("azimuth", "polar", "vndf rows", "vndf columns")),
    "luminance": ("f4", ("azimuth", "polar", "side", "side")),
}
COLOURS = {"rgb": ("f4", ("azimuth", "polar", "colour", "side", "side"))}
SPECTRA = {
    "wavelengths": ("f4", ("wavelength",)),
    "spectra": ("f4", ("azimuth", "polar", "wavelength", "side", "side")),
}

# Axes along which it interpolates must have two values.
INTERPOLATED = ("rows", "columns", "side")
ASCENDING = ("theta_i", "phi_i", "wavelengths")
DENSITIES = ("vndf", "luminance")


def write(fields: dict[str, Numbers], stream: BinaryIO) -> None:
    """Write a dictionary of arrays to a binary stream."""
    names = {name: name.encode() for name in fields}
    fields = {name: np.ascontiguousarray(array) for name, array in fields.items()}
    place = len(MAGIC) + 2 + 4
    for name, array in fields.items():
        place += 2 + len(names[name]) + 2 + 1 + 8 + 8 * array.ndim
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
    require(_bytes(stream, len(MAGIC)) == MAGIC, "it is not a tensor file of Mitsuba")
    version = tuple(_bytes(stream, 2))
    require(version[0] == 1, f"it has the unknown version {version[0]}.{version[1]}")
    (n,) = _numbers(stream, "<I")
    require(n <= MAX_FIELDS, f"it announces {n} fields")
    headers = {}
    for _ in range(n):
        (length,) = _numbers(stream, "<H")
        name = _bytes(stream, length).decode("utf-8", "replace")
        n_axes, kind, place = _numbers(stream, "<HBQ")
        require(n_axes <= MAX_AXES, f"its field {name:.40} has {n_axes} axes")
        require(kind in TYPES, f"its field {name:.40} has the unknown type {kind}")
        shape = _numbers(stream, f"<{n_axes}Q")
        n_bytes = math.prod(shape) * np.dtype(TYPES[kind]).itemsize
        reason = f"its field {name:.40} of shape {shape} does not fit into {size} bytes"
        require(place + n_bytes <= size, reason)
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


def check_measured(path: str | os.PathLike[str]) -> tuple[float, float] | None:
    """Raise one clear sentence unless `measured` can take the file.

    Returns
    -------
    tuple of float, or None
        Least and largest wavelength of its data in nm; None if they are colours.

    Raises
    ------
    OSError
        If it cannot be opened.
    FileFormatError
        If a field is missing, of another type or shape, not finite, or no density
        where one is drawn from.
    """
    with open(path, "rb") as stream:
        try:
            fields = read(stream)
            _check_shapes(fields)
            _check_values(fields)
        except FileFormatError as error:
            raise FileFormatError(f"cannot load {path}: {error}") from None
    if "wavelengths" not in fields:
        return None
    nm = fields["wavelengths"]
    return float(nm.min()), float(nm.max())


def _check_shapes(fields: dict[str, NDArray[np.generic]]) -> None:
    """Types and shapes, as they must fit each other."""
    sizes = {"one": 1, "colour": 3}
    wanted = FIELDS | (SPECTRA if "wavelengths" in fields else COLOURS)
    for name, (kind, axes) in wanted.items():
        require(name in fields, f"its field {name} is missing")
        field = fields[name]
        require(
            field.dtype == kind and field.ndim == len(axes),
            f"its field {name} is {field.dtype} with {field.ndim} axes instead of "
            f"{np.dtype(kind)} with {len(axes)}",
        )
        for axis, size in zip(axes, field.shape):
            least = 2 if axis.endswith(INTERPOLATED) else axis != "letters"
            reason = f"its field {name} of shape {field.shape} does not fit the others"
            require(size == sizes.setdefault(axis, size) and size >= least, reason)


def _check_values(fields: dict[str, NDArray[np.generic]]) -> None:
    """Values that it may divide by, and look up."""
    for name in (*FIELDS, *SPECTRA, *COLOURS):
        if name not in fields or fields[name].dtype != np.float32:
            continue
        field = fields[name].astype(np.float32)
        require(bool(np.isfinite(field).all()), f"its field {name} is not finite")
        if name in ASCENDING:
            require(bool((np.diff(field) > 0).all()), f"its {name} must ascend")
        if name in DENSITIES:
            total = field.sum(axis=(2, 3), dtype=float)
            good = (field >= 0).all() and (total > 0).all() and np.isfinite(total).all()
            require(bool(good), f"its field {name} is not a sampling density")
