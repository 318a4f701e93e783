"""Files that a specimen names, and that Mitsuba's plugins do not check themselves."""

import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import SpecimenError
from ..formats.tensor_file import check_measured

# Scene files may include others; no more than this many deep.
MAX_INCLUDES = 15


def check_named_files(
    specimen: Mapping[str, Any] | str | os.PathLike[str],
    parameters: Mapping[str, str] | None = None,
    wavelengths: Sequence[float] = (),
) -> None:
    """Raise if a damaged file would crash Mitsuba's plugin `measured`.

    Or if it has no data at one of the `wavelengths`, beyond which it goes on with its
    last ones.

    Names that are not found are left to Mitsuba, and so are scene files that are not
    XML.

    Parameters
    ----------
    specimen : dict, str or path
        Dictionary or scene file, as Mitsuba loads it.
    parameters : dict, optional
        Values of the ``$name`` parameters of a scene file.
    wavelengths : sequence of float
        In nm, of a measurement in a spectral variant.

    Raises
    ------
    FileFormatError
        If a file is damaged.
    SpecimenError
        If its data do not cover the wavelengths.
    """
    if isinstance(specimen, Mapping):
        names = _dictionary_names(specimen)
    else:
        names = _scene_names(Path(specimen), dict(parameters or {}), MAX_INCLUDES)
    for name in names:
        path = Path(str(mi.file_resolver().resolve(str(name))))
        if path.is_file():
            covered = check_measured(path) or (0.0, np.inf)
            beyond = [nm for nm in wavelengths if not _holds(covered, nm)]
            if beyond:
                low, high = covered
                raise SpecimenError(
                    f"{path.name} covers the wavelengths from {low:g} to {high:g} nm, "
                    f"got {beyond[0]:g} nm"
                )


def _holds(covered: tuple[float, float], nm: float) -> bool:
    """Whether a wavelength, in the single precision of Mitsuba's, is in a range."""
    return covered[0] <= float(np.float32(nm)) <= covered[1]


def _dictionary_names(node: Mapping[str, Any]) -> Iterator[str | Path]:
    """File names in a dictionary and all that it holds."""
    if node.get("type") == "measured" and isinstance(node.get("filename"), str):
        yield node["filename"]
    for value in node.values():
        if isinstance(value, Mapping):
            yield from _dictionary_names(value)


def _scene_names(
    path: Path, parameters: dict[str, str], depth: int
) -> Iterator[str | Path]:
    """File names in a scene file and those that it includes, beside it if there."""
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, OSError, ValueError, LookupError):
        return
    for default in root.iter("default"):
        parameters.setdefault(default.get("name", ""), default.get("value", ""))
    for bsdf in root.iter():
        if bsdf.get("type") == "measured":
            for child in bsdf.iter("string"):
                if child.get("name") == "filename":
                    yield _beside(path, child.get("value", ""), parameters)
    for include in root.iter("include"):
        other = _beside(path, include.get("filename", ""), parameters)
        if depth:
            yield from _scene_names(Path(other), parameters, depth - 1)


def _beside(path: Path, name: str, parameters: Mapping[str, str]) -> str | Path:
    """File of that name beside `path`, or the name alone if there is none."""
    for key in sorted(parameters, key=len, reverse=True):
        name = name.replace(f"${key}", parameters[key])
    beside = path.parent / name
    return beside if beside.is_file() else name
