"""Directions that are not of ``pdf``: what is wrong, by the counts of all patches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import drjit as dr
import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats
from ...single_precision import BSDF_ROUNDING
from ..conditions import Condition
from ..evidence import Evidence
from ..maps import FourMaps
from ..mistakes import PDF, SAMPLE, Function, Guess, Mistake
from ..probe import Probe, numbers, uniform, vectors
from ..samples import MAX_SCORE, Samples, beyond_rounding, moments, samples_of
from ..tally import groups, patch_of
from .case import Case
from .ratios import FACTORS, factor


class Counts(Mistake):
    """What is wrong with directions, or with their density."""

    TURNED = "{who} draws directions {how}"
    DENSITY_OF_TURNED = "{who} is that of directions {how}"
    ABOUT_Z = "{who} draws directions about z, not about wi"
    NEVER_ON_A_SIDE = """{who} integrates to {mass:.3g} on a side where `sample` never
        goes, at {place}"""
    SIDE_LEFT_OUT = """{who} never goes to a side where `pdf` integrates to {mass:.3g}
        and `eval` is not zero, at {place}"""
    LOST = """{who} gives no direction for {part:.4g} of its numbers, where `pdf`
        integrates to {mass:.5g}"""
    REJECTED = """{who} rejects {part:.3g} of its directions, where `pdf` and `eval` are
        not 0"""
    MASS = "{sums}"
    NOT_OF_SAMPLE = """{who} is not the density of `sample`, whose weights are right
        ({sums})"""
    OTHER_LOBE = """{who} draws another lobe for component {component} alone than in the
        whole: it takes one lobe for the other"""
    OTHER_THAN_ALONE = """{who} draws other directions of component {component} in the
        whole than alone, as where the number that picks a lobe is used again"""
    OTHER_PROBABILITY = """{who}: directions are drawn with another probability than
        `pdf` says: {where}"""
    FACTOR_OF_PDF = "{who} {of_pdf} ({sums})"
    FACTOR_OF_SAMPLE = "{who}: its density {of_sample} ({sums})"
    FACTOR_OF_EITHER = "`pdf` {of_pdf}, or the density of `sample` {of_sample} ({sums})"


# Samples whose factors are summed up by patch, and hits due of a group of patches.
N_REDRAWN = 2**18
MIN_HITS = 200

# Mean squared score of a factor that explains a density, where 1 is due; and by how
# much the sum of squares must be less than without: chance gives a wrong one of the 16
# factors an advantage of 50, a ratio of likelihoods of exp(25), hardly ever.
MAX_MISFIT = 1.5
MIN_ADVANTAGE = 50

# Distance of two directions that are the same.
SAME_DIRECTION = 1e-3

# Fraction of the samples that may be lost, or by which an integral may be off.
MAX_LOST = 1e-3

# Fraction of the lost samples that must have a direction for these to tell: of a right
# `sample` at most the rest are where `pdf` is not 0.
MIN_DIRECTED = 0.9

# What may be wrong with half vectors, and by which matrix their x and y get right.
CHANGES_OF_HALF_VECTORS = {
    "": ((1, 0), (0, 1)),  # of which some are rejected
    "with x and y swapped": ((0, 1), (1, 0)),
    "whose x has a wrong sign": ((-1, 0), (0, 1)),
    "whose y has a wrong sign": ((1, 0), (0, -1)),
    "turned by 180 degrees": ((-1, 0), (0, -1)),
}

# Maps that must agree on a factor, those that are most off.
MAX_MAPS = 3

# Factors that may distort a density.
DISTORTIONS = ("cos_o", "jacobian", "dot", "cos_h", "sin_o", "two", "pi", "four")


def turned(case: Case) -> Guess | None:
    """Directions are turned or mirrored."""
    evidence = case.evidence
    guess = next(filter(None, (_turned(evidence.bsdf, m) for m in evidence.maps)), None)
    if guess and evidence.of_volumes and _stays(evidence):
        return Counts.ABOUT_Z(SAMPLE)
    return guess


def _stays(evidence: Evidence) -> bool:
    """Whether the same numbers give the same directions from wherever light comes."""
    one, other = (
        samples_of(evidence.bsdf, condition, 2**10, (evidence.seed, 74), False).wo
        for condition in (Condition(20.0, 25.0), Condition(60.0, 140.0))
    )
    return not beyond_rounding(np.abs(one - other).max(axis=1) > SAME_DIRECTION)


def side_left_out(case: Case) -> Guess | None:
    """Directions never go to a side.

    ``eval`` is lit there: it is ``pdf`` only if no probability is left for that side.
    """
    maps = case.worst
    by_side = maps.drawn.reshape(2, -1).sum(axis=1)
    never = maps.pdf.reshape(2, -1)[by_side == 0].sum()
    if never < 1e-3:
        return None
    where = {"mass": never, "place": maps.condition}
    if _none_fails(case) and maps.pdf.sum() - maps.drawn.sum() > never / 2:
        return Counts.NEVER_ON_A_SIDE(PDF, **where)
    return Counts.SIDE_LEFT_OUT(SAMPLE, **where)


def distorted(case: Case) -> Guess | None:
    """``pdf`` or the density of ``sample`` has a factor that the other has not.

    Right weights are those of the true density: then ``pdf`` is wrong. So it is if it
    integrates to more than 1, or to less though every number gives a direction; where
    it integrates to 1 and directions are lost, ``sample`` is. Else those that are lost
    may tell, or either may be wrong.
    """
    whole, bsdf = case.maps, case.evidence.bsdf
    found = _distortion(bsdf, sorted(whole, key=lambda one: one.misfit)[-MAX_MAPS:])
    if found is None:
        return None
    name, power = found
    words = f"lacks the factor {FACTORS[name]}", f"has an extra factor {FACTORS[name]}"
    of_pdf, of_sample = words if power > 0 else reversed(words)
    lost = any(1 - maps.drawn.sum() > MAX_LOST for maps in whole)
    complete = all(abs(maps.mass - 1) < MAX_LOST for maps in whole)
    more = any(maps.mass >= 1 + MAX_LOST for maps in whole)
    guilty = PDF
    if not case.weights_are_right() and complete and lost:
        guilty = SAMPLE
    elif not (case.weights_are_right() or more) and (complete or lost):
        samples = _redrawn(bsdf, whole[0].condition, 0, 71)
        guilty = _by_lost_samples(samples, name, power)
    mistake = {
        PDF: Counts.FACTOR_OF_PDF,
        SAMPLE: Counts.FACTOR_OF_SAMPLE,
        SAMPLE | PDF: Counts.FACTOR_OF_EITHER,
    }[guilty]
    return mistake(guilty, of_pdf=of_pdf, of_sample=of_sample, sums=_sums(case))


def without_direction(case: Case) -> Guess | None:
    """Numbers give no direction, where ``pdf`` leaves none out."""
    maps = case.worst
    missing = 1 - float(maps.drawn.sum())
    complete = abs(maps.mass - 1) < MAX_LOST < missing
    if complete and maps.count_scores.total < -5:
        return Counts.LOST(SAMPLE, part=missing, mass=maps.mass)
    return None


def unnormalised(case: Case) -> Guess | None:
    """``pdf`` is of more than all, or has a constant factor.

    Where samples fail and weights are wrong, `sample` may have that factor as well.
    """
    tells = case.weights_are_right() or _none_fails(case)
    if case.worst.pdf.sum() > 1.001 or (tells and _is_proportional(case.worst)):
        return Counts.MASS(PDF, sums=_sums(case))
    return None


def not_of_sample(case: Case) -> Guess:
    """``pdf`` is another density than that of the weights."""
    return Counts.NOT_OF_SAMPLE(PDF, sums=_sums(case))


def rejected(case: Case) -> Guess | None:
    """Samples fail though all is well with their directions, which then lack."""
    if case.worst.drawn.sum() > case.worst.pdf.sum():
        return None
    samples = _redrawn(case.evidence.bsdf, case.worst.condition, 0, 72)
    lost = _directed(samples) & (samples.pdf > 0)
    part = np.mean(lost & (samples.eval > 0).any(axis=1))
    return Counts.REJECTED(SAMPLE, part=part) if part > MAX_LOST else None


def other_than_alone(case: Case) -> Guess | None:
    """Directions of a component are others than if it is asked alone."""
    bsdf, condition = case.evidence.bsdf, case.worst.condition
    whole, *each = (
        _redrawn(bsdf, replace(condition, component=i), 0, 76)
        for i in (None, *range(bsdf.component_count()))
    )
    for i, one in enumerate(each):
        here, there = whole.smooth & (whole.component == i), one.smooth
        if min(here.sum(), there.sum()) < MIN_HITS:
            continue
        if not {*whole.type[here].tolist()} & {*one.type[there].tolist()}:
            return Counts.OTHER_LOBE(SAMPLE, component=i)
        means = zip(moments(whole.wo[here]), moments(one.wo[there]))
        apart = (
            abs(a.mean() - b.mean())
            / np.sqrt(a.var() / len(a) + b.var() / len(b) + 1e-30)
            for a, b in means
        )
        if (one.component[there] == i).all() and max(apart) > MAX_SCORE:
            return Counts.OTHER_THAN_ALONE(SAMPLE, component=i)
    return None


def other_probability(case: Case) -> Guess:
    """Directions are drawn with another probability."""
    where = f"{_worst_patch(case.worst)} ({_sums(case)})"
    lobes = {
        one
        for s in case.evidence.samples
        for one in zip(s.component[s.smooth].tolist(), s.type[s.smooth].tolist())
    }
    several = len(lobes) > 1 and case.worst.condition.component is None
    # a density that is not complete may be the wrong one as well
    incomplete = lobes and abs(case.worst.mass - 1) > MAX_LOST
    guilty = SAMPLE | PDF if several or incomplete else SAMPLE
    return Counts.OTHER_PROBABILITY(guilty, where=where)


def _sums(case: Case) -> str:
    """Text on the integral of ``pdf`` and the share that it should equal."""
    share = case.worst.drawn.sum()
    std_err = np.sqrt(max(share * (1 - share), 0) / case.worst.totals.n)
    return (
        f"`pdf` integrates to {case.worst.pdf.sum():.4f}, where it should equal the "
        f"sampled mass of {share:.4f} +- {std_err:.1g} (std_err)"
    )


def _redrawn(bsdf: mi.BSDF, condition: Condition, *key: int) -> Samples:
    """Further samples, of which nothing is compared."""
    return samples_of(bsdf, condition, N_REDRAWN, key, False)


def _none_fails(case: Case) -> bool:
    """Whether every sample has a direction: their density integrates to 1."""
    samples = _redrawn(case.evidence.bsdf, case.worst.condition, 0, 72)
    return bool(samples.given.mean() > 1 - MAX_LOST)


def _directed(samples: Samples) -> Flags:
    """Mask of lost samples that have a direction."""
    length = np.linalg.norm(samples.wo, axis=1)
    return ~samples.given & (np.abs(length - 1) < BSDF_ROUNDING)


def _turned(bsdf: mi.BSDF, maps: FourMaps) -> Guess | None:
    """How the counted map is turned or mirrored against the density; None if not.

    Light tells which of both is right.
    """
    shape, n = (2, *maps.subdivision.shape), maps.subdivision.n_phi
    drawn = maps.drawn.reshape(shape)
    due = maps.pdf.reshape(shape)
    misfit = np.abs(drawn - due).sum()
    # where chance explains it, there is nothing to turn
    if misfit < 4 * np.sqrt(drawn.size / maps.totals.n) or not due.any():
        return None
    sectors = np.arange(n)
    sector_of = {
        "mirrored in phi: a sign is wrong": -1 - sectors,
        "turned by 180 degrees in phi: a sign is wrong": sectors + n // 2,
        "mirrored in x: a sign is wrong": n // 2 - 1 - sectors,
        "with x and y swapped": n // 4 - 1 - sectors,
        "turned by 90 degrees in phi: axes are swapped": sectors + n // 4,
        "turned by -90 degrees in phi: axes are swapped": sectors - n // 4,
    }
    changes = {
        "in the wrong hemisphere": due[::-1],
        "opposite to the right ones: a sign is wrong": np.roll(due[::-1], n // 2, 2),
    }
    changes |= {name: due[:, :, own % n] for name, own in sector_of.items()}
    off = {name: np.abs(drawn - other).sum() for name, other in changes.items()}
    off |= {
        # all of one lobe
        how and f"of half vectors {how}": 4 * np.abs(counts - maps.pdf).sum()
        for how, counts in _half_vectors_changed(bsdf, maps)
    }
    best = min(off, key=lambda name: off[name])
    if off[best] > 0.4 * min(misfit, off[""] / 4):
        return None
    light = np.sum([one.values for one in maps.due.channels], axis=0).reshape(shape)
    light /= light.sum()
    of_drawn, of_pdf = (np.abs(light - x / x.sum()).sum() for x in (drawn, due))
    if of_drawn < of_pdf / 2:
        return Counts.DENSITY_OF_TURNED(PDF, how=best)
    return Counts.TURNED(SAMPLE, how=best)


def _half_vectors_changed(
    bsdf: mi.BSDF, maps: FourMaps
) -> Iterator[tuple[str, Floats]]:
    """Changes of half vectors, with shares of the reflected directions by patch."""
    probe = Probe(bsdf, maps.condition)
    bs, _ = probe.sample(*uniform(N_REDRAWN, (0, 75)))
    wi = dr.opaque(mi.Vector3f, maps.condition.wi.tolist())
    given = dr.abs(dr.norm(bs.wo) - 1) < BSDF_ROUNDING
    half = dr.select(given, bs.wo, wi) + wi
    half /= dr.maximum(dr.norm(half), 1e-9)
    dr.eval(half, given)
    for how, change in CHANGES_OF_HALF_VECTORS.items():
        x, y = (dr.opaque(mi.Point2f, row.tolist()) for row in np.transpose(change))
        flat = mi.Point2f(half.x, half.y)
        h = mi.Vector3f(dr.dot(flat, x), dr.dot(flat, y), half.z)
        reflected = 2 * dr.dot(h, wi) * h - wi
        lit = numbers(given & (probe.pdf(reflected) > 0), N_REDRAWN)
        index = numbers(patch_of(maps.subdivision, maps.condition, reflected), len(lit))
        counts = np.bincount(index, lit, len(maps.pdf))
        yield how, counts / len(lit)


def _is_proportional(maps: FourMaps) -> bool:
    """Whether a constant factor explains the difference."""
    if abs(maps.count_scores.total) < 5:
        return False
    n, drawn, due = maps.totals.n, maps.totals.counts, maps.pdf
    expected = n * due * (drawn.sum() / n / due.sum()) if due.sum() > 0 else due
    enough = expected > MIN_HITS
    z = (drawn[enough] - expected[enough]) / np.sqrt(expected[enough])
    return bool(enough.any() and np.mean(z**2) < 1.5 and abs(z).max() < 6)


def _worst_patch(maps: FourMaps) -> str:
    """Text on the count and its expectation in the patch that is most off."""
    scores = maps.count_scores
    if not scores.z.size:
        return f"z of the sum {scores.total:+.1f}"
    group = int(np.abs(scores.z).argmax())
    ends = np.append(scores.first[1:], len(maps.pdf))
    own = np.arange(scores.first[group], ends[group])
    due = maps.totals.n * maps.pdf[own]
    # of its group the one that is most off
    off = np.abs(maps.totals.counts[own] - due) / np.sqrt(np.maximum(due, 1))
    k = int(own[off.argmax()])
    patches = maps.subdivision
    half, patch = divmod(k, patches.n_patches)
    i, j = divmod(patch, patches.n_phi)
    theta, phi = np.degrees(patches.theta[i]), np.degrees(patches.phi[j])
    where = "illuminated side" if half == 0 else "other side"
    drawn, expected = maps.totals.counts[k], maps.totals.n * maps.pdf[k]
    return (
        f"{drawn:.0f} where {expected:.1f} are expected "
        f"at theta_o {theta:.0f}, phi_o {phi:.0f} of the {where}, {maps.condition}"
    )


def _distortion(bsdf: mi.BSDF, whole: Sequence[FourMaps]) -> tuple[str, int] | None:
    """Name and power of the factor by which ``pdf`` is less than the true density.

    None if none fits.

    Over directions of the density ``pdf t``, the sum of 1 / t in a patch is the
    integral of ``pdf`` there: within chance on all patches of all maps.
    """
    scores: dict[tuple[str, int], list[Floats]] = {}
    for i, maps in enumerate(whole):
        samples = _redrawn(bsdf, maps.condition, i, 71)
        ok = samples.smooth
        index = patch_of(maps.subdivision, maps.condition, vectors(samples.wo[ok]))
        patch = numbers(index, int(ok.sum()))
        first = groups(N_REDRAWN * maps.pdf, MIN_HITS)
        if not first.size:
            continue
        due = N_REDRAWN * np.add.reduceat(maps.pdf, first)
        factors = {name: factor(name, samples, ok) for name in DISTORTIONS}
        for name, power in [("", 0), *product(DISTORTIONS, (1, -1))]:
            t = factors[name] ** -power if name else np.ones(len(patch))
            sums, squares = (
                np.add.reduceat(np.bincount(patch, x, len(maps.pdf)), first)
                for x in (t, t**2)
            )
            variance = np.maximum(squares - sums**2 / N_REDRAWN, 1)
            z_squared = (sums - due) ** 2 / variance
            scores.setdefault((name, power), []).append(z_squared)
    if not scores:
        return None
    misfit = {key: np.concatenate(z) for key, z in scores.items()}
    name, power = min(misfit, key=lambda key: float(np.mean(misfit[key])))
    least = misfit[name, power]
    better = float(np.sum(misfit["", 0]) - np.sum(least))
    if not name or np.mean(least) > MAX_MISFIT or better < MIN_ADVANTAGE:
        return None
    return name, power


def _by_lost_samples(samples: Samples, name: str, power: int) -> Function:
    """Whether the directions of lost samples show ``pdf`` or ``sample`` to be wrong.

    `sample` should lose none where ``pdf`` is not 0; else the lost ones are drawn with
    the same density as the others, by which ``pdf`` integrates to no more than 1.
    """
    directed = _directed(samples)
    if np.count_nonzero(directed) < MIN_DIRECTED * np.count_nonzero(~samples.given):
        return SAMPLE | PDF
    if directed.any() and np.mean(samples.pdf[directed] > 0) > 1 - MIN_DIRECTED:
        return SAMPLE
    by_pdf = np.zeros(samples.n)
    every = samples.smooth | directed
    by_pdf[every] = factor(name, samples, every) ** -power
    std_err = np.std(by_pdf) / np.sqrt(samples.n)
    return PDF if np.mean(by_pdf) - 1 > max(MAX_LOST, 5 * std_err) else SAMPLE | PDF
