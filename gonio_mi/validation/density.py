"""Directions that are not drawn with the density of ``pdf``, and who is wrong."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import product

import mitsuba as mi
import numpy as np

from ..array_types import Floats
from .collecting import Drawn, collect
from .damping import groups
from .drawing import patch_of
from .equality import BSDF_ROUNDING
from .evidence import Evidence
from .maps import FourMaps
from .probe import numbers
from .ratios import FACTORS, factor

__all__ = ["explain_density"]

# Samples whose factors are summed up by patch, and hits due of a group of patches.
REDRAWN = 2**18
ENOUGH = 200

# Mean squared score of a factor that explains a density, where 1 is due; and by how
# much the sum of squares must be less than without: chance gives a wrong one of the 16
# factors an advantage of 50, a ratio of likelihoods of exp(25), hardly ever.
EXPLAINED = 1.5
BETTER = 50

# Mean squared score, and the square of that of the sum, that chance explains.
FITS = 16

# Part of the samples that is lost.
LOST = 1e-3

# Where nothing tells; and the part of the lost samples that must have a direction for
# these to tell: of a right `sample` at most the rest are where `pdf` is not 0.
BOTH, TOLD = "pdf or sample", 0.9

# What may distort a density.
DISTORTIONS = ("cos_o", "jacobian", "dot", "cos_h", "sin_o", "two", "pi", "four")


def explain_density(
    evidence: Evidence, failed: Collection[str], bsdf: mi.BSDF
) -> tuple[str, str]:
    """Return function and mistake, where counted directions contradict ``pdf``."""
    whole = [m for m in evidence.maps if m.condition.component is None]
    # one component says less, unless it is all that is wrong
    maps = max(whole, key=_misfit)
    if _misfit(maps) < FITS:
        maps = max(evidence.maps, key=_misfit)
    turned = next(filter(None, map(_turned, evidence.maps)), "")
    n = maps.totals.n
    drawn, due = maps.totals.counts / n, maps.pdf
    sums = f"`pdf` integrates to {due.sum():.4f}, sampled mass is {drawn.sum():.4f}"
    outside = drawn[due < 1e-6].sum()
    if turned:
        return "sample", f"`sample` draws directions {turned}"
    if outside > 0.02 * drawn.sum():
        return (
            "sample",
            f"`sample` draws {outside:.3g} of its directions where `pdf` is 0",
        )
    sides = zip(drawn.reshape(2, -1).sum(axis=1), due.reshape(2, -1).sum(axis=1))
    never = sum(integral for counts, integral in sides if counts == 0)
    if never > 1e-3:
        return "pdf", (
            f"`pdf` integrates to {never:.3g} on a side where `sample` never goes, "
            f"at {maps.condition}"
        )
    distortion = _distortion(whole, bsdf)
    if distortion:
        return _of_distortion(distortion, whole, bsdf, "weights" in failed, sums)
    integral = _mass_of_pdf(maps)
    if abs(integral - 1) < LOST < 1 - drawn.sum() and maps.count_scores.total < -5:
        return "sample", (
            f"`sample` gives no direction for {1 - drawn.sum():.4g} of its numbers, "
            "where `pdf` integrates to 1"
        )
    if due.sum() > 1.001 or _is_proportional(maps):
        return "pdf", sums
    if "weights" not in failed:
        return "pdf", (
            f"`pdf` is not the density of `sample`, whose weights are right ({sums})"
        )
    lobes = {int(c) for d in evidence.drawn for c in np.unique(d.component[d.smooth])}
    where = f"{_worst_patch(maps)} ({sums})"
    if len(lobes) == 1 and abs(integral - 1) > LOST:
        # a density that is not complete may be the wrong one as well
        return BOTH, (
            "`sample` or `pdf`: directions are drawn with another probability than "
            f"`pdf` says: {where}"
        )
    what = "lobes or directions" if len(lobes) > 1 else "directions"
    return "sample", (
        f"`sample` draws {what} with another probability than `pdf` says: {where}"
    )


def _of_distortion(
    distortion: tuple[str, int],
    whole: Sequence[FourMaps],
    bsdf: mi.BSDF,
    weights_fail: bool,
    sums: str,
) -> tuple[str, str]:
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
    lost = any(1 - maps.totals.counts.sum() / maps.totals.n > LOST for maps in whole)
    complete = bool((abs(by_pdf - 1) < LOST).all())
    guilty = "pdf"
    if weights_fail and complete and lost:
        guilty = "sample"
    elif weights_fail and (complete or lost) and (by_pdf < 1 + LOST).all():
        guilty = _of_lost(
            collect(bsdf, whole[0].condition, REDRAWN, (0, 71)), *distortion
        )
    return guilty, {
        "pdf": f"`pdf` {of_pdf} ({sums})",
        "sample": f"`sample`: its density {of_sample} ({sums})",
        BOTH: f"`pdf` {of_pdf}, or the density of `sample` {of_sample} ({sums})",
    }[guilty]


def _of_lost(drawn: Drawn, name: str, power: int) -> str:
    """Which of ``pdf`` and ``sample`` the directions of lost samples speak against.

    `sample` should lose none where ``pdf`` is not 0; else the lost ones are drawn with
    the same density as the others, by which ``pdf`` integrates to no more than 1.
    """
    length = np.linalg.norm(drawn.wo, axis=1)
    lost = ~drawn.given
    told = lost & (np.abs(length - 1) < BSDF_ROUNDING)
    if np.count_nonzero(told) < TOLD * np.count_nonzero(lost):
        return BOTH
    if told.any() and np.mean(drawn.pdf[told] > 0) > 1 - TOLD:
        return "sample"
    by_pdf = np.zeros(drawn.n)
    every = drawn.smooth | told
    by_pdf[every] = factor(name, drawn, every) ** -power
    std_err = np.std(by_pdf) / np.sqrt(drawn.n)
    return "pdf" if np.mean(by_pdf) - 1 > max(LOST, 5 * std_err) else BOTH


def _mass_of_pdf(maps: FourMaps) -> float:
    """Integral of ``pdf``, also where ``eval`` is black."""
    return float(maps.pdf.sum() + maps.due.unused.values.sum())


def _misfit(maps: FourMaps) -> float:
    """Distance of counted and due, weighed by what chance explains."""
    scores = maps.count_scores
    return float(np.sum(scores.z**2)) / max(len(scores.z), 1) + scores.total**2


def _worst_patch(maps: FourMaps) -> str:
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


def _is_proportional(maps: FourMaps) -> bool:
    """Whether a constant factor explains the difference."""
    if abs(maps.count_scores.total) < 5:
        return False
    n, drawn, due = maps.totals.n, maps.totals.counts, maps.pdf
    expected = n * due * (drawn.sum() / n / due.sum()) if due.sum() > 0 else due
    enough = expected > ENOUGH
    z = (drawn[enough] - expected[enough]) / np.sqrt(expected[enough])
    return bool(enough.any() and np.mean(z**2) < 1.5 and abs(z).max() < 6)


def _turned(maps: FourMaps) -> str:
    """How the counted map is turned or mirrored against the density; empty if not."""
    patches = maps.subdivision
    shape = (2, *patches.shape)
    drawn = (maps.totals.counts / maps.totals.n).reshape(shape)
    due = maps.pdf.reshape(shape)
    misfit = np.abs(drawn - due).sum()
    # where chance explains it, there is nothing to turn
    if misfit < 4 * np.sqrt(drawn.size / maps.totals.n):
        return ""
    n = patches.n_phi
    columns = np.arange(n)
    changes = {
        "in the wrong hemisphere": due[::-1],
        "mirrored in phi: a sign is wrong": due[:, :, (-1 - columns) % n],
        "turned by 180 degrees in phi: a sign is wrong": due[
            :, :, (columns + n // 2) % n
        ],
        "mirrored in x: a sign is wrong": due[:, :, (n // 2 - 1 - columns) % n],
        "with x and y swapped": due[:, :, (n // 4 - 1 - columns) % n],
        "turned by 90 degrees in phi: axes are swapped": due[
            :, :, (columns + n // 4) % n
        ],
        "turned by -90 degrees in phi: axes are swapped": due[
            :, :, (columns - n // 4) % n
        ],
    }
    best = min(changes, key=lambda name: np.abs(drawn - changes[name]).sum())
    return best if np.abs(drawn - changes[best]).sum() < 0.4 * misfit else ""


def _distortion(whole: Sequence[FourMaps], bsdf: mi.BSDF) -> tuple[str, int] | None:
    """Name and power of the factor by which ``pdf`` is less than the true density.

    None if none fits.

    Over directions of the density ``pdf t``, the sum of 1 / t in a patch is the
    integral of ``pdf`` there: within chance on all patches of all maps.
    """
    scores: dict[tuple[str, int], list[Floats]] = {}
    for i, maps in enumerate(whole):
        drawn = collect(bsdf, maps.condition, REDRAWN, (i, 71))
        ok = drawn.smooth
        wo = mi.Vector3f(drawn.wo[ok].T)
        patch = numbers(patch_of(maps.subdivision, maps.condition, wo), int(ok.sum()))
        first = groups(REDRAWN * maps.pdf, ENOUGH)
        if not first.size:
            continue
        due = REDRAWN * np.add.reduceat(maps.pdf, first)
        for name, power in [("", 0), *product(DISTORTIONS, (1, -1))]:
            t = factor(name, drawn, ok) ** -power if name else np.ones(len(patch))
            sums, squares = (
                np.add.reduceat(np.bincount(patch, x, len(maps.pdf)), first)
                for x in (t, t**2)
            )
            variance = np.maximum(squares - sums**2 / REDRAWN, 1)
            z_squared = (sums - due) ** 2 / variance
            scores.setdefault((name, power), []).append(z_squared)
    if not scores:
        return None
    misfit = {key: np.concatenate(z) for key, z in scores.items()}
    name, power = min(misfit, key=lambda key: float(np.mean(misfit[key])))
    least = misfit[name, power]
    better = float(np.sum(misfit["", 0]) - np.sum(least))
    if not name or np.mean(least) > EXPLAINED or better < BETTER:
        return None
    return name, power
