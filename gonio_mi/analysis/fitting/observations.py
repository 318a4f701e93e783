"""Observations of a fit: values of records and tables, and their uncertainties."""

from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from ...array_types import Floats
from ...errors import SettingError
from ...files.measured_table import MeasuredTable
from ...results.record import Record
from ...results.tally import holds_integrals, without_chance
from ...single_precision import FEW_ROUNDINGS
from ..points import Points
from ..points.predictions import (
    INTEGRAL_ERR,
    MIN_INTEGRAL_ERR,
    predictions_of_record,
    predictions_of_table,
)

# Part of the mean below which values without an uncertainty are uncertain alike.
MIN_RELATIVE_VALUE = 0.01

# Part that the error of a model's integrals may have of the standard error of a table's
# values, but of the tenth of them that are known best: 0.5 % of the variance.
MAX_INTEGRAL_PART, KNOWN_BEST = 0.07, 0.1


class RecordObservations:
    """Flux fractions of one incident direction of a record, in all its detectors.

    As they are, where sums over mirror facets are negative by chance: only unbiased
    values have weighted means, and so least squares, without bias.

    Parameters
    ----------
    single : Record

    Attributes
    ----------
    values : ndarray, shape (n,)
    predictions : list of PatchPredictions or of ConePredictions
        What predicts them, one after the other, ``[order]``.
    stated : bool
        Whether uncertainties of the values are known, and not only how they compare,
        as of integrals, which have no noise.
    """

    order: Any = slice(None)

    def __init__(self, single: Record) -> None:
        self.single = single
        self.predictions = predictions_of_record(single)
        self.values = self.kept(single.flux_fraction)
        (self._tally,) = single.tallies
        sampled = not holds_integrals(single.tallies)
        self._has_batches = sampled and self._tally.n_batches > 1
        self.stated = not without_chance(single.tallies)

    def variances(self, predicted: Floats) -> Floats:
        """Variances for weights: the record's, smoothed over the detectors' flux."""
        found = self.std_errs() ** 2
        if holds_integrals(self.single.tallies):
            least = INTEGRAL_ERR * (self.values + self.values.mean())
            return found + least**2
        n, hits = len(self.single.channels), float(self._tally.hits.sum())
        columns = (one.reshape(-1, n).T for one in (found, predicted, self.values))
        least = FEW_ROUNDINGS * self.values.sum()  # of a channel without light
        each = [
            smoothed(variances, flux, max(values.sum(), least) / hits)
            for variances, flux, values in zip(*columns)
        ]
        return np.stack(each, axis=-1).ravel()

    def count(self, variances: Floats) -> float:
        """How many values chi-square has; one of less than a hit counts in part."""
        if holds_integrals(self.single.tallies):
            return float(self.values.size)
        return float(np.sum(self.std_errs() ** 2 / variances))

    def misfit(self, predicted: Floats) -> float:
        """Chi-square; of integrals, of distances relative to value and mean."""
        relative = self.values + self.values.mean()
        variances = self.variances(predicted) if self.stated else relative**2
        return float(np.sum((predicted - self.values) ** 2 / variances))

    def points(self, variances: Floats) -> Points:
        """Values with the errors of batches, in which detectors go together.

        And of single precision: where all rays came, the batches say that the sum of
        what they carry is exact.
        """
        rounding = FEW_ROUNDINGS * self.values[None]
        if not self._has_batches:
            return Points(self.values, np.sqrt(variances), rounding)
        patches, channels = self.single.subdivision, len(self.single.channels)
        shape = self.single.n_hemispheres, patches.n_detectors, channels
        hemisphere, patch, channel = (a.ravel() for a in np.indices(shape))
        where = hemisphere, *np.divmod(patch, patches.shape[1]), channel
        found = Points.of_record(self.single, 0, where)
        return replace(found, roots=np.vstack([found.roots, rounding]))

    def kept(self, values: Floats) -> Floats:
        """Values of the detectors, without what is between them, in one row."""
        detectors = self.single.subdivision.n_detectors
        hemispheres, channels = self.single.n_hemispheres, len(self.single.channels)
        return values.reshape(hemispheres, -1, channels)[:, :detectors].ravel()

    def std_errs(self) -> Floats:
        """Standard errors of the flux fractions; 0 where nothing is known of one."""
        solid = self.single.subdivision.projected_solid_angles[..., None]
        both = [self.single.brdf_std_err, self.single.btdf_std_err]
        errors = np.stack([one * solid for one in both if one is not None])
        return self.kept(np.nan_to_num(errors))


