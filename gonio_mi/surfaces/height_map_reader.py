"""Reads a file of a profilometer or an AFM; a program of its own, and a module.

``python height_map_reader.py FILE FORMATS OUT`` tries the FORMATS (``metropro,asc``),
writes the heights to OUT as ``.npy``, and a line of JSON that says the rest. The
library that reads them brings many others, and what a damaged file makes of all these
stays in a process of its own: a crash, or the memory that a wrong size in a header
would take.
"""

import contextlib
import json
import logging
import os
import re
import sys
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

# Bytes of address space for the libraries alone, and for each byte of the file, of
# which text and compressed numbers grow.
ROOM, ROOM_PER_BYTE = 2**32, 2**8

# Points that a byte of a file can stand for: no compression in use does better.
POINTS_PER_BYTE = 1032

# What is no number in a line of text, and stands for none.
LABEL = re.compile(r"\b(?!(?:nan|inf|infinite|bad)\b)[^\W\d_]{2,}|[{:=]", re.IGNORECASE)


# Spacing in um beyond which an NMS file of a confocal microscope is in nm, as surfalize
# 0.19 reads it, and was taken for mm, as SurfaceTopography 1.27.1 does.
MAX_NMS_SPACING = 1e4

# First lines of an ESRI ASCII grid; where its corner lies is no matter.
ESRI = re.compile(
    r"(ncols|nrows|cellsize|dx|dy|nodata_value|[xy]ll\w+)\s+([-+.\de]+|nan)$",
    re.IGNORECASE,
)


class UnfitFileError(ValueError):
    """A file that does not hold heights, or whose header is impossible."""


def read(path: str, formats: Sequence[str]) -> tuple[dict[str, Any], Any]:
    """Return a file's metadata and heights, NaN for missing points.

    Row 0 of the heights is the first of the file. Whatever is wrong raises ValueError.
    """
    first: Exception | None = None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for name in formats:
                try:
                    return _read(path, name)
                except Exception as error:
                    first = first or error
                    if isinstance(error, (MemoryError, UnfitFileError)):
                        raise
            raise first or ValueError("no format was asked for")
    except UnfitFileError:
        raise
    except MemoryError:
        raise ValueError("it asks for more memory than such a file can fill") from None
    except Exception as error:  # the library's readers raise anything
        said = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(
            "it is damaged, or not a file that SurfaceTopography reads as "
            f"{' or '.join(formats)}: {said}"
        ) from error


def _read(path: str, name: str) -> tuple[dict[str, Any], Any]:
    """Facts and heights of a file in the format of that name."""
    if name == "tiff":
        return _tiff(path)
    if name == "asc" and (grid := _esri(path)):
        return grid
    with open(path, "rb") as stream:
        magic = stream.read(12)
    if magic.startswith((b"aISO-2.0", b"bISO-2.0")):
        raise UnfitFileError(
            "it is an SDF file of version 2.0 (ISO 25178-71), of which only 1.0 is "
            "read: export it as SDF 1.0 or X3P"
        )
    if magic == b"ISO-10303-21":
        raise UnfitFileError("it is a STEP model: export a mesh (obj, ply, stl)")
    return _map(path, name)


def _esri(path: str) -> tuple[dict[str, Any], Any] | None:
    """Facts and heights of an ESRI ASCII grid; None for another file."""
    with open(path, encoding="utf-8", errors="replace") as stream:
        lines = [line.strip() for line in stream if line.strip()]
    n, header = 0, {}
    while n < len(lines) and (found := ESRI.match(lines[n])):
        header[found[1].lower()] = float(found[2])
        n += 1
    if not {"ncols", "nrows"} <= header.keys():
        return None
    n_x, n_y = (int(header[name]) for name in ("ncols", "nrows"))
    values = np.array(" ".join(lines[n:]).split(), dtype=float)
    if values.size != n_x * n_y:
        raise UnfitFileError(
            f"an ESRI grid of {n_x} x {n_y} points must have as many values, got "
            f"{values.size}"
        )
    size = header.get("cellsize", np.nan)
    spacing = [header.get("dx", size), header.get("dy", size)]
    if np.isnan(spacing).any():
        raise UnfitFileError("an ESRI grid must state its cellsize")
    values[values == header.get("nodata_value", -9999.0)] = np.nan
    facts: dict[str, Any] = {"format": "ESRI ASCII grid", "channel": "heights"}
    # its first row is the northernmost, the largest y
    heights = np.ascontiguousarray(values.reshape(n_y, n_x)[::-1])
    return facts | {"spacing": spacing, "unit": None, "periodic": False}, heights


