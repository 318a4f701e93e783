"""What Mitsuba's plugin `measured` needs of its tensor file, which it does not check.

It maps the file into memory and reads wherever the headers point, so that a damaged
one ends the process. The fields and their shapes are those of its source,
``src/bsdfs/measured.cpp``.
"""

import os
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError
from . import tensor_file
from .header import require

__all__ = ["check_measured"]

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
            fields = tensor_file.read(stream)
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
            require(
                size == sizes.setdefault(axis, size) and size >= least,
                f"its field {name} of shape {field.shape} does not fit the others",
            )


def _check_values(fields: dict[str, NDArray[np.generic]]) -> None:
    """Values that it may divide by, and look up."""
    for name, field in _numbers(fields):
        require(bool(np.isfinite(field).all()), f"its field {name} is not finite")
        if name in ASCENDING:
            require(bool((np.diff(field) > 0).all()), f"its {name} must ascend")
        if name in DENSITIES:
            total = field.sum(axis=(2, 3), dtype=float)
            good = (field >= 0).all() and (total > 0).all() and np.isfinite(total).all()
            require(bool(good), f"its field {name} is no density to draw from")


def _numbers(
    fields: dict[str, NDArray[np.generic]],
) -> Iterator[tuple[str, NDArray[np.float32]]]:
    """Fields that hold numbers to compute with."""
    for name in (*FIELDS, *SPECTRA, *COLOURS):
        field = fields.get(name)
        if field is not None and field.dtype == np.float32:
            yield name, field.astype(np.float32)
