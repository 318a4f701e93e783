"""Counted directions against the integral of ``pdf``, by patch and in total."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..evidence import BIAS, INTERFACE, NOISE, Evidence
from ..factors import has_known_factor, ratios_of
from ..integrals import SUM_ERROR
from ..maps import FourMaps
from ..samples import BSDF_ROUNDING, samples_of
from .weights import check_scores

__all__ = ["check_maps", "check_roulette"]

# Samples that tell a roulette, the least fraction that it rejects, and standard errors
# within which weights make up for that.
N_ROULETTE = 2**16
MIN_REJECTED = 0.01
MAX_SCORE = 4


def check_maps(evidence: Evidence, maps: FourMaps) -> None:
    """Counts, in four views; and ``pdf`` integrates to no more than 1.

    Where ``eval`` is black, a density does no harm.
    """
    check_scores(evidence, maps, "sampling", maps.count_scores)
    used, unused = maps.pdf.sum(), maps.due.unused.values.sum()
    slack = max(maps.pdf_sum_bound, SUM_ERROR) + maps.due.unused.sum_bound
    if used + unused > 1 + slack:
        harmless = used <= 1 + slack
        text = f"`pdf` integrates to {used + unused:.4g}, more than 1"
        if harmless:
            text += f", {unused:.4g} of it where `eval` is black"
        evidence.breach(
            "sampling",
            "pdf",
            f"{used + unused:.5g} at {maps.condition}",
            text,
            maps.condition,
            size=used + unused - 1,
            off=min(used + unused - 1, 1.0),
            effect=INTERFACE if harmless else "",
        )


def check_roulette(evidence: Evidence) -> None:
    """Whether ``sample`` rejects directions at random and its weights make up for it.

    Then directions are rarer than by ``pdf``, and weights larger than ``eval`` over it,
    by the same factor: noise, and no bias, as long as `weights` holds.
    """
    whole = [maps for maps in evidence.maps if maps.condition.component is None]
    if not whole or not evidence.of("sampled_weight"):
        return
    if not all(_is_roulette(evidence, maps) for maps in whole):
        return
    if has_known_factor(ratios_of(evidence, "sample")):
        return  # a cosine or a Jacobian is no chance: `pdf` lacks it
    mistake = (
        "`sample` rejects directions by a Russian roulette of its own, and its weights "
        "make up for it"
    )
    evidence.breaches[:] = [
        replace(b, effect=NOISE, mistake=mistake)
        if b.name == "sampled_weight" and b.effect == BIAS
        else b
        for b in evidence.breaches
    ]
    evidence.tests[:] = [
        replace(t, effect=NOISE) if t.name == "sampling" and t.effect == BIAS else t
        for t in evidence.tests
    ]


def _is_roulette(evidence: Evidence, maps: FourMaps) -> bool:
    """Whether the mean of weight times pdf over ``eval`` is the integral of ``pdf``."""
    key = (evidence.seed, 2, 73)
    samples = samples_of(evidence.bsdf, maps.condition, N_ROULETTE, key)
    lit = samples.usable & (samples.eval > 0).any(axis=1)
    ratio = np.zeros(samples.n)
    over = samples.weight[lit].sum(axis=1) * samples.pdf[lit]
    ratio[lit] = over / samples.eval[lit].sum(axis=1)
    due, std_err = maps.pdf.sum(), ratio.std() / np.sqrt(samples.n)
    rejected, missing = 1 - samples.given.mean(), due - lit.mean()
    return bool(
        missing > MIN_REJECTED
        and rejected > missing / 2
        and (ratio[lit] > 1 - BSDF_ROUNDING).all()
        and abs(ratio.mean() - due) < MAX_SCORE * std_err + SUM_ERROR
    )
