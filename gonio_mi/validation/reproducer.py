"""Reproducers: what is wrong with a BSDF, in 20 lines of Mitsuba and NumPy.

One template for each kind of finding, filled with the BSDF, the direction and the patch
where it was found. Each prints two numbers that should be equal, and how far apart they
are: in standard errors, or, where chance takes no part, in roundings. Counts and bit
masks must be equal.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from os import PathLike
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import SettingError
from ..files import replacing
from .conditions import TURN, Condition, Sweep
from .maps import FourMaps
from .samples import BSDF_ROUNDING
from .verdict import Property, Verdict

# Where is looked if a finding names no direction.
ANYWHERE = Condition(50.0, 25.0, uv=(0.35, 0.6))

RNG = "np.random.default_rng(0)"

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

# Answers at the samples, as one number for each.
VALUE = "np.array(bsdf.eval(ctx, si, bs.wo)).mean(0)"
PDF = "np.array(bsdf.pdf(ctx, si, bs.wo))"
WEIGHT = "np.array(weight).mean(0)"
PRODUCT = f"{WEIGHT} * {PDF}"
ONE_EACH = "np.array({}).reshape(-1, n).mean(0)"
GUILTY = ONE_EACH.format("FUNCTION")

# What is counted of samples, and the density of all.
COUNTED = {
    "sampling": ("1.0", "bsdf.pdf(ctx, si, wo)"),
    "weights": (WEIGHT, "bsdf.eval(ctx, si, wo)"),
}

# What stands for longer text in templates. Others are filled in by `_words`.
WORDS = {
    "OFF": "np.abs(a - b) / np.maximum(np.maximum(np.abs(a), np.abs(b)), 1e-30)",
    "SMOOTH": "LIT & ~mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)",
    "LIT": "dr.any(weight != 0)",
    "RANDOM": "mi.Float(u[0]), mi.Point2f(u[1:])",
    "ROUNDING": f"{BSDF_ROUNDING:.2g}",
    "SPHERE": "mi.warp.square_to_uniform_sphere(mi.Point2f(u[1:]))",
}

# Last lines: of arrays `a` and `b`, of numbers, of values `x` of which none should be
# negative or not finite, of counts, of numbers known to an error.
COMPARE = """\
off, a, b = (one + np.zeros(n) for one in (np.where(SMOOTH, OFF, 0), a, b))
k = np.argsort(off)[-n // 1000]  # one sample in a thousand is farther off
print(f"{a[k]:.6g} and {b[k]:.6g}: {off[k] / ROUNDING:.3g} roundings")"""
COMPARE_ALL = COMPARE.replace("SMOOTH", "LIT")
COMPARE_STEEP = COMPARE.replace("SMOOTH", "SMOOTH & (dr.abs(bs.wo.z) > 1e-3)")
EQUAL = """\
off = OFF
print(f"{a:.6g} and {b:.6g}: {off / ROUNDING:.3g} roundings")"""
SAME = 'print(f"{a} and {b}, which must be equal: {a == b}")'
SCORED = 'print(f"{a:.6g} and {b:.6g}: {abs(a - b) / error:.3g} standard errors")'
IMPROPER = """\
wrong = x[~(x >= 0) | ~np.isfinite(x)]
print(f"{wrong[:3]}: {wrong.size} and 0, which must be equal: {wrong.size == 0}")"""

COUNT = f"""\
low, high = np.array(CORNERS)  # of a patch, in the unit square
square = np.array(mi.warp.uniform_sphere_to_square(bs.wo))
inside = np.all((low <= square) & (square < high), axis=0) & np.array(COUNTED)
drawn, due = DRAWN * inside, []
for points in (np.arange(n) * [[1 / n], [0.618034]] + rng.random((16, 2, 1))) % 1:
    wo = mi.warp.square_to_uniform_sphere(mi.Point2f(low + (high - low) * points))
    due += [4 * np.pi * np.prod(high - low) * np.mean(DENSITY, dtype=float)]
a, b = np.mean(drawn), np.mean(due)
error = np.hypot(np.std(drawn) / n**0.5, np.std(due) / 4) + 1e-7
{SCORED}"""

# Of all directions the first moments, and the one that is farthest off.
MOMENTS = f"""\
moments = lambda wo: np.stack([x + np.zeros(n) for x in (1, *np.array(wo))])
drawn, due = np.where(np.array(COUNTED), DRAWN * moments(bs.wo), 0), []
for points in (np.arange(n) * [[1 / n], [0.618034]] + rng.random((16, 2, 1))) % 1:
    wo = mi.warp.square_to_uniform_sphere(mi.Point2f(points))
    due += [4 * np.pi * np.mean(np.atleast_2d(DENSITY).mean(0) * moments(wo), axis=1)]
a, b = np.mean(drawn, axis=1), np.mean(due, axis=0)
error = np.hypot(np.std(drawn, axis=1) / n**0.5, np.std(due, axis=0) / 4) + 1e-7
a, b, error = np.transpose([a, b, error])[np.argmax(np.abs(a - b) / error)]
{SCORED}"""

# All that a function sends anywhere.
WHOLE = f"""\
flux = []
for points in (np.arange(n) * [[1 / n], [0.618034]] + rng.random((16, 2, 1))) % 1:
    wo = mi.warp.square_to_uniform_sphere(mi.Point2f(points))
    flux += [4 * np.pi * np.mean(WHAT, dtype=float)]
a, b, error = np.mean(flux), 1, np.std(flux) / 4 + 1e-7
{SCORED}"""

BACK = """\
back = dr.zeros(mi.SurfaceInteraction3f, n)
back.wi, back.sh_frame, back.uv = bs.wo, si.sh_frame, si.uv
a = np.array(bsdf.eval(ctx, si, bs.wo)).mean(0) / np.abs(bs.wo.z)
"""

# The sum of `eval`, after a change of a parameter.
GRADIENT = f"""\
params = mi.traverse(bsdf)
def total(x):
    params[KEY] = x
    params.update()
    return dr.sum(bsdf.eval(ctx, si, bs.wo), axis=None)
x = type(params[KEY])(params[KEY])
a = np.ravel(total(x + 1e-3) - total(x - 1e-3))[0] / 2e-3
dr.enable_grad(x)
b = np.ravel(dr.forward_to(total(x), flags=dr.ADFlag.AllowNoGrad))[0]
{EQUAL}"""

# Angles of the ends, and all corners of the random numbers.
ENDS = f"""\
ends = np.array([0, 0.5, np.nextafter(np.float32(1), np.float32(0))], np.float32)
u, x = np.array(np.meshgrid(ends, ends, ends)).reshape(3, -1), []
for theta in np.radians([0, 1e-3, 89.99, 90, 90.01, 120, 179.999, 180]):
    wi = np.array([np.sin(theta), 0, np.cos(theta)]).round(9)
    si.wi = dr.zeros(mi.Vector3f, 27) + mi.Vector3f(wi.tolist())
    dr.make_opaque(si)
    bs, weight = bsdf.sample(ctx, si, RANDOM)
    for wo in (bs.wo, si.wi, -si.wi, mi.reflect(si.wi), -mi.reflect(si.wi)):
        x += [np.ravel(dr.select(dr.squared_norm(wo) > 0.5, WHAT, 0))]
x = np.concatenate(x)
{IMPROPER}"""

# Corners of the whole sphere, in the unit square.
EVERYWHERE = ([0.0, 0.0], [1.0, 1.0])

# Which samples go the way of the first in a discrete direction.
LOBE = """\
discrete = np.array(mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta) & (bs.pdf > 0))
first = np.argmax(np.broadcast_to(discrete, n))
wo, pdf = (np.array(one) + np.zeros(n) for one in (bs.wo, bs.pdf))
same = discrete & np.all(np.abs(wo - wo[:, first, None]) < 1e-3, axis=0)
"""

# Lines after the samples, by property and words of the mistake; the first that fits.
FINDINGS = (
    ("sampling", "more than 1", WHOLE.replace("WHAT", "bsdf.pdf(ctx, si, wo)")),
    ("sampled_weight", "", f"a, b = {PRODUCT}, {VALUE}\n{COMPARE}"),
    ("sampled_pdf", "", f"a, b = np.array(bs.pdf), {PDF}\n{COMPARE}"),
    (
        "eval_pdf",
        "",
        f"""\
