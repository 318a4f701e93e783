"""Measure here and at once: set up, send rays, and make the records."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import mitsuba as mi
from numpy.typing import ArrayLike

from ..errors import SettingError, VariantError, check_memory, is_ctrl_c, shown
from ..estimators import METHODS
from ..kernels import launches_kernels
from ..progress import Announcement, bar
from ..results.record import Record
from ..results.tally import Tally, batch_sizes
from ..settings import DEFAULTS, MeasurementSettings
from ..settings.values import Order
from ..specimen.kept import loaded_once
from ..specimen.specimen import Specimen
from ..specimen.specimen_text import SpecimenLike
from ..transport.polarisation import n_channels, n_elements
from ..transport.setup import Setup
from ..variants import is_parallel
from .incidence import incident_angles
from .launcher import Launcher, group_size, rays_per_round
from .recording import check_resumable, record_of, records_of, warn_of_interruption
from .schedule import Target, rays_sent, rounds, schedule
from .setup import set_up

logger = logging.getLogger(__name__)


def measure_each(
    specimen: SpecimenLike | Specimen,
    incidents: Sequence[tuple[float, float] | None],
    **settings: Any,
) -> Record:
    """Stack of the incident directions, each ``(theta_i, phi_i)`` in degrees or None.

    All else as of :func:`~gonio_mi.campaigns.measure.measure`.
    """
    (record,) = measure_stacks(specimen, incidents, **settings)
    return record


def measure_orders(
    specimen: SpecimenLike,
    theta_i: ArrayLike | None = None,
    phi_i: ArrayLike = 0.0,
    *,
    orders: Sequence[int | str] = (1, 2, "3+"),
    **settings: Any,
) -> dict[str, Record]:
    """Measure several scattering orders, each as `measure` does it.

    The rays are traced once and sorted by their numbers of events, for about the time
    of one measurement of all orders and with the same bits as one by one. With
    `rel_err`, `noise` and the estimators `quadrature` and `next_event` one order is
    measured after the other.

    Parameters
    ----------
    specimen, theta_i, phi_i, **settings
        Those of `measure`, without `order`, `resume`, `executor` and `folder`.
    orders : sequence of int or str
        Such as ``2`` and ``"3+"``, or ``"all"``; see the setting `order` of
        :func:`~gonio_mi.measure`. Each needs sums of its own in memory.

    Returns
    -------
    dict of Record
        By the names of the orders, ``"2"`` and ``"3+"``.

    Raises
    ------
    TypeError, ValueError, SpecimenError, VariantError, LostRaysError
        As of :func:`~gonio_mi.measure`.
    """
    for name in sorted({"order", "resume", "whole"} & settings.keys()):
        raise SettingError(f"measure_orders does not accept {name}")
    parsed = list(dict.fromkeys(Order.parse("orders", one) for one in orders))
    if not parsed:
        raise SettingError(f"orders must hold at least one order, got {shown(orders)}")
    incidents, stacked = incident_angles(theta_i, phi_i, settings.get("incident"))
    records = measure_stacks(specimen, incidents, parsed, **settings)
    return {
        str(order): record if stacked else record[0]
        for order, record in zip(parsed, records)
    }


@launches_kernels(is_parallel)
def measure_stacks(
    specimen: SpecimenLike | Specimen,
    incidents: Sequence[tuple[float, float] | None],
    orders: Sequence[Order] = (),
    /,
    *,
    whole: bool = False,
    progress: bool = False,
    resume: Record | None = None,
    parameters: dict[str, Any] | None = None,
    emitter: dict[str, Any] | None = None,
    **given: Any,
) -> list[Record]:
    """Stacks of the incident directions: of each of the orders, or one of all rays.

    As a `whole` they are not returned after Ctrl-C, but KeyboardInterrupt is raised.
    The other arguments are those of :func:`~gonio_mi.campaigns.measure.measure`.
    """
    given = {name: value for name, value in given.items() if value is not None}
    if orders:
        given["order"] = Order(most=max(order.most for order in orders))
    asked = DEFAULTS.changed(**given)  # refused before anything is loaded
    _check_together(given, asked, incidents, emitter)
    with loaded_once(specimen, parameters, given.get("period")) as loaded:
        settings = _settled(loaded.own_settings, given, resume)
        method = METHODS[settings.estimator]
        if len(orders) > 1 and (Target.of(settings) or not method.follows_exits):
            given |= {"progress": progress, "emitter": emitter}
            return _one_by_one(loaded, incidents, orders, {"whole": whole, **given})
        if len(orders) == 1:
            settings, orders = replace(settings, order=orders[0]), ()
        setups = set_up(loaded, settings, incidents, emitter, orders=orders)
    finished: list[list[Tally]] = [[] for _ in setups]
    if resume is not None:
        check_resumable(resume, setups, rays_per_round(setups[0]))
        finished[: len(resume)] = [[tally] for tally in resume.tallies]
    started = time.perf_counter()
    complete = send_all(setups, finished, progress)
    records = records_of(setups, finished, complete, resume)
    logger.info("measured for %.3g s: %r", time.perf_counter() - started, records[0])
    if records[0].provenance.interrupted:
        if whole:
            raise KeyboardInterrupt
        warn_of_interruption(setups, records[0])
    return records


def _one_by_one(
    specimen: Specimen,
    incidents: Sequence[tuple[float, float] | None],
    orders: Sequence[Order],
    given: dict[str, Any],
) -> list[Record]:
    """Stacks of the orders, one after the other, until one is interrupted."""
    records: list[Record] = []
    for one in orders:
        records += measure_stacks(specimen, incidents, [one], **given)
        if records[-1].provenance.interrupted:
            break
    return records


def send_all(
    setups: Sequence[Setup], finished: list[list[Tally]], progress: bool = False
) -> bool:
    """Complete the tallies of all setups in `finished`; return whether they are.

    Whenever it is interrupted by Ctrl-C, they hold all batches after a whole round, or
    in the first round those that have finished it; it is raised if that is nothing.
    """
    setup, method = setups[0], setups[0].method
    settings, n_passes, n = setup.settings, len(setup.passes), len(setups)
    plan = batch_sizes(settings.rays, settings.batches)
    _check_sums_fit(setups, plan)
    # one that is carried on has sent more in some directions than in others
    launcher = Launcher(setups[:1] if any(finished) else setups)
    size = group_size(n, method.together) if method.together else launcher.together
    begun = size if method.together else n
    known: list[Any] = [None] * n
    rays = None
    if Target.of(settings) is None:
        before = sum(sum(rays_sent(tallies, n_passes)) for tallies in finished)
        rays = (n * sum(plan) - before) * n_passes
    complete = True
    with bar(
        progress, total=rays, unit="ray", unit_scale=True, delay=1, mininterval=0.2
    ) as report:
        if rays is not None and setup.samples:
            report = Announcement(report, rays)
        try:
            for first in range(0, n, size):
                if first % begun == 0:
                    some = slice(first, first + begun)
                    known[some] = method.begin(setups[some], progress)
                some = slice(first, first + size)
                if setup.samples:
                    _send(launcher, setups[some], known[some], finished[some], report)
                elif report is not None:
                    report(sum(plan) * len(setups[some]))
        except (KeyboardInterrupt, RuntimeError) as error:
            if not is_ctrl_c(error):
                raise
            complete = False
    for one, tallies, of_it in zip(setups, finished, known):
        # what nothing is beside is joined where another Ctrl-C costs no rays
        if of_it is not None and (tallies or not one.samples):
            tallies[:] = [method.finish(one, tallies, of_it)]
    if not any(finished):
        raise KeyboardInterrupt
    return complete


def _send(
    launcher: Launcher,
    setups: Sequence[Setup],
    known: Sequence[Any],
    sent: Sequence[list[Tally]],
    report: Callable[[float], Any] | None,
) -> None:
    """Add to what each of the setups has `sent` what their settings ask for.

    Those whose next rounds are alike share them. Precision is that with what is `known`
    without rays.
    """
    schedules = [
        schedule(
            setup.settings,
            rays_per_round(setup),
            len(setup.passes),
            tallies,
            partial(_looked_at, setup, light),
        )
        for setup, light, tallies in zip(setups, known, sent)
    ]
    parts = [next(rounds, None) for rounds in schedules]
    while part := next(filter(None, parts), None):
        alike = [number for number, other in enumerate(parts) if other == part]
        alike = alike[: launcher.n_together(part)]
        grown = launcher.tallies([setups[i] for i in alike], part, report)
        own = [sent[i] for i in alike]
        if part.start:
            for tallies, more in zip(own, zip(*grown)):
                tallies[:] = [Tally.join(tallies).accumulate(Tally.join(more))]
        else:
            for each in grown:
                for tallies, tally in zip(own, each):
                    tallies.append(tally)
        for i in alike:
            parts[i] = next(schedules[i], None)


def _looked_at(setup: Setup, known: Any, tally: Tally) -> Record:
    """Record of the rays so far, and of what is `known` without them."""
    return record_of(setup, setup.method.finish(setup, [tally], known))


def _check_together(
    given: Mapping[str, Any],
    asked: MeasurementSettings,
    incidents: Sequence[tuple[float, float] | None],
    emitter: object,
) -> None:
    """Raise ValueError for settings that are mutually exclusive or do not apply."""
    if "wavelengths" in given and not mi.is_spectral:
        raise VariantError(
            "wavelengths need a spectral variant, such as llvm_ad_spectral, "
            f"got {mi.variant()}"
        )
    patches = asked.incident
    if patches is not None and (emitter is not None or asked.divergence):
        other = "divergence" if asked.divergence else "emitter"
        raise SettingError(
            f"incident and {other} are mutually exclusive, for both set the directions "
            f"of the beam, got incident {patches!s:.40}"
        )
    if None in incidents and emitter is None and asked.side != "front":
        raise SettingError(
            "side requires theta_i, for the scene's own emitter has a direction, "
            f"got side {asked.side} alone"
        )
    if not given.keys() & {"rel_err", "noise"} and "max_rays" in given:
        raise SettingError(
            f"max_rays requires rel_err or noise, got max_rays {asked.max_rays!r} alone"
        )


def _settled(
    own: dict[str, Any], given: dict[str, Any], resume: object
) -> MeasurementSettings:
    """Settings that are `given`, else the scene's `own`, else the defaults."""
    settings = DEFAULTS.changed(**own | given)
    estimator = settings.estimator
    method = METHODS[estimator]
    if resume is not None and not method.resumes:
        raise SettingError(f"resume is for sampled rays, got the estimator {estimator}")
    if method.integrates:
        return settings
    others = {"rays": given.get("rays"), "resume": resume}
    for goal, also in (("noise", {"rel_err": given.get("rel_err")}), ("rel_err", {})):
        for name, other in (others | also).items():
            if goal in given and other is not None:
                raise SettingError(f"{goal} and {name} are mutually exclusive")
    if settings.rel_err is not None and given.keys() & {"rays", "noise"}:
        # instead of what the scene asks for
        settings = replace(settings, rel_err=None)
    return settings


def _check_sums_fit(setups: Sequence[Setup], plan: Sequence[int]) -> None:
    """Raise ValueError if the sums of all setups do not fit into memory."""
    n_orders = max(len(setups[0].orders), len(setups[0].classes))
    sums = n_orders * sum(setup.n_collected for setup in setups)
    # while they are joined; and beside those of the rounds before
    n_rounds = len(rounds(plan, rays_per_round(setups[0])))
    copies = 2 * min(n_rounds, 2)
    check_memory(
        f"{sums} patches in {len(plan)} batches",
        copies * 8 * sums * len(plan) * n_channels() * (1 + n_elements()),
        "take fewer patches, incident directions, batches or orders at once",
    )
