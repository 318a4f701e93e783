"""The instrument: takes a specimen and settings, runs batches, returns a record."""

import logging
import time
import warnings

import mitsuba as mi
import numpy as np

from ..collector import subdivision
from ..errors import VariantError, checked_choice, checked_count
from ..memory import check_memory
from ..progress import bar
from ..results.ray_density import FLOOR
from ..results.record import Record
from ..results.tally import Tally, batch_sizes
from ..transport.kernels import launches_kernels
from ..transport.specimen import Specimen
from .batches import MAX_RAYS, checked_target, n_batches, send, send_until
from .incidence import emitter_scene, incident_angles, incident_key, lamp_digest
from .loading import check_variant, load_specimen, loaded, specimen_name
from .resuming import check_resumable

__all__ = ["measure", "measure_whole"]

logger = logging.getLogger(__name__)

# Light is said to be created where the intervals of this level begin above all that
# came, and by more than what a path of so many events loses to single precision.
SURE = 1 - 1e-9
PATH_ROUNDING = 1000 * float(np.finfo(np.float32).eps)


@launches_kernels(unless=("executor", "folder"))
def measure(
    specimen,
    theta_i=None,
    phi_i=0.0,
    *,
    collector=None,
    rays=None,
    rel_err=None,
    max_rays=None,
    floor=FLOOR,
    sampler=None,
    estimator=None,
    seed=0,
    side="front",
    footprint=None,
    emitter=None,
    emission=None,
    collector_radius=None,
    hemispheres=None,
    points=None,
    max_depth=None,
    rr_depth=None,
    trace=None,
    wavelengths=None,
    period=None,
    order=None,
    batches=None,
    parameters=None,
    resume=None,
    executor=None,
    folder=None,
    progress=False,
):
    """Measure how a specimen scatters light.

    A setting that is None takes its value from the specimen's scene file, if that is a
    complete measurement (integrator `goniophotometer`, sensor `collector`), else from
    the defaults below.

    Parameters
    ----------
    specimen : dict, mi.BSDF, mi.Scene, str or path
        A BSDF, a shape or a scene: a dictionary, an object or an XML file.
    theta_i, phi_i : float or sequence of float, optional
        Incident direction in degrees: ``0 <= theta_i < 90`` from the normal of the lit
        face, `phi_i` from +x counter-clockwise seen from +z. Sequences give a stack of
        records: all azimuths for the first angle, then for the second, and so on.
        Without `theta_i` the scene's own emitter is used.
    collector : str or Subdivision
        ``angle:NTxNP``, ``solid:NTxNP`` or ``projected:NTxNP``. Default
        ``projected:30x30``.
    rays : int
        Rays for each incident direction, up to 1e15. Default 1e6. In spectral variants
        so many for every four wavelengths.
    rel_err : float, optional
        Instead of `rays`: go on until the relative standard error of every patch worth
        reporting is at most this, for each incident direction. For `quadrature` the
        error to which every patch converges, down to a millionth of the mean; default
        1e-4.
    max_rays : int
        Where to stop then at the latest, with a warning. Default 1e9.
    floor : float
        Patches whose BRDF (or BTDF) is below this fraction of the mean over the
        collector are not worth reporting. Default 0.1.
    sampler : str or dict
        Mitsuba sampler plugin. Default ``sobol``, one quasi-Monte Carlo sequence for
        each batch; ``independent`` sends independent rays.
    estimator : {"weighted", "analog", "quadrature", "next_event"}
        Sum throughput; let rays survive or end and count them; integrate ``eval`` over
        the patches of a flat specimen in a collimated beam, deterministic, with rays
        for delta components only; or deposit ``eval``, at every event on geometry,
        towards points in random patches that are in sight, and count the rays as
        well, by the balance heuristic: for narrow apertures and for patches far from
        the lobes, but not for totals. Default ``weighted``.
    seed : int
        Same seed, same bits: whatever the number of threads.
    side : {"front", "back"}
        Face that looks at the emitter, +z or -z. Reflection is always its side.
    footprint : {"full", "point"} or float
        Where light lands on the top of the specimen: all over, in the middle, or in a
        disk of that radius about the middle. Default ``full``.
    emitter : dict, optional
        Mitsuba emitter, or shape with one, instead of a collimated beam. With `theta_i`
        it is described for incidence along the normal, above the specimen on +z, and
        turned about the origin.
    emission : {"radiometric", "equal_power"}
        Weight of the rays of such an emitter: its radiance, cosines and distance, as a
        real instrument has them (default); or the same power for uniform points on
        emitter and specimen, as in the paper (section 2.2).
    collector_radius : float
        Radius in scene units on which the exit position counts; 0, the default, is the
        far field.
    hemispheres : {"auto", "upper", "both"}
        ``auto`` leaves out the lower one for flat specimens that declare no
        transmission.
    points : int
        Points for each event, of the estimator `next_event`. Default 1. With
        ``hemispheres="upper"`` none is spent on a dark lower one.
    max_depth : int
        Surface events before a ray is truncated. Default 1000.
    rr_depth : int
        Surface events before Russian roulette; -1, the default, for never.
    trace : bool
        Trace rays even where a flat specimen does not need it. Default False.
    period : {"none", "box"}, float or (float, float)
        ``box`` makes the specimen's bounding box one cell of an infinite surface, so
        that there are no edges; numbers are the extents of that cell in x and y, about
        the middle of the box. The cell is the specimen: light that passes its openings
        is incident and transmitted, straight on (:attr:`Record.direct`). Beside a
        finite specimen, light is ``missed`` and not incident. Default ``none``.
    order : int or str
        Collect only rays with so many surface events: ``2``, or ``"3+"`` for three or
        more; ``0`` is the direct light that passes a periodic specimen. With one seed,
        orders 0, 1, 2 and ``"3+"`` add up to ``"all"``, the default, to the bit.
    wavelengths : sequence of float
        In nm, the channels in spectral variants, where the data of specimen and lamp
        hold them. Default 550.
    batches : int
        Independent batches from which uncertainties come. Default 16: with `sobol`
        every doubling costs a fifth of the precision that the same rays give.
    parameters : dict
        Values for the ``$name`` parameters of an XML file.
    resume : Record
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
        After Ctrl-C, of the batches that were finished, with a warning and the setting
        ``interrupted``. A BSDF that creates light, as a reflectance above 1 does, gives
        a warning.

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
    if executor is not None or folder is not None:
        return _by_campaign(dict(locals()))
    check_variant()
    integrator_settings = {
        "estimator": estimator,
        "rays": None if rays is None else checked_count("rays", rays, 1, MAX_RAYS),
        "batches": None if batches is None else checked_count("batches", batches),
        "points": points,
        "max_depth": max_depth,
        "rr_depth": rr_depth,
        "footprint": footprint,
        "emission": emission,
        "trace": trace,
        "wavelengths": _joined(wavelengths),
        "period": _joined(period),
        "order": None if order is None else str(order),
    }
    if wavelengths is not None and not mi.is_spectral:
        raise VariantError(
            "wavelengths need a spectral variant, such as llvm_ad_spectral, "
            f"got {mi.variant()}"
        )
    seed = checked_count("seed", seed, 0)
    checked_choice("side", side, ("front", "back"))
    if theta_i is None and emitter is None and (side != "front" or np.any(phi_i)):
        raise ValueError(
            "side and phi_i go with theta_i: without it the scene's emitter decides "
            f"where light comes from, got side {side} and phi_i {phi_i}"
        )
    incidents, stacked = incident_angles(theta_i, phi_i)
    if collector is not None:
        collector = subdivision(collector)
    scene = load_specimen(specimen, parameters)
    if _asked(scene, estimator) == "quadrature":
        integrator_settings["rel_err"], rel_err = rel_err, None
        if resume is not None:
            raise ValueError("resume is for sampled rays, got the estimator quadrature")
    target = checked_target(rel_err, max_rays, floor, rays, resume)
    integrator = _integrator(scene, integrator_settings)
    sensor = _sensor(scene, collector, collector_radius, hemispheres, sampler)
    measured = Specimen(scene, integrator.settings["period"])
    measured.name = specimen_name(specimen, parameters)
    integrator.check(measured)
    emitters = [emitter_scene(scene, emitter, incident, side) for incident in incidents]
    lamp = lamp_digest(emitter)
    benches = [
        integrator.bench(measured, lamps.emitters(), sensor, incident, lamp)
        for lamps, incident in zip(emitters, incidents)
    ]

    plan = batch_sizes(integrator.rays, integrator.batches)
    sums = sum(bench.n_collected for bench in benches)
    check_memory(
        f"{sums} patches in {len(plan)} batches",
        2 * 8 * sums * len(plan) * len(mi.Spectrum()),  # while they are joined
        "take fewer patches, incident directions or batches",
    )
    finished = [[] for _ in benches]
    if resume is not None:
        check_resumable(resume, integrator, benches, seed, plan)
        finished[: len(resume)] = [[tally] for tally in resume.tallies]

    started = time.perf_counter()
    keys = [(seed, *incident_key(incident)) for incident in incidents]
    complete = _send_all(integrator, benches, keys, plan, target, finished, progress)
    records = [
        integrator.record(bench, Tally.join(tallies), seed)
        for bench, tallies in zip(benches, finished)
        if tallies
    ]
    record = Record.stack(records) if stacked else records[0]
    _warn_of_created_light(records)
    logger.info("measured for %.3g s: %r", time.perf_counter() - started, record)
    if target:
        record.settings.update(target.reached(record))
        if complete:
            _warn_unless_reached(record, target)
    if not complete:
        record.settings["interrupted"] = True
        _warn_of_interruption(integrator, target, plan, finished)
    return record


def measure_whole(specimen, *args, **settings):
    """Like :func:`measure`, but after Ctrl-C KeyboardInterrupt instead of a part."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "interrupted: ", RuntimeWarning)
        record = measure(specimen, *args, **settings)
    if record.settings.get("interrupted"):
        raise KeyboardInterrupt
    return record