wo = WHERE
a = {ONE_EACH.format("bsdf.eval_pdf(ctx, si, wo)[INDEX]")}
b = {ONE_EACH.format("ALONE")}
{COMPARE.replace("SMOOTH", "a + b > 0")}""",
    ),
    (
        "eval_pdf_sample",
        "other samples",
        f"""\
other = bsdf.eval_pdf_sample(ctx, si, bs.wo, RANDOM)[3]
a, b = {ONE_EACH.format("other")}, {WEIGHT}
{COMPARE_ALL}""",
    ),
    (
        "eval_pdf_sample",
        "",
        f"""\
wo = bs.wo
a = {ONE_EACH.format("bsdf.eval_pdf_sample(ctx, si, wo, RANDOM)[INDEX]")}
b = {ONE_EACH.format("ALONE")}
{COMPARE}""",
    ),
    (
        "reciprocity",
        "symmetric in wi and wo$",
        f"""\
back = dr.zeros(mi.SurfaceInteraction3f, n)
back.wi, back.sh_frame = bs.wo, mi.Frame3f(bs.wo)
a, b = {VALUE}, np.array(bsdf.eval(ctx, back, si.wi)).mean(0)
{COMPARE}""",
    ),
    ("energy", "", WHOLE.replace("WHAT", "np.array(bsdf.eval(ctx, si, wo)).max(0)")),
    (
        "reciprocity",
        "discrete",
        f"""\
{LOBE}back = dr.zeros(mi.SurfaceInteraction3f, n)
back.wi, back.sh_frame = mi.Vector3f(wo[:, first].tolist()), si.sh_frame
there, returned = bsdf.sample(ctx, back, RANDOM)
home = np.all(np.abs(np.array(there.wo) - np.array(si.wi)) < 1e-3, axis=0)
x, y = {WEIGHT} * same, np.array(returned).mean(0) * home
a, b, error = np.mean(x), np.mean(y), np.std(x - y) / n**0.5 + 1e-7
{SCORED}""",
    ),
    (
        "reciprocity",
        "",
        f"""\
{BACK}eta = np.where(bs.wo.z * si.wi.z < 0, bs.eta, 1)
b = np.array(bsdf.eval(ctx, back, si.wi)).mean(0) / np.abs(si.wi.z) * eta**2
{COMPARE_STEEP}""",
    ),
    (
        "adjoint",
        "`sample`",
        f"""\
