"""Values about directions, and the covariance of their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...array_types import Floats
from ...collector.directions import direction
from ...files.measured_table import MeasuredTable


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
    dof : ndarray or float
        Degrees of freedom of `std_err`.
    """

    value: Floats
    std_err: Floats
    roots: Floats
    dof: Floats | float = np.inf

    @classmethod
    def of_table(cls, table: MeasuredTable) -> Points:
        """BRDF or BTDF of each row of a table in 1/sr, with a common scale."""
        value = table.bsdf
        roots = table.scale_uncertainty * value[None]
        return cls(value, table.bsdf_std_err, roots, table.bsdf_dof)

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
