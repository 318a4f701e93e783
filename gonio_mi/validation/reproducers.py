"""Reproducers: what is wrong with a BSDF, in 20 lines of Mitsuba and NumPy.

The lines of a kind of finding, filled with the BSDF, the direction and the patch where
it was found. Each prints two numbers that should be equal, and how far apart they
are: in standard errors, or, where chance takes no part, in roundings. Counts and bit
masks must be equal.
"""

import os
import re
import textwrap
from collections.abc import Mapping
from enum import Enum
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
from .conditions import POSITION, TURN, WAVELENGTHS_NM, Condition, Sweep
from .maps import FourMaps
from .mistakes import SCRIPTS, Kind, MatrixKind
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

# What a mean over samples counts, and the density that it should follow: of directions,
# of those where `eval` is not zero, and of weights.
OF_SAMPLES = {"DRAWN": "np.array(smooth())", "DENSITY": "pdf(wo)"}
OF_LIT_SAMPLES = {
    "DRAWN": "(value(bs.wo) > 0).any(axis=0)",
    "DENSITY": "pdf(wo) * (value(wo) > 0).any(axis=0)",
}
OF_WEIGHTS = {
    "DRAWN": "np.where(smooth(), np.atleast_2d(weight).mean(axis=0), 0)",
    "DENSITY": "value(wo).mean(axis=0)",
}

# What phase functions have instead.
IN_A_MEDIUM = {
    "bsdf": "phase",
    "si": "mei",
    "SPECTRUM": "phase.eval_pdf(ctx, mei, bs.wo, True)[0]",
}

# Answers of functions, of `eval` if no other, and of `sample` by what a finding is
# about.
ANSWERS = {
    "eval": "bsdf.eval(ctx, si, wo, True)",
    "pdf": "bsdf.pdf(ctx, si, wo, True)",
    "eval_pdf": "bsdf.eval_pdf(ctx, si, wo, True)[0]",
    "sample": "bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]), True)[1]",
}
SAMPLED = {"weight": "weight", "pdf": "bs.pdf", "direction": "dr.abs(bs.wo)"}

# Random numbers of a scalar variant, of one sample after the other.
EACH = "zip(*(z.T.tolist() for z in x))"

# What functions follow a change of a parameter, if not all.
STALE = {"sample": ("bs.pdf", "pdf(bs.wo)"), "pdf": ("pdf(bs.wo)", "bs.pdf")}
PRODUCT = ("np.atleast_2d(weight) * pdf(bs.wo)", "value(bs.wo)")


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


def script(verdict: Verdict, one: Property) -> str:
    """The script that shows a property that fails."""
    kind = one.kind or Kind[one.name.upper()]
    condition, part = _condition(one), kind.name
    words = _words(verdict, one, kind)
    if part in ("SAMPLING", "WEIGHTS"):
        maps, corners = _box(verdict, one.name) if not condition.fields else NO_BOX
        condition = maps.condition if maps else condition
        part = "moments_apart" if corners == EVERYWHERE else part
        rounded = [[[float(f"{x:.9g}")] for x in corner] for corner in corners]
        words["CORNERS"] = str(rounded)
        if kind is Kind.SAMPLING and maps and maps.due.unused.values.sum() > UNUSED:
            words |= OF_LIT_SAMPLES
    matrices = isinstance(kind, MatrixKind)
    given = parts("matrix" if matrices else script_kind(one.of_volumes))
    words = _place(verdict, one, condition) | words
    words["COUNT"] = "2**20" if "standard errors" in given[part] else "2**16"
    head = _setting(verdict, condition, given)
    if part in ("ENDS", "LENGTH_AT_AN_END"):  # which draw their own samples
        words["COUNT"] = "27"
    else:
        head += given["random"] + given["sample"]
    if kind is MatrixKind.FIRST_ELEMENT:
        both = mi.variant(), unpolarised(mi.variant())
        head = _filled(head + given["first element"], words | {"VARIANT": "variant"})
        head = f"values = []\nfor variant in {both}:\n{textwrap.indent(head, '    ')}"
    return composed(given, given["title"] + given["imports"] + head, part, words)


