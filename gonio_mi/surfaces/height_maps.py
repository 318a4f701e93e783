"""Maps of heights as files have them: instruments, images, arrays."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..array_types import Floats
from ..errors import FileFormatError, PackageError, SpecimenError, no_file, to_install

# Endings of the files of instruments, and the formats in which the library
# SurfaceTopography may read each. Left out are containers of anything (HDF5, NetCDF,
# MATLAB, zip), and tables that may be a measured BSDF.
SAME_NAME = """
al3d asc bcr datx di ezd frt gwy ibw jpk lext mdt mi mnt nms oir opd opdx os3d
plu plux poir qep sdf sur tmd x3p zmg zon
"""
READERS = {name: name for name in SAME_NAME.split()} | {
    **dict.fromkeys(("001", "spm"), "di"),
    "apx": "plu",
    "bcrf": "bcr",
    **dict.fromkeys(("cur", "stp", "tom", "top"), "wsxm"),
    "dat": "metropro,asc",
    "nid": "ezd",
    **dict.fromkeys(("tif", "tiff"), "ps,tiff"),
    **dict.fromkeys(("vk3", "vk4", "vk6", "vk7"), "vk"),
}

# Files that are a specimen by their name alone: heights and nothing else.
ENDINGS = tuple(f".{name}" for name in (*READERS, "npy", "png"))

# Seconds that reading a file may take.
PATIENCE = 300


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights on a regular grid, and the metadata of their file.

    Attributes
    ----------
    heights : ndarray of float64, shape (n_y, n_x)
        Row 0 is the first of the file and the smallest y; NaN for missing points.
    source : str
        What they come from, in words.
    spacing : (float, float), optional
        Distance of grid points along x and y, if the file says it.
    unit : str, optional
        Of heights and spacing, if the file says it.
    periodic : bool, optional
        Whether the last row and column are next to the first, if the file says it.
    codes : int, optional
        Largest whole number that its type holds, where heights are codes of an image.
    """

    heights: Floats
    source: str
    spacing: tuple[float, float] | None = None
    unit: str | None = None
    periodic: bool | None = None
    codes: int | None = None


def is_height_map(path: str | os.PathLike[str]) -> bool:
    """Whether a file is a height map by its name."""
    return os.fspath(path).lower().endswith(ENDINGS)


def read_height_map(
    path: Path, read_image: Callable[[Path], NDArray[np.generic]]
) -> HeightMap:
    """Heights of a file, by its ending.

    Parameters
    ----------
    path : Path
        A ``.npy`` file, a file of an instrument (:data:`READERS`), or else an image.
    read_image : callable
        Returns the pixels of an image in their own type, channels last if it has
        several.

    Raises
    ------
    SpecimenError, FileFormatError
        If there is no such file, or it is damaged.
    ImportError
        If the extra ``surfaces`` is not installed, and the file needs it.
    """
    if not path.is_file():
        raise SpecimenError(f"heightfield.filename: {no_file(path)}")
    ending = path.suffix[1:].lower()
    if ending == "npy":
        try:  # nothing else that NumPy loads by its content
            return HeightMap(np.lib.format.open_memmap(path, mode="r"), path.name)
        except Exception as error:  # a damaged header is evaluated as Python
            raise unreadable(path, error) from None
    if ending in READERS:
        return _foreign(path, READERS[ending])
    pixels: Any = read_image(path)
    codes = int(np.iinfo(pixels.dtype).max) if pixels.dtype.kind in "ui" else None
    if pixels.ndim == 3 and pixels.size:
        pixels = pixels[..., 0]
    return HeightMap(pixels, path.name, codes=codes)


def unreadable(path: Path, error: Exception) -> SpecimenError:
    """Error for a file that holds no heights, with the reason of whoever read it."""
    said = re.sub(r"\[\w+\.(cpp|h):\d+\] ", "", " ".join(str(error).split()))
    return SpecimenError(
        "heightfield.filename must be an image, a .npy file or a file of a "
        f"profilometer, got {path}, which is damaged or something else: {said}"
    )


def _foreign(path: Path, formats: str) -> HeightMap:
    """Heights of an instrument's file."""
    if find_spec("SurfaceTopography") is None:
        raise PackageError(
            f"the library SurfaceTopography must be installed to read {path.name}: "
            f"{to_install('surfaces')}"
        )
    try:
        facts, heights = read_apart(str(path), formats.split(","))
    except ValueError as error:
        raise FileFormatError(f"{path} cannot be read: {error}") from None
    source = f"{path.name} ({facts.pop('format')}, {facts.pop('channel')})"
    spacing = facts.pop("spacing")
    return HeightMap(heights, source, spacing and tuple(spacing), **facts)


def read_apart(path: str, formats: Sequence[str]) -> tuple[dict[str, Any], Floats]:
    """:func:`~gonio_mi.surfaces.height_map_reader.read` in a process of its own."""
    import json  # with the others slow to import
    import subprocess
    import tempfile

    program = Path(__file__).with_name("height_map_reader.py")
    # threads of a linear algebra that is not needed take address space
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "heights.npy"
        try:
            done = subprocess.run(
                [sys.executable, str(program), path, ",".join(formats), str(out)],
                env=environment,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=PATIENCE,
            )
            facts = json.loads(done.stdout.decode().splitlines()[-1])
        except subprocess.TimeoutExpired:
            raise ValueError(f"that took more than {PATIENCE} seconds") from None
        except (ValueError, IndexError):
            raise ValueError("its reader crashed: it is probably damaged") from None
        if "error" in facts:
            raise ValueError(facts["error"])
        return facts, np.load(out)
