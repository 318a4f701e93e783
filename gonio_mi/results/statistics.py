"""Estimates, standard errors and intervals from counts and from independent batches.

Normal scores: the number of standard deviations that is as improbable as a finding.
"""

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats, Integers, Numbers

# A probability below counts as that, so that no score is infinite.
MIN_PROBABILITY = 1e-300

# Standard deviations beyond which the skewness of sums is not taken for chance.
MIN_SKEWNESS = 3.0

# From 0 to a quantile of Student's t, for any level that differs from 1: 8 are enough.
NEWTON_STEPS = 10


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


def batch_std_err(sums: Numbers, incident: Numbers, unlike: bool = False) -> Floats:
    """Standard error of :func:`ratio` from the scatter between batches.

    The usual linearisation of a ratio estimator (Cochran 1977, *Sampling
    Techniques*, eq. 6.13); for batches of equal incident flux it is the standard error
    of the mean of the batches. Where that is `unlike`, the ratio follows the batches
    that have most of it: it is then that of leaving out one batch after the other
    (Efron 1982, *The Jackknife*). NaN for fewer than two batches, or where all flux
    fell on one.
    """
    n = len(sums)
    if n < 2:
        return np.full(np.broadcast_shapes(sums.shape, incident.shape)[1:], np.nan)
    square = sum(one * one for one in _deviations(sums, incident, unlike))
    with np.errstate(invalid="ignore"):
        return np.sqrt(square * (n / (n - 1))) / incident.sum(axis=0, dtype=float)


def residuals(sums: Numbers, incident: Numbers, unlike: bool = False) -> Floats:
    """Part of each batch in the error of :func:`ratio`, shaped like `sums`.

    Their products, added up over the batches, are the covariance of the ratios, and
    their squares that of :func:`batch_std_err`; of a single batch they are 0.
    """
    n = len(sums)
    scale = np.sqrt(n / max(n - 1, 1)) / incident.sum(axis=0, dtype=float)
    return np.stack(list(_deviations(sums, incident, unlike))) * scale


def _deviations(sums: Numbers, incident: Numbers, unlike: bool) -> Iterator[Floats]:
    """Deviation of each batch from the ratio, or from that of the others if `unlike`.

    One after the other, for maps of many patches are large.
    """
    n, incident = len(sums), np.asarray(incident, dtype=float)
    fraction = ratio(sums, incident)
    with np.errstate(divide="ignore", invalid="ignore"):
        # of each batch's deviation, the part that the others' ratio would leave
        kept = (1 - incident / incident.sum(axis=0)) / (1 - 1 / max(n, 2))
    for batch_sum, batch_incident, others in zip(sums, incident, kept):
        deviation = batch_sum - fraction * batch_incident
        yield deviation / others if unlike else deviation


def effective_batches(incident: Numbers) -> Floats:
    """Number of batches alike whose scatter is known as well as that of unlike ones.

    By the degrees of freedom of a sum of squares (Satterthwaite 1946, Biometrics
    Bulletin 2, 110), each in proportion to the square of the `incident` flux.

    Parameters
    ----------
    incident : ndarray, shape (n_batches, ...)
    """
    n, squares = len(incident), np.square(incident / incident.sum(axis=0, dtype=float))
    alike = squares.sum(axis=0) ** 2 / np.square(squares).sum(axis=0)
    return np.asarray(1 + alike * (n - 1) / n)


def heavy_hits(sums: Numbers, incident: Numbers, hits: Integers) -> Floats:
    """Weight of the hits that make sums scatter between batches, and their share.

    A sum of independent hits has the cumulants ``n E[w**2]`` and ``n E[w**3]``. What
    `n` hits of a patch's own mean weight would have of them is taken off, for patches
    may well differ in that; the quotient of the rest, pooled over all patches per hit,
    is the weight of the heavy hits where few heavy ones are among many light ones.
    Sequences that spread hits evenly have less of both.

    Parameters
    ----------
    sums : ndarray, shape (n_batches, n_theta, n_phi, channels)
    incident : ndarray, broadcastable to `sums`
    hits : ndarray, shape (n_theta, n_phi, 1)
        Over all batches.

    Returns
    -------
    weight, share : ndarray of float64, shape (channels,)
        The weight as part of all incident flux, at most the largest sum; 0 for fewer
        than three batches, which do not tell, and for sums that are no more skewed by
        chance where all hits of a patch weigh the same. Their share in all hits is by
        the third cumulants of all patches together: those of a patch of few hits, per
        hit, tell little of the others.
    """
    n = len(sums)
    if n < 3:
        return np.zeros((2, sums.shape[-1]))
    square, cube = np.zeros((2, *sums.shape[1:]))
    incident = np.asarray(incident, dtype=float)
    fraction = ratio(sums, incident)
    for batch_sum, batch_incident in zip(sums, incident):
        deviation = batch_sum - fraction * batch_incident
        square += (squared := deviation * deviation)
        cube += squared * deviation  # a power of 3 is 30 times slower
    count = np.maximum(hits, 1).astype(float)
    mean = np.sum(sums, axis=0, dtype=float) / count
    alike = mean * mean
    # what is more than that of hits all alike, per hit
    second = (square * (n / (n - 1)) / count - alike).sum(axis=(0, 1))
    third = cube * (n**2 / ((n - 1) * (n - 2))) / count - alike * mean
    # both lack hits to know the mean: 1 - 1/h of them, and 1 - 1/h**2
    few = count / (count + 1)
    thirds = third * few
    third = thirds.sum(axis=(0, 1))
    # the third power that normal sums, and Poisson counts of hits alike, have by
    # chance; a single hit has that of one alike in any case
    normal = 6 * square * (square / (n * count)) ** 2
    counted = 18 * alike**3 / n
    chance = (normal + counted) * (1 - 1 / count) * few**2
    chance = np.sqrt(chance.sum(axis=(0, 1)))
    known = (third > MIN_SKEWNESS * chance) & (second > 0)
    weight = np.divide(third, second, out=np.zeros(len(second)), where=known)
    weight = np.minimum(weight, np.max(sums, axis=(0, 1, 2)))
    found = np.maximum((thirds * count).sum(axis=(0, 1)), 0.0)
    share = np.zeros(len(weight))
    np.divide(found, weight**3 * hits.sum(), out=share, where=weight > 0)
    return np.stack([weight / incident.sum(axis=(0, 1, 2)), share])


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
    from scipy import special  # slow to import

    hits, rays = np.asarray(hits, dtype=float), np.asarray(rays, dtype=float)
    tail = (1 - level) / 2
    misses = rays - hits
    # quantiles of the beta distribution; scipy.stats would double the time of import
    low = special.betaincinv(hits, misses + 1, tail)
    high = special.betaincinv(hits + 1, misses, 1 - tail)
    return np.where(hits == 0, 0.0, low), np.where(misses == 0, 1.0, high)


