"""How many rays keep a promise: the paper's bounds, and what a map asks for.

The paper bounds the *absolute* error of every flux fraction by ``epsilon`` with
probability ``1 - delta``. People want a *relative* error of every patch that matters:
its standard error (:func:`standard_error_rays`), or its error, of all patches at once
(:func:`relative_rays`). Both need the patches' probabilities.
"""

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from ..array_types import Floats
from ..collector import Subdivision
from ..errors import SettingError, checked_count, checked_number

__all__ = [
    "chebyshev_rays",
    "paper_rays",
    "relative_rays",
    "reliability",
    "rms_expectation",
    "simulated_reliability",
    "standard_error_rays",
    "union_rays",
]


def chebyshev_rays(epsilon: float, delta: float) -> int:
    """Rays for one detector by eq. 17: ``ceil(ln(2 / delta) / (2 epsilon^2))``.

    Parameters
    ----------
    epsilon : float
        Absolute error of the flux fraction, in (0, 1).
    delta : float
        Probability of exceeding it, in (0, 1).
    """
    epsilon, delta = _checked(epsilon, delta)
    return math.ceil(math.log(2 / delta) / (2 * epsilon**2))


def paper_rays(n_patches: int, epsilon: float, delta: float) -> int:
    """Rays for `n_patches` detectors by the paper's eq. 21: that many times eq. 17.

    Its derivation multiplies the probabilities of dependent events (eq. 18); as a bound
    it is safe, and far from tight: see :func:`union_rays`.
    """
    return checked_count("n_patches", n_patches) * chebyshev_rays(epsilon, delta)


def union_rays(n_patches: int, epsilon: float, delta: float) -> int:
    """Rays for the same promise by a union bound over the patches of Hoeffding's bound.

    ``ceil(ln(2 m / delta) / (2 epsilon^2))``: grows with the logarithm of the number
    of patches, not with the number itself.
    """
    epsilon, delta = _checked(epsilon, delta)
    n_patches = checked_count("n_patches", n_patches)
    return math.ceil(math.log(2 * n_patches / delta) / (2 * epsilon**2))


def standard_error_rays(probabilities: ArrayLike, rel_err: float) -> int:
    """Independent rays that bring the relative standard error of each patch down.

    ``(1 - p) / (p rel_err^2)`` for the rarest patch: the binomial variance.

    Parameters
    ----------
    probabilities : array_like
        Flux fraction of each patch worth reporting, in (0, 1].
    rel_err : float
        Largest relative standard error of any of them, in (0, 1).

    Returns
    -------
    int
        At least 1.

    Raises
    ------
    ValueError
        If a number is out of its range, or there is no probability.
    """
    p = _checked_probabilities(probabilities).min()
    rel_err = checked_number("rel_err", rel_err, 1e-9, 1, "a number in (0, 1)")
    return max(math.ceil((1 - p) / (p * rel_err**2)), 1)


def reliability(probabilities: ArrayLike, rel_err: float, rays: float) -> float:
    """Lower bound of the probability that all patches are within `rel_err` at once.

    Union bound over normal tails of independent rays; at least 0.
    """
    p = np.asarray(probabilities, dtype=float).ravel()
    scores = rel_err * np.sqrt(rays * p / np.maximum(1 - p, np.finfo(float).tiny))
    return max(0.0, 1 - 2 * float(special.ndtr(-scores).sum()))


def relative_rays(probabilities: ArrayLike, rel_err: float, level: float = 0.95) -> int:
    """Independent rays that bring all patches within a relative error, all at once.

    Parameters
    ----------
    probabilities : array_like
        Flux fraction of each patch worth reporting, in (0, 1].
    rel_err : float
        Largest relative error of any of them, in (0, 1).
    level : float
        Probability that none exceeds it, in (0, 1).

    Returns
    -------
    int
        The smallest number for which :func:`reliability` is `level`.

    Raises
    ------
    ValueError
        If a probability is not in (0, 1], or there is none.
    """
    p = _checked_probabilities(probabilities)
    rel_err = checked_number("rel_err", rel_err, 1e-9, 1, "a number in (0, 1)")
    level = checked_number("level", level, 1e-9, 1, "a number in (0, 1)")
    # the rarest patch alone, and every patch as rare as it, bracket the answer
    odds = (1 - p.min()) / p.min() + 1e-12
    low = odds * (special.ndtri((1 - level) / 2) / rel_err) ** 2
    high = odds * (special.ndtri((1 - level) / (2 * p.size)) / rel_err) ** 2
    if p.size == 1:
        return math.ceil(low)
    from scipy import optimize  # slow to import, and used here only

    root = optimize.brentq(
        lambda log_n: reliability(p, rel_err, math.exp(log_n)) - level,
        math.log(low * 0.99),
        math.log(high * 1.01),
    )
    return math.ceil(math.exp(root))


def simulated_reliability(
    probabilities: ArrayLike,
    rel_err: float,
    rays: int,
    campaigns: int = 200,
    seed: int = 0,
) -> tuple[float, float]:
    """Fraction of simulated campaigns in which every patch is within `rel_err`.

    Each campaign draws the multinomial counts that `rays` independent rays would give.

    Returns
    -------
    fraction, std_err : float
    """
    p = np.asarray(probabilities, dtype=float).ravel()
    rest = max(0.0, 1 - p.sum())
    generator = np.random.default_rng(seed)
    good = 0
    for _ in range(campaigns):
        counts = generator.multinomial(rays, np.append(p, rest) / (p.sum() + rest))[:-1]
        good += bool(np.all(np.abs(counts / (rays * p) - 1) <= rel_err))
    fraction = good / campaigns
    return fraction, math.sqrt(
        max(fraction * (1 - fraction), 1 / campaigns) / campaigns
    )


def rms_expectation(
    patches: Subdivision, probabilities: Floats, rays: float
) -> tuple[float, float]:
    """Expected squared RMS error of a BRDF map, and its relative standard deviation.

    Of `rays` independent rays, of which a patch receives one with its probability.

    Parameters
    ----------
    patches : Subdivision
    probabilities : ndarray, shape (n_theta, n_phi)
    rays : int

    Returns
    -------
    mean_square, relative_std : float
        The second by the binomial fourth moment, with patches as if independent.
    """
    p = probabilities
    scale = (rays * patches.projected_solid_angles) ** -2.0
    variance = rays * p * (1 - p)
    spread = np.sqrt(np.sum((variance + 2 * variance**2) * scale**2))
    mean_square = float(np.mean(variance * scale))
    return mean_square, float(spread / np.sum(variance * scale))


def _checked_probabilities(probabilities: ArrayLike) -> Floats:
    p = np.asarray(probabilities, dtype=float).ravel()
    if not p.size or not ((p > 0) & (p <= 1)).all():
        raise SettingError(
            "probabilities must be at least one number in (0, 1], "
            f"got {p.size} from {p.min() if p.size else np.nan:g}"
        )
    return p


def _checked(epsilon: float, delta: float) -> tuple[float, float]:
    condition = "a number in (0, 1)"
    return (
        checked_number("epsilon", epsilon, 1e-12, 1, condition),
        checked_number("delta", delta, 1e-300, 1, condition),
    )
