"""Reproducers: what is wrong with a BSDF, in 20 lines of Mitsuba and NumPy.

The lines of a kind of finding, filled with the BSDF, the direction and the patch where
it was found. Each prints two numbers that should be equal, and how far apart they
are: in standard errors, or, where chance takes no part, in roundings. Counts and bit
masks must be equal.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import SettingError
from ..files import replacing
from ..instrument.specimen_text import with_real_indices
from ..single_precision import BSDF_ROUNDING
from ..transport.variants import unpolarised
from .conditions import POSITION, TURN, Condition, Sweep
from .kinds import LIT, PDF, PRODUCT, SMOOTH, VALUE, Kind, MatrixKind, each
from .maps import FourMaps
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

# What is counted in a patch, and of all directions.
COUNTED = {
    Kind.SAMPLING: Kind.MOMENTS,
    Kind.WEIGHTS: Kind.MOMENTS_OF_WEIGHTS,
}

# Answers of functions, of `eval` if no other, and of `sample` by what a finding is
# about.
ANSWERS = {
    "sample": "bsdf.sample(ctx, si, RANDOM, True)[1]",
    "pdf": "bsdf.pdf(ctx, si, wo, True)",
    "eval_pdf": "bsdf.eval_pdf(ctx, si, wo, True)[0]",
}
SAMPLED = {"weight": "weight", "pdf": "bs.pdf", "direction": "dr.abs(bs.wo)"}

# What functions follow a change of a parameter, if not all.
STALE = {"sample": ("bs.pdf", PDF), "pdf": (PDF, "bs.pdf")}

# What stands for longer text in templates. Others are filled in by `_words`.
WORDS = {
    "RANDOM": "mi.Float(u[0]), mi.Point2f(u[1:])",
    "ROUNDING": f"{BSDF_ROUNDING:.2g}",
    "SPHERE": "mi.warp.square_to_uniform_sphere(mi.Point2f(u[1:]))",
}


def reproducer(verdict: Verdict, name: str | None = None) -> str:
    """Python script that shows one failure by calls of Mitsuba alone.

    At most 20 lines of code, without an import of this package. The last line that it
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
    failed = {one.name: one for one in verdict.failures}
    if verdict.source is None:
        raise SettingError(
            "a reproducer needs the BSDF as a dictionary or a file, got an object"
        )
    one = next(iter(failed.values()), None) if name is None else failed.get(name)
    if one is None:
        which = "a property" if name is None else name
        raise SettingError(f"a reproducer needs {which} that fails, got none")
    return script(verdict, one)


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


def script(verdict: Verdict, one: Property) -> str:
    """The script that shows a property that fails."""
    kind = one.kind or Kind[one.name.upper()]
    condition = one.condition or ANYWHERE
    words = _words(verdict, one, kind)
    if kind in COUNTED:
        maps, corners = _box(verdict, one.name)
        condition = maps.condition if maps else condition
        words |= _counted(maps, corners, kind)
        kind = COUNTED[kind] if corners == EVERYWHERE else kind
    if isinstance(condition, Sweep):
        condition = ANYWHERE
    body = kind.value
    for word, text in (words | WORDS).items():
        body = text.join(re.split(rf"\b{word}\b", body))
    n = "2**20" if "standard errors" in body else "2**16"
    n = "27" if one.name == "ends" else n
    lines = list(_head(verdict, one, condition, n))
    if kind is MatrixKind.FIRST_ELEMENT:
        lines = list(_in_both_variants(lines, words["FLUX"]))
    text = "\n".join([*lines, body]) + "\n"
    if "rng." not in body:
        rng = "np.random.default_rng(0)"
        text = text.replace(f"rng = {rng}\nu = rng", f"u = {rng}")
    if mi.is_polarized and isinstance(kind, Kind):
        text = of_first_elements(text)
    return in_a_medium(text) if one.of_volumes else text


def _counted(maps: FourMaps | None, corners: Any, kind: Kind) -> dict[str, str]:
    """Words of a template that compares samples and integrals in a box."""
    counted = LIT if maps and not maps.totals.delta_mean.any() else SMOOTH
    density = "bsdf.pdf(ctx, si, wo, True)"
    dark = maps.due.unused.values.sum() if maps else 0.0
    if kind is Kind.SAMPLING and dark > UNUSED:
        counted = "dr.any(bsdf.eval(ctx, si, bs.wo, True) > 0)"
        density = f"dr.select(dr.any(bsdf.eval(ctx, si, wo, True) > 0), {density}, 0)"
    rounded = [[[float(f"{x:.9g}")] for x in corner] for corner in corners]
    return {"CORNERS": str(rounded), "COUNTED": counted, "DENSITY": density}


