"""Sums over patches, their ratios and other functions, with errors from the batches.

Patches of one run are correlated, which the scatter of sums knows.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from ...array_types import Floats
from ...errors import SettingError
from ...results import statistics
from ...results.estimates import MIN_EVEN_HITS, Estimate, Estimates, summed
from ...results.record import Record
from ...results.tally import without_chance

# Of all intervals.
LEVEL = 0.95


def difference(one: Floats, other: Floats) -> Floats:
    """Estimate of a difference of two quantities, of rays of their own.

    Each limit is as far from the value as those of both are, added in squares (Zou and
    Donner 2008, Statistics in Medicine 27, 1693).

    Parameters
    ----------
    one, other : ndarray, shape (4,)
        Value, standard error and limits.
    """
    value = one[0] - other[0]
    std_err = np.sqrt(np.nansum([one[1] ** 2, other[1] ** 2]))
    below = np.hypot(one[0] - one[2], other[3] - other[0])
    above = np.hypot(one[3] - one[0], other[0] - other[2])
    return np.array([value, std_err, value - below, value + above])


def ratio(record: Record, weights: Floats, over: Floats | None = None) -> Floats:
    """Weighted flux of a record of one channel, over what came or another such flux.

    By the error of a ratio of sums, and limits of :meth:`Record.interval`.

    Parameters
    ----------
    record : Record
        Of one incident direction.
    weights, over : ndarray, shape (n_hemispheres, n_rows, n_columns)
        Weights of flux fractions, those of `over` of at least 0; None for all that
        came.

    Returns
    -------
    ndarray, shape (4,)
        Value, standard error and limits.
    """
    if over is not None and np.all(weights >= 0) and np.any(weights > over):
        # of flux that is no part of the other: p / (1 - p), for the part p of both
        part = ratio(record, weights, over + weights)
        with np.errstate(divide="ignore"):
            found = part / (1 - np.minimum(part, 1.0))
        found[1] = part[1] / (1 - part[0]) ** 2
        return np.asarray(found)
    estimates = record.estimates[0]
    one = estimates.weighted(weights, over)
    value, std_err = one.value, one.std_err
    if np.all(weights >= 0):
        low, high = one.interval(LEVEL)
        high = np.fmax(high, _of_unlike_passes(estimates, weights, one))
        if over is not None:
            low, high = _widened(record, weights, over - weights, low, high)
        # no flux is negative, and no part more than the whole
        limits = np.clip([low, high], 0.0, np.inf if over is None else 1.0)
        return np.concatenate([np.maximum(value, 0.0), std_err, *limits])
    signs = (np.maximum(sign * weights, 0) for sign in (1, -1))
    _, _, low, high = difference(*(ratio(record, part, over) for part in signs))
    # limits of correlated sums, and no nearer than where rays are few
    ends = statistics.student_interval(value, std_err, estimates.n_batches, LEVEL)
    return np.concatenate(
        [value, std_err, np.fmin(ends[0], low), np.fmax(ends[1], high)]
    )


def _of_unlike_passes(estimates: Estimates, weights: Floats, one: Estimate) -> Floats:
    """Upper limit where few hits may all be of wavelengths that count little.

    Passes share their hits, and one more may count as much as the mean one of each
    pass together: more than that of the pass that counts most. NaN where it is not
    needed, or nothing was hit.
    """
    tally, n = estimates.tally, estimates.passes
    many = tally.hits[weights > 0].sum() >= n * MIN_EVEN_HITS
    if n == 1 or many or not tally.hits.any():
        return np.full(1, np.nan)
    flux = summed(tally.sums, np.full(weights.shape, weights.max())).sum()
    missed = flux * n / tally.hits.sum() / one.incident.sum()
    return statistics.gamma_interval(one.value, one.std_err, missed, LEVEL)[1]


def _widened(
    record: Record, weights: Floats, rest: Floats, low: Floats, high: Floats
) -> tuple[Floats, Floats]:
    """Limits of a part, where few rays tell of it or of the rest.

    Those that are missing may be far brighter than the others: of either light its own
    limits hold, and the part is least where it is least and the rest is most.
    """
    hits = record.estimates[0].tally.hits
    if min(hits[weights > 0].sum(), hits[rest > 0].sum()) >= MIN_EVEN_HITS:
        return low, high
    own, other = (ratio(record, one)[2:, None] for one in (weights, rest))
    with np.errstate(invalid="ignore"):
        ends = own / (own + other[::-1])
    return np.fmin(low, ends[0]), np.fmax(high, ends[1])


def jackknifed(record: Record, curve: Callable[[Floats], float]) -> Floats:
    """Function of the map of reflected flux fractions, with its error and limits.

    Of a record of one channel. Its error is that of leaving out one batch after the
    other (Efron 1982, *The Jackknife*), and its limits are Student's t.
    """
    (tally,) = record.tallies
    sums, came = tally.sums[:, 0, :, :, 0].astype(float), tally.incident[:, 0]
    value, n = curve(sums.sum(axis=0) / came.sum()), len(sums)
    std_err = 0.0 if without_chance(record.tallies) else np.nan
    if n > 1:
        kept = zip(sums.sum(axis=0) - sums, came.sum() - came)
        std_err = float(np.std([curve(s / c) for s, c in kept]) * np.sqrt(n - 1))
    numbers = np.array([value]), np.array([std_err])
    return np.ravel([*numbers, *statistics.student_interval(*numbers, n, LEVEL)])


def covariance(record: Record, weights: ArrayLike) -> Floats:
    """Covariance of weighted sums of flux fractions, estimated from the batches.

    Of integrals, whose errors are no matter of chance, it is 0.

    Parameters
    ----------
    weights : array_like, shape (n, n_hemispheres, n_rows, n_columns)
        One row of weights of the record's ``flux_fraction`` for each sum.

    Returns
    -------
    ndarray, shape (channels, n, n)
        For a stack with the incident direction as first axis; NaN of a single batch.
    """
    rows, found = checked_weights(record, weights), []
    for one in record.estimates:
        tally, unlike = one.tally, one.unlike_power
        sums = np.stack([summed(tally.sums, row) for row in rows], axis=-1)
        each = statistics.residuals(sums, tally.incident[..., None], unlike)
        if len(each) == 1:
            each = np.full(each.shape, 0.0 if without_chance([tally]) else np.nan)
        found.append(np.einsum("bsk,bsl->skl", each, each))
    return np.array(found) if record.stacked else found[0]


def checked_weights(record: Record, weights: ArrayLike) -> Floats:
    """Weights as an array ``(n, n_hemispheres, n_rows, n_columns)``, or ValueError."""
    rows = np.asarray(weights, dtype=float)
    shape = (record.n_hemispheres, *record.subdivision.shape)
    if rows.ndim != 4 or rows.shape[1:] != shape or not np.isfinite(rows).all():
        raise SettingError(
            f"weights must be finite, of the shape (n, {', '.join(map(str, shape))}), "
            f"got the shape {rows.shape}"
        )
    return rows
