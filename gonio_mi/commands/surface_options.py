"""Options of the command line that say what a file of heights, or a mesh, is."""

from __future__ import annotations

from argparse import Namespace
from typing import Any

from ..errors import SettingError
from ..formats.height_maps import is_height_map
from ..formats.meshes import is_mesh
from ..instrument.loading import surface_specimen
from ..instrument.mesh import NORMALS, mesh
from ..instrument.specimen_text import parse_specimen
from ..surfaces.preparation import FILLS, FORMS
from ..surfaces.topography import UNITS
from .arguments import number

__all__ = ["add_surface_options", "given_surface", "prepared_surface"]

# Properties of the plugin `heightfield`, with their options' metavar and sentence.
NUMBERS = {
    "size": (
        "X",
        "Extent in x, from the first point of a row to the last; with --period, from "
        "the first to where it comes again, a cell further. Default: what the file "
        "says, else 2, with a warning.",
    ),
    "size_y": ("Y", "Extent in y. Default: what the file says, else by square cells."),
    "scale": (
        "Z",
        "Factor on the heights; of an image of whole numbers, the height of a step of "
        "1. Default: 1; such images have none.",
    ),
    "range": (
        "Z",
        "Of an image of whole numbers, instead of --scale: the height from black to "
        "white.",
    ),
}
WORDS = {
    "unit": (
        tuple(UNITS),
        "Unit of all these where the file does not state it; it scales nothing, but "
        "wavelengths can be compared with it.",
    ),
    "form": (
        tuple(FORMS),
        "What to take away: the mean height, the plane (tilt), or a quadratic or cubic "
        "polynomial. Default: keep it all.",
    ),
    "fill": (
        FILLS,
        "What stands for points that were not measured: the nearest measured one, or "
        "planes through three around. Default: none, which refuses them.",
    ),
}


def add_surface_options(parser: Any) -> None:
    """Add the options to a parser, in a group of their own."""
    group = parser.add_argument_group(
        "surface",
        "where SPECIMEN is a file of heights, or a mesh, which takes --unit, --bsdf, "
        "--normal and --mean-plane",
    )
    for name, (metavar, sentence) in NUMBERS.items():
        group.add_argument(
            f"--{name.replace('_', '-')}", type=number, metavar=metavar, help=sentence
        )
    for name, (choices, sentence) in WORDS.items():
        group.add_argument(f"--{name}", choices=choices, help=sentence)
    group.add_argument(
        "--bsdf",
        metavar="BSDF",
        help="What it is made of, in one word such as conductor:material=Al. Default: "
        "a mirror that reflects all light; for a mesh there is none.",
    )
    group.add_argument(
        "--normal",
        choices=tuple(NORMALS),
        help="Of a mesh: the axis of the file that is the specimen's normal, +z, and "
        "not the vertical of what hangs upright. Default: z.",
    )
    group.add_argument(
        "--mean-plane",
        type=number,
        metavar="Z",
        help="Of a mesh: height of the mean plane along the normal axis. Default: in "
        "the middle.",
    )


def given_surface(options: Namespace) -> dict[str, Any]:
    """Properties of the plugin `heightfield` that the command line gives."""
    values = {name: getattr(options, name) for name in (*NUMBERS, *WORDS)}
    return {name: value for name, value in values.items() if value is not None}


def prepared_surface(specimen: Any, options: Namespace) -> Any:
    """The specimen, or the shape of a file of heights or a mesh with what is given.

    A surface of heights is finite, unless a period joins its last row and column to the
    first.

    Raises
    ------
    ValueError
        If something is given, and it is no such file.
    """
    given = given_surface(options)
    bsdf = None if options.bsdf is None else parse_specimen(options.bsdf)
    if isinstance(bsdf, str):
        raise SettingError(f"--bsdf must be a BSDF in one word, got {bsdf!r}")
    lying = {"normal": options.normal, "mean_plane": options.mean_plane}
    lying = {name: value for name, value in lying.items() if value is not None}
    if is_mesh(specimen):
        _check_of_mesh(given)
        if bsdf is None:
            return specimen  # which is refused in the words of all commands
        return mesh(specimen, bsdf, **lying)
    if lying:
        name = next(iter(lying)).replace("_", "-")
        raise SettingError(f"--{name} goes with a mesh, got {specimen!r}")
    if isinstance(specimen, str) and is_height_map(specimen):
        period = getattr(options, "period", None)
        return surface_specimen(specimen, bsdf, period, **given)
    if given or options.bsdf is not None:
        names = [f"--{name.replace('_', '-')}" for name in given] or ["--bsdf"]
        raise SettingError(f"{names[0]} goes with a file of heights, got {specimen!r}")
    return specimen


def _check_of_mesh(given: dict[str, Any]) -> None:
    """Raise ValueError for what goes with heights only."""
    for name in given.keys() - {"unit"}:
        option = f"--{name.replace('_', '-')}"
        raise SettingError(f"{option} goes with a file of heights, got a mesh")