radiance = mi.BSDFContext(mi.TransportMode.Radiance)
eta = np.where(bs.wo.z * si.wi.z < 0, bs.eta, 1)
a, b = {WEIGHT}, np.array(bsdf.sample(radiance, si, RANDOM)[1]).mean(0) * eta**2
{COMPARE_ALL}""",
    ),
    (
        "adjoint",
        "",
        f"""\
{BACK}ctx = mi.BSDFContext(mi.TransportMode.Radiance)
b = np.array(bsdf.eval(ctx, back, si.wi)).mean(0) / np.abs(si.wi.z)
{COMPARE_STEEP}""",
    ),
    (
        "masks",
        "",
        f"""\
awake = mi.Bool(np.arange(n) % 2 == 0)
a, b = np.max(np.abs(np.array(MASKED)) * np.array(~awake)), 0
{SAME}""",
    ),
    ("ends", "length", ENDS.replace("WHAT", "1e-3 - dr.abs(dr.norm(bs.wo) - 1)")),
    ("ends", "", ENDS.replace("WHAT", "END")),
    ("parameters", "gradients", GRADIENT),
    (
        "parameters",
        "follow",
        f"""\
params = mi.traverse(bsdf)
params[KEY] *= 0.5
params.update()
bs, weight = bsdf.sample(ctx, si, RANDOM)
a, b = SIDES
{COMPARE}""",
    ),
    (
        "components",
        "discrete lobe of",
        f"""\
own = (np.array(bs.sampled_component) == NUMBER) & np.array(LIT)
ctx.component = NUMBER
alone, weight_alone = bsdf.sample(ctx, si, RANDOM)
a = np.median(({WEIGHT} * np.array(bs.pdf))[own])
b = np.median(np.array(weight_alone).mean(0) * np.array(alone.pdf))
{EQUAL}""",
    ),
    (
        "components",
        "",
        f"""\
