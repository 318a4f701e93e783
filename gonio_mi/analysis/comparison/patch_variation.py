"""Bound on the difference between a patch mean and the value at a point of the patch.

The patches around tell: where lobes are resolved, a value is no farther from the mean
than the farthest mean of all patches that one of `NEIGHBOURHOOD` times the width would
meet.
Around the pole all sectors of the first ring are one patch. Of 600 points in each of
264 maps (11 BSDFs, 6 collectors, 4 angles of incidence, half of the points in the lobe)
the variation is known for 90 000, of which 23 are beyond, at most by a factor of 2.1.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...array_types import Flags, Integers
from ...collector import RingsAndSectors, Subdivision
from ..points import CountedPoints
from .agreement import PointPairs, Variation, judge

# Size of what reaches the patches around one, in sizes of a patch, and points per side.
NEIGHBOURHOOD, POINTS_PER_SIDE = 2.5, 4

# Means that differ by more than this factor, next to each other, resolve no lobe.
MAX_RESOLVED_RATIO = 3.0

# A lobe is hidden in a patch that is brighter than the darkest around by this part of
# its mean, and if so by `MAX_RESOLVED_RATIO` times as much as this part of the patches
# around it.
MIN_PEAK, MIN_SURROUNDINGS = 0.1, 0.4

# What decides where patches cannot.
REMEDY = "compare the specimen itself with the table, which measures at its points"

# Standard errors by which two means differ without being told apart.
MAX_STD_ERRS = 3.0


def variation_within(
    patches: Subdivision, patch: Integers, points_of: Any
) -> tuple[Variation, Flags]:
    """How far values in some patches may be from their means, and where that is known.

    Parameters
    ----------
    patches : Subdivision
    patch : ndarray of int, shape (n,)
    points_of : callable
        Of numbers of patches, shape (m,): their :class:`CountedPoints`.

    Returns
    -------
    variation : Variation
        Of those patches where it is known.
    known : ndarray of bool, shape (n,)
        False next to the horizon, beyond which there is no patch, and where the means
        are steeper than a lobe that is resolved, be it on top of a diffuse one.
    """
    around, beyond = _around(patches, patch)
    numbers, where = np.unique(np.stack([*around.T, patch]), return_inverse=True)
    means: CountedPoints = points_of(numbers)
    value, error = means.value[where], means.error[where]
    value, error = value.reshape(-1, len(patch)), error.reshape(-1, len(patch))
    mean, own = value[-1], error[-1]
    apart = np.abs(value[:-1] - mean)
    chance = np.hypot(error[:-1], own)
    bound = np.maximum(apart - MAX_STD_ERRS * chance, 0).max(axis=0)
    low = np.maximum(value - MAX_STD_ERRS * error, 0)
    high = value + MAX_STD_ERRS * error
    steep = low[:-1] > MAX_RESOLVED_RATIO * high[-1]
    steep |= low[-1] > MAX_RESOLVED_RATIO * high[:-1]
    base = value.min(axis=0)
    above = mean - base > MAX_RESOLVED_RATIO * (value[POINTS_PER_SIDE**2 : -1] - base)
    alone = above.mean(axis=0) > MIN_SURROUNDINGS
    alone &= low[-1] - base > MIN_PEAK * mean
    # what is hidden in the noise, without bias: it may be negative
    hidden = np.where(apart > MAX_STD_ERRS * chance, 0.0, apart**2 - chance**2)
    hidden = hidden.mean(axis=0)
    known = ~(beyond | alone | steep.any(axis=0))
    # a value is about half as far from the mean as that of the next patch
    return Variation(bound[known], hidden[known] / 4), known


def left_undecided(
    sets: Sequence[PointPairs],
    scale: float,
    p_values: dict[str, float],
    alpha: float,
    notes: list[str],
) -> bool:
    """Whether only variation within patches lets two agree; it is noted how large."""
    known = [(one.variation, one.mine) for one in sets if one.variation is not None]
    if not known:
        return False
    bounds = np.concatenate([variation.bound for variation, _ in known])
    values = np.concatenate([points.value for _, points in known])
    parts = bounds / np.where(values > 0, values, np.inf)
    _, _, _, without = judge([replace(one, variation=None) for one in sets], scale)
    least, bare = min(p_values.values()), min(without.values())
    limit = alpha / len(p_values)
    counted = min(1.0, len(p_values) * bare)
    notes.append(
        f"means over patches stand for points: up to {np.median(parts):.1%} of a value "
        f"in the median, {parts.max():.1%} at most, may be what the BRDF does within a "
        "patch, and are not counted as differences; counting them, p would be "
        f"{counted:.3g}"
    )
    if least < limit or bare >= limit:
        return False
    notes.append(f"what differs may be that: {REMEDY}")
    return True


def _around(patches: Subdivision, patch: Integers) -> tuple[Integers, Flags]:
    """Patches around others, ``(n, 2 * points)``, and which of those the horizon cuts.

    The second half is around the pole for patches of the first ring.
    """
    points = patches.points(POINTS_PER_SIDE)[patch]
    middle = points.mean(axis=1, keepdims=True)
    center = middle.copy()
    if isinstance(patches, RingsAndSectors):
        center[patch < patches.shape[1]] = 0, 0, 1
    each = [one + NEIGHBOURHOOD * (points - one) for one in (middle, center)]
    far: Any = np.concatenate(each, axis=1)
    beyond = far[..., 2] <= 0
    far[..., 2] = np.maximum(far[..., 2], 1e-6)
    far /= np.linalg.norm(far, axis=-1, keepdims=True)
    return patches.patch(far), beyond.any(axis=1)
