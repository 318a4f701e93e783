"""Drawn against due: counts, weights and energy, by patch and in total."""

from __future__ import annotations

import numpy as np
from scipy import special

from .equality import BSDF_ROUNDING
from .evidence import INTERFACE, NOISE, Evidence
from .extent import misplaced, surplus
from .integrals import SUM_ERROR
from .maps import FourMaps

__all__ = ["check_energy", "check_maps", "check_pooled"]

# No sample ever meets a density below that: where `pdf` falls to it before it is 0 (as
# Mitsuba's facets do), what `eval` has there is a matter of tails, not of a hole.
UNDERFLOW = 1e-12

# Share of the light that must be judged for a verdict on weights.
JUDGED = 0.9


def check_maps(evidence: Evidence, maps: FourMaps) -> None:
    """Counted directions against ``pdf``, weights against ``eval``, in four views."""
    for name, scores in (
        ("sampling", maps.count_scores),
        ("weights", maps.weight_scores),
    ):
        texts, off = scores.statistics, misplaced(maps, name)
        for view, p in scores.p_values.items():
            evidence.test(name, p, texts[view], maps.condition, off)
    _check_excess(evidence, maps)
    _check_reach(evidence, maps)


def _check_excess(evidence: Evidence, maps: FourMaps) -> None:
    """``pdf`` integrates to no more than 1; where ``eval`` is black, nobody minds."""
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
            size=used + unused - 1,
            off=min(used + unused - 1, 1.0),
            theta_i=maps.condition.theta_i,
            effect=INTERFACE if harmless else None,
        )


def _check_reach(evidence: Evidence, maps: FourMaps) -> None:
    """All light of ``eval`` is where samples go; and too rarely, if at all, is told."""
    due, flux = maps.due, maps.smooth_flux.mean()
    lost = due.unreached.values.sum()
    bound = max(due.unreached.sum_bound, SUM_ERROR * max(flux, 1))
    if lost > bound and due.least > UNDERFLOW:
        evidence.breach(
            "weights",
            "pdf",
            f"{lost / flux:.3g} of the light at {maps.condition}",
            f"`eval` sends {lost / flux:.3g} of its light where `pdf` is 0",
            size=lost,
            off=min(lost / flux, 1.0),
            theta_i=maps.condition.theta_i,
        )
    elif maps.judged < JUDGED:
        evidence.lesser["weights"] = NOISE
        evidence.undecided["weights"] = (
            f"tails are too heavy: {1 - maps.judged:.2g} of the light at "
            f"{maps.condition} is in weights that {maps.totals.n} samples meet too "
            "rarely, a noise that a sampler nearer to `eval` has not"
        )


def check_pooled(evidence: Evidence) -> None:
    """Sums of all patches over all conditions: a small error that is everywhere."""
    for name in ("sampling", "weights"):
        scores = [
            (m.count_scores if name == "sampling" else m.weight_scores).total
            for m in evidence.maps
        ]
        # those that cannot vary are judged one by one
        scores = [z for z in scores if 0 < abs(z) < 8]
        if len(scores) > 1:
            z = float(np.sum(scores) / np.sqrt(len(scores)))
            p = float(2 * special.ndtr(-abs(z)))
            gains = [surplus(m, name) for m in evidence.maps]
            off = abs(float(np.mean(gains)))
            evidence.test(name, p, f"z of all sums together {z:+.1f}", off=off)


def check_energy(evidence: Evidence, maps: FourMaps) -> None:
    """Reflectance plus transmittance is at most 1, in importance mode.

    The smooth part is integrated, the discrete one is sampled; and all that was sampled
    is another test, of the weights.
    """
    if maps.condition.mode != "importance" or maps.condition.component is not None:
        return
    drawn = maps.totals
    std_err = np.sqrt(drawn.variance / drawn.n)
    flux = maps.smooth_flux + drawn.delta_mean
    worst = int(flux.argmax())
    # only what is sampled of it varies
    noise = std_err[worst] if drawn.delta_mean[worst] > 0 else 0.0
    bound = max(maps.smooth_bound[worst] + maps.eval_rounding, SUM_ERROR)
    smooth = maps.smooth_flux[worst] > drawn.delta_mean[worst]
    whole = "`eval` integrates to" if smooth else "discrete lobes have the weight"
    for value, error, slack, what in (
        (flux[worst], noise, bound, whole),
        (
            drawn.mean.max(),
            std_err[drawn.mean.argmax()],
            BSDF_ROUNDING,
            "weights have the mean",
        ),
    ):
        excess = value - 1 - slack
        z = excess / max(error, 1e-7)
        text = f"{what} {value:.5g}"
        evidence.test("energy", float(special.ndtr(-z)), text, maps.condition)
