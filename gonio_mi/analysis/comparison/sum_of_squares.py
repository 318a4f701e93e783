"""Tail probability of a sum of squares of correlated normal scores."""

from __future__ import annotations

import numpy as np
import scipy  # its parts are imported when used

from ...array_types import Floats

# Standard deviations from the mean within which the saddlepoint is 0 over 0.
NEAR_MEAN = 1e-3


def p_value_of_squares(
    chi2: float, trace_of_square: float, common: Floats, most: float
) -> float:
    """Probability that a sum of squares of correlated normal scores reaches `chi2`.

    Errors in common, such as those of a fit's parameters, are few eigenvectors of the
    correlation with large eigenvalues: each is a chi-square of its own. What is left
    is one chi-square with the mean and the variance that remain (Satterthwaite 1946).
    One for all would have too light a tail: of 384 scores of which a tenth of the
    variance is one common error, it would reject 12 times as often as it says at 1e-3.

    Parameters
    ----------
    chi2 : float
    trace_of_square : float
        Of the correlation of all scores, the sum of its squared eigenvalues.
    common : ndarray, shape (n_errors, n)
        Roots of the part of the correlation that is in common.
    most : float
        Upper limit of the degrees of freedom.
    """
    n = common.shape[1]
    size, axes = np.linalg.eigh(common @ common.T)
    kept = size > np.finfo(float).eps * n
    if not kept.any():
        dof = min(n**2 / trace_of_square, most)
        return float(scipy.special.chdtrc(dof, chi2 * dof / n))
    along = axes[:, kept].T @ common / np.sqrt(size[kept])[:, None]
    independent = np.maximum(1 - np.sum(common**2, axis=0), 0.0)
    weights = size[kept] + along**2 @ independent
    mean = max(n - weights.sum(), np.finfo(float).tiny)
    square = max(trace_of_square - np.sum(weights**2), mean**2 / most)
    dof = np.append(np.ones_like(weights), mean**2 / square)
    return _p_value_of_sum(chi2, np.append(weights, square / mean), dof)


def _p_value_of_sum(value: float, weights: Floats, dof: Floats) -> float:
    """Probability that a weighted sum of independent chi-squares reaches a value.

    By the saddlepoint of Lugannani and Rice in the form of Barndorff-Nielsen (Kuonen
    1999, Biometrika 86, 929), to a few per cent of itself however small it is.
    """
    mean, sd = float(dof @ weights), float(np.sqrt(2 * dof @ weights**2))
    if value <= 0:
        return 1.0
    if abs(value - mean) < NEAR_MEAN * sd:
        value = mean + NEAR_MEAN * sd

    def apart(t: float) -> float:
        """Derivative of the cumulant generating function, less the value."""
        return float(dof @ (weights / (1 - 2 * t * weights)) - value)

    # both ends are roots of bounds of it, and are passed in case of roundings
    i = int(np.argmax(weights))
    low = -0.501 * dof.sum() / value
    high = (1 - 0.999 * min(dof[i] * weights[i] / value, 1.0)) / (2 * weights[i])
    t = scipy.optimize.brentq(apart, low, high, xtol=1e-300)
    rest = 1 - 2 * t * weights
    w = np.sign(t) * np.sqrt(2 * t * value + dof @ np.log(rest))
    v = t * np.sqrt(2 * dof @ (weights / rest) ** 2)
    return float(scipy.special.ndtr(-(w + np.log(v / w) / w)))
