"""Patches worth reporting, their precision, and the rays that a measurement needs.

The paper bounds the *absolute* error of every flux fraction by ``epsilon`` with
probability ``1 - delta``. People want a *relative* error of every patch that matters:
its standard error (:func:`standard_error_rays`), or its error, of all patches at once
(:func:`relative_rays`). Both need the patches' probabilities.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Flags, Floats
from ..collector import Subdivision, subdivision
from ..errors import SettingError, SettingTypeError, checked_count, checked_number
from .record import Record

# Patches whose BRDF is below this fraction of the mean BRDF are not worth reporting.
FLOOR = 0.1


def lobe(
    values: ArrayLike, projected_solid_angles: ArrayLike, floor: float = FLOOR
) -> Flags:
    """Patches worth reporting: those that reach `floor` times the collector's mean.

    Parameters
    ----------
    values : array_like, shape (..., n_theta, n_phi)
        BRDF, or BRDF and BTDF, of one channel in 1/sr.
    projected_solid_angles : array_like, shape (n_theta, n_phi)
    floor : float
        In [0, 1).

    Returns
    -------
    ndarray of bool, shape of `values`
        Their number is the paper's m', the patches inside of the lobe.
    """
    floor = checked_number("floor", floor, 0, 1, "a fraction in [0, 1)")
    values = np.asarray(values, dtype=float)
    weights = np.broadcast_to(projected_solid_angles, values.shape)
    return (values > 0) & (values >= floor * np.average(values, weights=weights))


def relative_errors(record: Record, floor: float = FLOOR) -> Floats:
    """Relative standard errors of the patches worth reporting; NaN elsewhere.

    Of one incident direction, shape ``(n_hemispheres, n_theta, n_phi, channels)``;
    infinite where a standard error is not known.
    """
    value = patch_values(record, "brdf", "btdf")
    std_err = patch_values(record, "brdf_std_err", "btdf_std_err")
    relative = np.full(value.shape, np.nan)
    weights = record.subdivision.projected_solid_angles
    for channel in range(value.shape[-1]):
        inside = lobe(value[..., channel], weights, floor)
        errors = std_err[..., channel][inside] / value[..., channel][inside]
        relative[..., channel][inside] = np.where(np.isnan(errors), np.inf, errors)
    return relative


def precision(record: Record, floor: float = FLOOR) -> tuple[float, int]:
    """Largest relative standard error among the patches worth reporting.

    Parameters
    ----------
    record : Record
        Of one incident direction.
    floor : float
        See :func:`lobe`.

    Returns
    -------
    worst : float
        Over all channels; infinite where a standard error is not known, or if no light
        was received at all.
    n_lobe : int
        Number of patches worth reporting, the paper's m'; the most of any channel.
    """
    relative = relative_errors(record, floor)
    inside = ~np.isnan(relative)
    n_lobe = int(inside.sum(axis=(0, 1, 2)).max())
    return (float(relative[inside].max()) if n_lobe else np.inf), n_lobe


def patch_values(record: Record, upper: str, lower: str) -> Floats:
    """Quantity over all hemispheres, ``(n_hemispheres, n_theta, n_phi, channels)``."""
    parts = [getattr(record, upper)]
    if record.has_lower:
        parts.append(getattr(record, lower))
    return np.stack(parts)


@dataclass(frozen=True)
class Plan:
    """Numbers of rays that the bounds ask for; see :func:`plan`.

    Attributes
    ----------
    n_patches, n_lobe : int
        Patches of the hemisphere, and those worth reporting (the paper's m').
    chebyshev, paper, paper_lobe, union : int
        Absolute error: eq. 17 for one patch, eq. 21 for all, eq. 21 with m', and the
        union bound for all.
    standard_error : int
        Relative standard error `rel_err` of each patch worth reporting, which is what
        the setting `rel_err` of a measurement asks for.
    relative : int
        Relative error `rel_err` of the patches worth reporting, all at once.
    epsilon, delta, rel_err, level : float
        What was asked.
    source : str
        Where the probabilities come from.
    """

    n_patches: int
    n_lobe: int
    chebyshev: int
    paper: int
    paper_lobe: int
    union: int
    standard_error: int
    relative: int
    epsilon: float
    delta: float
    rel_err: float
    level: float
    source: str

    def _repr_html_(self) -> str:
        import html  # whose table of entities is slow to import

        return f"<pre>{html.escape(str(self))}</pre>"

    def __str__(self) -> str:
        absolute = (
            f"|error| < {self.epsilon:g} of the incident flux, {1 - self.delta:.3g}"
        )
        relative = f"relative error < {self.rel_err:g}, {self.level:.3g}"
        standard = f"relative standard error < {self.rel_err:g} (measure --rel-err)"
        lobe = f"{self.n_lobe} patches in the lobe"
        rows = [
            (self.chebyshev, "one patch (eq. 17)", absolute),
            (self.paper, f"{self.n_patches} patches (eq. 21)", absolute),
            (self.paper_lobe, f"{lobe} (eq. 21, m')", absolute),
            (self.union, f"{self.n_patches} patches, union bound", absolute),
            (self.standard_error, f"{lobe}, each", standard),
            (self.relative, f"{lobe}, all at once", relative),
        ]
        lines = [f"patch probabilities from {self.source}"]
        lines += [f"{rays:14.4g}  {what:42s}{asked}" for rays, what, asked in rows]
        return "\n".join(lines)


def plan(
    pilot: Record | None = None,
    *,
    collector: str | Subdivision = "projected:30x30",
    epsilon: float = 0.005,
    delta: float = 0.01,
    rel_err: float = 0.01,
    level: float = 0.95,
    floor: float = FLOOR,
) -> Plan:
    """Plan the rays of a measurement.

    Parameters
    ----------
    pilot : Record, optional
        A first measurement of the specimen at one incident direction, which says how
        the light is spread. Without one a Lambertian specimen of reflectance 1 is
        assumed: the worst case of all specimens that light every patch.
    collector : str or Subdivision
        Patches of the Lambertian; a pilot brings its own.
    epsilon, delta : float
        The paper's absolute error tolerance and confidence, in (0, 1).
    rel_err, level : float
        Relative standard error of each patch worth reporting; and relative error that
        all of them keep at once with probability `level`.
    floor : float
        Patches below this fraction of the mean BRDF are not worth reporting.

    Returns
    -------
    Plan
        For independent rays.

    Raises
    ------
    TypeError, ValueError
        If a number is out of its range, or the pilot is no record, a stack, or
        reflects nothing.
    """
    if pilot is None:
        patches = subdivision(collector)
        probabilities = (patches.projected_solid_angles / np.pi).ravel()
        n_patches, source = patches.n_patches, f"a white Lambertian specimen, {patches}"
    else:
        probabilities, n_patches = _pilot_probabilities(pilot, floor)
        source = f"a pilot of {pilot.ledger.emitted:.3g} rays, {pilot.subdivision}"
    n_lobe = len(probabilities)
    return Plan(
        n_patches=n_patches,
        n_lobe=n_lobe,
        chebyshev=chebyshev_rays(epsilon, delta),
        paper=paper_rays(n_patches, epsilon, delta),
        paper_lobe=paper_rays(n_lobe, epsilon, delta),
        union=union_rays(n_patches, epsilon, delta),
        standard_error=standard_error_rays(probabilities, rel_err),
        relative=relative_rays(probabilities, rel_err, level),
        epsilon=epsilon,
        delta=delta,
        rel_err=rel_err,
        level=level,
        source=source,
    )


def _pilot_probabilities(pilot: Record, floor: float) -> tuple[Floats, int]:
    """Flux fractions of the patches worth reporting, and the number of all patches."""
    if not isinstance(pilot, Record):
        raise SettingTypeError(
            f"pilot must be a Record, got {pilot!r:.80} (collector= takes patches)"
        )
    if len(pilot) != 1:
        raise SettingError(
            f"the pilot must be of one incident direction, got a stack of {len(pilot)}"
        )
    record = pilot[0]
    values = patch_values(record, "brdf", "btdf")
    if not values.any():
        raise SettingError("the pilot must have received some light, got none")
    projected = record.subdivision.projected_solid_angles
    # the channel with the least light in a patch asks for most rays
    least = values.min(axis=-1)
    inside = lobe(least, projected, floor)
    return (least * projected)[inside], inside.size


# ------------------------------------------------------------------------------ bounds


def chebyshev_rays(epsilon: float, delta: float) -> int:
    """Rays for one detector by eq. 17: ``ceil(ln(2 / delta) / (2 epsilon^2))``.

    Parameters
    ----------
    epsilon : float
        Absolute error of the flux fraction, in (0, 1).
    delta : float
        Probability of exceeding it, in (0, 1).
    """
    return union_rays(1, epsilon, delta)


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
    condition = "a number in (0, 1)"
    epsilon = checked_number("epsilon", epsilon, 1e-12, 1, condition)
    delta = checked_number("delta", delta, 1e-300, 1, condition)
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
    from scipy import special  # slow to import

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
    from scipy import optimize, special  # slow to import

    p = _checked_probabilities(probabilities)
    rel_err = checked_number("rel_err", rel_err, 1e-9, 1, "a number in (0, 1)")
    level = checked_number("level", level, 1e-9, 1, "a number in (0, 1)")
    # the rarest patch alone, and every patch as rare as it, bracket the answer
    odds = (1 - p.min()) / p.min() + 1e-12
    low = odds * (special.ndtri((1 - level) / 2) / rel_err) ** 2
    high = odds * (special.ndtri((1 - level) / (2 * p.size)) / rel_err) ** 2
    if p.size == 1:
        return math.ceil(low)
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
    variance = max(fraction * (1 - fraction), 1 / campaigns)
    return fraction, math.sqrt(variance / campaigns)


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
