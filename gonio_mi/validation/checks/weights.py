"""Sampled weights against the integral of ``eval``, by patch and in total."""

from __future__ import annotations

import numpy as np
from scipy import special

from ..conditions import Condition
from ..evidence import NOISE, Evidence
from ..integrals import SUM_ERROR
from ..kinds import Kind
from ..maps import FourMaps, unexplained_fraction
from ..probe import Probe
from ..samples import Samples, beyond_rounding
from .answers import lattice

# Density that no sample ever meets: where `pdf` falls below it before it is 0 (as that
# of Mitsuba's facets does), the light of `eval` is a matter of tails, not of a hole.
UNDERFLOW = 1e-12

# Fraction of the light that must be judged for a verdict on weights.
MIN_JUDGED = 0.9


def check_scores(evidence: Evidence, maps: FourMaps, name: str) -> None:
    """Test the scores of all patches: their sum, mean, spread and worst."""
    scores, (off, _) = maps.scores(name), unexplained_fraction(maps, name)
    texts = scores.statistics
    for view, p in scores.p_values.items():
        evidence.test(name, p, texts[view], maps.condition, off)


def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Check that ``eval`` and ``pdf`` are not 0 where ``sample`` scatters light."""
    usable = samples.usable
    dark = usable & (samples.eval == 0).all(axis=1)
    if beyond_rounding(dark):
        both = beyond_rounding(dark & (samples.pdf == 0))
        functions = "`eval` and `pdf` are" if both else "`eval` is"
        evidence.breach(
            "weights",
            "eval",
            f"{100 * dark.sum() / usable.sum():.3g} % of the samples with light at "
            f"{samples.condition}",
            f"{functions} 0 where `sample` scatters light",
            samples.condition.middle(dark),
            size=1 + float(dark.mean()),
            off=float(dark.mean()),
        )


def check_unsampled_side(evidence: Evidence, condition: Condition) -> bool:
    """Check and return whether ``eval`` is black from a side that is never sampled."""
    value = np.nan_to_num(Probe(evidence.bsdf, condition).values(lattice()), nan=0)
    light = 4 * np.pi * float(value.mean(axis=0).max())
    if light > 0:
        evidence.breach(
            "weights",
            "eval",
            f"{light:.3g} of the light at {condition}",
            "`eval` scatters light from a side that `flags` does not declare, and "
            "`sample` none",
            condition,
            size=light,
            off=min(light, 1.0),
            kind=Kind.LIGHT_OF_A_DARK_SIDE,
        )
    return light == 0


def check_maps(evidence: Evidence, maps: FourMaps) -> None:
    """Test sums of weights, and check that samples reach all light of ``eval``.

    Light that samples meet too rarely to judge is reported.
    """
    check_scores(evidence, maps, "weights")
    due, flux = maps.due, maps.smooth_flux.mean()
    lost = due.unreached.values.sum()
    # on a side where samples never go
    sides = due.unreached.values.reshape(2, -1).sum(axis=1)
    beyond = sides[maps.totals.counts.reshape(2, -1).sum(axis=1) == 0].sum()
    function, where = "pdf", "where `pdf` is 0"
    if beyond > lost / 2:
        function, where = "eval", "to a side where `pdf` is 0 and `sample` never goes"
    bound = max(due.unreached.sum_bound, SUM_ERROR * max(flux, 1))
    if lost > bound and due.least > UNDERFLOW:
        evidence.breach(
            "weights",
            function,
            f"{lost / flux:.3g} of the light at {maps.condition}",
            f"`eval` sends {lost / flux:.3g} of its light {where}",
            maps.condition,
            size=lost,
            off=min(lost / flux, 1.0),
        )
    elif maps.judged < MIN_JUDGED:
        evidence.downgraded["weights"] = NOISE
        evidence.undecided["weights"] = (
            f"tails are too heavy: {1 - maps.judged:.2g} of the light at "
            f"{maps.condition} is in weights that {maps.totals.n} samples meet too "
            "rarely, importance sampling closer to `eval` would remove it"
        )


def check_pooled(evidence: Evidence) -> None:
    """Test sums over all patches and conditions, for a small error everywhere."""
    for name in ("sampling", "weights"):
        varying = (m for m in evidence.maps if name == "weights" or m.count_varies)
        # what is certain is judged one by one
        scores = [z for m in varying if 0 < abs(z := m.scores(name).total) < 8]
        if len(scores) > 1:
            z = float(np.sum(scores) / np.sqrt(len(scores)))
            p = float(2 * special.ndtr(-abs(z)))
            gains = [unexplained_fraction(m, name)[1] for m in evidence.maps]
            off = abs(float(np.mean(gains)))
            evidence.test(name, p, f"z of all sums together {z:+.1f}", off=off)