def _send_all(integrator, benches, keys, plan, target, finished, progress):
    """Append to `finished` the tallies of all benches; return whether all are there.

    After Ctrl-C they are those of what was finished; it is raised if that is nothing.
    """
    left = sum(sum(plan[n_batches(tallies) :]) for tallies in finished)
    rays = None if target else left * integrator.passes
    with bar(
        progress, total=rays, unit="ray", unit_scale=True, delay=1, mininterval=0.2
    ) as report:
        try:
            for bench, key, tallies in zip(benches, keys, finished):
                if not integrator.samples(bench):
                    if report is not None:
                        report(sum(plan))
                elif target:
                    send_until(target, integrator, bench, key, tallies, report)
                else:
                    send(integrator, bench, key, plan, tallies, report)
                if integrator.integrates:
                    tallies[:] = [integrator.integrated(bench, tallies)]
        except (KeyboardInterrupt, RuntimeError) as error:
            if not _is_ctrl_c(error):
                raise
            if integrator.integrates:  # rays alone are not enough
                for tallies in finished:
                    if tallies and tallies[0].errors is None:
                        tallies.clear()
            if not any(finished):
                raise KeyboardInterrupt from None
            return False
    return True


def _warn_of_created_light(records):
    """Warn if more light left than came, beyond chance and single precision."""
    for record in records:
        total, low = record.dhr, record.interval(SURE, "dhr")[0]
        if record.has_lower:
            total, low = total + record.dht, low + record.interval(SURE, "dht")[0]
        if np.any(low > 1 + PATH_ROUNDING):
            theta_i, phi_i = record.theta_i[0], record.phi_i[0]
            warnings.warn(
                f"the BSDF creates light: {np.max(total):.6g} of what came leaves for "
                f"incidence at theta_i {theta_i:g}, phi_i {phi_i:g}",
                RuntimeWarning,
                stacklevel=3,
            )
            return


