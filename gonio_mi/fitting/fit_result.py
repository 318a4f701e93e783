"""What a fit has found: parameters, their covariance, and what is left."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from typing import Any

import numpy as np

from ..array_types import Floats
from ..files.channels import wavelengths_nm
from ..files.measured_table import MeasuredTable
from ..instrument.loading import specimen_name
from ..instrument.measurement import measure_here
from ..reports.page import picture_and_text
from ..results.record import Record

__all__ = ["Fit"]

# Chi-square per degree of freedom beyond which noise does not explain what is left; and
# the relative distance of points from the model that may be noise of an instrument.
MISFIT, FOLLOWED = 1.5, 0.1


@dataclass(frozen=True, eq=False)
class Fit:
    """A BSDF that was fitted to a record or a table.

    Attributes
    ----------
    record : Record or MeasuredTable
        What it was fitted to.
    bsdf : dict
        Mitsuba dictionary of the model with what was found.
    names : tuple of str
        Of the parameters that were free; those of a colour end in its channel.
    values, std_errs : ndarray, shape (n_parameters,)
        `std_errs` are what the noise of the record makes uncertain, and no more: what
        the model cannot do is in `chi2` and `misplaced`. NaN where a value is at its
        limit, or any would do.
    covariance : ndarray, shape (n_parameters, n_parameters)
    chi2 : float
        Sum of the squared residuals over the variances of the patches.
    dof : int
        Its degrees of freedom: patches less parameters.
    misplaced : float
        Part of the light that the model sends into other patches than the record; of a
        table or of apertures, half the mean difference over the mean of all values.
    predicted : ndarray, shape (n,)
        What the model says of the values: flux fractions of the detectors of a record,
        BSDF of the rows of a table.
    at_limit : tuple of str
        Parameters that would go beyond what they may be.
    scatter : float, optional
        Of a table that states no uncertainty: how far its points are from the model,
        relative, root mean square. `chi2` is then that of points as uncertain as that.
    """

    record: Record | MeasuredTable
    bsdf: dict[str, Any]
    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    chi2: float
    dof: int
    misplaced: float
    predicted: Floats
    at_limit: tuple[str, ...] = ()
    scatter: float | None = None

    @property
    def _residual(self) -> str:
        """What is left between the values and the model."""
        if self.scatter is not None:
            return (
                "the table states no uncertainty: +- is one standard error from how "
                f"its points scatter about the model, by {100 * self.scatter:.3g} % "
                "(rms)"
            )
        left = f"{100 * self.misplaced:.3g} % of the light in other patches"
        if isinstance(self.record, MeasuredTable):
            left = f"points differ by {200 * self.misplaced:.3g} % of their mean"
        return (
            f"+- is one standard error; chi-square per degree of freedom "
            f"{self.reduced_chi2:.3g} ({self.dof} degrees), {left}"
        )

    @property
    def std_errs(self) -> Floats:
        """Standard errors of `values`."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def reduced_chi2(self) -> float:
        """Chi-square per degree of freedom: 1 where noise explains all."""
        return self.chi2 / self.dof

    @property
    def label(self) -> str:
        """Name of the model, with its distribution of micro-normals if it has one."""
        distribution = self.bsdf.get("distribution")
        name = str(self.bsdf["type"])
        return name if distribution is None else f"{name} {distribution}"

    @cached_property
    def prediction(self) -> Record | MeasuredTable:
        """Record of the model as the record was measured, or the model's table.

        Raises ValueError for a record of apertures.
        """
        if isinstance(self.record, MeasuredTable):
            return replace(
                self.record,
                value=self.predicted,
                quantity="btdf" if self.record.quantity == "btdf" else "brdf",
                sigma=None,
                uncertainty=0.0,
                scale_uncertainty=0.0,
            )
        nm = wavelengths_nm(self.record.channels)
        singles = [
            measure_here(
                self.bsdf,
                float(theta_i),
                float(phi_i),
                collector=self.record.subdivision,
                estimator="quadrature",
                side=self.record.asked.side,
                hemispheres="both" if self.record.has_lower else "upper",
                wavelengths=None if nm is None else nm.tolist(),
            )
            for theta_i, phi_i in zip(self.record.theta_i, self.record.phi_i)
        ]
        return Record.stack(singles) if self.record.stacked else singles[0]

    def plot(self, path: str | PathLike[str] | None = None) -> Any:
        """Figure of record and prediction in the plane of incidence."""
        from .fit_figure import fit_figure

        return fit_figure(self, path)

    def to_dict(self) -> dict[str, Any]:
        """What was found, in JSON's types."""
        parameters = zip(self.names, self.values.tolist(), self.std_errs.tolist())
        return {
            "bsdf": self.bsdf,
            "parameters": {
                name: {"value": value, "std_err": _known(std_err)}
                for name, value, std_err in parameters
            },
            "covariance": [list(map(_known, row)) for row in self.covariance.tolist()],
            "chi2": self.chi2,
            "dof": self.dof,
            "misplaced": self.misplaced,
            "at_limit": list(self.at_limit),
            "scatter": self.scatter,
        }

    def _repr_html_(self) -> str:
        """Picture and numbers, for notebooks; numbers alone without Matplotlib."""
        return picture_and_text(self.plot, self)

    def __repr__(self) -> str:
        pairs = zip(self.names, self.values, self.std_errs)
        found = ", ".join(f"{name} {x:.6g} +- {error:.2g}" for name, x, error in pairs)
        return f"<Fit of {self.label}: {found}>"

    def __str__(self) -> str:
        width = max(map(len, self.names))
        lines = [specimen_name(self.bsdf)]
        errors = self.std_errs
        correlation = self.covariance / np.outer(errors, errors)
        for i, name in enumerate(self.names):
            line = f"  {name:<{width}}  {self.values[i]:.6g}"
            if np.isfinite(errors[i]):
                line += f" +- {errors[i]:.2g}"
            elif name not in self.at_limit:
                line += "  (any value would do)"
            others = [
                f"{correlation[i, j]:+.2f} with {self.names[j]}"
                for j in range(len(self.names))
                if j != i and abs(correlation[i, j]) > 0.9
            ]
            line += f"  (correlation {', '.join(others)})" if others else ""
            line += "  (at its limit)" if name in self.at_limit else ""
            lines.append(line)
        lines.append(f"  {self._residual}")
        if self.scatter is None and self.reduced_chi2 > MISFIT:
            lines.append(
                "  the model does not follow the record within its noise, which is all "
                "that +- stands for"
            )
        if self.scatter is not None and self.scatter > FOLLOWED:
            lines.append("  the model does not follow the table: +- says little")
        return "\n".join(lines)


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None
