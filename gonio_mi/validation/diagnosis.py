"""From failed properties to the one function that explains them, and its mistake.

The table is read once, from above: the first row that fails and has an explanation
names the function. Where two answers about the same samples differ, the factor between
them tells the mistake (:mod:`.factors`); where counts and ``pdf`` differ, a factor of
`DISTORTIONS` may.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import TypeAlias

import numpy as np

from ..array_types import Floats
from ..single_precision import BSDF_ROUNDING
from .checks.components import alone, are_apart
from .evidence import EFFECTS, INTERFACE, MODEL, NOISE, Evidence
from .factors import FACTORS, explain, explain_weights, factor, ratios_of
from .maps import FourMaps
from .probe import numbers, vectors
from .samples import Samples, beyond_rounding, samples_of, unequal
from .tally import groups, patch_of

# Fraction of the share of the largest failure below which another is no symptom of it,
# but a smaller one beside it, and explains nothing.
MAX_MINOR = 0.2

# Guilty function, and mistake.
Guess: TypeAlias = "tuple[str, str]"

# What is left where nothing explains a failure.
ANY = "sample", "`sample` or `eval` is wrong"


def likely_mistake(
    evidence: Evidence,
    failed: Mapping[str, str],
    shares: Mapping[str, float | None],
) -> Guess:
    """Likely guilty function and mistake.

    Parameters
    ----------
    evidence : Evidence
    failed, shares : dict
        Effect by name of property, and share of the light that it is about.

    Returns
    -------
    function, mistake : str
    """
    worst = min(failed.values(), key=EFFECTS.index)
    own = {name: shares[name] for name in failed if failed[name] == worst}
    largest = max((x for x in own.values() if x is not None), default=0.0)
    minor = {n for n, x in own.items() if x is not None and x < MAX_MINOR * largest}
    if "weights" in failed and "sampled_weight" not in failed:
        # each weight is right where it was drawn: only counts explain a wrong mean
        minor.discard("sampling")
    failed = {name: effect for name, effect in failed.items() if name not in minor}
    names = [name for name in EXPLAINED_BY if failed.get(name) == worst]
    if worst == MODEL:
        # a law that a model may choose
        names.sort(key=lambda name: name == "delta")
    for name in names:
        found = EXPLAINED_BY[name](evidence, failed, name)
        if found is not None:
            return found
    return ANY


def _worst_breach_guess(
    evidence: Evidence, _: Mapping[str, str], name: str
) -> Guess | None:
    """Guess by the worst breach of a property."""
    worst = evidence.worst(name)
    if name == "eval_pdf_sample":
        # a mistake of eval_pdf explains both
        worst = next(iter(evidence.of("eval_pdf")), worst)
    if worst is None and name == "parameters":
        return evidence.suspects.get(name, ANY)
    if worst is None and name == "delta":
        return "sample", "`sample`: the pdf of a discrete lobe is not its probability"
    return None if worst is None else (worst.function, worst.mistake)


def _energy_guess(evidence: Evidence, _: Mapping[str, str], __: str) -> Guess:
    """Guess whether ``eval`` or the weights of discrete lobes gain or lose light."""
    totals = [m.smooth_flux.max() + m.totals.delta_mean.max() for m in evidence.maps]
    discrete = any(m.totals.delta_mean.max() > 1 + 1e-4 for m in evidence.maps)
    weights = [b for b in evidence.of("components") if b.function == "sample"]
    mixed = any(m.totals.delta_mean.any() for m in evidence.maps)
    if weights and mixed and not discrete:
        return "sample", weights[0].mistake
    function = "sample" if discrete else "eval"
    most = max(totals, default=1.0)
    if most < 1:  # a phase function, which absorbs nothing
        return function, f"`{function}` loses light: {min(totals):.4g} of it leaves"
    return function, f"`{function}` gains light: {most:.4g} of it leaves"


def _odd_function_guess(
    evidence: Evidence, failed: Mapping[str, str], _: str
) -> Guess | None:
    """Guess which of ``sample``, ``pdf`` and ``eval`` contradicts the two others."""
    if failed.get("sampled_weight") == NOISE:
        if "weights" not in failed:
            noisy = [b for b in evidence.of("sampled_weight") if b.effect == NOISE]
            return noisy[0].function, noisy[0].mistake
        return "sample", (
            "`sample` weight lacks division by the probability with which a direction "
            "is not rejected"
        )
    dark = _worst_breach_guess(evidence, failed, "weights")
    if dark and "weights" in failed:
        # one of them is 0 where another is not
        return dark
    excess = _worst_breach_guess(evidence, failed, "sampling")
    if excess and failed.get("sampling") == INTERFACE:
        return excess
    if "sampling" not in failed:
        if "sampled_pdf" in failed:
            return "sample", explain(ratios_of(evidence, "sampled_pdf"), "sampled_pdf")
        if "weights" in failed and not evidence.of("sampled_weight"):
            return _counts_guess(evidence, weights_fail=True)
        return explain_weights(evidence, failed)
    lobes = _lobes(evidence)
    if lobes:
        return "pdf", f"`pdf` {lobes}"
    wrong_weights = "sampled_weight" in failed or "weights" in failed
    if evidence.of("sampled_pdf") and not wrong_weights:
        return "pdf", explain(ratios_of(evidence, "pdf"), "pdf")
    # a weight that is `eval` over a wrong `pdf` is wrong, too
    by_pdf = not (evidence.of("sampled_weight") or evidence.of("sampled_pdf"))
    return _counts_guess(evidence, by_pdf or "weights" in failed)


# What is looked at first explains what comes later.
EXPLAINED_BY: dict[str, Callable[[Evidence, Mapping[str, str], str], Guess | None]] = {
    "answers": _worst_breach_guess,
    "directions": _worst_breach_guess,
    "delta": _worst_breach_guess,
    "sampling": _odd_function_guess,
    "sampled_pdf": _odd_function_guess,
    "sampled_weight": _odd_function_guess,
    "weights": _odd_function_guess,
    "eval_pdf": _worst_breach_guess,
    "eval_pdf_sample": _worst_breach_guess,
    "energy": _energy_guess,
    "continuity": _worst_breach_guess,
    "reciprocity": _worst_breach_guess,
    "adjoint": _worst_breach_guess,
    "flags": _worst_breach_guess,
    "masks": _worst_breach_guess,
    "components": _worst_breach_guess,
    "ends": _worst_breach_guess,
    "parameters": _worst_breach_guess,
}


def _lobes(evidence: Evidence) -> str:
    """How ``pdf`` combines its components wrongly; empty if it is their mixture."""
    samples = evidence.whole[0]
    if evidence.bsdf.component_count() < 2 or not samples.smooth.any():
        return ""
    each = alone(evidence, samples)

    def is_it(density: Floats) -> bool:
        differs = unequal(density, samples.pdf, samples.pdf_slack) & samples.smooth
        return not beyond_rounding(differs)

    if not are_apart(evidence.bsdf, samples, each):
        return ""  # no component can be asked alone
    own = [i for i, density in enumerate(each.pdf) if is_it(density)]
    if len(own) == 1:
        return f"is that of component {own[0]} alone"
    if not own and is_it(each.pdf.sum(axis=0)):
        return "is the sum of its components', without the probability of each"
    return ""


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

# Guilty where nothing tells.
EITHER = "pdf or sample"

# Factors that may distort a density.
DISTORTIONS = ("cos_o", "jacobian", "dot", "cos_h", "sin_o", "two", "pi", "four")


def _sums_text(due: float, share: float, n: int) -> str:
    """Text on the integral of ``pdf`` and the share of `n` samples it should equal."""
    std_err = np.sqrt(max(share * (1 - share), 0) / n)
    return (
        f"`pdf` integrates to {due:.4f}, where it should equal the sampled mass of "
        f"{share:.4f} +- {std_err:.1g} (std_err)"
    )


def _counts_guess(evidence: Evidence, weights_fail: bool) -> Guess:
    """Function and mistake, where counted directions contradict ``pdf``."""
    whole = [m for m in evidence.maps if m.condition.component is None]
    if not whole:
        return evidence.suspects.get("sampling", ANY)
    # one component says less, unless it is all that is wrong
    maps = max(whole, key=_misfit)
    if _misfit(maps) < MAX_CHANCE:
        maps = max(evidence.maps, key=_misfit)
    if _misfit(maps) < MAX_CHANCE and "sampling" in evidence.suspects:
        # only in a band or sector of incidence, that maps have not met
        return evidence.suspects["sampling"]
    n = maps.totals.n
    drawn, due = maps.totals.counts / n, maps.pdf
    sums = _sums_text(due.sum(), drawn.sum(), n)
    turned = next(filter(None, map(_turned, evidence.maps)), "")
    if turned:
        return "sample", f"`sample` draws directions {turned}"
    outside = drawn[due < 1e-6].sum()
    if outside > 0.02 * drawn.sum():
        return (
            "sample",
            f"`sample` draws {outside:.3g} of its directions where `pdf` is 0",
        )
    by_side = _guess_of_a_side(evidence, maps)
    if by_side:
        return by_side
    distortion = _distortion(evidence, whole)
    if distortion:
        return _distortion_guess(evidence, distortion, whole, weights_fail, sums)
    integral, missing = _mass_of_pdf(maps), 1 - drawn.sum()
    if abs(integral - 1) < MAX_LOST < missing and maps.count_scores.total < -5:
        return "sample", (
            f"`sample` gives no direction for {missing:.4g} of its numbers, "
            "where `pdf` integrates to 1"
        )
    if due.sum() > 1.001 or _is_proportional(maps):
        return "pdf", sums
    if not weights_fail:
        return "pdf", (
            f"`pdf` is not the density of `sample`, whose weights are right ({sums})"
        )
    where = f"{_worst_patch(maps)} ({sums})"
    lobes = {int(c) for s in evidence.samples for c in np.unique(s.component[s.smooth])}
    if len(lobes) == 1 and abs(integral - 1) > MAX_LOST:
        # a density that is not complete may be the wrong one as well
        return EITHER, (
            "`sample` or `pdf`: directions are drawn with another probability than "
            f"`pdf` says: {where}"
        )
    what = "lobes or directions" if len(lobes) > 1 else "directions"
    return "sample", (
        f"`sample` draws {what} with another probability than `pdf` says: {where}"
    )


def _guess_of_a_side(evidence: Evidence, maps: FourMaps) -> Guess | None:
    """Function and mistake if directions never go to a side; None if they do.

    ``eval`` is lit there: it is ``pdf`` only if no probability is left for that side.
    """
    drawn, due = maps.totals.counts.reshape(2, -1) / maps.totals.n, maps.pdf
    never = due.reshape(2, -1)[drawn.sum(axis=1) == 0].sum()
    if never < 1e-3:
        return None
    samples = samples_of(evidence.bsdf, maps.condition, N_REDRAWN, (0, 72))
    complete = samples.given.mean() > 1 - MAX_LOST
    if complete and due.sum() - drawn.sum() > never / 2:
        return "pdf", (
            f"`pdf` integrates to {never:.3g} on a side where `sample` never goes, "
            f"at {maps.condition}"
        )
    return "sample", (
        f"`sample` never goes to a side where `pdf` integrates to {never:.3g} and "
        f"`eval` is lit, at {maps.condition}"
    )


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


def _distortion(
    evidence: Evidence, whole: Sequence[FourMaps]
) -> tuple[str, int] | None:
    """Name and power of the factor by which ``pdf`` is less than the true density.

    None if none fits.

    Over directions of the density ``pdf t``, the sum of 1 / t in a patch is the
    integral of ``pdf`` there: within chance on all patches of all maps.
    """
    scores: dict[tuple[str, int], list[Floats]] = {}
    for i, maps in enumerate(whole):
        samples = samples_of(evidence.bsdf, maps.condition, N_REDRAWN, (i, 71))
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


def _distortion_guess(
    evidence: Evidence,
    distortion: tuple[str, int],
    whole: Sequence[FourMaps],
    weights_fail: bool,
    sums: str,
) -> Guess:
    """Which of ``pdf`` and ``sample`` has a factor that the other has not.

    Right weights are those of the true density: then ``pdf`` is wrong. So it is if it
    integrates to more than 1, or to less though every number gives a direction; where
    it integrates to 1 and directions are lost, ``sample`` is. Else those that are lost
    may tell, or either may be wrong.
    """
    name, power = distortion
    words = (f"lacks {FACTORS[name]}", f"has {FACTORS[name]} too much")
    of_pdf, of_sample = words if power > 0 else reversed(words)
    by_pdf = np.array([_mass_of_pdf(maps) for maps in whole])
    counted = [maps.totals.counts.sum() / maps.totals.n for maps in whole]
    lost = any(1 - mass > MAX_LOST for mass in counted)
    complete = bool((abs(by_pdf - 1) < MAX_LOST).all())
    guilty = "pdf"
    if weights_fail and complete and lost:
        guilty = "sample"
    elif weights_fail and (complete or lost) and (by_pdf < 1 + MAX_LOST).all():
        samples = samples_of(evidence.bsdf, whole[0].condition, N_REDRAWN, (0, 71))
        guilty = _by_lost_samples(samples, *distortion)
    return guilty, {
        "pdf": f"`pdf` {of_pdf} ({sums})",
        "sample": f"`sample`: its density {of_sample} ({sums})",
        EITHER: f"`pdf` {of_pdf}, or the density of `sample` {of_sample} ({sums})",
    }[guilty]


def _by_lost_samples(samples: Samples, name: str, power: int) -> str:
    """Whether the directions of lost samples show ``pdf`` or ``sample`` to be wrong.

    `sample` should lose none where ``pdf`` is not 0; else the lost ones are drawn with
    the same density as the others, by which ``pdf`` integrates to no more than 1.
    """
    length = np.linalg.norm(samples.wo, axis=1)
    lost = ~samples.given
    directed = lost & (np.abs(length - 1) < BSDF_ROUNDING)
    if np.count_nonzero(directed) < MIN_DIRECTED * np.count_nonzero(lost):
        return EITHER
    if directed.any() and np.mean(samples.pdf[directed] > 0) > 1 - MIN_DIRECTED:
        return "sample"
    by_pdf = np.zeros(samples.n)
    every = samples.smooth | directed
    by_pdf[every] = factor(name, samples, every) ** -power
    std_err = np.std(by_pdf) / np.sqrt(samples.n)
    return "pdf" if np.mean(by_pdf) - 1 > max(MAX_LOST, 5 * std_err) else EITHER
