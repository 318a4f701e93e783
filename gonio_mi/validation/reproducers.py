"""Reproducers: what is wrong with a BSDF, by Mitsuba and NumPy alone.

The source of the property that fails, of the functions that it names and of its
judgement, which a verdict calls too, with the BSDF, the direction and the patch where
it was found. Each prints two numbers that should be equal, and how far apart they
are: in standard errors, or, where chance takes no part, in roundings. Counts and bit
masks must be equal.
"""

import ast
import inspect
import os
import re
import textwrap
from collections.abc import Iterator, Mapping
from functools import cache
from os import PathLike
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import SettingError
from ..files import replacing
from ..single_precision import BSDF_ROUNDING
from ..specimen.specimen_text import with_real_indices
from ..variants import unpolarised
from .checks.ends import at_ends, length_at_ends
from .checks.first_element import first_element
from .conditions import POSITION, TURN, Condition, Sweep
from .densities import (
    all_around,
    by_lattices as lattices_of,
    directions,
    in_box,
    lit_directions,
)
from .judgements import OF_CHANCE, by_sample, equal, most_apart
from .maps import FourMaps
from .mistakes import Claim
from .phase_functions import Scatterer
from .probe import Probe
from .verdict import Property, Verdict

# Where is looked if a finding names no direction.
ANYWHERE = Condition(50.0, 25.0, uv=(0.35, 0.6))

# Hits that a patch must have to be counted in.
MIN_HITS = 100

# Part of a density where `eval` is black that makes a difference.
UNUSED = 1e-4

# Stock BSDFs of one dictionary, which are the same everywhere.
UNTEXTURED = (
    *("diffuse", "conductor", "roughconductor", "dielectric", "roughdielectric"),
    *("plastic", "roughplastic", "pplastic", "principled", "principledthin", "hair"),
    *("thindielectric", "null"),
)

# Square of the score, less what chance gives the worst, from which on it is shown.
MIN_SCORE = 25.0

# Relative error of an integral over patches.
ROUGHLY = 1e-4

# Corners of the whole sphere, in the unit square.
EVERYWHERE = ([0.0, 0.0], [1.0, 1.0])

# Where no map is.
NO_BOX: tuple[None, Any] = (None, EVERYWHERE)

# What is set beside a field of a surface interaction, and all that a medium has.
TANGENTS = ("n", "dp_du", "dp_dv")
BESIDE = {"sh_frame": ("sh_frame", *TANGENTS), "dp_du": TANGENTS, "uv": ()}
OF_A_MEDIUM = ("time", "t", "p", "n")

# What a script needs the source of, and how those parts begin that come last.
OURS = "gonio_mi."
LATER = ("def", "class")

# Characters of a line.
WIDTH = 88

# What a script says of its unit, by the judgement that it ends with.
CHANCE = "# Five standard errors are hardly ever chance.\n"
ROUNDINGS = f"""\
# A rounding is {BSDF_ROUNDING:.2g} of them: 1024 operations in single precision.
# A few are no mistake.
"""
UNITS = dict.fromkeys(OF_CHANCE, CHANCE) | dict.fromkeys((equal, by_sample), ROUNDINGS)

IMPORTS = """import drjit as dr
import mitsuba as mi
import numpy as np
"""


def reproducer(verdict: Verdict, name: str | None = None) -> str:
    """Python script that shows one failure by calls of Mitsuba alone.

    At most 40 lines of code, without an import of this package. The last line that it
    prints has two numbers that should be equal, and how far apart they are: in standard
    errors, or in roundings of a thousand operations in single precision where chance
    takes no part; of counts and bit masks, whether they are equal. What
    raises an exception raises it there too.

    Parameters
    ----------
    verdict : Verdict
        Of a BSDF that was given as a dictionary or as a file.
    name : str, optional
        Property that fails; the worst by default.

    Returns
    -------
    str

    Raises
    ------
    SettingError
        If nothing fails, or the BSDF was given as an object.
    """
    if verdict.source is None:
        raise SettingError(
            "a reproducer needs the BSDF as a dictionary or a file, got an object"
        )
    for one in verdict.failures:
        if name in (None, one.name):
            return script(verdict, one)
    which = "a property" if name is None else name
    raise SettingError(f"a reproducer needs {which} that fails, got none")


