"""The sum of squares that a fit makes small, and how uncertain its minimum is."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats
from ..errors import SpecimenError
from ..instrument.loading import loaded
from ..results.record import Record
from .fitted_models import FittedModel
from .patch_predictions import PatchPredictions
from .pooled_variances import pooled

__all__ = ["Search"]

# Differences for derivatives, relative to a value or to a hundredth of its range: wide
# against single precision, narrow against the curvature.
STEP = 3e-4

# Relative error of the integrals of a model, in no error bar of a record of integrals.
RELATIVE_FLOOR = 1e-4

# Standard errors by which a parameter changes the record all over its range, at least;
# and the condition beyond which parameters do the same to it, as far as derivatives by
# differences in single precision can tell.
LEAST_EFFECT, MOST_ALIKE = 1.0, 1e3


class Search:
    """The sum of squares to be minimised, and how uncertain its minimum is."""

    def __init__(self, record: Record, model: FittedModel) -> None:
        self.model = model
        self.singles = [record[i] for i in range(len(record))]
        self.predictions = [PatchPredictions(single) for single in self.singles]
        self.fluxes = [single.flux_fraction.ravel() for single in self.singles]
        self.flux = np.concatenate(self.fluxes)
        self.scales = np.ones_like(self.flux)

    def begin(self) -> Floats:
        """Values of a first search, on a few nodes, from the best of all starts."""
        for one in self.predictions:
            one.begin()
        tried = []
        for start in self.model.starts():
            predicted = self.predicted(start)
            self._weigh(predicted)
            tried.append((float(np.sum(self.residuals(predicted) ** 2)), start))
        best = min(tried, key=lambda one: one[0])[1]
        self._weigh(self.predicted(best))
        return self.minimum(best)

    def adapt(self, values: Floats) -> None:
        """Refine the nodes for these values, and share variances."""
        bsdf = self._bsdf(values)
        self._weigh(np.concatenate([one.adapt(bsdf) for one in self.predictions]))

    def _weigh(self, predicted: Floats) -> None:
        """Share variances among patches that are predicted to be alike."""
        ends = np.cumsum([flux.size for flux in self.fluxes])[:-1]
        each = map(_variances, self.singles, self.fluxes, np.split(predicted, ends))
        self.scales = np.sqrt(np.concatenate(list(each)))

    def residuals(self, predicted: Floats) -> Floats:
        """Differences of prediction and record over their standard errors."""
        return (predicted - self.flux) / self.scales

    def minimum(self, values: Floats) -> Floats:
        """Values of least squares, with nodes and variances as they are."""
        from scipy.optimize import least_squares

        low, high = self.model.limits
        inside = np.clip(values, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
        found = least_squares(
            lambda x: self.residuals(self.predicted(x)),
            inside,
            lambda x: self._jacobian(x) / self.scales[:, None],
            (low, high),
            x_scale="jac",
            xtol=1e-7,
            ftol=1e-9,
        )
        return found.x

    def covariance(self, values: Floats) -> Floats:
        """Covariance of the minimum, from the scatter of the batches about it.

        NaN for parameters at a limit, and for those of which any value would do.
        """
        low, high = self.model.limits
        jacobian = self._jacobian(values) / self.scales[:, None]
        size = np.linalg.norm(jacobian, axis=0)
        free = ~self.at_limit(values) & (size * (high - low) > LEAST_EFFECT)
        jacobian = jacobian[:, free]
        if free.any() and np.linalg.cond(jacobian / size[free]) > MOST_ALIKE:
            names = ", ".join(parameter.name for parameter in self.model.parameters)
            raise SpecimenError(
                f"the record does not determine {names} together: give some of them, "
                "as in roughconductor:alpha=0.2"
            )
        estimate = np.linalg.pinv(jacobian) / self.scales
        total = np.full((len(values), len(values)), np.nan)
        total[np.ix_(free, free)] = 0.0
        ends = np.cumsum([flux.size for flux in self.fluxes])
        for single, part in zip(self.singles, np.split(estimate, ends[:-1], axis=1)):
            total[np.ix_(free, free)] += _propagated(single, part)
        return total

    def at_limit(self, values: Floats) -> Flags:
        """Which of the parameters would go beyond their limits."""
        low, high = self.model.limits
        near = 1e-4 * (high - low)
        return (values < low + near) | (values > high - near)

    def predicted(self, values: Floats) -> Floats:
        """Prediction with the nodes as they are."""
        bsdf = self._bsdf(values)
        return np.concatenate([one.of(bsdf) for one in self.predictions])

    def _jacobian(self, values: Floats) -> Floats:
        """Derivatives of the prediction, by differences within the limits."""
        here, columns = self.predicted(values), []
        for i, (value, low, high) in enumerate(zip(values, *self.model.limits)):
            step = STEP * max(abs(value), (high - low) / 100)
            moved = values.copy()
            moved[i] = value + step if value + step <= high else value - step
            there = self.predicted(moved)
            columns.append((there - here) / (moved[i] - value))
        return np.stack(columns, axis=-1)

    def _bsdf(self, values: Floats) -> mi.BSDF:
        return loaded("the model", mi.load_dict, self.model.bsdf(values))


def _batches(single: Record) -> Floats | None:
    """Flux fractions batch by batch, shape (n_batches, n); None for integrals."""
    (tally,) = single.tallies
    if single.settings.get("estimator") == "quadrature" or tally.n_batches < 2:
        return None
    incident = tally.incident.astype(float)[:, None, None, None]
    return (tally.sums / incident).reshape(tally.n_batches, -1)


def _std_errs(single: Record) -> Floats:
    """Standard errors of the flux fractions; 0 where nothing is known of one."""
    solid = single.subdivision.projected_solid_angles[..., None]
    both = [single.brdf_std_err, single.btdf_std_err]
    errors = np.stack([one * solid for one in both if one is not None])
    return np.nan_to_num(errors).ravel()


def _variances(single: Record, flux: Floats, predicted: Floats) -> Floats:
    """Variance of each patch, of which a fit makes its weights."""
    found = _std_errs(single) ** 2
    if _batches(single) is None:
        return found + (RELATIVE_FLOOR * (flux + flux.mean())) ** 2
    (tally,) = single.tallies
    hits = np.repeat(tally.hits.ravel(), len(single.channels)).astype(np.int64)
    # a tenth of a ray, where all batches received the same
    least = 0.1 / max(single.ledger.emitted, 1)
    return np.maximum(pooled(found, hits, predicted), least**2)


def _propagated(single: Record, estimate: Floats) -> Floats:
    """Covariance of a linear estimate from the patches of one incident direction."""
    batches = _batches(single)
    if batches is None:
        return (estimate * _std_errs(single) ** 2) @ estimate.T
    each = batches @ estimate.T
    return np.atleast_2d(np.cov(each, rowvar=False)) / len(batches)
