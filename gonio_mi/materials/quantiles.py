"""Shares of light below the edges of bins, and pieces between those of two."""

import numpy as np

from ..array_types import Floats, Integers

__all__ = ["cumulative", "merged"]


def cumulative(weight: Floats) -> Floats:
    """Share of light below each edge of the last axis; even where there is none."""
    total = weight.sum(axis=-1, keepdims=True)
    share = np.where(total > 0, weight, 1.0)
    cumulative = np.cumsum(share, axis=-1)
    cumulative = cumulative / cumulative[..., -1:]
    return np.concatenate([np.zeros_like(total), cumulative], axis=-1)


def merged(first: Floats, second: Floats) -> tuple[Floats, Floats, Integers]:
    """Pieces on which the quantile functions of both distributions are linear.

    Parameters
    ----------
    first, second : ndarray, shape (..., n + 1)
        Share of the light below n + 1 equidistant edges from -1 to 1; strictly
        ascending.

    Returns
    -------
    begin, slope : ndarray, shape (2, ..., 2 n - 1)
        Where each piece begins in either distribution; its growth per share of light.
    of : ndarray of int, shape (2, ..., 2 n - 1)
        The cell that it is part of.
    """
    n = first.shape[-1] - 1
    inner = np.concatenate([first[..., 1:-1], second[..., 1:-1]], axis=-1)
    order = np.argsort(inner, axis=-1, kind="stable")
    zero = np.zeros((*first.shape[:-1], 1))
    share = np.take_along_axis(inner, order, axis=-1)
    share = np.concatenate([zero, share], axis=-1)
    passed = np.cumsum(order < n - 1, axis=-1)
    passed = np.concatenate([zero.astype(int), passed], axis=-1)
    of = np.stack([passed, np.arange(2 * n - 1) - passed])
    begin, slope = np.empty((2, *of.shape))
    for end, cumulative in enumerate((first, second)):
        low = np.take_along_axis(cumulative, of[end], axis=-1)
        high = np.take_along_axis(cumulative, of[end] + 1, axis=-1)
        slope[end] = (2 / n) / (high - low)
        begin[end] = of[end] * (2 / n) - 1 + (share - low) * slope[end]
    return begin, slope, of
