"""Parameters of a BSDF from a record, a table or a specimen, with uncertainties."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...array_types import Floats
from ...errors import SettingError, shown
from ...files.measured_table import MeasuredTable
from ...kernels import launches_kernels
from ...progress import bar
from ...results.azimuth_symmetry import without_copies
from ...results.record import Record
from ...specimen.specimen_text import SpecimenLike, parse_specimen
from ..comparison.measure_like import PRECISION_SETTINGS, first_that_can
from ..points.predictions import check_record, check_table, near_field
from .least_squares import (
    FittedModel,
    Search,
)
from .observations import Observations, RecordObservations, TableObservations
from .result import Fit
from .scene_model import FittedScene, SceneSearch, is_scene

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
        notes=(*_near(record, fitted), *search.notes),
    )


def _near(
    record: Record | MeasuredTable, fitted: FittedModel | FittedScene
) -> list[str]:
    """Note on a near-field record; none for a scene, which is measured likewise."""
    if isinstance(record, Record) and isinstance(fitted, FittedModel):
        return near_field(record)
    return []


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
        check_table(record)
        return [TableObservations(record)]
    check_record(record)
    return [RecordObservations(single) for single in record]