class TableObservations:
    """BSDF values of a measured table, in all its directions.

    Parameters
    ----------
    table : MeasuredTable
        Where it states an aperture, or else patches, its values are means over these.
        Without any uncertainty all values are taken for uncertain by the same part of
        themselves.

    Attributes as of :class:`RecordObservations`.
    """

    def __init__(self, table: MeasuredTable) -> None:
        self.table, self.values = table, table.bsdf
        self.stated = bool(table.bsdf_std_err.any())
        self.order: Any
        self.predictions, self.order = predictions_of_table(table)
        self._mean = float(np.abs(self.values).mean())
        if self.stated:
            best = np.quantile(table.bsdf_std_err, KNOWN_BEST) / self._mean
            wanted = np.clip(MAX_INTEGRAL_PART * best, MIN_INTEGRAL_ERR, INTEGRAL_ERR)
            for one in self.predictions:
                one.refine_to(float(wanted))

    def variances(self, predicted: Floats) -> Floats:
        """Variances for weights: the table's, or squares of what the model predicts.

        Raises
        ------
        ValueError
            If the table states none, and the model predicts no light at all.
        """
        if not self.stated and not predicted.any():
            raise SettingError(
                f"the model must send light to where {self.table.name} was measured "
                f"({self.table.quantity}), got none"
            )
        if not self.stated:
            size = np.abs(predicted)
            return (size + MIN_RELATIVE_VALUE * size.mean()) ** 2
        # a part of what is predicted: a part of a value that noise made small would
        # give it too much weight
        relative = self.table.uncertainty
        found = self.table.bsdf_std_err**2 - (relative * self.values) ** 2
        if self.table.degrees_of_freedom is not None:
            # of Student's t, from 3 on
            dof = max(self.table.degrees_of_freedom, 3.0)
            found = found * dof / (dof - 2)
        found = np.maximum(found, 0) + (relative * predicted) ** 2
        # what the model's integrals may be wrong by; and the rounding of its values
        least = max(one.integral_err for one in self.predictions)
        return found + (max(least, FEW_ROUNDINGS) * self._mean) ** 2

    def count(self, variances: Floats) -> float:
        """How many values chi-square has."""
        return float(variances.size)

    def misfit(self, predicted: Floats) -> float:
        """Chi-square; without variances, of distances relative to both values.

        Relative to those of a model alone one that is far too bright would be near.
        """
        variances = self.variances(predicted)
        if not self.stated:
            variances = (variances + self.variances(self.values)) / 2
        return float(np.sum((predicted - self.values) ** 2 / variances))

    def points(self, variances: Floats) -> Points:
        """Values with these variances, and with errors of a common factor."""
        return replace(Points.of_table(self.table), std_err=np.sqrt(variances))


Observations: TypeAlias = RecordObservations | TableObservations


# Power of the flux that a variance is: 0 of noise from elsewhere, 1 of counts, 2 of
# light that fluctuates as a whole.
MIN_POWER, MAX_POWER = 0.0, 2.0


def smoothed(variances: Floats, flux: Floats, hit: float) -> Floats:
    """Variances as a power of the flux that a model predicts, about as those given.

    A detector that has by chance received too little has too small a variance as well:
    weights from variances of single detectors, or of few, would pull a fit down by what
    a hit of each is worth. Two numbers for all detectors, and the model's flux, know
    nothing of a single one's chance (Carroll and Ruppert 1988, *Transformation and
    Weighting in Regression*, chapter 3). They are the most likely for variances that
    follow a gamma distribution, whose quotients by these have the mean 1.

    Parameters
    ----------
    variances, flux : ndarray, shape (n,)
    hit : float
        Flux of a hit, with which detectors that received none are uncertain as well.
    """
    from scipy.optimize import minimize_scalar

    log_flux = np.log(flux + hit)
    log_flux -= log_flux.mean()
    given = variances + hit**2

    def deviance(power: float) -> float:
        return float(np.log(np.mean(given * np.exp(-power * log_flux))))

    limits = MIN_POWER, MAX_POWER
    power = minimize_scalar(deviance, bounds=limits, method="bounded").x
    return np.mean(given * np.exp(-power * log_flux)) * np.exp(power * log_flux)