def save_reproducer(verdict: Verdict, path: str | PathLike[str]) -> None:
    """Write :func:`reproducer` of the worst failure to a file; raises as it does.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    text = reproducer(verdict)
    with replacing(path) as stream:
        stream.write(text.encode())


def script(verdict: Verdict, one: Property, claim: Claim | None = None) -> str:
    """The script that shows a property that fails, by another claim if there is one."""
    condition, claim = _condition(one), claim or one.shown
    if claim is None:
        raise SettingError(f"no script shows {one.name}")
    if claim.stated is in_box:
        maps, corners = _box(verdict, one.name) if not condition.fields else NO_BOX
        condition = maps.condition if maps else condition
        of = claim.given
        if of == (directions,) and maps and maps.due.unused.values.sum() > UNUSED:
            of = (lit_directions,)
        rounded = [[float(f"{x:.9g}") for x in corner] for corner in corners]
        claim = Claim(in_box, claim.judge, (*of, *rounded))
        if corners == EVERYWHERE:
            claim = Claim(all_around, most_apart, of)
    setting = _setting(verdict, condition, one.of_volumes, claim)
    call = f"{claim.stated.__name__}(bsdf, ctx, si, u{_given(claim)})"
    if claim.stated is first_element:
        both = mi.variant(), unpolarised(mi.variant())
        setting = setting.replace(f'"{verdict.settings["variant"]}"', "variant")
        setting = textwrap.indent(f"{setting}values.append({call})\n", "    ")
        setting = f"values = []\nfor variant in {both}:\n{setting}"
        call = "values, values[0] > 0"
    needed = [claim.judge, *filter(callable, claim.given), claim.stated]
    needed = [Scatterer, *needed] if one.of_volumes else needed
    title = f"{verdict.name}: {one.mistake or verdict.mistake or one.question}"
    return (
        f"# {title} ({condition})\n"
        f"# Two numbers that should be equal where {one.question or 'it is right'}.\n"
        f"{UNITS.get(claim.judge, '')}"
        f"{IMPORTS}\n\n{sources(*needed)}\n\n\n{setting}"
        f"{claim.judge.__name__}(*{call})\n"
    )


def by_lattices(verdict: Verdict, one: Property) -> str:
    """The same of the total of samples or weights, by lattices of directions."""
    of = one.shown.given if one.shown else ()
    return script(verdict, one, Claim(lattices_of, most_apart, of))


def _given(claim: Claim) -> str:
    """Arguments of a property, after the usual ones."""
    words = [x.__name__ if callable(x) else repr(x) for x in claim.given]
    return "".join(f", {word}" for word in words)


@cache
def sources(*needed: Any) -> str:
    """Source of functions and classes, and of what they name, without annotations."""
    found: dict[Any, str] = {}

    def add(one: Any) -> None:
        if one in found:
            return
        found[one] = source = _without_annotations(inspect.getsource(one))
        nodes, known = ast.walk(ast.parse(source)), vars(inspect.getmodule(one))
        for name in [x.id for x in nodes if isinstance(x, ast.Name)]:
            other = known.get(name)
            if str(getattr(other, "__module__", "")).startswith(OURS):
                add(other)
            elif isinstance(other, float):
                found[name] = f"{name} = {other!r}"
        del found[one]  # what it names comes before
        found[one] = source

    for one in needed:
        add(one)
    return "\n\n\n".join(sorted(found.values(), key=lambda x: x.startswith(LATER)))


def _without_annotations(source: str) -> str:
    """Source of a function or class without the types of arguments and answers."""
    lines = source.rstrip().splitlines()
    heads, cuts = [], []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.FunctionDef):
            continue
        heads.append((node.lineno - 1, node.body[0].lineno - 1))
        for x in (*node.args.args, node.args.vararg):
            if x is not None and x.annotation is not None:
                begin, end = x.col_offset + len(x.arg), x.annotation.end_col_offset
                cuts.append((x.lineno, begin, end))
        if (types := node.returns) is not None:
            begin = lines[types.lineno - 1].rindex(")", 0, types.col_offset) + 1
            cuts.append((types.lineno, begin, types.end_col_offset))
    for line, begin, end in sorted(cuts, reverse=True):
        after = re.sub("^ = ", "=", lines[line - 1][end:])
        lines[line - 1] = lines[line - 1][:begin] + after
    for first, last in sorted(heads, reverse=True):
        head = " ".join(x.strip() for x in lines[first + 1 : last])
        joined = re.sub(r",? ?\)", ")", lines[first] + head)
        if len(joined) <= WIDTH:
            lines[first:last] = [joined]
    return "\n".join(lines)


def _condition(one: Property) -> Condition:
    """Where a finding is, or anywhere if it is everywhere."""
    found = one.condition
    return ANYWHERE if found is None or isinstance(found, Sweep) else found


def _setting(
    verdict: Verdict, condition: Condition, of_volumes: bool, claim: Claim
) -> str:
    """Lines of a script from the variant to what a property takes."""
    textured = _is_textured(verdict) or "uv" in condition.fields
    textured &= not of_volumes
    axes = TURN.T.round(7).tolist() if condition.turned and textured else [[0, 0, 1]]
    kind = "PhaseFunction" if of_volumes else "BSDF"
    chance = claim.judge in OF_CHANCE and claim.stated is not lattices_of
    count = "2**20" if chance else "2**16"
    if claim.stated in (at_ends, length_at_ends):  # which have numbers of their own
        count = "27"
    mode = f"mi.TransportMode.{condition.mode.capitalize()}"
    given = f"None, {mode}" if of_volumes else mode
    kinds = "Medium" if of_volumes else "Surface"
    lines = [
        f'mi.set_variant("{verdict.settings["variant"]}")',
        str(verdict.source),
        *(["bsdf = Scatterer(phase)"] if of_volumes else []),
        f"ctx, n = mi.{kind}Context({given}), {count}",
        "u = mi.Point3f(np.random.default_rng(0).random((3, n), dtype=np.float32))",
        f"si = dr.zeros(mi.{kinds}Interaction3f, n)",
    ]
    wi = f"mi.Vector3f({', '.join(map(str, condition.wi.round(8).tolist()))}) + 0 * u"
    fields = {"wi": wi}
    if not of_volumes:
        fields["sh_frame"] = f"mi.Frame3f({', '.join(map(str, axes))})"
    if mi.is_spectral:
        fields["wavelengths"] = f"mi.UnpolarizedSpectrum({list(condition.nm)})"
    placed = {}
    if textured:
        placed["uv"] = "mi.Point2f({}, {})".format(*condition.uv)
        placed |= {"dp_du": "2 * si.sh_frame.s", "dp_dv": "2 * si.sh_frame.t"}
    if (textured or of_volumes) and condition.turned:
        placed["p"] = f"mi.Point3f({POSITION.tolist()})"
    for own in filter(None, (fields, placed)):
        names = ", ".join(f"si.{name}" for name in own)
        lines.append(f"{names} = {', '.join(own.values())}")
    if condition.component is not None:
        lines.append(f"ctx.component = {condition.component}")
    if condition.differentials:
        lines.append("si.duv_dx, si.duv_dy = [0.3, 0.1], [-0.1, 0.2]")
    return "\n".join([*lines, *_fields(condition, of_volumes)]) + "\n"


def _fields(condition: Condition, of_volumes: bool) -> Iterator[str]:
    """Lines of a script that set fields of the surface interaction."""
    si = Probe(None, condition).interaction()
    names = [x for name in condition.fields for x in BESIDE.get(name, (name,))]
    if of_volumes:
        names = [name for name in names if name in OF_A_MEDIUM]
    for name in dict.fromkeys(names):
        value = getattr(si, name)
        parts = (value.s, value.t, value.n) if name == "sh_frame" else (value,)
        text = ", ".join(str(np.array(x).ravel().round(6).tolist()) for x in parts)
        yield f"si.{name} = type(si.{name})({text})"


def _is_textured(verdict: Verdict) -> bool:
    """Whether the BSDF may depend on the place: it has textures, or is unknown."""
    types = re.findall(r"""["']type["']: ["'](\w+)["']""", str(verdict.source))
    return len(types) != 1 or types[0] not in UNTEXTURED


