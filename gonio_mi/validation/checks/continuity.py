"""Continuous at normal incidence, non-zero up to grazing angles."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...collector.directions import direction
from ..arrays import Sides, answer_of, drawn, lit_from, rows, smooth, sphere, value
from ..conditions import PHI, Condition
from ..evidence import MODEL, Evidence, Question
from ..judgements import by_sample, equal
from ..mistakes import EVAL, PDF, Claim, Mistake
from ..probe import Probe, spectral, uniform, vectors
from ..samples import ULPS, Samples


def horizon(bsdf: Any, ctx: Any, si: Any, u: Any) -> tuple[float, float]:
    """As many directions are illuminated from near the horizon as from 60 degrees."""
    shares = []
    for cosine in (0.5, 1e-3):
        wi = mi.Vector3f((1 - cosine**2) ** 0.5, 0, cosine) * dr.sign(si.wi.z)
        there = lit_from(si, wi + 0 * u)
        shares.append(np.mean(value(bsdf, ctx, there, sphere(u.y, u.z)) > 0))
    return shares[0], shares[1]


def at_normal(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> Sides:
    """No jump at normal incidence."""
    bs, weight = drawn(bsdf, ctx, si, u)
    near = lit_from(si, si.wi + mi.Vector3f(2**-16, 0, 0))
    here, there = (rows(what(bsdf, ctx, x, bs.wo, u)) for x in (si, near))
    return here, there, smooth(bs, weight)


CONTINUITY = Question("continuity", __doc__, MODEL, shown=Claim(horizon, equal))


class Continuity(Mistake):
    """Where values jump."""

    AT_NORMAL = "{who} jumps at normal incidence"
    AT_HORIZON = "{who} is zero at grazing {direction} but not at smaller angles"


# Tilt from the normal, in radians, and the part of all values that may change by it: a
# lobe ten times as wide changes by so much.
MAX_TILT = 2.0**-16
MAX_JUMP = 0.1

# Cosines of directions that come near to the horizon, to within 0.06 degrees.
COSINES = 2.0 ** np.arange(-2, -10.5, -0.5)

# Part of the largest value below which light has faded before it ends.
MIN_LAST = 1e-6

# Azimuths and samples that are looked at for each of them.
N_AZIMUTHS = 16
N_SAMPLES = 2**6


def check_normal(evidence: Evidence, samples: Samples) -> None:
    """Check that ``eval`` and ``pdf`` are continuous at normal incidence.

    Parameters
    ----------
    samples : Samples
        At normal incidence; of others nothing is said.
    """
    usable = samples.smooth & np.isfinite(samples.eval).all(axis=1)
    if samples.condition.theta_i != 0 or not usable.any():
        return
    probe = Probe(evidence.bsdf, samples.condition)
    nearby = [
        direction(MAX_TILT, phi) * np.sign([1, 1, samples.condition.wi[2]])
        for phi in np.radians(PHI)
    ]
    for function, answer, here, slack in (
        (EVAL, probe.values, samples.eval, samples.eval_slack),
        (PDF, probe.densities, samples.pdf, samples.pdf_slack),
    ):
        # a tilt changes as many times more than rounding as it is larger than 4 ulp
        steep = slack[usable].sum() * MAX_TILT / ULPS
        whole = here[usable].sum()
        changes = [np.abs(answer(samples.wo, wi) - here)[usable].sum() for wi in nearby]
        # near normal incidence, and nowhere else, all azimuths are one direction
        jump = min(changes) / whole if whole > 0 else 0.0
        if jump > MAX_JUMP and min(changes) > 4 * steep:
            guess, at = Continuity.AT_NORMAL(function), samples.condition
            text = f"{function.quoted} changes by {jump:.3g} of itself within "
            text += f"{np.degrees(MAX_TILT):.1g} degrees of normal incidence, {at.side}"
            shown = Claim(at_normal, by_sample, (answer_of(function),))
            how = {"size": float(jump), "shown": shown}
            evidence.breach(CONTINUITY, guess, at, statistic=text, **how)


def check_cutoffs(evidence: Evidence, condition: Condition) -> None:
    """Check that no direction is black just because it is near the horizon.

    Light arrives from there and leaves where ``sample`` sends it, then goes the other
    way. All azimuths are asked, so that a tilted normal hides one side at most.
    """
    n = N_AZIMUTHS * N_SAMPLES
    azimuths = 2 * np.pi * (np.arange(N_AZIMUTHS) + 0.3) / N_AZIMUTHS
    azimuths = np.repeat(azimuths, N_SAMPLES)
    face = np.sign(condition.wi[2])
    probe = Probe(evidence.bsdf, condition)
    random = uniform(n, (evidence.seed, 51))
    lit: dict[str, list[float]] = {"wi": [], "wo": []}
    for cosine in COSINES:
        ring = direction(np.full(n, np.arccos(cosine)), azimuths) * [1, 1, face]
        near = vectors(ring)
        bs, weight = probe.sample(*random, wi=near)
        far = mi.Vector3f(bs.wo)
        there = [spectral(x, n) for x in (weight, probe.eval(far, wi=near))]
        lit["wi"].append(max(float(np.nan_to_num(x).max()) for x in there))
        back = spectral(probe.eval(near, wi=far), n)
        lit["wo"].append(float(np.nan_to_num(back).max()))
    for name, ones in lit.items():
        if not any(ones) or ones[-1]:
            continue
        k = np.flatnonzero(ones)[-1]
        last = COSINES[k]
        if ones[k] < MIN_LAST * max(ones):
            continue  # it has faded before
        theta = np.degrees(np.arccos(last))
        text = f"zero for theta_{name[1]} beyond {theta:.4g} degrees, {condition.side}"
        guess, how = Continuity.AT_HORIZON(EVAL, direction=name), {"size": float(last)}
        evidence.breach(CONTINUITY, guess, condition, statistic=text, **how)
