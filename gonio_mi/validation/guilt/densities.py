"""Densities that differ: of what `sample` returns, ``pdf`` and its components."""

from __future__ import annotations

import numpy as np

from ...array_types import Floats
from ..mistakes import PDF, SAMPLE, Guess
from ..samples import agree
from .case import Case, Diagnosis

# Sum of squared scores that counts of directions may hide.
MAX_UNSEEN = 100


def slightly_off(case: Case) -> Guess | None:
    """One of both is wrong by less than counts of directions tell."""
    each = []
    for samples in (*case.evidence.whole, *case.evidence.sweeps):
        own = samples.usable & (samples.pdf > 0)
        ratio = samples.sampled_pdf[own] / samples.pdf[own]
        each.append(np.mean((ratio - 1) ** 2) if own.any() else 0.0)
    off = float(max(each, default=0.0)) ** 0.5
    n = max((maps.totals.n for maps in case.evidence.maps), default=0)
    seen = n * off**2 >= MAX_UNSEEN or not case.other_density_is_returned()
    return None if seen else Diagnosis.SLIGHTLY(SAMPLE | PDF, off=off)


def of_sample(case: Case) -> Guess:
    """The one that `sample` returns."""
    return case.densities.blame(SAMPLE)


def of_sample_alone(case: Case) -> Guess | None:
    """The same, where weights are not ``eval`` over it."""
    for one in case.densities.each:
        own = one.samples
        if not agree(own.flux, own.eval, own.eval_slack, one.wrong):
            return case.densities.blame(SAMPLE)
    return None


def of_pdf(case: Case) -> Guess:
    """``pdf``, where weights are ``eval`` over what `sample` returns."""
    return case.densities.blame(PDF)


def wrong_mixture(case: Case) -> Guess | None:
    """``pdf`` is that of one component, or their sum, and not their mixture."""
    each, samples = case.apart, case.evidence.whole[0]
    if each is None or each.pdf.any(axis=1).sum() < 2:
        return None  # no component can be asked alone, or one is all

    def is_whole(density: Floats) -> bool:
        return agree(density, samples.pdf, samples.pdf_slack, samples.smooth)

    own = [i for i, density in enumerate(each.pdf) if is_whole(density)]
    if len(own) == 1:
        return Diagnosis.ONE_COMPONENT(PDF, component=own[0])
    whole = not own and is_whole(each.pdf.sum(axis=0))
    return Diagnosis.PLAIN_SUM(PDF) if whole else None