def _warn_unless_reached(record, target):
    if not record.settings["reached"] <= target.rel_err:
        warnings.warn(
            f"rel_err of {target.rel_err:g} was not reached with {target.max_rays:g} "
            f"rays: it is {record.settings['reached']:.3g} in the worst patch",
            RuntimeWarning,
            stacklevel=3,
        )


def _warn_of_interruption(integrator, target, plan, finished):
    if integrator.integrates or target:
        kept = f"{sum(map(bool, finished))} of {len(finished)} incident directions"
        kept += ", the last one less precise" if target else ""
    else:
        batches = sum(map(n_batches, finished))
        kept = f"{batches} of {len(plan) * len(finished)} batches; resume= carries "
        kept += "it on"
    warnings.warn(f"interrupted: the record holds {kept}", RuntimeWarning, stacklevel=3)


def _by_campaign(arguments):
    """Record of what the arguments of :func:`measure` ask for, by a campaign."""
    from .campaigns import campaign  # which stands on this module

    if arguments.pop("resume") is not None:
        raise ValueError("resume and folder exclude each other, got both")
    specimen = arguments.pop("specimen")
    stacked = np.ndim(arguments["theta_i"]) > 0 or np.ndim(arguments["phi_i"]) > 0
    record = campaign({"specimen": specimen}, **arguments)["specimen"]
    return record if stacked else record[0]


# ------------------------------------------------------------------ parts of the bench


def _is_ctrl_c(error):
    """Whether Ctrl-C is at the bottom of it: Dr.Jit wraps what a loop raises."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _asked(scene, estimator):
    """Estimator that is given, or that of the scene's own integrator."""
    return estimator or getattr(scene.integrator(), "settings", {}).get("estimator")


def _joined(wavelengths):
    """Wavelengths as the integrator's text property."""
    if wavelengths is None or isinstance(wavelengths, str):
        return wavelengths
    return ",".join(str(nm) for nm in np.atleast_1d(wavelengths))


def _integrator(scene, settings):
    """Integrator with `settings`; what is None is the scene's own or the default."""
    given = {key: value for key, value in settings.items() if value is not None}
    own = getattr(scene.integrator(), "settings", {})
    plugin = {"type": "goniophotometer"}
    return loaded("the measurement", mi.load_dict, plugin | own | given)


def _sensor(scene, collector, radius, hemispheres, sampler):
    """Collector; what is None is that of the scene's collector or the default."""
    film = {"type": "patches"}
    sensor = {"type": "collector"}
    for own in scene.sensors():
        if hasattr(own, "arrival"):
            film["subdivision"] = str(own.film().subdivision)
            film["hemispheres"] = own.film().hemispheres
            sensor |= {"radius": own.radius, "sampler": own.sampler()}
            break
    if collector is not None:
        film["subdivision"] = str(collector)
    if hemispheres is not None:
        film["hemispheres"] = hemispheres
    if radius is not None:
        sensor["radius"] = radius
    if sampler is not None:
        if isinstance(sampler, str):
            sampler = {"type": sampler}
        sensor["sampler"] = loaded("the sampler", mi.load_dict, sampler)
    return loaded("the collector", mi.load_dict, sensor | {"film": film})
