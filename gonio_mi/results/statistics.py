"""Estimates, standard errors and intervals from counts and from independent batches."""

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from ..array_types import Floats, Numbers

__all__ = [
    "batch_std_err",
    "binomial_interval",
    "binomial_std_err",
    "gamma_interval",
    "ratio",
    "student_interval",
    "upper_limit",
]


def ratio(sums: Numbers, incident: Numbers) -> Floats:
    """Flux fraction over all batches: sum of `sums` over sum of `incident`.

    Parameters
    ----------
    sums : ndarray, shape (n_batches, ...)
    incident : ndarray, broadcastable to `sums`

    Returns
    -------
    ndarray of float64, shape (...)
        NaN where nothing was incident.
    """
    with np.errstate(invalid="ignore"):
        return np.sum(sums, axis=0, dtype=float) / np.sum(incident, axis=0, dtype=float)


def batch_std_err(sums: Numbers, incident: Numbers) -> Floats:
    """Standard error of :func:`ratio` from the scatter between batches.

    The usual linearisation of a ratio estimator (Cochran 1977, *Sampling
    Techniques*, eq. 6.13); for batches of equal incident flux it is the standard error
    of the mean of the batches. NaN for fewer than two batches.
    """
    n = len(sums)
    if n < 2:
        return np.full(np.broadcast_shapes(sums.shape, incident.shape)[1:], np.nan)
    incident = np.asarray(incident, dtype=float)
    fraction = ratio(sums, incident)
    square = np.zeros(fraction.shape)
    for batch_sum, batch_incident in zip(sums, incident):
        square += (batch_sum - fraction * batch_incident) ** 2
    with np.errstate(invalid="ignore"):
        return np.sqrt(square * (n / (n - 1))) / incident.sum(axis=0)


def binomial_std_err(hits: ArrayLike, rays: ArrayLike) -> Floats:
    """Standard error of ``hits / rays`` for independent rays; NaN without a hit."""
    p = np.asarray(hits, dtype=float) / np.asarray(rays)
    return np.where(np.asarray(hits) > 0, np.sqrt(p * (1 - p) / rays), np.nan)


def binomial_interval(
    hits: ArrayLike, rays: ArrayLike, level: float
) -> tuple[Floats, Floats]:
    """Exact interval for a probability (Clopper and Pearson 1934), also at 0 hits.

    Returns
    -------
    low, high : ndarray
        Cover the truth with probability at least `level`.
    """
    hits, rays = np.asarray(hits, dtype=float), np.asarray(rays, dtype=float)
    tail = (1 - level) / 2
    misses = rays - hits
    # quantiles of the beta distribution; scipy.stats would double the time of import
    low = special.betaincinv(hits, misses + 1, tail)
    high = special.betaincinv(hits + 1, misses, 1 - tail)
    return np.where(hits == 0, 0.0, low), np.where(misses == 0, 1.0, high)


def gamma_interval(
    value: Floats, std_err: Floats, largest: Floats | float, level: float
) -> tuple[Floats, Floats]:
    """Interval for a sum of few weights: Poisson counts, of weights unlike each other.

    Fay and Feuer 1997, *Confidence intervals for directly standardized rates*,
    Statistics in Medicine 16, 791: for weights all alike it is the exact one of their
    count, and without a scatter its upper limit is that of a count of `largest`.

    Parameters
    ----------
    value, std_err : ndarray
        Of the sum, above 0; `std_err` may be 0.
    largest : float or ndarray
        Weight of a hit that may have been missed by chance, in the unit of `value`.
    """
    tail, variance = (1 - level) / 2, np.square(std_err)
    with np.errstate(divide="ignore", invalid="ignore"):
        low = variance / value * special.gammaincinv(value**2 / variance, tail)
    more, value_of_more = variance + largest**2, value + largest
    high = special.gammaincinv(value_of_more**2 / more, 1 - tail) * more / value_of_more
    return np.where(std_err == 0, value, low), high


def student_interval(
    value: Floats,
    std_err: Floats,
    n_batches: int,
    level: float,
    below: ArrayLike = 0.0,
    above: ArrayLike = 0.0,
) -> tuple[Floats, Floats]:
    """Interval by Student's t with ``n_batches - 1`` degrees of freedom.

    It reaches at least `below` and `above` to its sides; NaN where `std_err` is.
    """
    half = special.stdtrit(max(n_batches - 1, 1), (1 + level) / 2) * std_err
    low, high = (np.maximum(half, np.nan_to_num(least)) for least in (below, above))
    return value - low, value + high


def upper_limit(rays: ArrayLike, level: float) -> Floats:
    """Probability of a hit that leaves a patch empty with chance (1 - level) / 2."""
    return -np.expm1(np.log((1 - level) / 2) / np.asarray(rays, dtype=float))