def _map(path: str, name: str) -> tuple[dict[str, Any], Any]:
    """Map of a format that the library reads."""
    from SurfaceTopography import open_topography

    with contextlib.closing(open_topography(path, format=name)) as reader:
        channel = reader.default_channel
        if channel.dim != 2:
            raise UnfitFileError("it holds a line profile and not an area")
        n_x, n_y = channel.nb_grid_pts
        if not 0 < n_x * n_y <= POINTS_PER_BYTE * os.path.getsize(path):
            raise UnfitFileError(
                f"it cannot hold the {n_x} x {n_y} points of its header"
            )
        sizes = channel.physical_sizes
        found = channel.topography(**({} if sizes else {"physical_sizes": (1, 1)}))
        if not found.is_uniform:
            raise UnfitFileError("its points are not on a regular grid")
        heights = np.ma.filled(found.heights().astype(float), np.nan)
        shape = heights.shape
        spacing = [float(s) / n for s, n in zip(sizes, shape)] if sizes else None
        is_micro = name == "nms" and found.unit == "µm"
        if is_micro and spacing and max(spacing) > MAX_NMS_SPACING:
            spacing = [length * 1e-6 for length in spacing]
        if name == "asc" and not (sizes or found.unit or channel.name != "Default"):
            _check_labels(path, shape[0])
        return {
            "format": reader.name(),
            "channel": channel.name,
            "spacing": spacing,
            "unit": found.unit,
            "periodic": bool(found.is_periodic),
        }, np.ascontiguousarray(heights.T)


def _check_labels(path: str, n_columns: int) -> None:
    """Raise UnfitFileError for text with labels, of which the library has read nothing.

    Comments may say anything, but do not name the columns of a map.
    """
    with open(path, encoding="utf-8", errors="replace") as stream:
        for line in filter(LABEL.search, stream):
            words = line.strip("# \n").split()
            names = len(words) == n_columns and not any(w[0].isdigit() for w in words)
            if names or not line.startswith("#"):
                raise UnfitFileError(
                    f"it is text with labels, such as {line.strip():.40}, and not a "
                    "grid of heights"
                )


def _tiff(path: str) -> tuple[dict[str, Any], Any]:
    """First page and channel of an image, in numbers of its own."""
    import tifffile

    # it logs what is wrong with a file, line by line, and then raises it
    logging.getLogger("tifffile").setLevel(logging.CRITICAL + 1)
    with tifffile.TiffFile(path) as file:
        page = file.pages[0]
        n_pixels = int(np.prod(page.shape))
        if not 0 < n_pixels <= POINTS_PER_BYTE * os.path.getsize(path):
            raise UnfitFileError(f"it cannot hold the {n_pixels} pixels of its header")
        pixels = page.asarray()
    pixels = pixels[..., 0] if pixels.ndim == 3 else pixels
    if pixels.ndim != 2 or pixels.dtype.kind not in "uif":
        raise UnfitFileError(
            f"its pixels must be one or several channels of grey, got an array of "
            f"{pixels.dtype} and shape {pixels.shape}"
        )
    whole = pixels.dtype.kind in "ui"
    facts: dict[str, Any] = dict.fromkeys(("spacing", "unit", "periodic"))
    facts |= {"format": "TIFF", "channel": "first channel"}
    facts["codes"] = int(np.iinfo(pixels.dtype).max) if whole else None
    return facts, pixels.astype(float)


def _main(path: str, formats: str, out: str) -> int:
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        room = ROOM + ROOM_PER_BYTE * os.path.getsize(path)
        resource.setrlimit(resource.RLIMIT_AS, (room, room))
    try:
        facts, heights = read(path, formats.split(","))
    except ValueError as error:
        print(json.dumps({"error": str(error)}))
        return 1
    np.save(out, heights)
    print(json.dumps(facts))
    return 0


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))
