"""How far the mean over a patch may be from the value at a point of it.

The patches around tell: where lobes are resolved, a value is no farther from the mean
than the farthest mean of all patches that one of `REACH` times the width would meet. Of
1500 random points in each of 80 maps (8 BSDFs, 5 collectors) all were within, but for 4
on the rim of lobes much narrower than a patch.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..array_types import Flags, Integers
from ..collector.hemisphere import Subdivision
from .agreement import PointSet, Readings, Variation, judge

__all__ = ["MEASURED_ANEW", "left_undecided", "variation_within"]

# Size of what reaches the patches around one, in sizes of a patch, and points per side.
REACH, POINTS = 2.5, 4

# Means that differ by more than this factor, next to each other, resolve no lobe.
STEEP = 3.0

# What decides where patches cannot.
MEASURED_ANEW = (
    "compare the specimen itself with the table, which measures at its points"
)

# Standard errors by which two means differ without being told apart.
CHANCE = 3.0


def variation_within(
    patches: Subdivision, patch: Integers, readings_of: Any
) -> tuple[Variation, Flags]:
    """How far values in some patches may be from their means, and where that is known.

    Parameters
    ----------
    patches : Subdivision
    patch : ndarray of int, shape (n,)
    readings_of : callable
        Of numbers of patches, shape (m,): their :class:`Readings`.

    Returns
    -------
    variation : Variation
        Of those patches where it is known.
    known : ndarray of bool, shape (n,)
        False next to the horizon, beyond which there is no patch, and where the means
        are steeper than a lobe that is resolved.
    """
    around, beyond = _around(patches, patch)
    numbers, where = np.unique(np.stack([*around.T, patch]), return_inverse=True)
    readings: Readings = readings_of(numbers)
    value, error = readings.value[where], readings.error[where]
    value, error = value.reshape(-1, len(patch)), error.reshape(-1, len(patch))
    mean, own = value[-1], error[-1]
    apart = np.abs(value[:-1] - mean)
    chance = np.hypot(error[:-1], own)
    bound = np.maximum(apart - CHANCE * chance, 0).max(axis=0)
    low, high = np.maximum(value - CHANCE * error, 0), value + CHANCE * error
    steep = (low[:-1] > STEEP * high[-1]) | (low[-1] > STEEP * high[:-1])
    # what is hidden in the noise, without bias: it may be negative
    hidden = np.where(apart > CHANCE * chance, 0.0, apart**2 - chance**2).mean(axis=0)
    known = ~(beyond | steep.any(axis=0))
    # a value is about half as far from the mean as that of the next patch
    return Variation(bound[known], hidden[known] / 4), known


def left_undecided(
    sets: Sequence[PointSet],
    scale: float,
    p_values: dict[str, float],
    alpha: float,
    notes: list[str],
) -> bool:
    """Whether only variation within patches lets two agree; it is noted how large."""
    known = [(one.variation, one.readings) for one in sets if one.variation is not None]
    if not known:
        return False
    bounds = np.concatenate([variation.bound for variation, _ in known])
    values = np.concatenate([readings.value for _, readings in known])
    parts = bounds / np.where(values > 0, values, np.inf)
    notes.append(
        f"means over patches stand for points: up to {np.median(parts):.1%} of a value "
        f"in the median, {parts.max():.1%} at most, may be what the BRDF does within a "
        "patch, and are not counted"
    )
    _, _, _, without = judge([replace(one, variation=None) for one in sets], scale)
    least, bare = min(p_values.values()), min(without.values())
    limit = alpha / len(p_values)
    if least < limit or bare >= limit:
        return False
    notes.append(f"what differs may be that: {MEASURED_ANEW}")
    return True


def _around(patches: Subdivision, patch: Integers) -> tuple[Integers, Flags]:
    """Patches around others, ``(n, points)``, and which of those the horizon cuts."""
    points = patches.points(POINTS)[patch]
    middle = points.mean(axis=1, keepdims=True)
    far = middle + REACH * (points - middle)
    beyond = far[..., 2] <= 0
    far[..., 2] = np.maximum(far[..., 2], 1e-6)
    far /= np.linalg.norm(far, axis=-1, keepdims=True)
    return patches.patch(far), beyond.any(axis=1)
