"""Components add up to the whole."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats
from ..arrays import (
    Sides,
    answer_of,
    drawn,
    lit,
    of_eval,
    of_pdf,
    rows,
    smooth,
)
from ..evidence import INTERFACE, SAME, Evidence, Question
from ..judgements import by_sample, equal, same
from ..mistakes import EVAL, PDF, SAMPLE, Claim, Guess, Mistake
from ..probe import Probe, is_delta, numbers, spectral
from ..samples import Samples, agree, beyond_rounding, unequal
from .answers import LOBES
from .flags import DECLARED


def component(ctx: Any, i: int) -> Any:
    """Context in which a component is alone."""
    return mi.BSDFContext(ctx.mode, ctx.type_mask, i)


def components(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> Sides:
    """Components add up to the whole."""
    bs, weight = drawn(bsdf, ctx, si, u)
    each = range(bsdf.component_count())
    asked = [rows(what(bsdf, component(ctx, i), si, bs.wo, u)) for i in each]
    return rows(what(bsdf, ctx, si, bs.wo, u)), sum(asked), smooth(bs, weight)


def discrete_flux(bsdf: Any, ctx: Any, si: Any, u: Any, i: int) -> tuple[float, float]:
    """The discrete lobe of a component has the same flux alone as in the whole."""
    bs, weight = drawn(bsdf, ctx, si, u)
    own = lit(weight) & (np.array(bs.sampled_component) == i)
    whole = np.median((rows(weight).mean(axis=0) * rows(bs.pdf))[0, own])
    bs, weight = drawn(bsdf, component(ctx, i), si, u)
    return whole, np.median(rows(weight).mean(axis=0) * rows(bs.pdf))


def type_masks(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> tuple[int, int]:
    """What a mask of types excludes does not answer, of one component."""
    answers = 0
    for i in range(bsdf.component_count()):
        types = int(mi.BSDFFlags.All) & ~int(bsdf.flags(i))
        other = mi.BSDFContext(ctx.mode, types, ctx.component)
        bs, _ = drawn(bsdf, other, si, u)
        answers += int(np.sum(rows(what(bsdf, other, si, bs.wo, u)) != 0))
    return answers, 0


def type_masks_of_samples(bsdf: Any, ctx: Any, si: Any, u: Any) -> tuple[int, int]:
    """What a mask of types excludes is not sampled."""
    answers = 0
    for i in range(bsdf.component_count()):
        types = int(mi.BSDFFlags.All) & ~int(bsdf.flags(i))
        other = mi.BSDFContext(ctx.mode, types, ctx.component)
        bs, weight = drawn(bsdf, other, si, u)
        excluded = np.array(bs.sampled_type) & int(bsdf.flags(i)) & 0x7E != 0
        answers += int(np.sum(excluded & lit(weight)))
    return answers, 0


COMPONENTS = Question(
    "components",
    __doc__,
    INTERFACE,
    volumes=SAME,
    rank=3,
    shown=Claim(components, by_sample, (of_eval,)),
)


class Components(Mistake):
    """Mistakes in components."""

    OTHER_LOBE = """the weight of {who} times the probability of the discrete lobe of
        component {component} is not that of the component alone"""
    IGNORED = "{those} ignore ctx.component"
    IGNORES = "{those} ignores ctx.component"
    NO_SUM = "{who} ignores ctx.component, or the components are not a sum"
    PDF_IS_MORE = "{who} of the whole is more than those of its components together"
    TYPE_IGNORED = "{who} ignores ctx.type_mask"


@dataclass(frozen=True)
class Alone:
    """Answers of each component alone about samples of the whole BSDF.

    Attributes
    ----------
    eval : ndarray, shape (n_components, n, channels)
    pdf : ndarray, shape (n_components, n)
    wo : ndarray, shape (n_components, n, 3)
        Directions that ``sample`` draws of them from the same random numbers.
    discrete : ndarray, shape (n_components, channels)
        Flux fraction of each one's discrete lobe; 0 without.
    """

    eval: Floats
    pdf: Floats
    wo: Floats
    discrete: Floats


def alone(evidence: Evidence, samples: Samples) -> Alone:
    """Ask each component about the directions of samples of the whole."""
    random, answers = samples.random, []
    for i in range(evidence.bsdf.component_count()):
        probe = Probe(evidence.bsdf, replace(samples.condition, component=i))
        value, density = probe.values(samples.wo), probe.densities(samples.wo)
        bs, weight = probe.sample(*random)
        flux = spectral(weight, samples.n) * numbers(bs.pdf, samples.n)[:, None]
        discrete = _median(flux[numbers(is_delta(bs), samples.n)])
        answers.append((value, density, spectral(bs.wo, samples.n), discrete))
    return Alone(*map(np.array, zip(*answers)))


def _median(flux: Floats) -> Floats:
    """Median flux fraction of samples of one discrete lobe; 0 without samples."""
    return np.median(flux, axis=0) if len(flux) else np.zeros(flux.shape[1])


def _check_discrete(evidence: Evidence, samples: Samples, each: Alone) -> None:
    """Check that a discrete lobe has the same flux fraction alone as in the whole."""
    for i, due in enumerate(each.discrete):
        own = samples.given & samples.delta & (samples.component == i)
        if not beyond_rounding(own) or not due.any():
            continue
        flux = samples.flux[own]
        whole = _median(flux)
        several = unequal(flux, np.broadcast_to(whole, flux.shape), 0.0).any()
        if several or not unequal(whole[None], due[None], 0.0)[0]:
            continue
        guess = Components.OTHER_LOBE(SAMPLE, component=i)
        text = f"{due.max():.4g} of the light alone, {whole.max():.4g} in the whole,"
        shown = Claim(discrete_flux, equal, (i,))
        how = {"found": text, "shown": shown}
        evidence.breach(COMPONENTS, guess, samples.condition, **how)


def are_apart(bsdf: mi.BSDF, samples: Samples, each: Alone) -> bool:
    """Whether no component alone is the whole, of several with a density."""
    smooth = [
        value
        for i, value in enumerate(each.eval)
        if int(bsdf.flags(i)) & int(mi.BSDFFlags.Smooth)
    ]
    if len(smooth) < 2:
        return True
    whole = samples.eval, samples.eval_slack, samples.smooth
    return not any(agree(x, *whole) for x in smooth)


def _check_types(evidence: Evidence, samples: Samples, each: Alone) -> None:
    """Check that ctx.type_mask selects a component whose lobe types no other has.

    Where a component alone is the whole, as of plugins that heed masks of types only,
    the types that are sampled tell it, and no values.
    """
    bsdf = evidence.bsdf
    apart = are_apart(bsdf, samples, each)
    lobes = sum(int(getattr(mi.BSDFFlags, name)) for name in LOBES)
    types = [int(bsdf.flags(i)) & lobes for i in range(bsdf.component_count())]
    for i, own in enumerate(types):
        if any(own & other for j, other in enumerate(types) if j != i):
            continue
        probe = Probe(bsdf, replace(samples.condition, types=own))
        bs, weight = probe.sample(*samples.random)
        given = (spectral(weight, samples.n) != 0).any(axis=1)
        drawn = numbers(bs.sampled_type, samples.n)
        density, of_component = probe.densities(samples.wo), each.pdf[i]
        # a sample may fail where a lobe is chosen that the mask excludes
        both = samples.smooth & (density > 0) & (of_component > 0)
        share = np.median(density[both] / of_component[both]) if both.any() else 1.0
        value = probe.values(samples.wo)
        if evidence.by_chance(value, each.eval[i], samples.wo):
            value = each.eval[i]
        for function, wrong in (
            (EVAL, unequal(value, each.eval[i], 0.0)),
            (PDF, unequal(density, min(share, 1.0) * of_component, 0.0)),
            (SAMPLE, given & ((drawn & (lobes ^ own)) != 0)),
        ):
            wrong = wrong & (samples.smooth | (function is SAMPLE))
            if beyond_rounding(wrong) and (apart or function is SAMPLE):
                guess = Components.TYPE_IGNORED(function)
                shown = Claim(type_masks, same, (answer_of(function),))
                if function is SAMPLE:
                    shown = Claim(type_masks_of_samples, same)
                how = {"off": None, "shown": shown}
                evidence.breach(DECLARED, guess, samples, wrong, **how)
                return


def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Check that the values of the components add up to those of the whole.

    The density of the whole is at most the sum of the components' densities, for each
    component is picked with a probability of at most 1.
    """
    if samples.condition.component is not None or not evidence.bsdf.component_count():
        return
    each = alone(evidence, samples)
    if not evidence.of("components"):
        _check_discrete(evidence, samples, each)
        _check_types(evidence, samples, each)
    whole, total, _ = samples.hold(components, of_eval)
    density = samples.hold(components, of_pdf)[1][:, 0]
    usable = samples.smooth & np.isfinite(total).all(axis=1) & np.isfinite(density)
    deaf = _ignoring_components(samples, each, usable)
    wrong = unequal(total, whole, samples.eval_slack) & usable
    both = total[usable], whole[usable], samples.wo[usable]
    if beyond_rounding(wrong) and not evidence.by_chance(*both):
        ratio = total[wrong].sum(axis=1) / np.maximum(whole[wrong].sum(axis=1), 1e-30)
        guess = deaf or Components.NO_SUM(EVAL)
        text = f"their sum is {np.median(ratio):.4g} times the whole"
        how = {"found": text, "size": 1 + float(wrong.mean()), "off": None}
        evidence.breach(COMPONENTS, guess, samples, wrong, **how)
    more = unequal(samples.pdf, density, samples.pdf_slack) & (samples.pdf > density)
    more &= usable
    if beyond_rounding(more):
        ratio = samples.pdf[more] / np.maximum(density[more], 1e-30)
        text = f"`pdf` is up to {min(ratio.max(), 1e6):.4g} times the sum of those of "
        text += "the components"
        guess = Components.PDF_IS_MORE(PDF)
        evidence.breach(COMPONENTS, guess, samples, more, found=text, off=None)


def _ignoring_components(samples: Samples, each: Alone, usable: Flags) -> Guess | None:
    """What functions ignore ctx.component; None if none does.

    For a BSDF with one component this cannot be told. `eval` shows it.
    """
    if len(each.pdf) < 2:
        return None
    own = {
        EVAL: (each.eval, samples.eval, samples.eval_slack),
        PDF: (each.pdf, samples.pdf, samples.pdf_slack),
        SAMPLE: (each.wo, samples.wo, 0.0),
    }
    *others, last = [
        function.quoted
        for function, (answers, whole, slack) in own.items()
        if all(agree(one, whole, slack, usable) for one in answers)
    ] or [""]
    if others:
        return Components.IGNORED(EVAL, those=f"{', '.join(others)} and {last}")
    return Components.IGNORES(EVAL, those=last) if last else None