def by_lattices(verdict: Verdict, one: Property) -> str:
    """The same of the total of samples or weights, by lattices of directions."""
    given, condition = parts(script_kind(one.of_volumes)), _condition(one)
    words = _place(verdict, one, condition) | {"COUNT": "2**16"}
    words |= _words(verdict, one, Kind[one.name.upper()])
    head = given["title"] + given["imports"] + _setting(verdict, condition, given)
    return composed(given, head, "lattices", words)


def in_two_variants(variant: str, source: str, of_volumes: bool) -> str:
    """Script that compares a scalar variant with LLVM's."""
    given = dict(parts(script_kind(of_volumes)))
    if mi.is_spectral:
        colours = textwrap.indent(given["wavelengths"], "    ")
        given["variants"] = re.sub(r"(?=    value =)", colours, given["variants"])
    llvm = variant.replace("scalar", "llvm_ad")
    words = {
        "VARIANTS": f"({llvm!r}, [x], 0), ({variant!r}, {EACH}, None)",
        "AXES": "mei.wi" if of_volumes else "[0, 0, 1]",
        "SOURCE": source,
        "NM": str(list(WAVELENGTHS_NM)),
        "ROUNDING": f"{BSDF_ROUNDING:.2g}",
    }
    words |= IN_A_MEDIUM if of_volumes else {}
    return given["imports"] + _filled(given["variants"], words)


def script_kind(of_volumes: bool) -> str:
    """Which parts of scripts there are: ``medium``, ``polarised`` or ``surface``."""
    return "medium" if of_volumes else "polarised" if mi.is_polarized else "surface"


@cache
def parts(own: str) -> dict[str, str]:
    """Lines of the parts of scripts by name, each followed by those that it asks for.

    Parts whose name begins with `own` stand for those without, also inside of others.
    """
    lines, followed = {}, {}
    for path in sorted(SCRIPTS.glob("*.py")):
        text = path.read_text(encoding="utf-8")
        _, *found = re.split(r"^# %% (.*)\n", text, flags=re.MULTILINE)
        for heading, body in zip(found[::2], found[1::2]):
            name, _, others = heading.partition(":")
            lines[name], followed[name] = body.strip("\n") + "\n", others.split()
    for name in [one for one in lines if one.startswith(f"{own} ")]:
        usual = name.removeprefix(f"{own} ")
        if usual in lines:
            rows = map(re.escape, lines[usual].splitlines(keepends=True))
            margin = re.compile(r"^( *)" + r"\1".join(rows), re.MULTILINE)
            instead = textwrap.indent(lines[name], r"\1")
            for other in [one for one in lines if not one.startswith(f"{own} ")]:
                lines[other] = margin.sub(instead, lines[other])
        lines[usual], followed[usual] = lines[name], followed[name]
    return {
        name: body + "".join(lines[other] for other in followed[name])
        for name, body in lines.items()
    }


def composed(
    given: Mapping[str, str], head: str, part: str, words: Mapping[str, str]
) -> str:
    """Script of a head, the definitions that a part uses, and this, with all words."""
    body = _filled(given[part], words)
    for name, lines in reversed(list(given.items())):
        defined, _, function = name.removeprefix("define ").partition(" of ")
        if not name.startswith("define ") or function not in ("", words["GUILTY"]):
            continue
        if re.search(rf"(?m)^[^#]*(?<![.\w]){defined}\b(?! =)", body):
            body = _filled(lines, words) + body
    return _filled(head, words) + body


def _filled(lines: str, words: Mapping[str, str]) -> str:
    """Lines with words in capitals, and some names, replaced."""
    return re.sub(
        r"(\b\w+ = (?=SOURCE))?\b([A-Z][A-Z_]+|bsdf|si)\b",
        lambda found: words.get(found[2], found[0]),
        lines,
    )