def _box(verdict: Verdict, name: str) -> tuple[FourMaps | None, Any]:
    """Map and box of directions in which most flux is wrong, given enough hits.

    Of boxes that are certainly wrong, the one of the largest difference times the
    fraction that it is of the box. The box is that of a patch, of a ring, of a
    hemisphere or of the whole sphere: its corners in the unit square that Mitsuba maps
    onto the sphere.
    """
    found: list[tuple[float, FourMaps, Any]] = []
    whole = [one for one in verdict.maps if one.condition.component is None]
    for maps in whole if name == "weights" else whole or verdict.maps:
        n, patches = maps.totals.n, maps.subdivision
        shape = (2, *patches.shape)
        drawn, due = maps.totals.counts, n * maps.pdf
        hits = squares = np.maximum(drawn, due)
        if name == "weights":
            drawn, squares = maps.totals.sums, maps.totals.squares
            due = n * maps.weights
        cosines = np.cos(patches.theta_edges)
        for axes in ((0, 1, 2), (1, 2), (2,), ()):
            k, q, e, s = (
                x.reshape(shape).sum(axis=axes, keepdims=True)
                for x in (drawn, due, hits, squares)
            )
            variance = np.maximum(s - np.maximum(k, q) ** 2 / n, 0) + (ROUGHLY * q) ** 2
            off = np.where(e >= MIN_HITS, np.abs(k - q), 0)
            # of many patches the worst is far off by chance
            certain = off**2 / (variance + 1e-30) - 2 * np.log(off.size) > MIN_SCORE
            flux = np.where(certain, off**2 / np.maximum(np.maximum(k, q), 1e-30), 0)
            half, ring, sector = np.unravel_index(flux.argmax(), flux.shape)
            low, high = [0.0, 0.0], [1.0, 1.0]
            if 2 not in axes:
                low[0], high[0] = patches.phi_edges[[sector, sector + 1]] / (2 * np.pi)
            if 0 not in axes:
                edges = cosines[[ring, ring + 1]] if 1 not in axes else [1.0, 0.0]
                up = maps.condition.side == ("front", "back")[half]
                ends = edges if up else [-x for x in edges]
                low[1], high[1] = sorted((1 - x) / 2 for x in ends)
            found.append((float(flux.max()) / n, maps, (low, high)))
    wrong, best, corners = max(found, key=lambda one: one[0], default=(0, None, None))
    return (best, corners) if wrong > 0 else (None, EVERYWHERE)


