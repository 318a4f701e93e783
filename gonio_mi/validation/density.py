"""Directions that are not drawn with the density of ``pdf``, and who is wrong."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from ..array_types import Floats
from ..collector import EqualSolidAngle
from .evidence import Evidence
from .maps import FourMaps
from .ratios import FACTORS, factor

__all__ = ["explain_density"]

# Patches on which reciprocals of the density are summed up, and samples each needs.
COARSE = EqualSolidAngle(8, 12)
ENOUGH = 200

# Mean squared score, and the square of that of the sum, that chance explains.
FITS = 16

# Part of the samples that is lost.
LOST = 1e-3

# Densities below that have no usable reciprocal.
SMALLEST = 1e-30

# What may distort a density.
DISTORTIONS = ("cos_o", "jacobian", "dot", "cos_h", "sin_o", "two", "pi", "four")


def explain_density(evidence: Evidence, failed: Collection[str]) -> tuple[str, str]:
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
    distortion = _distortion(evidence)
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
    what = "lobes or directions" if len(lobes) > 1 else "directions"
    return "sample", (
        f"`sample` draws {what} with another probability than `pdf` says: "
        f"{_worst_patch(maps)} ({sums})"
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


def _distortion(evidence: Evidence) -> str:
    """Factor by which the density of ``pdf`` is distorted; empty if none fits.

    The mean of 1 / density over samples in a patch is the patch's solid angle.
    """
    found: dict[str, list[Floats]] = {name: [] for name in ("", *DISTORTIONS)}
    best: dict[tuple[str, int], list[Floats]] = {}
    for drawn in evidence.drawn:
        ok = drawn.smooth & (drawn.pdf > 0) & np.isfinite(drawn.pdf)
        if drawn.condition.component is not None or not ok.any():
            continue
        wo = drawn.wo[ok]
        patch = COARSE.patch(wo) + COARSE.n_patches * (wo[:, 2] < 0)
        enough = np.bincount(patch, minlength=2 * COARSE.n_patches) >= ENOUGH
        solid = 2 * np.pi / COARSE.n_patches
        for name in found:
            t = 1.0 if not name else factor(name, drawn, ok)
            for power in (1, -1):
                density = np.maximum(drawn.pdf[ok] * t**power, SMALLEST)
                sums = np.bincount(patch, 1 / density, minlength=2 * COARSE.n_patches)
                off = np.abs(sums[enough] / drawn.n / solid - 1)
                best.setdefault((name, power), []).append(off)
    scores = {
        key: float(np.median(np.concatenate(off)))
        for key, off in best.items()
        if sum(map(len, off)) > 10
    }
    if not scores:
        return ""
    (name, power), score = min(scores.items(), key=lambda item: item[1])
    if not name or score > 0.5 * scores["", 1] or score > 0.1:
        return ""
    return f"lacks {FACTORS[name]}" if power > 0 else f"has {FACTORS[name]} too much"