def _words(verdict: Verdict, one: Property, kind: Enum) -> dict[str, str]:
    """Text that replaces words in capitals, for what a finding is about."""
    guess = one.guess or verdict.guess
    guilty = guess.functions.names[0] if guess else one.function or "eval"
    guilty = one.about if kind is Kind.UPDATE else guilty
    guilty = guilty if guilty in ANSWERS else "eval"
    about, samples, answer = one.about, guilty == "sample", ANSWERS[guilty]
    quantity = SAMPLED.get(about, "weight") if samples else "answer(wo)"
    if kind is Kind.LENGTH_AT_AN_END:
        quantity = "1e-3 - dr.select(lit(), abs(dr.norm(bs.wo) - 1), 0)"
    stale, expected = STALE.get(guilty, PRODUCT)
    excluded = "(bs.sampled_type & int(bsdf.flags(i)) & 0x7E) != 0"
    own = f'params["{about}"]'
    to = guess.fields.get("to") if guess else None
    changed = f"dr.select({own} == 0, 0.5, {own} / 2)"
    words = {
        "OTHER": f"type({own})({to})" if to else changed,
        "GUILTY": guilty,
        "ABOUT": about,
        "NORMAL": about or "[0, 0, 1]",
        "STALE": stale,
        "EXPECTED": expected,
        "INDEX": str(int(about == "pdf")),
        "EITHER": "pdf" if about == "pdf" else "value",
        "TURNED": answer.replace("[1]", "[0].wo") if samples else "answer(bs.wo)",
        "EXCLUDED": excluded if samples else "bsdf.component_count() == 1",
        "FLUX": "weight * bs.pdf" if samples else answer.replace("wo,", "bs.wo,"),
        "QUANTITY": quantity,
        "SPECTRUM": answer.replace("wo,", "bs.wo,"),
        "ANSWER": answer,
    }
    words |= OF_WEIGHTS if one.name == "weights" else OF_SAMPLES
    if one.of_volumes:
        words = {name: _filled(text, IN_A_MEDIUM) for name, text in words.items()}
        words |= IN_A_MEDIUM
    return words


def _place(verdict: Verdict, one: Property, condition: Condition) -> dict[str, str]:
    """Text that replaces words in capitals, for where a finding is."""
    textured = _is_textured(verdict)
    axes = TURN.T.round(7).tolist() if condition.turned and textured else [[0, 0, 1]]
    return {
        "TITLE": f"{verdict.name}: {one.mistake or verdict.mistake or one.question}",
        "CONDITION": str(condition),
        "QUESTION": one.question or "it is right",
        "ROUNDING": f"{BSDF_ROUNDING:.2g}",
        "VARIANT": f'"{verdict.settings["variant"]}"',
        "SOURCE": str(verdict.source),
        "MODE": condition.mode.capitalize(),
        "COMPONENT": str(condition.component),
        "WI": str([float(f"{x:.8g}") for x in condition.wi]),
        "AXES": ", ".join(map(str, axes)),
        "UV": "{}, {}".format(*condition.uv),
        "POSITION": str(POSITION.tolist() if condition.turned else [0, 0, 0]),
        "NM": str(list(condition.nm)),
    }


def _condition(one: Property) -> Condition:
    """Where a finding is, or anywhere if it is everywhere."""
    found = one.condition
    return ANYWHERE if found is None or isinstance(found, Sweep) else found


def _setting(verdict: Verdict, condition: Condition, given: Mapping[str, str]) -> str:
    """Lines of a script from the variant to the surface interaction."""
    textured = _is_textured(verdict) or "uv" in condition.fields
    textured &= "phase" not in given["interaction"]
    used = {
        "component": condition.component is not None,
        "texture": textured,
        "position": textured and condition.turned,
        "differentials": condition.differentials,
        "wavelengths": mi.is_spectral,
    }
    names = ["variant", "interaction", *(k for k, on in used.items() if on)]
    return "".join(map(given.__getitem__, names)) + _fields(condition, given)


def _fields(condition: Condition, given: Mapping[str, str]) -> str:
    """Lines of a script that set fields of the surface interaction."""
    si, lines = Probe(None, condition).interaction(), ""
    names = [x for name in condition.fields for x in BESIDE.get(name, (name,))]
    if "phase" in given["interaction"]:
        names = [name for name in names if name in OF_A_MEDIUM]
    for name in dict.fromkeys(names):
        value = getattr(si, name)
        parts = (value.s, value.t, value.n) if name == "sh_frame" else (value,)
        text = ", ".join(str(np.array(x).ravel().round(6).tolist()) for x in parts)
        lines += _filled(given["field"], {"FIELD": name, "NUMBERS": text})
    return lines


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
