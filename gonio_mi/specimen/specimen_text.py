"""Specimens as text: parsed from a word of the command line, and named by one."""

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from ..errors import SpecimenError, no_file

if TYPE_CHECKING:
    import mitsuba as mi

# What `measure` takes: a dictionary of Mitsuba's, an object of it, or a file.
SpecimenLike: TypeAlias = (
    "dict[str, Any] | mi.BSDF | mi.Shape | mi.Scene | str | os.PathLike[str]"
)

# Refractive indices, for which Mitsuba takes an integer for a name in its table.
INDICES = {"int_ior", "ext_ior"}

# What others call BSDFs, and the word for each here.
CALLED = {
    "ggx": "roughconductor:distribution=ggx",
    "beckmann": "roughconductor:distribution=beckmann",
    **dict.fromkeys(("lambert", "lambertian"), "diffuse"),
    "mirror": "conductor",
    "glass": "dielectric",
}


def parse_specimen(text: str) -> Any:
    """Specimen from a word of the command line.

    Parameters
    ----------
    text : str
        Path of an existing file or one that ends in ``.xml``; or a BSDF in one word:
        ``diffuse``, ``roughconductor:alpha=0.2,distribution=ggx``. A value is a number,
        ``true``, ``false``, a colour ``0.2/0.5/0.1``, or else a text.

    Returns
    -------
    str or dict
        What :func:`load_specimen` takes.
    """
    is_plugin = re.match(r"\w\w+:\s*\w+\s*=", text)  # whatever its last value ends in
    if os.path.isfile(text) or (text.endswith(".xml") and not is_plugin):
        return text
    name, _, settings = text.partition(":")
    if not re.fullmatch(r"[\w-]*", name):  # a name of no plugin, but of a file
        if re.match(r"\w+,\s*\w+\s*=", text):  # of a plugin, and a parameter
            meant = text.replace(",", ":", 1)
            raise SpecimenError(
                f"specimen must have a colon before its parameters, as in {meant}, "
                f"got {text}"
            )
        word = "; a BSDF in one word is like roughconductor:alpha=0.2"
        raise SpecimenError(no_file(text) + (not Path(name).suffix) * word)
    specimen = {"type": name}
    # a comma parts two parameters where a name and = follow it, and else two numbers
    for setting in filter(None, re.split(r",(?=[^,]*=)|,$", settings)):
        key, equals, value = (part.strip() for part in setting.partition("="))
        if not (key and equals):
            raise SpecimenError(
                f"specimen must look like roughconductor:alpha=0.2, got {text!r}"
            )
        if "," in value:
            raise SpecimenError(_with_commas(key, value))
        if value.lower().lstrip("+-") in ("nan", "inf"):
            raise SpecimenError(f"{key} must be a finite number, got {value}")
        if key in specimen:
            raise SpecimenError(f"{key} must be given once, got {text!r}")
        specimen[key] = _value(value)
    return specimen


def _with_commas(key: str, value: str) -> str:
    """Message on a value with commas, which part parameters."""
    number = re.fullmatch(r"([-+]?\d+),(\d+)", value)
    if number:
        like = f"a number with a point, such as {number[1]}.{number[2]}"
    elif value.count(",") == 2:
        like = f"a colour with slashes, such as {value.replace(',', '/')}"
    else:
        like = "a value without commas"
    return f"{key} must be {like}, got {value}"


def _value(text: str) -> Any:
    """Number, boolean, colour or text."""
    if text in ("true", "false"):
        return text == "true"
    if re.fullmatch(r"[-+]?\d+", text):
        return int(text)
    try:
        if text.count("/") == 2:
            return {"type": "rgb", "value": [float(x) for x in text.split("/")]}
        return float(text)
    except ValueError:
        return text


def with_real_indices(node: Any) -> Any:
    """Dictionary as Mitsuba takes it: refractive indices are no integers."""
    if not isinstance(node, dict):
        return node
    real = {key: float(node[key]) for key in INDICES if type(node.get(key)) is int}
    return {key: with_real_indices(value) for key, value in node.items()} | real


def specimen_name(
    specimen: SpecimenLike, parameters: dict[str, Any] | None = None
) -> str:
    """Short name of a specimen: its file, or its BSDF in one word where that fits.

    The inverse of :func:`parse_specimen`, as far as there is one. A scene of one mesh
    has the name of its file and of what it is made of.
    """
    settings = parameters or {}
    if mesh := _only_mesh(specimen):
        bsdf = mesh["bsdf"]
        if isinstance(bsdf, dict) and bsdf["type"] == "twosided":
            bsdf = bsdf.get("bsdf", bsdf)
        return f"{Path(mesh['filename']).name} of {specimen_name(bsdf)}"
    if isinstance(specimen, dict):
        name = specimen["type"]
        settings = {key: value for key, value in specimen.items() if key != "type"}
    elif isinstance(specimen, (str, os.PathLike)):
        name = str(specimen)
    else:
        return specimen.class_name()
    words = {key: _word(value) for key, value in settings.items()}
    told = ",".join(f"{key}={word}" for key, word in words.items() if word is not None)
    return f"{name}:{told}" if told else name


def _only_mesh(specimen: SpecimenLike) -> dict[str, Any] | None:
    """The shape of a scene that is a mesh in a file and nothing else."""
    if not isinstance(specimen, dict) or specimen.get("type") != "scene":
        return None
    parts = [part for part in specimen.values() if isinstance(part, dict)]
    alone = len(parts) == 1 and "filename" in parts[0] and "bsdf" in parts[0]
    return parts[0] if alone else None


def _word(value: Any) -> str | None:
    """Value of a dictionary in a word; None for what has none."""
    if isinstance(value, dict) and value.get("type") == "rgb":
        return "/".join(f"{x:g}" for x in np.ravel(value["value"]))
    if isinstance(value, bool):
        return str(value).lower()
    return str(value) if isinstance(value, (int, float, str)) else None