def gamma_interval(
    value: Floats,
    std_err: Floats,
    largest: Floats | float,
    level: float,
    heavy: Floats | float = 0.0,
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
    heavy : float or ndarray
        Weight of the hits that scatter: as many as explain `std_err` are counts, and
        the rest of `value` is certain.
    """
    from scipy import special  # slow to import

    tail, variance = (1 - level) / 2, np.square(std_err)
    with np.errstate(divide="ignore", invalid="ignore"):
        counted = np.where(heavy * value > variance, variance / heavy, value)
        low = variance / counted
        low = low * special.gammaincinv(counted**2 / variance, tail)
        more, with_more = variance + largest**2, counted + largest
        high = special.gammaincinv(with_more**2 / more, 1 - tail)
        high = high * more / with_more
    low = np.where(std_err == 0, counted, low)
    return low + (value - counted), high + (value - counted)


def student_interval(
    value: Floats,
    std_err: Floats,
    n_batches: int | Floats,
    level: float,
    below: ArrayLike = 0.0,
    above: ArrayLike = 0.0,
) -> tuple[Floats, Floats]:
    """Interval by Student's t with ``n_batches - 1`` degrees of freedom.

    It reaches at least `below` and `above` to its sides; NaN where `std_err` is.
    """
    dof = np.maximum(n_batches - 1, 1)
    half = np.vectorize(student_quantile, [float])(dof, level) * std_err
    low, high = (np.maximum(half, np.nan_to_num(least)) for least in (below, above))
    return value - low, value + high


@lru_cache(maxsize=256)
def student_quantile(dof: float, level: float) -> float:
    """Size that Student's t exceeds with chance ``1 - level``.

    A first measurement needs nothing else of SciPy's functions, to import which takes
    longer than to measure. The variable u of ``t = sqrt(dof) sinh(u)`` has a density
    in proportion to ``cosh(u)**-dof``; the double-exponential rule (Takahasi and Mori
    1974, Publ. RIMS 9, 721) integrates its tails to rounding, and Newton's method
    converges, for their logarithm is concave.

    Parameters
    ----------
    dof : float
        Degrees of freedom, at least 1.
    level : float
        In (0, 1).
    """
    x = np.linspace(-3.5, 3.75, 59)
    steps = np.exp(x - np.exp(-x)) / np.sqrt(dof)
    weights = steps * (1 + np.exp(-x)) * (x[1] - x[0])

    def log_density(u: Floats | float) -> Any:
        return -dof / 2 * np.log1p(np.sinh(u) ** 2)

    def tail_over_density(u: float) -> Any:
        return weights @ np.exp(log_density(u + steps) - log_density(u))

    u = 0.0
    log_tail = np.log1p(-level) + np.log(tail_over_density(u))
    for _ in range(NEWTON_STEPS):
        over = tail_over_density(u)
        u += over * (log_density(u) + np.log(over) - log_tail)
    return float(np.sqrt(dof) * np.sinh(u))


def upper_limit(rays: ArrayLike, level: float) -> Floats:
    """Probability of a hit that leaves a patch empty with chance (1 - level) / 2."""
    return -np.expm1(np.log((1 - level) / 2) / np.asarray(rays, dtype=float))


def student_score(t: ArrayLike, dof: ArrayLike) -> Floats:
    """Normal score of the same probability as Student's t, with its sign.

    Beyond probabilities of 1e-300 it is approximate (Wallace 1959, Annals of
    Mathematical Statistics 30, 1124), so that scores keep their order.
    """
    from scipy import special  # slow to import

    dof, size = np.minimum(dof, 1e9), np.abs(t)
    tail = special.stdtr(dof, -size)
    score = -special.ndtri(np.maximum(tail, MIN_PROBABILITY))
    root = np.sqrt(dof * np.log1p(np.square(size) / dof))
    beyond = np.maximum(score, root * (8 * dof + 1) / (8 * dof + 3))
    return 0.0 + np.sign(t) * np.where(tail < MIN_PROBABILITY, beyond, score)


def two_sided_score(below: ArrayLike, above: ArrayLike) -> Floats:
    """Normal score from the probabilities of at most and at least what was seen."""
    from scipy import special  # slow to import

    p = np.minimum(2 * np.minimum(below, above), 1.0)
    size = -special.ndtri(np.maximum(p / 2, MIN_PROBABILITY))
    return np.where(np.less(below, above), -size, size)
