"""Derivatives of a measurement by parameters of its specimen, with uncertainties."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..array_types import Flags, Floats
from ..errors import SettingError, checked_choice, checked_number, did_you_mean, shown
from ..single_precision import ROUNDING
from . import statistics
from .estimates import Estimate, Estimates
from .tally import DifferentiatedIntegrals, DifferentiatedTally
from .values import QUANTITIES, TOTALS, MeasuredValues

# Weights of rays that were not seen, over the largest mean weight of a patch: slopes
# grow towards the tails of a lobe.
UNSEEN = 4.0

Limits = tuple[Floats, Floats]


@dataclass(frozen=True, eq=False)
class SampledGradients:
    """Derivatives of flux fractions by some numbers of parameters, from rays.

    Hemisphere 0 is the emitter's side. Derivatives of patches have the shape
    ``(n_theta, n_phi, channels, n)``, those of the total ``(channels, n)``.

    Attributes
    ----------
    tally : DifferentiatedTally
    light : Estimates
        Of the light itself.
    numbers : slice
        Components of the parameter.
    """

    tally: DifferentiatedTally
    light: Estimates
    numbers: slice

    def value(self, hemisphere: int, total: bool) -> Floats:
        """Derivatives of each patch, or of the `total`."""
        return statistics.ratio(self._changes(hemisphere, total), self._incident(total))

    def std_err(self, hemisphere: int, total: bool) -> Floats:
        """Standard errors from the batches; NaN without a hit."""
        sums, incident = self._changes(hemisphere, total), self._incident(total)
        found = statistics.batch_std_err(sums, incident, self.light.unlike_power)
        found[np.asarray(_sum_of(self.light, hemisphere, total).hits) == 0] = np.nan
        return found

    def interval(self, hemisphere: int, total: bool, level: float) -> Limits:
        """Limits by Student's t, or of few hits those of gains and losses.

        These are fluxes without a sign, which have limits like light, and the
        differences of these limit the derivative.
        """
        value, std_err = self.value(hemisphere, total), self.std_err(hemisphere, total)
        light = _sum_of(self.light, hemisphere, total)
        pairs = _pairs(self.tally.changes, self.numbers, hemisphere, total)
        count = np.maximum(np.asarray(light.hits)[..., None, None], 1)
        mean, incident = np.sum(pairs, axis=(0, 1)), self._incident(total).sum(axis=0)
        unseen = statistics.upper_limit(light.rays, level)
        unseen = unseen * mean / count * light.rays / incident
        least = np.maximum(unseen, ROUNDING * np.abs(value))
        n = np.asarray(self.light.n_batches)[..., None]
        limits = statistics.student_interval(value, std_err, n, level, least, least)
        rare, (low, high) = self._apart(hemisphere, total, level)
        few = rare | (light.few | light.dark)[..., None]
        return np.where(few, low, limits[0]), np.where(few, high, limits[1])

    def _apart(
        self, hemisphere: int, total: bool, level: float
    ) -> tuple[Flags, Limits]:
        """Where heavy gains or losses are rare, and limits of their differences."""
        numbers = self.numbers
        columns = slice(2 * numbers.start, 2 * numbers.stop)
        parts = self.tally.parts(columns)
        weight = parts.sums[:, hemisphere].sum(axis=0)
        hits = np.maximum(self.tally.hits[hemisphere], 1)[..., None]
        # in units of a weight that no ray has, as far as is known
        unit = UNSEEN * np.max(weight / hits, initial=0.0) / parts.scale or 1.0
        scaled = replace(parts, sums=parts.sums / unit)
        each = _sum_of(replace(self.light, tally=scaled), hemisphere, total)
        low, high = each.interval((1 + level) / 2)
        shape = *low.shape[:-1], self.tally.channels, -1, 2
        low, high, rare = (one.reshape(shape) for one in (low, high, each.pooled))
        limits = low[..., 0] - high[..., 1], high[..., 0] - low[..., 1]
        return np.any(rare, axis=-1), (limits[0] * unit, limits[1] * unit)

    def _incident(self, total: bool) -> Floats:
        """Incident flux per batch, broadcastable to derivatives."""
        incident = self.tally.incident.astype(float)[..., None]
        return incident if total else incident[:, None, None]

    def _changes(self, hemisphere: int, total: bool) -> Floats:
        """Gains less losses, per batch."""
        gains, losses = _pairs(self.tally.changes, self.numbers, hemisphere, total)
        found: Floats = gains - losses
        return found


def _sum_of(light: Estimates, hemisphere: int, total: bool) -> Estimate:
    """Estimates of the patches of a hemisphere, or of their total."""
    return light.total(hemisphere) if total else light.patches(hemisphere)


@dataclass(frozen=True, eq=False)
class IntegralGradients:
    """Derivatives of integrals, which may be wrong by their error.

    Attributes as of :class:`SampledGradients`.
    """

    tally: DifferentiatedIntegrals
    numbers: slice

    def value(self, hemisphere: int, total: bool) -> Floats:
        """Derivatives of each patch, or of the `total`."""
        return self._both(hemisphere, total)[0]

    def std_err(self, hemisphere: int, total: bool) -> Floats:
        """Error bounds, summed as if none cancelled."""
        return self._both(hemisphere, total)[1]

    def interval(self, hemisphere: int, total: bool, level: float) -> Limits:  # noqa: ARG002
        """Limits at any level."""
        value, error = self._both(hemisphere, total)
        return value - error, value + error

    def _both(self, hemisphere: int, total: bool) -> tuple[Floats, Floats]:
        """Derivatives and errors."""
        value, error = _pairs(self.tally.changes, self.numbers, hemisphere, total)
        return value[0], error[0]


def _pairs(
    changes: Floats, numbers: slice, hemisphere: int, total: bool
) -> tuple[Floats, Floats]:
    """First and second columns of some numbers per batch, channels before numbers."""
    columns = slice(2 * numbers.start, 2 * numbers.stop)
    own = np.swapaxes(changes[:, hemisphere, ..., columns, :], -1, -2)
    own = own.sum(axis=(1, 2)) if total else own
    return own[..., ::2], own[..., 1::2]


class Differentiated:
    """What a record tells of derivatives, by the parameters that were asked for."""

    @property
    def gradients(self: Any) -> tuple[str, ...]:
        """Parameters with respect to which the measurement was differentiated."""
        names: tuple[str, ...] = self.asked.gradients
        return names

    def gradient(self: Any, name: str, of: str = "brdf") -> Floats:
        """Derivative of a quantity by a parameter.

        Parameters
        ----------
        name : str
            One of `gradients`; with ``[i]`` behind it, of its number `i` alone.
        of : {"brdf", "btdf", "dhr", "dht"}

        Returns
        -------
        ndarray
            Shaped like the quantity; for several numbers of a parameter with a further
            axis of these.

        Raises
        ------
        ValueError
            If the measurement was not differentiated by that, for another `of`, or
            without lower hemisphere.
        """
        return _of_each(self, "value", name, of)[0]

    def gradient_std_err(self: Any, name: str, of: str = "brdf") -> Floats:
        """Standard error of a :meth:`gradient`; NaN for a patch without a hit.

        From the scatter of the batches; for integrals their estimated error.
        """
        return _of_each(self, "std_err", name, of)[0]

    def gradient_interval(
        self: Any, name: str, level: float = 0.95, of: str = "brdf"
    ) -> Limits:
        """Interval that covers the derivative with probability `level`.

        By Student's t over the batches. Where hits are few, or heavy ones rare, what
        rays gain and what they lose have limits as light has them, of which the
        differences are the interval.

        Returns
        -------
        low, high : ndarray
            Shaped like the :meth:`gradient`.
        """
        level = checked_number("level", level, 1e-12, 1, "between 0 and 1")
        low, high = _of_each(self, "interval", name, of, level)
        return low, high


@dataclass(frozen=True)
class Slope:
    """Derivative of a total in one channel by one number of a parameter."""

    of: str
    channel: str
    by: str
    value: float | None
    std_err: float | None
    low: float | None
    high: float | None


def slopes_of(record: Any, level: float) -> list[Slope]:
    """Derivatives of the totals of one incident direction, with their intervals."""
    found = []
    for of in TOTALS[: record.n_hemispheres]:
        for by in record.provenance.columns:
            value, error = record.gradient(by, of), record.gradient_std_err(by, of)
            low, high = record.gradient_interval(by, level, of)
            for channel, *numbers in zip(record.channels, value, error, low, high):
                known = (float(x) if np.isfinite(x) else None for x in numbers)
                found.append(Slope(of, channel, by, *known))
    return found


def _of_each(
    record: MeasuredValues, what: str, name: str, of: str, *more: float
) -> tuple[Floats, ...]:
    """Value, standard error or limits for all incident directions."""
    checked_choice("of", of, QUANTITIES)
    numbers, alone = _numbers(record, name)
    hemisphere, total = record._hemisphere(of), of in TOTALS
    each = []
    for tally, light in zip(record.tallies, record.estimates):
        estimates: Any
        if isinstance(tally, DifferentiatedIntegrals):
            estimates = IntegralGradients(tally, numbers)
        else:
            estimates = SampledGradients(tally, light, numbers)  # type: ignore[arg-type]
        found = getattr(estimates, what)(hemisphere, total, *more)
        each.append(found if isinstance(found, tuple) else (found,))
    solid = 1.0 if total else record.subdivision.projected_solid_angles[..., None, None]
    arrays = (record._squeeze(np.stack(one) / solid) for one in zip(*each))
    return tuple(one[..., 0] if alone else one for one in arrays)


def _numbers(record: MeasuredValues, name: str) -> tuple[slice, bool]:
    """Places of the numbers of a parameter, and whether it is one."""
    columns = record.provenance.columns
    kinds = DifferentiatedTally, DifferentiatedIntegrals
    if not all(isinstance(tally, kinds) for tally in record.tallies):
        columns = ()
    found = [
        i for i, one in enumerate(columns) if one == name or one.startswith(f"{name}[")
    ]
    if not found:
        known = ", ".join(columns) or "none"
        raise SettingError(
            f"gradient must be by a parameter that measure was given as gradients, "
            f"{known}, got {shown(name)}{did_you_mean(str(name), columns)}"
        )
    return slice(found[0], found[-1] + 1), columns[found[0]] == name
