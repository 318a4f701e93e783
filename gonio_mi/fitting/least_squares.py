"""The sum of squares that a fit makes small, and how uncertain its minimum is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..array_types import Flags, Floats
from ..errors import SpecimenError
from .fitted_model import FittedModel, LoadedModel
from .observations import Observations

__all__ = ["Search"]

# Differences for derivatives, relative to a value or to a hundredth of its range: wide
# against single precision, narrow against the curvature.
STEP = 3e-4

# Steps from each start, after which the best of them is known.
FIRST_STEPS = 12

# Standard errors by which a parameter changes the record all over its range, at least;
# and the condition beyond which parameters do the same to it, as far as derivatives by
# differences in single precision can tell.
LEAST_EFFECT, MOST_ALIKE = 1.0, 1e3


class Search:
    """The sum of squares to be minimised, and how uncertain its minimum is.

    Parameters
    ----------
    observations : sequence of Observations
    model : FittedModel
    report : callable, optional
        Called with 1 for each prediction.
    """

    def __init__(
        self,
        observations: Sequence[Observations],
        model: FittedModel,
        report: Callable[[float], Any] | None = None,
    ) -> None:
        self.observations, self.model = observations, model
        self._loaded, self._report = LoadedModel(model), report
        # the last prediction and its parameters, with the nodes as they are
        self._last: tuple[Floats, Floats] | None = None
        self.values = np.concatenate([one.values for one in observations])
        self.scales = np.ones_like(self.values)
        self._ends = np.cumsum([one.values.size for one in observations])[:-1]

    def begin(self) -> Floats:
        """Values of a first search on a few nodes: the best minimum of all starts."""
        self._last = None
        for one in self.observations:
            one.begin()
        tried = []
        for start in self.model.starts():
            self._weigh(self.predicted(start))
            found = self.minimum(start, FIRST_STEPS)
            tried.append((self.misfit(self.predicted(found)), found))
        return min(tried, key=lambda one: one[0])[1]

    def misfit(self, predicted: Floats) -> float:
        """Sum of squares by which minima and models are compared."""
        parts = zip(self.observations, np.split(predicted, self._ends))
        return sum(one.misfit(part) for one, part in parts)

    def adapt(self, values: Floats) -> None:
        """Refine the nodes for these values, and share variances."""
        self._last = None
        bsdf = self._loaded.bsdf(values)
        self._weigh(np.concatenate([one.adapt(bsdf) for one in self.observations]))

    def _weigh(self, predicted: Floats) -> None:
        """Share variances among patches that are predicted to be alike."""
        parts = zip(self.observations, np.split(predicted, self._ends))
        self.scales = np.sqrt(np.concatenate([one.variances(p) for one, p in parts]))

    def residuals(self, predicted: Floats) -> Floats:
        """Differences of prediction and observation over their standard errors."""
        return (predicted - self.values) / self.scales

    def minimum(self, values: Floats, most_steps: int | None = None) -> Floats:
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
            max_nfev=most_steps,
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
        parts = (
            np.split(array, self._ends, axis=-1) for array in (estimate, self.scales**2)
        )
        for one, part, variances in zip(self.observations, *parts):
            total[np.ix_(free, free)] += one.propagated(part, variances)
        return total

    def at_limit(self, values: Floats) -> Flags:
        """Which of the parameters would go beyond their limits."""
        low, high = self.model.limits
        near = 1e-4 * (high - low)
        return (values < low + near) | (values > high - near)

    def predicted(self, values: Floats) -> Floats:
        """Prediction with the nodes as they are."""
        if self._last is None or not np.array_equal(self._last[0], values):
            bsdf = self._loaded.bsdf(values)
            found = np.concatenate([one.of(bsdf) for one in self.observations])
            self._last = values.copy(), found
            if self._report is not None:
                self._report(1)
        return self._last[1]

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
