"""All elements of matrices: functions agree, in both directions and transport modes."""

from collections.abc import Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats
from ...collector.stokes import EXCHANGE, UPRIGHT
from ..arrays import answer_of, drawn, in_plane, lit_from, per_first
from ..evidence import Evidence, Question
from ..judgements import by_sample, elements, same
from ..mistakes import EVAL, PDF, SAMPLE, Claim, Function, Guess, Mistake
from ..mueller import (
    Lobes,
    Matrices,
    is_depolarised,
    off,
    other_mode,
    per_light,
    readings,
)
from ..samples import beyond_rounding
from .adjoint import ADJOINT
from .answers import ANSWERS
from .eval_pdf import EVAL_PDF, PARTS, joint
from .reciprocity import RECIPROCITY
from .sampled_pdf import SAMPLED_PDF
from .sampled_weight import SAMPLED_WEIGHT


def proper(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> tuple[int, int]:
    """Matrices are finite, and their first element is not negative."""
    bs, _ = drawn(bsdf, ctx, si, u)
    m = np.array(what(bsdf, ctx, si, bs.wo, u))
    return int(np.sum(~np.isfinite(m)) + np.sum(m[0, 0] < 0)), 0


def sampled_matrix(bsdf: Any, ctx: Any, si: Any, u: Any) -> tuple[Any, Any]:
    """Weight times pdf is `eval`, in all elements."""
    bs, weight = drawn(bsdf, ctx, si, u)
    flux = np.array(weight) * np.array(bs.pdf)
    return flux, np.array(bsdf.eval(ctx, si, bs.wo, True))


def joint_matrix(bsdf: Any, ctx: Any, si: Any, u: Any) -> tuple[Any, Any]:
    """`eval_pdf` answers as `eval`, in all elements."""
    bs, _ = drawn(bsdf, ctx, si, u)
    both = bsdf.eval_pdf(ctx, si, bs.wo, True)[0]
    return np.array(both), np.array(bsdf.eval(ctx, si, bs.wo, True))


def both_ways(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> tuple[Any, Any]:
    """Helmholtz reciprocity, in all elements."""
    bs, _ = drawn(bsdf, ctx, si, u)
    there, back = (
        in_plane(what, bsdf, ctx, si, wi, wo, u, [0, 0, 1])
        for wi, wo in ((si.wi, bs.wo), (bs.wo, mi.Vector3f(si.wi)))
    )
    signs = [1, 1, -1, 1]
    return there, np.einsum("jick,i,j->ijck", back, signs, signs)


def both_modes(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> tuple[Any, Any]:
    """Radiance mode answers as importance mode on the way back, in all elements."""
    bs, _ = drawn(bsdf, ctx, si, u)
    here, found, modes = mi.Vector3f(si.wi), [], mi.TransportMode
    for mode, wi, wo in (
        (modes.Radiance, here, bs.wo),
        (modes.Importance, bs.wo, here),
    ):
        own, there = mi.BSDFContext(mode), lit_from(si, wi)
        found.append(per_first(np.array(what(bsdf, own, there, wo, u))))
    return found[0], found[1]


class Matrix(Mistake):
    """Mistakes in matrices, in one `mode` or in both."""

    NOT_FINITE = "{who} returns matrices with elements that are not finite"
    NEGATIVE = "{who} returns matrices with a negative first element"
    DENSITIES = "{who}: their densities differ{mode}"
    FIRST_ELEMENT = """{who}: weight times pdf is another first element than that of
        `eval`; the unpolarised variant tells more{mode}"""
    DEPOLARISES = "{who} depolarises where {other} does not{mode}"
    ELEMENTS = """{who}: weight times pdf differs from `eval` in {n} elements ({names})
        but the first{mode}"""
    OTHER_VALUES = "{who} gives other {what} than `eval` and `pdf`{mode}"
    NOT_RECIPROCAL = """{who} is not reciprocal in its polarisation: M(wi, wo) is not Q
        M(wo, wi)^T Q"""
    OTHER_WAY = """{who} does not answer for light that goes from wo to wi in radiance
        mode (ctx.mode)"""
    DEPOLARISES_IN_RADIANCE = """{who} depolarises, other than in importance mode, in
        radiance mode (ctx.mode)"""
    POLARISES_IN_RADIANCE = """{who} polarises, other than in importance mode, in
        radiance mode (ctx.mode)"""


# Properties that are judged here, of each transport mode.
AGREEMENTS = ("sampled_pdf", "sampled_weight", "eval_pdf")

# Relative difference of densities, and of elements over the first one beside their
# slack, that is no rounding.
ROUNDING = 2e-3

# Fraction of the difference that a reading leaves which explains it.
EXPLAINED = 0.05


def check_finite(evidence: Evidence, matrices: Matrices, at: str = "") -> None:
    """Check that all elements are finite and that the first is not negative.

    `at` is text on directions that are none of all, whose share is not known.
    """
    bad = ~np.isfinite(matrices.raw).all(axis=(-1, -2, -3))
    negative = (np.nan_to_num(matrices.light) < 0).any(axis=-1)
    for wrong, mistake, what in (
        (bad, Matrix.NOT_FINITE, "elements that are not finite"),
        (negative, Matrix.NEGATIVE, "a negative first element"),
    ):
        if (wrong := np.asarray(wrong)).any():
            how: dict[str, Any] = {"off": None} if at else {}
            guess = mistake(matrices.function)
            how["shown"] = Claim(proper, same, (answer_of(matrices.function),))
            evidence.breach(ANSWERS, guess, matrices, wrong, found=what + at, **how)


def check_sampled(
    evidence: Evidence, lobes: Lobes, values: Matrices, pdf: Floats, slack: Floats
) -> None:
    """Check that weight times pdf is `eval`, and that the pdf is that of `pdf`."""
    usable = lobes.smooth & values.finite & np.isfinite(pdf)
    if not usable.any():
        return
    density = lobes.pdf
    wrong = usable & (np.abs(density - pdf) > ROUNDING * np.maximum(density, pdf))
    if beyond_rounding(wrong):
        ratio = density[wrong] / np.maximum(pdf[wrong], 1e-30)
        low, high = np.quantile(ratio, [0.05, 0.95])
        text = f"the pdf of `sample` is {low:.4g} to {high:.4g} times that of `pdf`"
        guess = Matrix.DENSITIES(SAMPLE | PDF, mode=values.in_mode)
        evidence.breach(SAMPLED_PDF, guess, lobes.weights, wrong, found=text, off=None)
    flux = lobes.flux
    light = np.maximum(values.light, flux.light)[..., None, None]
    difference = np.where(light > 0, flux.raw - values.raw, 0)
    difference = np.abs(difference / np.where(light > 0, light, 1))
    size = difference.max(axis=(-1, -2, -3))
    wrong = usable & (size > ROUNDING + slack)
    if not beyond_rounding(wrong):
        return
    suspects: tuple[Function, ...] = (SAMPLE, EVAL)
    if values.asked.mode == "radiance":
        # importance mode tells which answers of `eval` are due
        suspects = (EVAL,) if evidence.of("adjoint") else (SAMPLE,)
    worst = tuple(np.argwhere(wrong)[np.argmax(size[wrong])])
    place = np.unravel_index(np.argmax(difference[worst].max(axis=0)), (4, 4))
    guess = _difference_guess(flux.take(wrong), values.take(wrong), suspects)
    text = f"weight times pdf is off `eval` by up to {size[worst]:.3g} of the first "
    text += f"element, in element {place[0]}{place[1]},"
    how = {"found": text, "shown": Claim(sampled_matrix, elements)}
    evidence.breach(SAMPLED_WEIGHT, guess, flux.by(size), wrong, **how)


def _difference_guess(
    flux: Matrices, values: Matrices, suspects: Sequence[Function]
) -> Guess:
    """Guilty function and mistake, where weight times pdf is not `eval`."""
    in_mode = {"mode": values.in_mode}
    m_flux, m_eval = per_light(flux.raw), per_light(values.raw)
    light = np.maximum(flux.light, values.light)
    if (np.abs(flux.light - values.light) > ROUNDING * light).mean() > 0.5:
        return Matrix.FIRST_ELEMENT(EVAL | SAMPLE, **in_mode)
    if is_depolarised(m_eval) and not is_depolarised(m_flux):
        return Matrix.DEPOLARISES(EVAL, other="`sample`", **in_mode)
    if is_depolarised(m_flux) and not is_depolarised(m_eval):
        return Matrix.DEPOLARISES(SAMPLE, other="`eval`", **in_mode)
    misfit = off(m_flux, m_eval)
    for function in suspects:
        matrices, right = (flux, values) if function is SAMPLE else (values, flux)
        due = per_light(right.in_plane())
        for mistake, read in (*readings(matrices, UPRIGHT), *other_mode(matrices)):
            left = off(per_light(read), due)
            if np.mean(left) < EXPLAINED * np.mean(misfit):
                return mistake(function, **in_mode)
    names = [
        f"{i}{j}"
        for i, j in np.ndindex(4, 4)
        if np.abs(m_flux - m_eval)[..., i, j].max() > ROUNDING
    ]
    those = ", ".join([*names[:6], *(["..."] if len(names) > 6 else [])])
    both = suspects[0] | suspects[-1]
    return Matrix.ELEMENTS(both, n=len(names), names=those, **in_mode)


def check_eval_pdf(
    evidence: Evidence,
    values: Matrices,
    pdf: Floats,
    both: Matrices,
    both_pdf: Floats,
    asked: Flags,
) -> None:
    """Check that ``eval_pdf`` answers as ``eval`` and ``pdf``, in all elements."""
    light = np.where(values.light > 0, values.light, 1)[..., None, None]
    change = (np.abs(both.raw - values.raw) / light).max(axis=(-1, -2, -3))
    density = np.abs(both_pdf - pdf) / np.maximum(np.maximum(both_pdf, pdf), 1e-30)
    for what, wrong, shown in (
        ("values", asked & (change > ROUNDING), Claim(joint_matrix, elements)),
        (
            "densities",
            asked & (density > ROUNDING),
            Claim(joint, by_sample, PARTS["pdf"]),
        ),
    ):
        if beyond_rounding(wrong):
            fields = {"what": what, "mode": values.in_mode}
            guess = Matrix.OTHER_VALUES(Function.EVAL_PDF, **fields)
            how: dict[str, Any] = {"off": None, "shown": shown}
            how["found"] = f"its {what} differ"
            evidence.breach(EVAL_PDF, guess, values, wrong, **how)


def check_reciprocity(
    evidence: Evidence, there: Matrices, back: Matrices, slack: Floats
) -> None:
    """Check ``M(wi, wo) = Q M(wo, wi)^T Q``, where Q changes the sign of U.

    Matrices are divided by their first elements, which the unpolarised variant judges.
    """
    reverse = per_light(back.in_plane())
    due = EXCHANGE @ np.swapaxes(reverse, -1, -2) @ EXCHANGE
    _compare(evidence, RECIPROCITY, there, back, due, slack)


def check_adjoint(
    evidence: Evidence, radiance: Matrices, back: Matrices, slack: Floats
) -> None:
    """Check that radiance mode answers from wo to wi as importance mode does."""
    _compare(evidence, ADJOINT, radiance, back, per_light(back.in_plane()), slack)


def _compare(
    evidence: Evidence,
    question: Question,
    one: Matrices,
    back: Matrices,
    due: Floats,
    slack: Floats,
) -> None:
    """Check matrices over their first element where there is light both ways."""
    m = per_light(one.in_plane())
    both = one.lit & back.lit & one.finite & back.finite
    size = np.where(both, np.nan_to_num(off(m, due)), 0.0)
    wrong = size > ROUNDING + slack
    if not beyond_rounding(wrong):
        return
    mistake, stated = Matrix.NOT_RECIPROCAL, both_ways
    if question is ADJOINT:
        mistake, stated = Matrix.OTHER_WAY, both_modes
        if is_depolarised(m[wrong]):
            mistake = Matrix.DEPOLARISES_IN_RADIANCE
        elif is_depolarised(due[wrong]):
            mistake = Matrix.POLARISES_IN_RADIANCE
    text = f"elements over the first are off by up to {size[wrong].max():.3g}"
    shown = Claim(stated, elements, (answer_of(one.function),))
    how = {"found": text, "shown": shown}
    evidence.breach(question, mistake(one.function), one.by(size), wrong, **how)