def _words(verdict: Verdict, one: Property, kind: Kind | MatrixKind) -> dict[str, str]:
    """Text that replaces each word of a template for one finding."""
    guilty = str(one.function or verdict.function or "eval").split(" or ")[0]
    if kind is Kind.UPDATE:
        guilty = one.about
    answer = ANSWERS.get(guilty, "bsdf.eval(ctx, si, wo, True)")
    function = answer.replace(", wo,", ", bs.wo,")
    about, samples = one.about, guilty == "sample"
    if kind in (Kind.ANSWERS, Kind.ENDS):
        about = SAMPLED[about] if samples else answer
    stale = STALE.get(guilty, (PRODUCT, VALUE))
    excluded = "((bs.sampled_type & int(bsdf.flags(i)) & 0x7E) != 0)"
    return {
        "ABOUT": about,
        "NORMAL": about or "[0, 0, 1]",
        "STALE": stale[0],
        "DUE": stale[1],
        "INDEX": str(int(about == "pdf")),
        "TURNED": answer.replace("[1]", "[0].wo") if samples else function,
        "EXCLUDED": excluded if samples else "(bsdf.component_count() == 1)",
        "MASKED": re.sub(r"True\)(\[\d\])?$", r"awake)\1", function),
        "FLUX": "weight * bs.pdf" if samples else function,
        "FUNCTION": function,
        "ANSWER": answer,
    }


def _in_both_variants(lines: Sequence[str], value: str) -> Iterator[str]:
    """Lines up to the samples, in a loop over the polarised and the plain variant."""
    start = next(i for i, line in enumerate(lines) if "set_variant" in line)
    yield from lines[:start]
    yield "values = []"
    yield f"for variant in {mi.variant(), unpolarised(mi.variant())}:"
    yield "    mi.set_variant(variant)"
    yield from (
        f"    {line}" for text in lines[start + 1 :] for line in text.split("\n")
    )
    first = f"mi.unpolarized_spectrum({value})"
    yield f"    values += [{each(first)}]"


def of_first_elements(text: str) -> str:
    """Script that compares first elements where values are Mueller matrices."""
    first = "mi.unpolarized_spectrum"
    text = re.sub(r"(bsdf\.eval\([^()]*(?:\([^()]*\)[^()]*)*\))", rf"{first}(\1)", text)
    return re.sub(
        r"^( *)(.*), weight = (bsdf\.sample.*)$",
        rf"\1\2, weight = \3\n\1weight = {first}(weight)",
        text,
        flags=re.MULTILINE,
    )


def in_a_medium(text: str) -> str:
    """Script that asks a phase function instead of a BSDF."""
    for found, instead in (
        (r" & ~mi.has_flag\(bs.sampled_type, mi.BSDFFlags.Delta\)", ""),
        (r"mi.BSDFContext\((.*?)\)", r"mi.PhaseFunctionContext(None, \1)"),
        (r"SurfaceInteraction3f", "MediumInteraction3f"),
        (r"si.wi, si.sh_frame = (.*), mi.Frame3f.*", r"si.wi = \1"),
        (
            r"si.uv, si.p, .*(mi.Point3f\(.*?\)), .*\n",
            r"si.p, si.sh_frame = \1, mi.Frame3f(si.wi)\n",
        ),
        (r"si.uv, .*\n", "si.sh_frame = mi.Frame3f(si.wi)\n"),
        (r"bs, weight = bsdf", "flight, weight, density = bsdf"),
        (r"bs\.wo", "flight"),
        (r"bs\.pdf", "density"),
        (r"bsdf\.eval\((ctx, \w+, [^()]+)\)", r"bsdf.eval_pdf(\1)[0]"),
        (r"bsdf\.pdf\((ctx, \w+, [^()]+)\)", r"bsdf.eval_pdf(\1)[1]"),
        (r"\bbsdf\b", "phase"),
        (r"\bsi\b", "mei"),
    ):
        text = re.sub(found, instead, text)
    return text


