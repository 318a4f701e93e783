"""From failed properties to the one function that explains them, and its mistake.

The table is read once, from above: the first row that fails and has an explanation
names the function. Where two answers about the same samples differ, the factor between
them tells the mistake (:mod:`.factors`); where counts and ``pdf`` differ, a factor of
`DISTORTIONS` may.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..single_precision import BSDF_ROUNDING
from .checks.components import alone, are_apart
from .evidence import EFFECTS, INTERFACE, MODEL, NOISE, Evidence, Question
from .factors import (
    FACTORS,
    OF_PDF,
    OF_SAMPLED_PDF,
    explain,
    explain_weights,
    factor,
    ratios_of,
)
from .maps import FourMaps
from .mistakes import PDF, SAMPLE, Function, Guess, Mistake
from .probe import numbers, vectors
from .samples import Samples, beyond_rounding, samples_of, unequal
from .tally import groups, patch_of

# Fraction of the share of the largest failure below which another is no symptom of it,
# but a smaller one beside it, and explains nothing.
MAX_MINOR = 0.2


class Diagnosis(Mistake):
    """What is wrong by all that fails together."""

    ANY = "`sample` or `eval` is wrong"
    NOT_DIVIDED_BY_CHANCE = """{who} weight lacks division by the probability with which
        a direction is not rejected"""
    ONE_COMPONENT = "{who} is that of component {component} alone"
    PLAIN_SUM = "{who} is the sum of its components', without the probability of each"
    TURNED = "{who} draws directions {how}"
    OUTSIDE = "{who} draws {part:.3g} of its directions where `pdf` is 0"
    NEVER_ON_A_SIDE = """{who} integrates to {mass:.3g} on a side where `sample` never
        goes, at {place}"""
    SIDE_LEFT_OUT = """{who} never goes to a side where `pdf` integrates to {mass:.3g}
        and `eval` is lit, at {place}"""
    LOST = """{who} gives no direction for {part:.4g} of its numbers, where `pdf`
        integrates to 1"""
    MASS = "{sums}"
    NOT_OF_SAMPLE = """{who} is not the density of `sample`, whose weights are right
        ({sums})"""
    OTHER_PROBABILITY = """{who}: directions are drawn with another probability than
        `pdf` says: {where}"""
    OTHER_LOBES = """{who} draws lobes or directions with another probability than `pdf`
        says: {where}"""
    OTHER_DIRECTIONS = """{who} draws directions with another probability than `pdf`
        says: {where}"""
    FACTOR_OF_PDF = "{who} {of_pdf} ({sums})"
    FACTOR_OF_SAMPLE = "{who}: its density {of_sample} ({sums})"
    FACTOR_OF_EITHER = "`pdf` {of_pdf}, or the density of `sample` {of_sample} ({sums})"


# What is left where nothing explains a failure.
ANY = Diagnosis.ANY(SAMPLE)


def likely_mistake(
    evidence: Evidence, failed: Mapping[str, str], shares: Mapping[str, float | None]
) -> Guess:
    """Likely guilty function and mistake.

    Parameters
    ----------
    evidence : Evidence
    failed, shares : dict
        Effect by name of property, and share of the light that it is about.
    """
    worst = min(failed.values(), key=EFFECTS.index)
    if not mi.is_polarized:
        own = {name: shares[name] for name in failed if failed[name] == worst}
        largest = max((x for x in own.values() if x is not None), default=0.0)
        minor = {n for n, x in own.items() if x is not None and x < MAX_MINOR * largest}
        if "weights" in failed and "sampled_weight" not in failed:
            # each weight is right where it was drawn: only counts explain a wrong mean
            minor.discard("sampling")
        failed = {name: effect for name, effect in failed.items() if name not in minor}

    def rank(one: Question) -> tuple[bool, int, int]:
        """What explains others first, but for a law that a model may choose."""
        chosen = worst == MODEL and one.name == "delta"
        return chosen, one.rank, EFFECTS.index(failed[one.name])

    questions = [one for one in evidence.questions if one.name in failed]
    if not mi.is_polarized:
        questions = [one for one in questions if failed[one.name] == worst]
    for question in sorted(questions, key=rank):
        if question.identity:
            return next(filter(None, (guess(evidence, failed) for guess in ODD)))
        if question.explain is not None:
            guess = question.explain(evidence)
        else:
            guess = evidence.guess(question.name) or evidence.suspect(question.name)
        if guess is not None:
            return guess
    return ANY


# ------------------------------------------------ what contradicts the other functions


def _noise(evidence: Evidence, failed: Mapping[str, str]) -> Guess | None:
    """Weights that make up for directions rejected at random, or should."""
    if failed.get("sampled_weight") != NOISE:
        return None
    if "weights" in failed:
        return Diagnosis.NOT_DIVIDED_BY_CHANCE(SAMPLE)
    noisy = [b for b in evidence.of("sampled_weight") if b.effect == NOISE]
    return noisy[0].guess


def _dark(evidence: Evidence, failed: Mapping[str, str]) -> Guess | None:
    """One of them is 0 where another is not."""
    return evidence.guess("weights") if "weights" in failed else None


def _unused(evidence: Evidence, failed: Mapping[str, str]) -> Guess | None:
    """A density where no light is."""
    harmless = failed.get("sampling") == INTERFACE
    return evidence.guess("sampling") if harmless else None


def _without_counts(evidence: Evidence, failed: Mapping[str, str]) -> Guess | None:
    """Where directions are drawn with the density of ``pdf``, as far as is known."""
    if "sampling" in failed:
        return None
    if "sampled_pdf" in failed:
        return explain(ratios_of(evidence, OF_SAMPLED_PDF), OF_SAMPLED_PDF)
    if "weights" in failed and not evidence.of("sampled_weight"):
        return _counts_guess(evidence, weights_fail=True)
    return explain_weights(evidence, failed)


def _density(evidence: Evidence, failed: Mapping[str, str]) -> Guess | None:
    """A factor of ``pdf``, where `sample` returns another one and weights are right."""
    if "sampled_weight" in failed or "weights" in failed:
        return None
    wrong = evidence.of("sampled_pdf")
    return explain(ratios_of(evidence, OF_PDF), OF_PDF) if wrong else None


def _counts(evidence: Evidence, failed: Mapping[str, str]) -> Guess:
    """Directions against ``pdf``."""
    # a weight that is `eval` over a wrong `pdf` is wrong, too
    by_pdf = not (evidence.of("sampled_weight") or evidence.of("sampled_pdf"))
    return _counts_guess(evidence, by_pdf or "weights" in failed)


def _lobes(evidence: Evidence, _: Mapping[str, str]) -> Guess | None:
    """How ``pdf`` combines its components wrongly; None if it is their mixture."""
    samples = evidence.whole[0]
    if evidence.bsdf.component_count() < 2 or not samples.smooth.any():
        return None
    each = alone(evidence, samples)

    def is_it(density: Floats) -> bool:
        differs = unequal(density, samples.pdf, samples.pdf_slack) & samples.smooth
        return not beyond_rounding(differs)

    if not are_apart(evidence.bsdf, samples, each):
        return None  # no component can be asked alone
    own = [i for i, density in enumerate(each.pdf) if is_it(density)]
    if len(own) == 1:
        return Diagnosis.ONE_COMPONENT(PDF, component=own[0])
    whole = not own and is_it(each.pdf.sum(axis=0))
    return Diagnosis.PLAIN_SUM(PDF) if whole else None


# What is asked in turn; the first that knows tells.
ODD = (_noise, _dark, _unused, _without_counts, _lobes, _density, _counts)


# --------------------------------------------------- directions that are not of `pdf`

# Samples whose factors are summed up by patch, and hits due of a group of patches.
N_REDRAWN = 2**18
MIN_HITS = 200

# Mean squared score of a factor that explains a density, where 1 is due; and by how
# much the sum of squares must be less than without: chance gives a wrong one of the 16
# factors an advantage of 50, a ratio of likelihoods of exp(25), hardly ever.
MAX_MISFIT = 1.5
MIN_ADVANTAGE = 50

# Mean squared score, and the square of that of the sum, that chance explains.
MAX_CHANCE = 16

# Fraction of the samples that may be lost, or by which an integral may be off.
MAX_LOST = 1e-3

# Fraction of the lost samples that must have a direction for these to tell: of a right
# `sample` at most the rest are where `pdf` is not 0.
MIN_DIRECTED = 0.9

# Factors that may distort a density.
DISTORTIONS = ("cos_o", "jacobian", "dot", "cos_h", "sin_o", "two", "pi", "four")


@dataclass(frozen=True)
class _Counted:
    """Directions that were counted in maps, all of the `whole` or one the worst.

    Where `weights_fail`, these are not those of the true density.
    """

    evidence: Evidence
    whole: Sequence[FourMaps]
    maps: FourMaps
    weights_fail: bool

    @property
    def drawn(self) -> Floats:
        """Share of the samples, by patch."""
        return self.maps.totals.counts / self.maps.totals.n

    @property
    def sums(self) -> str:
        """Text on the integral of ``pdf`` and the share that it should equal."""
        share = self.drawn.sum()
        std_err = np.sqrt(max(share * (1 - share), 0) / self.maps.totals.n)
        return (
            f"`pdf` integrates to {self.maps.pdf.sum():.4f}, where it should equal the "
            f"sampled mass of {share:.4f} +- {std_err:.1g} (std_err)"
        )


def _counts_guess(evidence: Evidence, weights_fail: bool) -> Guess:
    """Function and mistake, where counted directions contradict ``pdf``."""
    whole = [m for m in evidence.maps if m.condition.component is None]
    suspect = evidence.suspect("sampling")
    if not whole:
        return suspect or ANY
    # one component says less, unless it is all that is wrong
    maps = max(whole, key=_misfit)
    if _misfit(maps) < MAX_CHANCE:
        maps = max(evidence.maps, key=_misfit)
    if suspect and _misfit(maps) < MAX_CHANCE:
        # only in a band or sector of incidence, that maps have not met
        return suspect
    counted = _Counted(evidence, whole, maps, weights_fail)
    return next(filter(None, (guess(counted) for guess in OF_COUNTS)))


def _as_turned(counted: _Counted) -> Guess | None:
    """Directions that are turned or mirrored."""
    how = next(filter(None, map(_turned, counted.evidence.maps)), "")
    return Diagnosis.TURNED(SAMPLE, how=how) if how else None


def _outside(counted: _Counted) -> Guess | None:
    """Directions where ``pdf`` is 0."""
    outside = counted.drawn[counted.maps.pdf < 1e-6].sum()
    some = outside > 0.02 * counted.drawn.sum()
    return Diagnosis.OUTSIDE(SAMPLE, part=outside) if some else None


def _beside(counted: _Counted) -> Guess | None:
    """Directions that never go to a side.

    ``eval`` is lit there: it is ``pdf`` only if no probability is left for that side.
    """
    maps, drawn, due = counted.maps, counted.drawn, counted.maps.pdf
    never = due.reshape(2, -1)[drawn.reshape(2, -1).sum(axis=1) == 0].sum()
    if never < 1e-3:
        return None
    bsdf = counted.evidence.bsdf
    samples = samples_of(bsdf, maps.condition, N_REDRAWN, (0, 72))
    complete = samples.given.mean() > 1 - MAX_LOST
    where = {"mass": never, "place": maps.condition}
    if complete and due.sum() - drawn.sum() > never / 2:
        return Diagnosis.NEVER_ON_A_SIDE(PDF, **where)
    return Diagnosis.SIDE_LEFT_OUT(SAMPLE, **where)


def _lost(counted: _Counted) -> Guess | None:
    """Samples without a direction, where ``pdf`` leaves none out."""
    missing = 1 - float(counted.drawn.sum())
    complete = abs(_mass_of_pdf(counted.maps) - 1) < MAX_LOST < missing
    if complete and counted.maps.count_scores.total < -5:
        return Diagnosis.LOST(SAMPLE, part=missing)
    return None


def _unnormalised(counted: _Counted) -> Guess | None:
    """A density with a constant factor, or of more than all."""
    if counted.maps.pdf.sum() > 1.001 or _is_proportional(counted.maps):
        return Diagnosis.MASS(PDF, sums=counted.sums)
    return None


def _of_right_weights(counted: _Counted) -> Guess | None:
    """A density that right weights do not have."""
    right = not counted.weights_fail
    return Diagnosis.NOT_OF_SAMPLE(PDF, sums=counted.sums) if right else None


def _otherwise(counted: _Counted) -> Guess:
    """Directions that are drawn with another probability."""
    where = f"{_worst_patch(counted.maps)} ({counted.sums})"
    samples = counted.evidence.samples
    lobes = {int(c) for s in samples for c in np.unique(s.component[s.smooth])}
    if len(lobes) > 1:
        return Diagnosis.OTHER_LOBES(SAMPLE, where=where)
    if lobes and abs(_mass_of_pdf(counted.maps) - 1) > MAX_LOST:
        # a density that is not complete may be the wrong one as well
        return Diagnosis.OTHER_PROBABILITY(SAMPLE | PDF, where=where)
    return Diagnosis.OTHER_DIRECTIONS(SAMPLE, where=where)


def _misfit(maps: FourMaps) -> float:
    """Mean squared score of the counts, plus the square of that of their sum."""
    scores = maps.count_scores
    return float(np.sum(scores.z**2)) / max(len(scores.z), 1) + scores.total**2


def _mass_of_pdf(maps: FourMaps) -> float:
    """Integral of ``pdf``, also where ``eval`` is black."""
    return float(maps.pdf.sum() + maps.due.unused.values.sum())


def _turned(maps: FourMaps) -> str:
    """How the counted map is turned or mirrored against the density; empty if not."""
    shape, n = (2, *maps.subdivision.shape), maps.subdivision.n_phi
    drawn = (maps.totals.counts / maps.totals.n).reshape(shape)
    due = maps.pdf.reshape(shape)
    misfit = np.abs(drawn - due).sum()
    # where chance explains it, there is nothing to turn
    if misfit < 4 * np.sqrt(drawn.size / maps.totals.n):
        return ""
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
        "opposite to those of `pdf`: a sign is wrong": np.roll(due[::-1], n // 2, 2),
    }
    changes |= {name: due[:, :, own % n] for name, own in sector_of.items()}
    off = {name: np.abs(drawn - other).sum() for name, other in changes.items()}
    best = min(off, key=lambda name: off[name])
    return best if off[best] < 0.4 * misfit else ""


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
    where = "lit side" if half == 0 else "other side"
    return (
        f"{maps.totals.counts[k]:.0f} where {maps.totals.n * maps.pdf[k]:.1f} are due "
        f"at theta_o {theta:.0f}, phi_o {phi:.0f} of the {where}, {maps.condition}"
    )


def _distorted(counted: _Counted) -> Guess | None:
    """Which of ``pdf`` and ``sample`` has a factor that the other has not.

    Right weights are those of the true density: then ``pdf`` is wrong. So it is if it
    integrates to more than 1, or to less though every number gives a direction; where
    it integrates to 1 and directions are lost, ``sample`` is. Else those that are lost
    may tell, or either may be wrong.
    """
    whole, bsdf = counted.whole, counted.evidence.bsdf
    found = _distortion(bsdf, whole)
    if found is None:
        return None
    name, power = found
    words = (f"lacks {FACTORS[name]}", f"has {FACTORS[name]} too much")
    of_pdf, of_sample = words if power > 0 else reversed(words)
    by_pdf = np.array([_mass_of_pdf(maps) for maps in whole])
    drawn = [maps.totals.counts.sum() / maps.totals.n for maps in whole]
    lost = any(1 - mass > MAX_LOST for mass in drawn)
    complete = bool((abs(by_pdf - 1) < MAX_LOST).all())
    guilty = PDF
    if counted.weights_fail and complete and lost:
        guilty = SAMPLE
    elif counted.weights_fail and (complete or lost) and (by_pdf < 1 + MAX_LOST).all():
        samples = samples_of(bsdf, whole[0].condition, N_REDRAWN, (0, 71))
        guilty = _by_lost_samples(samples, name, power)
    mistake = {
        PDF: Diagnosis.FACTOR_OF_PDF,
        SAMPLE: Diagnosis.FACTOR_OF_SAMPLE,
        SAMPLE | PDF: Diagnosis.FACTOR_OF_EITHER,
    }[guilty]
    return mistake(guilty, of_pdf=of_pdf, of_sample=of_sample, sums=counted.sums)


# What is asked in turn of counts; the first that knows tells.
OF_COUNTS = (
    *(_as_turned, _outside, _beside, _distorted, _lost, _unnormalised),
    *(_of_right_weights, _otherwise),
)


def _distortion(bsdf: mi.BSDF, whole: Sequence[FourMaps]) -> tuple[str, int] | None:
    """Name and power of the factor by which ``pdf`` is less than the true density.

    None if none fits.

    Over directions of the density ``pdf t``, the sum of 1 / t in a patch is the
    integral of ``pdf`` there: within chance on all patches of all maps.
    """
    scores: dict[tuple[str, int], list[Floats]] = {}
    for i, maps in enumerate(whole):
        samples = samples_of(bsdf, maps.condition, N_REDRAWN, (i, 71))
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
    length = np.linalg.norm(samples.wo, axis=1)
    lost = ~samples.given
    directed = lost & (np.abs(length - 1) < BSDF_ROUNDING)
    if np.count_nonzero(directed) < MIN_DIRECTED * np.count_nonzero(lost):
        return SAMPLE | PDF
    if directed.any() and np.mean(samples.pdf[directed] > 0) > 1 - MIN_DIRECTED:
        return SAMPLE
    by_pdf = np.zeros(samples.n)
    every = samples.smooth | directed
    by_pdf[every] = factor(name, samples, every) ** -power
    std_err = np.std(by_pdf) / np.sqrt(samples.n)
    return PDF if np.mean(by_pdf) - 1 > max(MAX_LOST, 5 * std_err) else SAMPLE | PDF