a, b = {GUILTY}, 0
for i in range(bsdf.component_count()):
    ctx.component = i
    b = b + {GUILTY}
{COMPARE}""",
    ),
    (
        "answers",
        "in places",
        f"""\
x = np.concatenate([np.ravel(ANSWER) for wo in (bs.wo, SPHERE)])
{IMPROPER}""",
    ),
    (
        "answers",
        "called again",
        f"""\
a = {GUILTY}
dr.eval(bsdf.sample(ctx, si, mi.Float(u[1]), mi.Point2f(u[:2])))
dr.eval(bsdf.eval(ctx, si, SPHERE))
b = {GUILTY}
{COMPARE}""",
    ),
    (
        "answers",
        "place of a ray",
        f"""\
a = {GUILTY}
bs.wo = dr.gather(mi.Vector3f, bs.wo, n - 1 - dr.arange(mi.UInt32, n))
b = {GUILTY}[::-1]
{COMPARE}""",
    ),
    (
        "answers",
        "local|world",
        f"""\
a = {ONE_EACH.format("TURNED")}
si.sh_frame = mi.Frame3f([0, 0, 1])
b = {ONE_EACH.format("TURNED")}
{COMPARE}""",
    ),
    (
        "directions",
        "length",
        f"""\
a, b = np.linalg.norm(np.array(bs.wo), axis=0), np.ones(n)
{COMPARE_ALL}""",
    ),
    (
        "directions",
        " eta ",
        f"""\
a, b = np.array(bs.eta) + np.zeros(n), np.ones(n)
{COMPARE.replace("SMOOTH", "LIT & (bs.wo.z * si.wi.z > 0)")}""",
    ),
    (
        "directions",
        "",
        f"""\
through = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Transmission) & LIT
a, b = np.sum(through), np.sum((bs.wo.z * si.wi.z < 0) & LIT)
{SAME}""",
    ),
    (
        "continuity",
        "normal incidence",
        f"""\
si.wi = mi.Vector3f(0, 0, 1) + dr.zeros(mi.Vector3f, n)
a = {GUILTY}
si.wi = dr.normalize(mi.Vector3f(1.5e-5, 0, 1)) + dr.zeros(mi.Vector3f, n)
b = {GUILTY}
{COMPARE}""",
    ),
    (
        "continuity",
        "",
        f"""\
shares = []
for cosine in (0.5, 1e-3):
    ring = mi.Vector3f((1 - cosine**2) ** 0.5, 0, cosine)
    si.wi = ring * dr.sign(si.wi.z) + dr.zeros(mi.Vector3f, n)
    shares += [np.mean(np.array(bsdf.eval(ctx, si, SPHERE)) > 0)]
a, b = shares
{EQUAL}""",
    ),
    (
        "delta",
        "direction",
        f"""\
{LOBE}a, b = wo[0], np.array(mi.reflect(si.wi))[0] + np.zeros(n)
{COMPARE.replace("SMOOTH", "same")}""",
    ),
    (
        "delta",
        "different weights",
        f"""\
{LOBE}a, b = np.min({WEIGHT}[same]), np.max({WEIGHT}[same])
{EQUAL}""",
    ),
    (
        "delta",
        "",
        f"""\
{LOBE}a, b, error = np.mean(same), pdf[first], np.std(same) / n**0.5 + 1e-7
{SCORED}""",
    ),
    (
        "flags",
        "is scattered though",
        f"a, b = np.mean(np.array({VALUE} > 0)), 0\n{SAME}",
    ),
    (
        "flags",
        "type_mask",
        f"""\
a, b = 0, 0  # answers that a mask excludes
for i in range(bsdf.component_count()):
    ctx.type_mask = int(mi.BSDFFlags.All) & ~int(bsdf.flags(i))
    bs, weight = bsdf.sample(ctx, si, RANDOM)
    a += np.sum(np.array(MASKED_TYPES & dr.any(FUNCTION != 0)))
{SAME}""",
    ),
    (
        "flags",
        "Anisotropic",
        f"""\
