"""All elements of matrices: in both directions and transport modes."""

from collections.abc import Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats
from ...collector.stokes import EXCHANGE, UPRIGHT
from ..arrays import Sides, answer_of, drawn, in_plane, lit_from, per_first
from ..evidence import Evidence, Question
from ..judgements import by_sample
from ..mistakes import EVAL, SAMPLE, Claim, Function, Guess, Mistake
from ..mueller import (
    Matrices,
    flux_of,
    in_mode,
    is_depolarised,
    lobe_slack,
    off,
    other_mode,
    per_light,
    readings,
    relative_slack,
    samples_at,
)
from ..samples import ELEMENT_ROUNDING, Samples, beyond_rounding
from .adjoint import ADJOINT
from .reciprocity import RECIPROCITY


def both_ways(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> Sides:
    """Helmholtz reciprocity, in all elements."""
    bs, _ = drawn(bsdf, ctx, si, u)
    there, back = (
        in_plane(what, bsdf, ctx, si, wi, wo, u, [0, 0, 1])
        for wi, wo in ((si.wi, bs.wo), (bs.wo, mi.Vector3f(si.wi)))
    )
    signs = [1, 1, -1, 1]
    return there, np.einsum("jick,i,j->ijck", back, signs, signs), True


def both_modes(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> Sides:
    """Radiance mode answers as importance mode on the way back, in all elements."""
    bs, _ = drawn(bsdf, ctx, si, u)
    here, found, modes = mi.Vector3f(si.wi), [], mi.TransportMode
    for mode, wi, wo in (
        (modes.Radiance, here, bs.wo),
        (modes.Importance, bs.wo, here),
    ):
        own, there = mi.BSDFContext(mode), lit_from(si, wi)
        found.append(per_first(np.array(what(bsdf, own, there, wo, u))))
    return found[0], found[1], True


class Matrix(Mistake):
    """Mistakes in matrices, in one `mode` or in both."""

    FIRST_ELEMENT = """{who}: weight times pdf is another first element than that of
        `eval`; the unpolarised variant tells more{mode}"""
    DEPOLARISES = "{who} depolarises where {other} does not{mode}"
    ELEMENTS = """{who}: weight times pdf differs from `eval` in {n} elements ({names})
        but the first{mode}"""
    NOT_RECIPROCAL = """{who} is not reciprocal in its polarisation: M(wi, wo) is not Q
        M(wo, wi)^T Q"""
    OTHER_WAY = """{who} does not answer for light that goes from wo to wi in radiance
        mode (ctx.mode)"""
    DEPOLARISES_IN_RADIANCE = """{who} depolarises, other than in importance mode, in
        radiance mode (ctx.mode)"""
    POLARISES_IN_RADIANCE = """{who} polarises, other than in importance mode, in
        radiance mode (ctx.mode)"""


# Numbers that choose a lobe on the way back, and the difference of cosines between two
# directions that are the same.
CHOICES = (0.01, 0.05, 0.15, 0.35, 0.65, 0.85, 0.95, 0.99)
SAME_DIRECTION = 1e-3

# Fraction of the difference that a reading leaves which explains it.
EXPLAINED = 0.05


def breach_of_elements(
    evidence: Evidence,
    question: Question,
    samples: Samples,
    flux: Floats,
    due: Floats,
    wrong: Flags,
) -> None:
    """Add that weight times pdf is not `eval` in some element.

    `flux` and `due` are both, and a mask says of which samples they are `wrong`.
    """
    suspects: tuple[Function, ...] = (SAMPLE, EVAL)
    if samples.condition.mode == "radiance":
        # importance mode tells which answers of `eval` are due
        suspects = (EVAL,) if evidence.of("adjoint") else (SAMPLE,)
    light = np.maximum(due, flux)[..., :1, :1]
    difference = np.abs((flux - due) / np.where(light > 0, light, 1))
    size = difference.max(axis=(-1, -2, -3))
    place = np.argmax(difference[_worst(size, wrong)].max(axis=0))
    both = (
        Matrices.of(samples, SAMPLE, flux).take(wrong),
        Matrices.of(samples, EVAL, due).take(wrong),
    )
    text = f"weight times pdf is off `eval` by up to {size[wrong].max():.3g} of the "
    text += f"first element, in element {place // 4}{place % 4},"
    guess = _difference_guess(*both, suspects)
    _breach(evidence, question, guess, samples, size, wrong, found=text)


def _worst(size: Floats, wrong: Flags) -> int:
    """Number of the sample that is most wrong."""
    return int(np.argmax(np.where(wrong, size, -np.inf)))


def _breach(
    evidence: Evidence,
    question: Question,
    guess: Guess,
    samples: Samples,
    size: Floats,
    wrong: Flags,
    **others: Any,
) -> None:
    """Add a breach that is shown where the samples are most wrong."""
    at = samples.middle(np.arange(samples.n) == _worst(size, wrong))
    evidence.breach(question, guess, samples, wrong, condition=at, **others)


def _difference_guess(
    flux: Matrices, values: Matrices, suspects: Sequence[Function]
) -> Guess:
    """Guilty function and mistake, where weight times pdf is not `eval`."""
    mode = {"mode": in_mode(values.asked)}
    m_flux, m_eval = per_light(flux.raw), per_light(values.raw)
    light = np.maximum(flux.light, values.light)
    if (np.abs(flux.light - values.light) > ELEMENT_ROUNDING * light).mean() > 0.5:
        return Matrix.FIRST_ELEMENT(EVAL | SAMPLE, **mode)
    if is_depolarised(m_eval) and not is_depolarised(m_flux):
        return Matrix.DEPOLARISES(EVAL, other="`sample`", **mode)
    if is_depolarised(m_flux) and not is_depolarised(m_eval):
        return Matrix.DEPOLARISES(SAMPLE, other="`eval`", **mode)
    misfit = off(m_flux, m_eval)
    for function in suspects:
        matrices, right = (flux, values) if function is SAMPLE else (values, flux)
        due = per_light(right.in_plane())
        for mistake, read in (*readings(matrices, UPRIGHT), *other_mode(matrices)):
            left = off(per_light(read), due)
            if np.mean(left) < EXPLAINED * np.mean(misfit):
                return mistake(function, **mode)
    names = [
        f"{i}{j}"
        for i, j in np.ndindex(4, 4)
        if np.abs(m_flux - m_eval)[..., i, j].max() > ELEMENT_ROUNDING
    ]
    those = ", ".join([*names[:6], *(["..."] if len(names) > 6 else [])])
    both = suspects[0] | suspects[-1]
    return Matrix.ELEMENTS(both, n=len(names), names=those, **mode)


@RECIPROCITY.asks("matrices")
def check_both_ways(evidence: Evidence, samples: Samples) -> None:
    """Check reciprocity, and radiance mode against importance mode on the way back."""
    if samples.condition.mode == "radiance":
        return  # which importance mode is compared with
    there = Matrices.of(samples, EVAL, samples.full("eval"))
    back = Matrices.of(samples, EVAL, samples.full("reverse")).exchanged()
    radiance = Matrices.of(samples, EVAL, samples.full("other_mode")).in_radiance()
    slack = relative_slack(
        *(samples.eval_slack, samples.eval, samples.reverse_slack, samples.reverse)
    )
    slack = np.where(samples.smooth, slack, np.inf)
    _check_ways(evidence, samples, there, radiance, back, slack)
    if samples.discrete.any():
        _check_lobes(evidence, samples)


def _check_lobes(evidence: Evidence, samples: Samples) -> None:
    """Check the same of discrete lobes."""
    bsdf, uv, n = evidence.bsdf, samples.condition.uvs, samples.n
    # the same lobe, for any of some choices, in both directions
    choices = np.repeat(samples.u[:, None], len(CHOICES), axis=1)
    choices[..., 0] = CHOICES
    wo = np.where(samples.discrete[:, None], samples.wo, samples.wi)
    wi = np.broadcast_to(wo[:, None], choices.shape)
    returned = samples_at(bsdf, wi, choices, uv[:, None])
    kind = (returned.type * returned.discrete).reshape(n, -1)
    flux = flux_of(returned, *kind.shape)
    same = np.abs(flux.wo - samples.wi[:, None]).max(-1) < SAME_DIRECTION
    same &= (kind > 0) & (kind == samples.type[:, None])
    back = flux.take((np.arange(n), same.argmax(axis=1)))
    other = samples_at(bsdf, samples.wi, samples.u, uv, mode="radiance")
    slack = lobe_slack(bsdf, samples)
    slack = np.where(samples.discrete & same.any(axis=1), slack, np.inf)
    known = other.discrete & (other.type == samples.type)
    modes = flux_of(samples), flux_of(other)
    _check_ways(evidence, samples, *modes, back, slack, np.where(known, slack, np.inf))


def _check_ways(
    evidence: Evidence,
    samples: Samples,
    there: Matrices,
    radiance: Matrices,
    back: Matrices,
    slack: Floats,
    slack_of_modes: Floats | None = None,
) -> None:
    """Check ``M(wi, wo) = Q M(wo, wi)^T Q``, and that ``M(wo, wi)`` is radiance mode's.

    Q changes the sign of U. Matrices are divided by their first elements, which the
    unpolarised variant judges.
    """
    due = per_light(back.in_plane())
    reverse = EXCHANGE @ np.swapaxes(due, -1, -2) @ EXCHANGE
    _compare(evidence, RECIPROCITY, samples, there, back, reverse, slack)
    slack = slack if slack_of_modes is None else slack_of_modes
    _compare(evidence, ADJOINT, samples, radiance, back, due, slack)


def _compare(
    evidence: Evidence,
    question: Question,
    samples: Samples,
    one: Matrices,
    back: Matrices,
    due: Floats,
    slack: Floats,
) -> None:
    """Check matrices over their first element where there is light both ways."""
    m = per_light(one.in_plane())
    both = one.lit & back.lit & one.finite & back.finite
    size = np.where(both, np.nan_to_num(off(m, due)), 0.0)
    wrong = size > ELEMENT_ROUNDING + slack
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
    shown = Claim(stated, by_sample, (answer_of(one.function),))
    how = {"found": text, "shown": shown}
    _breach(evidence, question, mistake(one.function), samples, size, wrong, **how)
