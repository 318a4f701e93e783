"""Values about directions, and the covariance of their errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...array_types import Floats
from ...collector.directions import direction
from ...files.measured_table import MeasuredTable
from ...results.record import Record
from ...results.statistics import residuals

# Hits that stand for a value that is not counted: more than enough for Student's t.
MANY_HITS = 2.0**60


@dataclass(frozen=True, eq=False)
class Points:
    """Values with two kinds of errors: independent ones, and common ones.

    The covariance of the values is ``diag(std_err**2) + roots.T @ roots``. Rows of
    `roots` are errors that all values have together: that of each batch of rays, that
    of a calibration, those of the parameters of a fit.

    Attributes
    ----------
    value : ndarray, shape (n,)
    std_err : ndarray, shape (n,)
        Standard uncertainties that are independent between points.
    roots : ndarray, shape (n_errors, n)
        None by default.
    dof : ndarray
        Degrees of freedom of `std_err`; by default infinitely many.
    """

    value: Floats
    std_err: Floats
    roots: Any = None
    dof: Any = None

    def __post_init__(self) -> None:
        n = len(self.value)
        if self.roots is None:
            object.__setattr__(self, "roots", np.zeros((0, n)))
        if self.dof is None:
            object.__setattr__(self, "dof", np.full(n, np.inf))

    def with_stated(self, relative: float) -> Points:
        """The same, each value with another relative standard uncertainty beside."""
        return replace(self, std_err=np.hypot(self.std_err, relative * self.value))

    def __getitem__(self, rows: Any) -> Points:
        """Return the points of some rows."""
        value, std_err = self.value[rows], self.std_err[rows]
        return Points(value, std_err, self.roots[:, rows], self.dof[rows])

    @classmethod
    def of_table(cls, table: MeasuredTable) -> Points:
        """BRDF or BTDF of each row of a table in 1/sr, with a common scale."""
        value = table.bsdf
        roots = table.scale_uncertainty * value[None]
        return cls(value, table.bsdf_std_err, roots, table.bsdf_dof)

    @classmethod
    def of_record(cls, record: Record, index: int, where: Any) -> Points:
        """Flux fractions of a record, with the error of each batch of rays.

        Parameters
        ----------
        record : Record
        index : int
            Of its incident direction.
        where : tuple of ndarray of int, each of shape (n,)
            Hemispheres, rows, columns and channels.
        """
        tally = record.tallies[index]
        sums = tally.sums[(slice(None), *where)].astype(float)
        incident = tally.incident[:, where[-1]].astype(float)
        roots = residuals(sums, incident, record.estimates[index].unlike_power)
        value = sums.sum(axis=0) / incident.sum(axis=0)
        return cls(value, np.zeros_like(value), roots)

    @property
    def error(self) -> Floats:
        """Standard error of each value."""
        return np.sqrt(self.std_err**2 + np.sum(self.roots**2, axis=0))

    @property
    def reported_error(self) -> Floats:
        """That of a result, NaN where nothing is known of it."""
        return self.error

    @property
    def welch(self) -> Floats:
        """Sum of the fourth powers of each value's errors over their dof."""
        return self.std_err**4 / self.dof

    @property
    def hits(self) -> Floats:
        """How many hits each value is counted by."""
        return np.full(len(self.value), MANY_HITS)

    def correlation(self, sigma: Floats) -> tuple[Floats, float]:
        """Share of the points' covariance: its root, over `sigma` of each point.

        And degrees of freedom, which are finite where it is an estimate.
        """
        return self.roots / sigma, np.inf

    def total(self, weight: Floats) -> tuple[float, float, float]:
        """Weighted sum of the values, its variance and its sum as of `welch`."""
        variance = float(self.covariance(weight[None])[0, 0])
        return float(self.value @ weight), variance, float(self.welch @ weight**4)

    def covariance(self, weights: Floats) -> Floats:
        """Covariance of weighted sums of the values.

        Parameters
        ----------
        weights : ndarray, shape (n_sums, n)
        """
        common = self.roots @ weights.T
        return (weights * self.std_err**2) @ weights.T + common.T @ common

    def dof_of(self, weights: Floats) -> float:
        """Degrees of freedom of one weighted sum, after Welch and Satterthwaite."""
        parts = (weights * self.std_err) ** 2
        with np.errstate(divide="ignore", invalid="ignore"):
            welch = np.nan_to_num(parts**2 / self.dof).sum()
        total = float(self.covariance(weights[None])[0, 0])
        return total**2 / welch if welch else np.inf


def exit_directions(table: MeasuredTable) -> Floats:
    """Unit vectors of exit, shape (n, 3), each above the horizon of its hemisphere."""
    theta = np.where(table.theta_o > 90, 180 - table.theta_o, table.theta_o)
    return direction(np.radians(theta), np.radians(table.phi_o))
