"""The function `fit`: parameters of a BSDF from a record or a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..errors import SettingError
from ..files.channels import wavelengths_nm
from ..files.measured_table import MeasuredTable
from ..instrument.loading import parse_specimen
from ..progress import bar
from ..results.copied_directions import without_copies
from ..results.record import Record
from ..transport.kernels import launches_kernels
from .fit_result import Fit
from .fitted_models import FittedModel
from .least_squares import Search
from .observations import Observations, RecordObservations, TableObservations

__all__ = ["fit"]

# Rounds of refined nodes and weights; a round is the last that moves no parameter by
# more than a part of its uncertainty, or of itself, which no node would notice.
MOST_ROUNDS, SETTLED, NEAR = 8, 0.02, 1e-3


@launches_kernels()
def fit(
    record: Record | MeasuredTable,
    model: str | Mapping[str, Any],
    free: Sequence[str] | None = None,
    *,
    uncertainty: float | None = None,
    scale_uncertainty: float | None = None,
    aperture_half_angle: float | None = None,
    progress: bool = False,
) -> Fit:
    """Find the parameters with which a BSDF is closest to a record or a table.

    Minimised is chi-square, the sum over the patches of all incident directions of the
    squared differences of record and model over their variances; the model's patches
    are integrals of its ``eval``. Variances are pooled over patches that the model
    makes alike. The covariance is that of the estimate over the record's own batches,
    so that it knows how patches depend on each other. Directions that a campaign copied
    from others are left out, since they would count their noise twice.

    Parameters
    ----------
    record : Record or MeasuredTable
        Of a collimated beam, with error bars. A table's values are means over its
        aperture, or over its patches as in one that :func:`gonio_mi.export` wrote, or
        if it states neither, the BSDF in its directions; without any uncertainty they
        are taken for uncertain by one part of themselves.
    model : str or dict
        BSDF plugin with what is known of it: ``"roughconductor:distribution=ggx"``.
    free : sequence of str, optional
        Parameters to be found; with limits, ``"weight=0:1"``, of any name. Default for
        ``diffuse``: reflectance; ``roughconductor``: alpha and specular_reflectance, of
        a metal that reflects all light unless it is said; ``roughdielectric``: alpha,
        int_ior; ``roughplastic``: alpha, int_ior, diffuse_reflectance; ``principled``:
        base_color, roughness, metallic, specular. Mitsuba has air, of index 1.000277,
        outside unless ``ext_ior`` is said. Colours of three channels are within 0 and
        1, as Mitsuba loads no others: one that would pass 1 is in ``at_limit``.
    uncertainty, scale_uncertainty : float, optional
        Of the values of a table, as of :func:`gonio_mi.compare`. Default: what it says.
    aperture_half_angle : float, optional
        Of the detector in degrees, if a table does not say it.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    Fit

    Raises
    ------
    ValueError
        If the record cannot be fitted, or does not determine the parameters.
    """
    bsdf = parse_specimen(model) if isinstance(model, str) else dict(model)
    if not isinstance(bsdf, dict):
        raise SettingError(f"model must be a BSDF in one word, got {model!r}")
    record = _as_told(
        record,
        uncertainty=uncertainty,
        scale_uncertainty=scale_uncertainty,
        aperture_half_angle=aperture_half_angle,
    )
    observations = _observations(record)
    channels = record.channels if isinstance(record, Record) else ("Y",)
    fitted = FittedModel(bsdf, free, channels)
    with bar(progress, desc=f"fit of {bsdf['type']}", unit="prediction") as report:
        search = Search(observations, fitted, report)
        values, covariance = _found(search)
    predicted = search.predicted(values)
    at_limit = search.at_limit(values)
    names = tuple(parameter.name for parameter in fitted.parameters)
    chi2 = float(np.sum(search.residuals(predicted) ** 2))
    dof, scatter = predicted.size - len(values), None
    if not all(one.stated for one in observations):
        covariance, chi2 = covariance * chi2 / dof, float(dof)
        scatter = float(np.sqrt(search.misfit(predicted) / dof))
    misplaced = np.abs(predicted - search.values).sum() / search.values.sum() / 2
    return Fit(
        record,
        fitted.bsdf(values),
        names,
        values,
        covariance,
        chi2=chi2,
        dof=dof,
        misplaced=float(misplaced),
        predicted=predicted,
        at_limit=tuple(name for name, at in zip(names, at_limit) if at),
        scatter=scatter,
    )


def _found(search: Search) -> tuple[Floats, Floats]:
    """Values of the parameters, and their covariance."""
    values = search.begin()
    _check_number(search.observations, search.model)
    for _ in range(MOST_ROUNDS):
        search.adapt(values)
        before, values = values, search.minimum(values)
        covariance = search.covariance(values)
        moved = np.abs(values - before)
        noise = np.nan_to_num(np.sqrt(np.diag(covariance)))
        if np.all(moved <= np.maximum(SETTLED * noise, NEAR * np.abs(values))):
            break
    return values, covariance


def _as_told(
    record: Record | MeasuredTable, **told: float | None
) -> Record | MeasuredTable:
    """Record without its copied directions, or table with what was told of it."""
    given: dict[str, Any] = {
        name: value for name, value in told.items() if value is not None
    }
    if isinstance(record, Record):
        if given:
            raise SettingError(f"{next(iter(given))} goes with a table, got a record")
        return without_copies(record)
    if record.aperture_half_angle is not None:
        given.pop("aperture_half_angle", None)
    return replace(record, **given)


def _observations(record: Record | MeasuredTable) -> list[Observations]:
    """What a fit has to explain, once it is known that it can."""
    if isinstance(record, MeasuredTable):
        _check_table(record)
        return [TableObservations(record)]
    _check(record)
    return [RecordObservations(record[i]) for i in range(len(record))]


def _check_number(observations: Sequence[Observations], model: FittedModel) -> None:
    """Raise ValueError unless there are more values than parameters."""
    n_values = sum(one.values.size for one in observations)
    names = [parameter.name for parameter in model.parameters]
    if n_values <= len(names):
        raise SettingError(
            f"a fit of {', '.join(names)} needs more than {len(names)} values, got "
            f"{n_values}"
        )


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
    needs = {
        "a collimated beam": np.isfinite(record.theta_i).all()
        and not record.asked.divergence
        and record.asked.incident is None,
        "light in its patches": record.flux_fraction.any(),
    }
    for need, holds in needs.items():
        if not holds:
            raise SettingError(f"a fit needs a record of {need}")
    if np.isnan(record.brdf_std_err[record.brdf > 0]).any():
        raise SettingError("a fit needs a record with error bars, of several batches")
