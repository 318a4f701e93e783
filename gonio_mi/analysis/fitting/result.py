"""What a fit has found: parameters, their covariance, and what follows from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from typing import Any

import numpy as np

from ...array_types import Floats
from ...errors import SettingError
from ...files.measured_table import MeasuredTable
from ...instrument.measure import measure_each
from ...reports.page import picture_and_text
from ...results.record import Record, wavelengths_nm
from ...results.tally import without_chance
from ...specimen.specimen_text import specimen_name
from ..comparison.comparison import known
from ..comparison.measure_like import PRECISION_SETTINGS
from ..points import Model, Points
from ..points.predictions import (
    Predictions,
    check_record,
    check_table,
    predictions_of_record,
    predictions_of_table,
)
from ..quantities import Quantity, quantity
from .least_squares import MAX_REDUCED_CHI2, MAX_SCATTER, FittedModel, LoadedModel
from .scene_model import FittedScene

# How the model's light is measured for a quantity: each ray of light adds to each
# receptor, so that the result follows the parameters smoothly.
DEPOSITS: dict[str, Any] = {"estimator": "next_event", "trace": True, "rays": 2**16}

# Standard errors to either side of 95 %.
Z_95 = 1.96

# Hits from which standard errors are right: of 100 counted one by one, those of a
# reflectance are a quarter too small (40 seeds), of 300 within chance.
MIN_FIT_HITS = 300


@dataclass(frozen=True, eq=False)
class Fit(Model):
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
        Its degrees of freedom: patches less parameters; a patch that is as uncertain as
        a hit counts in part.
    misplaced : float
        Part of the light that the model sends into other patches than the record; of a
        table or of apertures, half the mean difference over the mean of all values.
    predicted : ndarray, shape (n,)
        Values predicted by the model: flux fractions of the detectors of a record, or
        BSDF of the rows of a table.
    at_limit : tuple of str
        Parameters that would go beyond what they may be.
    scatter : float, optional
        Of a table that states no uncertainty, or a record of integrals: how far its
        points are from the model, relative, or its patches, relative to themselves and
        their mean; root mean square. `chi2` is then that of points as uncertain.
    model : FittedModel or FittedScene, optional
        The BSDF with its free parameters, which :meth:`quantity` varies.
    measured : Record, optional
        Of a scene, its last measurement.
    derivatives : {"exact", "differences"}
        By what the search and the uncertainties know how the model changes.
    notes : tuple of str
        Remarks on the fit: for a scene, ambiguous starting values, and reasons for
        finite differences; for a BSDF, a near-field record.
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
    model: FittedModel | FittedScene | None = None
    measured: Record | None = None
    derivatives: str = "differences"
    notes: tuple[str, ...] = ()

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
        """Record of the model as the record was measured, or the model's table."""
        if self.measured is not None:
            return self.measured
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
        stack = measure_each(
            self.bsdf,
            list(zip(self.record.theta_i.tolist(), self.record.phi_i.tolist())),
            collector=self.record.subdivision,
            estimator="quadrature",
            side=self.record.asked.side,
            hemispheres="both" if self.record.has_lower else "upper",
            wavelengths=None if nm is None else nm.tolist(),
        )
        return stack if self.record.stacked else stack[0]

    def quantity(self, name: str | Sequence[str], **settings: Any) -> Any:
        """Quantity of the fitted model, such as gloss, with the fit's covariance.

        The model is measured as :func:`gonio_mi.quantity` does, by deposits of light
        towards the receptors unless `rays` or `estimator` is given, and again, with the
        same rays, with its parameters one standard error to either side along the axes
        of their covariance: half the difference is the standard error of each axis.

        Parameters
        ----------
        name : str or sequence of str
            As of :func:`gonio_mi.quantity`.
        **settings
            Of :func:`gonio_mi.quantity`.

        Returns
        -------
        Quantity or tuple of Quantity
            Its `parts` are the standard errors of the parameters and of the model's own
            rays. What the model cannot do is in none, and noted.

        Raises
        ------
        TypeError, ValueError
            As of :func:`gonio_mi.quantity`.
        """
        if self.model is None:
            raise SettingError("a quantity needs a fit that `fit` has made")
        own: dict[str, Any] = {} if settings.keys() & PRECISION_SETTINGS else DEPOSITS
        if isinstance(self.record, Record):
            own = own | {"side": self.record.asked.side}
        if self.measured is not None:
            own = own | {"period": self.measured.asked.period}

        model = self.model

        def results(values: Floats) -> list[Quantity]:
            """Quantities of the model with these values."""
            with model.at(values) as bsdf:
                found = quantity(name, bsdf, **own | settings)
            return [found] if isinstance(found, Quantity) else list(found)

        found = results(self.values)
        errors = self._roots(
            model, lambda x: np.array([one.value for one in results(x)]), len(found)
        )
        total = np.linalg.norm(errors, axis=0).tolist()
        answers = [self._with_error(*pair) for pair in zip(found, total)]
        return answers[0] if len(answers) == 1 else tuple(answers)

    def points(self, like: Record | MeasuredTable) -> Points:
        """Values in 1/sr of what was measured, with the errors of the parameters.

        Integrals of the model's ``eval``, as those to which it was fitted; again with
        its parameters one standard error to either side, as of :meth:`quantity`.

        Parameters
        ----------
        like : Record or MeasuredTable
            Of one incident direction and a collimated beam; or a table.

        Raises
        ------
        ValueError
            If a BSDF cannot be compared with it, or a scene was fitted.
        """
        if not isinstance(self.model, FittedModel):
            raise SettingError(
                "a fit of a scene has no values beside what was measured: take the "
                "scene itself, or the fit's own record `measured`"
            )
        if isinstance(like, Record):
            check_record(like)
            each: Sequence[Predictions] = predictions_of_record(like)
            order: Any = slice(None)
        else:
            check_table(like)
            each, order = predictions_of_table(like)
        loaded = LoadedModel(self.model)

        def results(values: Floats) -> Floats:
            """Values of the model with these parameters, by the same nodes."""
            bsdf = loaded.bsdf(values)
            return np.concatenate([one.of(bsdf) for one in each])[order]

        for one in each:
            one.adapt(loaded.bsdf(self.values))
        value = results(self.values)
        roots = self._roots(self.model, results, len(value))
        least = max(one.integral_err for one in each)
        std_err = least * (np.abs(value) + np.abs(value).mean())
        if isinstance(like, MeasuredTable):
            return Points(value, std_err, roots)
        patches, channels = like.subdivision, len(like.channels)
        solid = patches.projected_solid_angles.ravel()[: patches.n_detectors]
        solid = np.tile(np.repeat(solid, channels), like.n_hemispheres)
        return Points(value / solid, std_err / solid, roots / solid)

    def _roots(
        self,
        model: FittedModel | FittedScene,
        results: Callable[[Floats], Floats],
        n: int,
    ) -> Floats:
        """Errors of n results by each axis of the parameters' covariance, (axes, n)."""
        errors = []
        for step in self._axes():
            ends, width = [], 0.0
            for sign in (1, -1):
                part = model.part_within_limits(self.values, sign * step)
                ends.append(results(self.values + sign * part * step))
                width += part
            errors.append((ends[0] - ends[1]) / width if width else np.zeros(n))
        return np.reshape(errors, (-1, n))

    def _axes(self) -> Floats:
        """Steps of the parameters by one standard error along each axis."""
        known = np.isfinite(self.std_errs)
        if not known.any():
            return np.zeros((0, len(self.values)))
        sizes, axes = np.linalg.eigh(self.covariance[np.ix_(known, known)])
        steps = np.zeros((len(sizes), len(self.values)))
        steps[:, known] = (axes * np.sqrt(np.maximum(sizes, 0))).T
        return steps

    def _with_error(self, one: Quantity, error: float) -> Quantity:
        """A quantity of the model, with the standard error of the parameters."""
        parts = {"parameters": error, "rays": float(np.nan_to_num(one.std_err))}
        std_err = float(np.hypot(error, parts["rays"]))
        half = Z_95 * error
        low, high = (float(np.hypot(half, end - one.value)) for end in one.interval)
        low = one.value - low if one.definition.curve else max(one.value - low, 0.0)
        unknown = [n for n, e in zip(self.names, self.std_errs) if not np.isfinite(e)]
        notes = [f"the uncertainty of {n} is not known, nor in this" for n in unknown]
        if self.reduced_chi2 > MAX_REDUCED_CHI2 or (self.scatter or 0) > MAX_SCATTER:
            notes.append("the model does not fit the data: its +- says little")
        interval = low, one.value + high
        found = replace(one, std_err=std_err, interval=interval, parts=parts)
        return replace(found, notes=tuple(notes))

    def plot(self, path: str | PathLike[str] | None = None) -> Any:
        """Figure of record and prediction in the plane of incidence."""
        from .figure import fit_figure

        return fit_figure(self, path)

    def to_dict(self) -> dict[str, Any]:
        """What was found, in JSON's types."""
        parameters = zip(self.names, self.values.tolist(), self.std_errs.tolist())
        return {
            "bsdf": self.bsdf,
            "parameters": {
                name: {"value": value, "std_err": known(std_err)}
                for name, value, std_err in parameters
            },
            "covariance": [list(map(known, row)) for row in self.covariance.tolist()],
            "chi2": self.chi2,
            "dof": self.dof,
            "misplaced": self.misplaced,
            "at_limit": list(self.at_limit),
            "scatter": self.scatter,
            "derivatives": self.derivatives,
            "notes": list(self.notes),
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
        # seven digits are what Mitsuba's single precision keeps
        short = {
            key: float(f"{value:.7g}") if isinstance(value, float) else value
            for key, value in self.bsdf.items()
        }
        lines = [specimen_name(short)]
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
        lines += [f"  note: {one}" for one in self.notes]
        what, why, places = "record", "integrals have no noise", "patches"
        left = f"{100 * self.misplaced:.3g} % misplaced flux"
        if isinstance(self.record, MeasuredTable):
            what, why, places = "table", "the table states no uncertainty", "points"
            left = f"points differ by {200 * self.misplaced:.3g} % of their mean"
        if self.scatter is not None:
            lines.append(
                f"  {why}: +- is one standard error from how {places} scatter about "
                f"the model, by {100 * self.scatter:.3g} % (rms); {left}"
            )
            if self.scatter > MAX_SCATTER:
                lines.append(f"  the model does not follow the {what}: +- says little")
            return "\n".join(lines)
        lines.append(
            f"  +- is one standard error; chi-square per degree of freedom "
            f"{self.reduced_chi2:.3g} ({self.dof} degrees of freedom), {left}"
        )
        if self.reduced_chi2 > MAX_REDUCED_CHI2:
            lines.append(
                f"  the model does not follow the {what} within its noise, which is "
                "all that +- stands for"
            )
        if isinstance(self.record, Record) and not without_chance(self.record.tallies):
            hits = int(self.record.counts.sum())
            if hits < MIN_FIT_HITS:
                lines.append(f"  {hits} hits are few: +- may be a quarter too small")
        return "\n".join(lines)