a = {GUILTY}
turn = mi.Matrix3f([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
si.wi, bs.wo = turn @ si.wi, turn @ bs.wo
b = {GUILTY}
{COMPARE}""",
    ),
    (
        "flags",
        "",
        f"""\
a = int(np.bitwise_or.reduce(np.array(bs.sampled_type) * np.array(LIT)))
b = a & int(bsdf.flags())  # what is sampled, and of that is declared
last = int(np.max(np.array(bs.sampled_component) * np.array(LIT)))
if a == b and last >= bsdf.component_count():
    a, b = last + 1, bsdf.component_count()
{SAME}""",
    ),
    ("", "", "answer = FUNCTION\nprint(type(answer), answer, mi.traverse(bsdf))"),
)


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


def save_reproducer(
    verdict: Verdict, path: str | PathLike[str], name: str | None = None
) -> None:
    """Write :func:`reproducer`, which raises as it does, to a file.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    text = reproducer(verdict, name)
    with replacing(path) as stream:
        stream.write(text.encode())


def script(verdict: Verdict, one: Property) -> str:
    """The script that shows a property that fails."""
    mistake = str(one.mistake or verdict.mistake or "")
    condition, body = one.condition or _told(one.statistic), ""
    if one.name in COUNTED:
        maps, corners = _box(verdict, one.name)
        condition = maps.condition if maps else condition
        body = _counting(maps, corners, one.name)
    if one.name == "sampling" and maps is None and "more than 1" in mistake:
        condition, body = _told(one.places[0] if one.places else one.statistic), ""
    if isinstance(condition, Sweep):
        condition = ANYWHERE
    body = body or next(
        template
        for name, words, template in FINDINGS
        if name in ("", one.name) and re.search(words, mistake)
    )
    for word, text in (_words(verdict, one, mistake) | WORDS).items():
        body = text.join(re.split(rf"\b{word}\b", body))
    n = "2**20" if "standard errors" in body else "2**16"
    n = "27" if one.name == "ends" else n
    lines = list(_head(verdict, one, condition, n))
    if one.name == "ends":
        lines = lines[:-3]  # it has its own samples
    text = "\n".join([*lines, body]) + "\n"
    if "rng." not in body:
        text = text.replace("rng = np.random.default_rng(0)\nu = rng", f"u = {RNG}")
    if mi.is_polarized:
        text = _of_first_elements(text)
    return _in_a_medium(text) if one.of_volumes else text


def _counting(maps: FourMaps | None, corners: Any, name: str) -> str:
    """Comparison of samples and integrals in one box of directions."""
    drawn, density = COUNTED[name]
    counted = "LIT" if maps and not maps.totals.delta_mean.any() else "SMOOTH"
    if name == "sampling" and maps and maps.due.unused.values.sum() > UNUSED:
        lit = "dr.any(bsdf.eval(ctx, si, {}) > 0)"
        counted = lit.format("bs.wo")
        density = f"dr.select({lit.format('wo')}, {density}, 0)"
    whole = corners == EVERYWHERE
    rounded = [[[float(f"{x:.9g}")] for x in corner] for corner in corners]
    words = {"CORNERS": str(rounded), "COUNTED": counted, "DRAWN": drawn}
    body = (MOMENTS if whole else COUNT).replace("DENSITY", density)
    for word, text in words.items():
        body = body.replace(word, text)
    return body


def _words(verdict: Verdict, one: Property, mistake: str) -> dict[str, str]:
    """What words of a template stand for in one finding."""
    guilty = str(one.function or verdict.function or "eval").split(" or ")[0]
    calls = {"sample": "weight", "pdf": "bsdf.pdf(ctx, si, wo)"}
    calls["eval_pdf"] = "bsdf.eval_pdf(ctx, si, wo)[0]"
    call = calls.get(guilty, "bsdf.eval(ctx, si, wo)")
    function, samples = call.replace(", wo)", ", bs.wo)"), guilty == "sample"
    drawn = "bsdf.sample(ctx, si, RANDOM{})"
    density = one.statistic.startswith("pdf") or mistake.startswith("the pdf of")
    sampled = "bs.pdf" if density else "weight[0]"
    index = int("than `pdf`" in mistake)
    key = re.search(r"(?:by|a change of) (\S+?)(?: are|$)", mistake)
    number = re.search(r"of component (\d+)", mistake)
    sides = {"sample": ("np.array(bs.pdf)", PDF), "pdf": (PDF, "np.array(bs.pdf)")}
    return {
        "ANSWER": sampled if samples else call,
        "END": sampled if samples else call + "[0]" * (".eval(" in call),
        "TURNED": f"{drawn.format('')}[0].wo" if samples else function,
        "MASKED_TYPES": "((bs.sampled_type & int(bsdf.flags(i)) & 0x7E) != 0)"
        if samples
        else "(bsdf.component_count() == 1)",
        "MASKED": f"{drawn.format(', awake')}[1]"
        if samples
        else function.replace("bs.wo)", "bs.wo, awake)"),
        "FUNCTION": function,
        "WHERE": "SPHERE" if "all directions" in one.statistic else "bs.wo",
        "ALONE": f"bsdf.{('eval', 'pdf')[index]}(ctx, si, wo)",
        "INDEX": str(index),
        "KEY": repr(key[1]) if key else "None",
        "NUMBER": number[1] if number else "0",
        "SIDES": ", ".join(sides.get(guilty, (PRODUCT, VALUE))),
    }


def _of_first_elements(text: str) -> str:
    """The same script where values are Mueller matrices: of their first elements."""
    first = "mi.unpolarized_spectrum"
    text = re.sub(r"(bsdf\.eval\([^()]*(?:\([^()]*\)[^()]*)*\))", rf"{first}(\1)", text)
    return re.sub(
        r"^( *)(.*), weight = (bsdf\.sample.*)$",
        rf"\1\2, weight = \3\n\1weight = {first}(weight)",
        text,
        flags=re.MULTILINE,
    )


def _in_a_medium(text: str) -> str:
    """The same script, which asks a phase function instead of a BSDF."""
    for found, instead in (
        (r" & ~mi.has_flag\(bs.sampled_type, mi.BSDFFlags.Delta\)", ""),
        (r"mi.BSDFContext\((.*?)\)", r"mi.PhaseFunctionContext(None, \1)"),
        (r"SurfaceInteraction3f", "MediumInteraction3f"),
        (r"si.wi, si.sh_frame = (.*), mi.Frame3f.*", r"si.wi = \1"),
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


def _told(statistic: str) -> Condition:
    """Condition that the text of a statistic names; an ordinary one if none."""
    found = re.search(r"theta_i ([\d.]+), phi_i ([\d.]+)", statistic)
    theta_i, phi_i = map(float, found.groups()) if found else (50.0, 25.0)
    side = (
        "back" if re.search(r", back|from the back|from behind", statistic) else "front"
    )
    component = re.search(r", component (\d+)", statistic)
    mode = "radiance" if ", radiance mode" in statistic else "importance"
    only = int(component[1]) if component else None
    return replace(
        ANYWHERE, theta_i=theta_i, phi_i=phi_i, side=side, mode=mode, component=only
    )


def _head(
    verdict: Verdict, one: Property, condition: Condition, n: str
) -> Iterator[str]:
    """Lines up to the samples."""
    title = f"{verdict.name}: {one.mistake or verdict.mistake or one.question}"
    yield f"# {title} ({condition})"
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
        yield f"si.uv, si.dp_du, si.dp_dv = mi.Point2f({u}, {v}), {tangents}"
    if mi.is_spectral:
        yield "si.wavelengths = mi.Spectrum([450.0, 520.0, 580.0, 650.0])"
    yield "dr.make_opaque(si)"
    yield "rng = np.random.default_rng(0)"
    yield "u = rng.random((3, n), dtype=np.float32)"
    yield "bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]))"


def _is_textured(verdict: Verdict) -> bool:
    """Whether the BSDF may depend on the place: it has textures, or is not known."""
    types = re.findall(r"""["']type["']: ["'](\w+)["']""", str(verdict.source))
    return len(types) != 1 or types[0] not in UNTEXTURED


def _box(verdict: Verdict, name: str) -> tuple[FourMaps | None, Any]:
    """Map and box of directions in which samples are most off, of enough hits.

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
    """Statement that loads ``bsdf`` of a dictionary or of a file; None of another.

    Or ``phase``, of `volumes`.
    """
    if isinstance(specimen, (str, os.PathLike)):
        given = [repr(str(specimen))]
        given += [f"{key}={str(x)!r}" for key, x in (parameters or {}).items()]
        return f"bsdf = mi.load_file({', '.join(given)}).shapes()[0].bsdf()"
    text = _text(specimen) if isinstance(specimen, dict) else None
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
