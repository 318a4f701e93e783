"""Parameters of a BSDF from a record, a table or a specimen, with uncertainties."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from typing import Any

import mitsuba as mi
import numpy as np

from ...array_types import Floats
from ...errors import SettingError, shown
from ...files.measured_table import MeasuredTable
from ...instrument.measure import measure_each
from ...kernels import launches_kernels
from ...progress import bar
from ...reports.page import picture_and_text
from ...results.azimuth_symmetry import without_copies
from ...results.record import Record, wavelengths_nm
from ...results.tally import without_chance
from ...specimen.specimen_text import SpecimenLike, parse_specimen, specimen_name
from ..comparison.comparison import known
from ..comparison.measure_like import PRECISION_SETTINGS, first_that_can
from ..quantities import Quantity, quantity
from .least_squares import MAX_REDUCED_CHI2, MAX_SCATTER, FittedModel, Search
from .observations import Observations, RecordObservations, TableObservations
from .scene_model import FittedScene, SceneSearch, is_scene

# How the model's light is measured for a quantity: each ray of light adds to each
# receptor, so that the result follows the parameters smoothly.
DEPOSITS: dict[str, Any] = {"estimator": "next_event", "trace": True, "rays": 2**16}

# Standard errors to either side of 95 %.
Z_95 = 1.96

# Angles at which a specimen is measured, in degrees: the middles of three equal parts
# of the projected solid angle, from which diffuse light comes in equal shares.
THETA_I = (24.0, 45.0, 66.0)


@launches_kernels()
def fit(
    record: Record | MeasuredTable | SpecimenLike,
    model: str | Mapping[str, Any],
    free: Sequence[str] | None = None,
    *,
    start: Mapping[str, float] | None = None,
    uncertainty: float | None = None,
    scale_uncertainty: float | None = None,
    aperture_half_angle: float | None = None,
    progress: bool = False,
    **settings: Any,
) -> Fit:
    """Find the parameters with which a BSDF looks like a record, a table or a specimen.

    Minimised is chi-square, the sum over the patches of all incident directions of the
    squared differences of record and model over their variances; the model's patches
    are integrals of its ``eval``. Variances of rays are a power of the flux that the
    model predicts, with a common factor, both by those of the record: a patch that by
    chance received too little has too small a one of its own. The covariance is that of
    the estimate over the record's own batches, so that it knows how patches depend on
    each other. Directions that a campaign copied from others are left out, since they
    would count their noise twice.

    Parameters
    ----------
    record : Record, MeasuredTable, dict, str or path
        Of a collimated beam, with error bars. A table's values are means over its
        aperture, or over its patches as in one that :func:`gonio_mi.export` wrote, or
        if it states neither, the BSDF in its directions; without any uncertainty they
        are taken for uncertain by one part of themselves. Patches of integrals, which
        have no noise, by one part of themselves and their mean. A specimen is measured
        at 24, 45 and 66 degrees of incidence, the middles of three equal parts of
        diffuse light: its ``eval`` is integrated (``quadrature``) where it is flat and
        has no delta components, else it is sampled.
    model : str, dict, path or mi.Scene
        BSDF plugin with what is known of it: ``"roughconductor:distribution=ggx"``. Or
        a scene, such as a surface of facets, or a BSDF with others in it, for records:
        it is measured as the record was, at each step with derivatives where it has
        them, and the search begins where it is.
    free : sequence of str, optional
        Parameters to be found; with limits, ``"weight=0:1"``, of any name. Default for
        ``diffuse``: reflectance; ``roughconductor``: alpha and specular_reflectance, of
        a metal that reflects all light unless it is said; ``roughdielectric``: alpha,
        int_ior; ``roughplastic``: alpha, int_ior, diffuse_reflectance; ``principled``:
        base_color, roughness, metallic, specular. Mitsuba has air, of index 1.000277,
        outside unless ``ext_ior`` is said. Parameters of a scene are named as by
        `mi.traverse`, or by the end of that: ``"bsdf_0.alpha.value"``; several that are
        one and the same are joined by ``+``. Colours of three channels are within 0 and
        1, as Mitsuba loads no others: one that would pass 1 is in ``at_limit``.
    start : mapping of str to float, optional
        Where the search for some of them begins: ``{"alpha": 0.01}``. Default: for a
        roughness 0.05, 0.15 and 0.4, and finer ones if none of these ends near what
        was measured and within the limits.
    uncertainty, scale_uncertainty : float, optional
        Of the values of a table, as of :func:`gonio_mi.compare`. Default: what it says.
    aperture_half_angle : float, optional
        Of the detector in degrees, if a table does not say it.
    progress : bool
        Show a progress bar on standard error.
    **settings
        Of :func:`~gonio_mi.measure`, for a specimen: other angles, `rays`. Beside a
        record those of a scene, by default four times its rays.

    Returns
    -------
    Fit

    Raises
    ------
    ValueError
        If the record cannot be fitted, or does not determine the parameters.
    """
    bsdf, scene = _parsed(model, free or ())
    if isinstance(record, Mapping) and "type" not in record:  # several, of orders
        text = f"record must be one record, table or specimen, got {shown(record)}"
        raise SettingError(f"{text}: take one of these")
    told = {
        "uncertainty": uncertainty,
        "scale_uncertainty": scale_uncertainty,
        "aperture_half_angle": aperture_half_angle,
    }
    own_settings: dict[str, Any] = {}
    if not isinstance(record, (Record, MeasuredTable)):
        if not scene:
            FittedModel(bsdf, free, ("Y",), start)  # refused before it is measured
        record = _measured(record, settings, progress)
    elif scene:
        own_settings = settings
    elif given := [name for name in settings if settings[name] is not None]:
        kind = type(record).__name__
        raise SettingError(f"{min(given)} applies to a specimen, got a {kind}")
    record = _as_told(record, {k: v for k, v in told.items() if v is not None})
    observations = _observations(record)
    fitted = _model(record, bsdf, free, start, scene)
    with bar(progress, desc=f"fit of {fitted.name}", unit="prediction") as report:
        search: Search
        if isinstance(fitted, FittedScene):
            search = SceneSearch(fitted, report, own_settings)
        else:
            search = Search(observations, fitted, report)
        values, covariance = search.found()
        return _result(record, fitted, search, values, covariance)


def _result(
    record: Record | MeasuredTable,
    fitted: FittedModel | FittedScene,
    search: Search,
    values: Floats,
    covariance: Floats,
) -> Fit:
    """What a search has found, and how far the model is from the record there."""
    predicted = search.predicted(values)
    at_limit = search.at_limit(values)
    chi2 = float(np.sum(search.residuals(predicted) ** 2))
    dof, scatter = max(round(search.count()) - len(values), 1), None
    if not all(one.stated for one in search.observations):
        # not less than what the errors of integrals are, of a record of such
        least = float(isinstance(record, Record))
        covariance, chi2 = covariance * max(chi2 / dof, least), float(dof)
        scatter = float(np.sqrt(search.misfit(predicted) / dof))
    misplaced = np.abs(predicted - search.values).sum() / search.values.sum() / 2
    return Fit(
        record,
        fitted.described(values),
        fitted.names,
        values,
        covariance,
        chi2=chi2,
        dof=dof,
        misplaced=float(misplaced),
        predicted=predicted,
        at_limit=tuple(name for name, at in zip(fitted.names, at_limit) if at),
        scatter=scatter,
        model=fitted,
        measured=search.measured(values) if isinstance(search, SceneSearch) else None,
        derivatives=search.derivatives,
    )


def _parsed(model: Any, free: Sequence[str]) -> tuple[Any, bool]:
    """The model, and whether it is a scene."""
    bsdf: Any = parse_specimen(model) if isinstance(model, str) else model
    scene = is_scene(bsdf, free)
    if scene and not free:
        raise SettingError(
            "free (--free) must name parameters of a scene as mi.traverse does, or "
            f"model must be a BSDF with a type, got {shown(model)}"
        )
    if not scene and not (isinstance(bsdf, Mapping) and "type" in bsdf):
        raise SettingError(f"model must be a BSDF with a type, got {shown(model)}")
    return bsdf, scene


def _model(
    record: Record | MeasuredTable,
    bsdf: Any,
    free: Sequence[str] | None,
    start: Mapping[str, float] | None,
    scene: bool,
) -> FittedModel | FittedScene:
    """The model with its free parameters, a BSDF or a scene."""
    if not scene:
        channels = record.channels if isinstance(record, Record) else ("Y",)
        return FittedModel(bsdf, free, channels, start)
    if isinstance(record, Record):
        return FittedScene(bsdf, free or (), start, record)
    raise SettingError(
        f"a fit of a scene needs a record, got the table {record.name}: take a BSDF"
    )


def _measured(
    specimen: SpecimenLike, settings: dict[str, Any], progress: bool
) -> Record:
    """Record of a specimen: integrals, or else rays; those where they are asked for."""
    given = {name: value for name, value in settings.items() if value is not None}
    ways: list[dict[str, Any]] = [{"estimator": "quadrature"}, {}]
    if isinstance(specimen, str):
        specimen = parse_specimen(specimen)
    own = {"theta_i": THETA_I, "progress": progress} | given
    return first_that_can(specimen, ways[bool(PRECISION_SETTINGS & own.keys()) :], own)


def _as_told(
    record: Record | MeasuredTable, told: dict[str, Any]
) -> Record | MeasuredTable:
    """Record without its copied directions, or table with what was told of it."""
    if isinstance(record, Record):
        for name in told:
            raise SettingError(f"{name} applies to tables only, got a record")
        return without_copies(record)
    return record.stated(**told)


def _observations(record: Record | MeasuredTable) -> Sequence[Observations]:
    """What a fit looks at, of each incident direction or of a whole table."""
    if isinstance(record, MeasuredTable):
        _check_table(record)
        return [TableObservations(record)]
    _check(record)
    return [RecordObservations(single) for single in record]


def _check_table(table: MeasuredTable) -> None:
    """Raise ValueError for a table that no BSDF can be fitted to."""
    if table.emitter_half_angle:
        raise SettingError(
            f"a fit needs a collimated beam, but {table.name} has an "
            f"emitter_half_angle of {table.emitter_half_angle:g} degrees"
        )
    if mi.is_rgb or (mi.is_spectral and wavelengths_nm([table.channel or ""]) is None):
        raise SettingError(
            "a fit to a table needs the variant llvm_ad_mono, or llvm_ad_spectral if "
            f"its channel is a wavelength such as 550nm, got {mi.variant()}"
        )
    if not table.bsdf.any():
        raise SettingError(f"a fit needs light, but all values of {table.name} are 0")
    if table.bsdf.sum() <= 0:
        raise SettingError(
            f"a fit needs light, but the values of {table.name} are negative on average"
        )


def _check(record: Record) -> None:
    """Raise ValueError for a record that no BSDF can be fitted to."""
    spectral = wavelengths_nm(record.channels) is not None
    colours = len(record.channels) > 1 and not spectral
    if spectral != mi.is_spectral or (colours and not mi.is_rgb):
        raise SettingError(
            f"the variant must be the record's, {record.provenance.variant}, got "
            f"{mi.variant()}"
        )
    filled = record.asked.divergence or record.asked.incident is not None
    if filled or not np.isfinite(record.theta_i).all():
        raise SettingError("a fit needs a record of a collimated beam")
    if not record.flux_fraction.any():
        raise SettingError(f"a fit needs light, got none (order: {record.asked.order})")
    if np.isnan(record.brdf_std_err[record.brdf > 0]).any():
        raise SettingError("a fit needs a record with error bars, of several batches")


# Hits from which standard errors are right: of 100 counted one by one, those of a
# reflectance are a quarter too small (40 seeds), of 300 within chance.
MIN_FIT_HITS = 300


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
        Its degrees of freedom: patches less parameters; a patch that is as uncertain as
        a hit counts in part.
    misplaced : float
        Part of the light that the model sends into other patches than the record; of a
        table or of apertures, half the mean difference over the mean of all values.
    predicted : ndarray, shape (n,)
        What the model says of the values: flux fractions of the detectors of a record,
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

        found, errors = results(self.values), []
        for step in self._axes():
            ends, width = [], 0.0
            for sign in (1, -1):
                part = self.model.part_within_limits(self.values, sign * step)
                ends.append(results(self.values + sign * part * step))
                width += part
            each = [(a.value - b.value) / width for a, b in zip(*ends)] if width else []
            errors.append(each or [0.0] * len(found))
        total = np.linalg.norm(np.reshape(errors, (-1, len(found))), axis=0).tolist()
        answers = [self._with_error(*pair) for pair in zip(found, total)]
        return answers[0] if len(answers) == 1 else tuple(answers)

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
                "  the model does not follow the record within its noise, which is all "
                "that +- stands for"
            )
        if isinstance(self.record, Record) and not without_chance(self.record.tallies):
            hits = int(self.record.counts.sum())
            if hits < MIN_FIT_HITS:
                lines.append(f"  {hits} hits are few: +- may be a quarter too small")
        return "\n".join(lines)
