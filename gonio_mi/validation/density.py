"""Directions that are not drawn with the density of ``pdf``, and who is wrong."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import product

import mitsuba as mi
import numpy as np

from ..array_types import Floats
from .collecting import collect
from .damping import groups
from .drawing import patch_of
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
        return "pdf", f"`pdf` {distortion} ({sums})"
    integral = due.sum() + maps.due.unused.values.sum()
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
        return "pdf or sample", (
            "`sample` or `pdf`: directions are drawn with another probability than "
            f"`pdf` says: {where}"
        )
    what = "lobes or directions" if len(lobes) > 1 else "directions"
    return "sample", (
        f"`sample` draws {what} with another probability than `pdf` says: {where}"
    )


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


def _distortion(whole: Sequence[FourMaps], bsdf: mi.BSDF) -> str:
    """Factor by which the density of ``pdf`` is distorted; empty if none fits.

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
        return ""
    misfit = {key: np.concatenate(z) for key, z in scores.items()}
    name, power = min(misfit, key=lambda key: float(np.mean(misfit[key])))
    least = misfit[name, power]
    better = float(np.sum(misfit["", 0]) - np.sum(least))
    if not name or np.mean(least) > EXPLAINED or better < BETTER:
        return ""
    return f"lacks {FACTORS[name]}" if power > 0 else f"has {FACTORS[name]} too much"
