"""The function `measure`: here and at once, or a campaign of one specimen."""

from __future__ import annotations

import inspect
from os import PathLike
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from ..errors import LostLightWarning, SettingError, warn
from ..instrument.incidence import incident_angles
from ..instrument.measure import measure_each, measure_stacks
from ..results.record import Record
from ..results.summary import lost_light
from ..settings import MeasurementSettings, declarations, numpydoc
from ..specimen.specimen_text import SpecimenLike

if TYPE_CHECKING:
    from concurrent.futures import Executor


def measure(
    specimen: SpecimenLike,
    theta_i: ArrayLike | None = None,
    phi_i: ArrayLike = 0.0,
    *,
    emitter: dict[str, Any] | None = None,
    parameters: dict[str, Any] | None = None,
    resume: Record | None = None,
    executor: Executor | int | None = None,
    folder: str | PathLike[str] | None = None,
    progress: bool = False,
    **settings: Any,
) -> Record:
    """Measure how a specimen scatters light.

    A setting that is None comes from the specimen's scene file, if that is a complete
    measurement (integrator `goniophotometer`, sensor `collector`), else from the
    defaults below.

    Parameters
    ----------
    specimen : dict, mi.BSDF, mi.Scene, str or path
        A BSDF, a shape or a scene: a dictionary, an object or an XML file.
    theta_i, phi_i : float or sequence of float, optional
        Incident direction in degrees: ``0 <= theta_i < 90`` from the normal of the lit
        face, `phi_i` from +x counter-clockwise seen from +z. Sequences give a stack of
        records: all azimuths for the first angle, then for the second, and so on.
        Without `theta_i` the scene's own emitter is used.
    {settings}
    emitter : dict, optional
        Mitsuba emitter, or shape with one, instead of a collimated beam. With `theta_i`
        it is described for incidence along the normal, above the specimen on +z, and
        turned about the origin.
    parameters : dict, optional
        Values for the ``$name`` parameters of an XML file.
    resume : Record, optional
        An interrupted record of this very measurement, which is carried on: the result
        has the bits of an uninterrupted one.
    executor, folder : optional
        Where to measure the incident directions, and where to keep what is finished:
        see :func:`campaign`, of which this is the case of one specimen.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    Record
        After Ctrl-C, of the rays that all batches had sent alike: all but the last
        eighth at most once a measurement is long; with a warning and the setting
        ``interrupted``. A BSDF that creates light, as a reflectance above 1 does, gives
        a warning. Light that is in no patch, misses the specimen, or leaves over edges
        of a surface that may be larger, beyond the statistical error, gives a
        :class:`~gonio_mi.errors.LostLightWarning`; a collector that is finer than the
        patches in which the specimen's own material was measured, a
        :class:`~gonio_mi.errors.FinerPatchesWarning`.

    Raises
    ------
    TypeError, ValueError
        If a setting is out of its range; the message names it.
    SpecimenError
        If the specimen cannot be loaded or measured, or an integral not be converged.
    VariantError
        If no variant is set, or one that cannot be used, or `wavelengths` are given in
        one that is not spectral, or a flag of Dr.Jit is set with which it cannot work.
    LostRaysError
        If the ledger does not hold all rays that were sent.
    """
    if "whole" in settings:  # is no setting, but for measure_whole
        MeasurementSettings().changed(whole=settings["whole"])
    settings |= {"emitter": emitter, "parameters": parameters, "progress": progress}
    incidents, stacked = incident_angles(theta_i, phi_i, settings.get("incident"))
    if executor is None and folder is None:
        (record,) = measure_stacks(specimen, incidents, resume=resume, **settings)
    elif resume is not None:
        raise SettingError("resume and folder are mutually exclusive")
    else:
        where: dict[str, Any] = {"executor": executor, "folder": folder}
        from .campaign import campaign  # pools of processes are slow to import

        done = campaign({"specimen": specimen}, theta_i, phi_i, **where, **settings)
        record = done["specimen"]
    record = record if stacked else record[0]
    for sentence in lost_light(record):
        warn(sentence, LostLightWarning)
    return record


def measure_whole(
    specimen: SpecimenLike,
    theta_i: ArrayLike | None = None,
    phi_i: ArrayLike = 0.0,
    **settings: Any,
) -> Record:
    """Like :func:`measure` here and at once, without a warning of light that is lost.

    And after Ctrl-C KeyboardInterrupt instead of a part.
    """
    incidents, stacked = incident_angles(theta_i, phi_i, settings.get("incident"))
    record = measure_each(specimen, incidents, whole=True, **settings)
    return record if stacked else record[0]


def _with_settings(signature: inspect.Signature) -> inspect.Signature:
    """Signature with each declared setting in the place of ``**settings``."""
    given = [p for p in signature.parameters.values() if p.name != "settings"]
    declared = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None)
        for name in declarations(MeasurementSettings)
    ]
    return signature.replace(parameters=given + declared)


measure.__doc__ = (measure.__doc__ or "").replace(
    "{settings}", numpydoc(MeasurementSettings)
)
measure.__signature__ = _with_settings(inspect.signature(measure))  # type: ignore[attr-defined]