# ------------------------------------------------------------------- the BSDF as text


def source_of(
    specimen: Any, parameters: Mapping[str, Any] | None = None, volumes: bool = False
) -> str | None:
    """Statement that loads ``bsdf`` from a dictionary or a file; None for an object.

    Of phase functions (`volumes`) it loads ``phase``.
    """
    if isinstance(specimen, (str, os.PathLike)):
        given = [repr(str(specimen))]
        given += [f"{key}={str(x)!r}" for key, x in (parameters or {}).items()]
        return f"bsdf = mi.load_file({', '.join(given)}).shapes()[0].bsdf()"
    given = with_real_indices(specimen)
    text = _text(given) if isinstance(specimen, dict) else None
    return text and f"{'phase' if volumes else 'bsdf'} = mi.load_dict({text})"


def _text(node: Any) -> str | None:
    """Python text of a part of a dictionary; None where it has none."""
    if isinstance(node, dict):
        parts = [(key, _text(value)) for key, value in node.items()]
        if any(value is None for _, value in parts):
            return None
        return "{" + ", ".join(f'"{key}": {value}' for key, value in parts) + "}"
    if isinstance(node, mi.Bitmap):
        return f"mi.Bitmap(np.array({np.array(node).tolist()}, np.float32))"
    if isinstance(node, mi.VolumeGrid):
        values = np.array(node)
        return f"mi.VolumeGrid(np.float32({values.tolist()}))"
    if isinstance(node, str):
        return '"' + node.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return repr(node) if isinstance(node, (bool, int, float, list)) else None