def _head(
    verdict: Verdict, one: Property, condition: Condition, n: str
) -> Iterator[str]:
    """Lines of a script up to the samples."""
    title = f"{verdict.name}: {one.mistake or verdict.mistake or one.question}"
    yield f"# {title} ({condition})"
    yield f"# Two numbers that should be equal where {one.question or 'it is right'}."
    yield f"# A rounding is {BSDF_ROUNDING:.2g}: 1024 operations in single precision."
    yield "import drjit as dr\nimport mitsuba as mi\nimport numpy as np\n"
    yield f'mi.set_variant("{verdict.settings["variant"]}")'
    yield str(verdict.source)
    mode = f"mi.TransportMode.{condition.mode.capitalize()}"
    yield f"ctx, n = mi.BSDFContext({mode}), {n}"
    if condition.component is not None:
        yield f"ctx.component = {condition.component}"
    yield "si = dr.zeros(mi.SurfaceInteraction3f, n)"
    axes = "[0, 0, 1]"
    if condition.turned and _is_textured(verdict):
        axes = ", ".join(map(str, TURN.T.round(7).tolist()))
    wi = [float(f"{x:.8g}") for x in condition.wi]
    yield f"si.wi, si.sh_frame = mi.Vector3f({wi}), mi.Frame3f({axes})"
    if _is_textured(verdict):
        u, v = condition.uv
        tangents = "2 * si.sh_frame.s, 2 * si.sh_frame.t"
        p = ", si.p", f", mi.Point3f({POSITION.tolist()})"
        name, value = p if condition.turned else ("", "")
        uv = f"mi.Point2f({u}, {v})"
        yield f"si.uv{name}, si.dp_du, si.dp_dv = {uv}{value}, {tangents}"
    if condition.differentials:
        yield "si.duv_dx, si.duv_dy = mi.Vector2f(0.3, 0.1), mi.Vector2f(-0.1, 0.2)"
    if mi.is_spectral:
        yield f"si.wavelengths = mi.Spectrum({list(condition.nm)})"
    yield "dr.make_opaque(si)"
    yield "rng = np.random.default_rng(0)"
    yield "u = rng.random((3, n), dtype=np.float32)"
    yield "bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]), True)"


def _is_textured(verdict: Verdict) -> bool:
    """Whether the BSDF may depend on the place: it has textures, or is unknown."""
    types = re.findall(r"""["']type["']: ["'](\w+)["']""", str(verdict.source))
    return len(types) != 1 or types[0] not in UNTEXTURED


def _box(verdict: Verdict, name: str) -> tuple[FourMaps | None, Any]:
    """Map and box of directions in which samples are most off, given enough hits.

    The box is that of a patch, of a ring, of a hemisphere or of the whole sphere: its
    corners in the unit square that Mitsuba maps onto the sphere.
    """
    found: list[tuple[float, FourMaps, Any]] = []
    whole = [one for one in verdict.maps if one.condition.component is None]
    for maps in whole if name == "weights" else whole or verdict.maps:
        n, patches = maps.totals.n, maps.subdivision
        shape = (2, *patches.shape)
        drawn, due = maps.totals.counts, n * maps.pdf
        hits, squares = np.maximum(drawn, due), np.maximum(drawn, due)
        if name == "weights":
            drawn, due, squares = (
                maps.totals.sums,
                n * maps.weights,
                maps.totals.squares,
            )
        cosines = np.cos(patches.theta_edges)
        for axes in ((0, 1, 2), (1, 2), (2,), ()):
            k, q, e, s = (
                x.reshape(shape).sum(axis=axes, keepdims=True)
                for x in (drawn, due, hits, squares)
            )
            variance = np.maximum(s - np.maximum(k, q) ** 2 / n, 0) + (ROUGHLY * q) ** 2
            z = np.where(e >= MIN_HITS, np.abs(k - q) / np.sqrt(variance + 1e-30), 0)
            half, ring, sector = np.unravel_index(z.argmax(), z.shape)
            low, high = [0.0, 0.0], [1.0, 1.0]
            if 2 not in axes:
                low[0], high[0] = patches.phi_edges[[sector, sector + 1]] / (2 * np.pi)
            if 0 not in axes:
                edges = cosines[[ring, ring + 1]] if 1 not in axes else [1.0, 0.0]
                up = maps.condition.side == ("front", "back")[half]
                ends = edges if up else [-x for x in edges]
                low[1], high[1] = sorted((1 - x) / 2 for x in ends)
            # of many patches the worst is far off by chance
            score = float(z.max()) ** 2 - 2 * np.log(z.size)
            found.append((score, maps, (low, high)))
    score, best, corners = max(found, key=lambda one: one[0], default=(0.0, None, None))
    return (best, corners) if score > MIN_SCORE else (None, EVERYWHERE)


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
