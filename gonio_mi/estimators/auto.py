"""The estimator `auto`: which of three costs least, for one specimen and one wish.

A rule decides where only one applies, or where costs are known; else short runs do,
which are independent of the measurement. Costs are a table, never a clock: the same
specimen and settings make the same choice, at any direction and with any seed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import SpecimenError
from ..results.estimates import MIN_EVEN_HITS, Estimates
from ..results.planning import lobe
from ..results.tally import Tally
from ..settings.measurement_settings import MAX_POINTS, Estimator, MeasurementSettings
from ..settings.values import Order
from ..specimen.scene_objects import holds_foreign_plugins
from ..specimen.specimen import Specimen
from ..transport.setup import Setup

# Where short runs arrive, whatever directions are measured: a direction has the same
# bits alone and in any stack. And their seed, of which no measurement's rays are.
PILOT_INCIDENT = (45.0, 0.0)
PILOT_SEED = 0x6175746F << 64

# Rays of `next_event` in each batch of a short run, and as many batches as usual; of
# `weighted` as many as cost the same.
PILOT_RAYS, PILOT_BATCHES = 4, 16

# Rays in each batch of a short run where the first order is known from facets.
FACET_RAYS = 256

# Part of the cost of rays that deposits may seem to have, to be taken. The variances of
# two times 16 batches have by chance a ratio above 3 once in 50 (F distribution), and a
# short run misses rare bright deposits: on glossy facets 6/7 of the variance may be.
MAX_RATIO = 1 / 3

# Rays of each batch of `next_event` whose intervals are known to hold: the fewest with
# which their coverage was counted (`python -m tests.benchmark --coverage`).
MIN_RAYS = 25

# Relative error of the worst patch from which on integrals cost less than rays.
INTEGRAL_REL_ERR = 0.01


def chosen(
    settings: MeasurementSettings,
    specimen: Specimen,
    orders: Sequence[Order],
    tried: Callable[[MeasurementSettings], Setup],
    short_run: Callable[[Setup, int], Tally],
) -> tuple[MeasurementSettings, str]:
    """Settings with the estimator that costs least, and why in words.

    Parameters
    ----------
    settings : MeasurementSettings
        Of the estimator ``auto``.
    specimen : Specimen
    orders : sequence of Order
        To be collected apart.
    tried : callable
        ``tried(settings)`` sets up the specimen in the pilot's direction, or raises
        SpecimenError where its estimator does not apply.
    short_run : callable
        ``short_run(setup, rays)`` sends so many rays in each batch.
    """
    usual = replace(settings, estimator=Estimator.WEIGHTED)
    surfaces = [shape.bsdf() for shape in specimen.surfaces]
    flags = [bsdf.flags() for bsdf in surfaces]
    by_delta = any(mi.has_flag(one, mi.BSDFFlags.Delta) for one in flags)
    flat = specimen.plane is not None and not settings.trace
    by_rays = not any(mi.has_flag(one, mi.BSDFFlags.Smooth) for one in flags)
    deposits = replace(settings, estimator=Estimator.NEXT_EVENT)
    by_facets = by_rays and not (flat or orders or settings.gradients)
    by_facets = by_facets and _controls(tried(deposits))
    wish, most = settings.rel_err, INTEGRAL_REL_ERR
    reasons = {
        "a medium is walked through": bool(specimen.media),
        "the variant is polarised": mi.is_polarized,
        "orders share their rays": bool(orders),
        "there are delta components only": by_rays and not by_facets,
        "the others need eval, and that of a plugin in Python may differ from sample": (
            any(map(holds_foreign_plugins, surfaces))
        ),
        "no relative error is asked for": flat and wish is None,
        f"above {most:g} it costs less than quadrature": flat and (wish or 0) > most,
        "delta components need rays": flat and by_delta,
    }
    for reason, holds in reasons.items():
        if holds:
            return usual, f"weighted, for {reason}"
    if not flat:
        return _traced(settings, usual, tried, short_run, by_facets)
    integrals = replace(settings, estimator=Estimator.QUADRATURE)
    try:
        tried(integrals)
    except SpecimenError as error:
        return usual, f"weighted, for {error}".partition(": ")[0]
    return integrals, f"quadrature, which costs less than rays up to {most:g}"


def _traced(
    settings: MeasurementSettings,
    usual: MeasurementSettings,
    tried: Callable[[MeasurementSettings], Setup],
    short_run: Callable[[Setup, int], Tally],
    by_facets: bool,
) -> tuple[MeasurementSettings, str]:
    """The same for geometry: short runs of equal cost, and what errors they leave.

    `by_facets`: the first order is known, and no point is sent to.
    """
    points = settings.points
    if points == 1 and not by_facets:  # nobody asked for more
        points = min(settings.collector.n_patches, MAX_POINTS)
    short = FACET_RAYS if by_facets else PILOT_RAYS
    deposits = replace(settings, estimator=Estimator.NEXT_EVENT, points=points)
    setup = tried(deposits)
    cost = setup.method.cost(setup)
    by_rays = settings.rel_err is None and settings.noise is None
    if by_rays:
        deposits = replace(deposits, rays=max(round(settings.rays / cost), 1))
        if deposits.rays < MIN_RAYS * settings.batches:
            return usual, "weighted, for the rays are few"
    sent = short_run(tried(_short(usual)), round(short * cost))
    if not sent.incident.any():
        return usual, "weighted, for no ray of a short run met the specimen"
    error = _error(settings, sent)
    if by_rays and not by_facets and _hides_bright_places(settings, deposits, sent):
        return usual, "weighted, for next_event may overlook rare bright places"
    # of independent rays: the same error for the square of that in rays
    other = _error(settings, short_run(tried(_short(deposits)), short))
    ratio = (other / error) ** 2 if error else np.inf
    part = f"about {ratio:.1g} of the CPU time of weighted, by short runs"
    how = "its first order from facets" if by_facets else f"{points} points"
    if not ratio <= MAX_RATIO:
        return usual, f"weighted, for next_event, {how}, needs {part}"
    return deposits, f"next_event, {how}, needs {part}"


def _short(settings: MeasurementSettings) -> MeasurementSettings:
    """Settings of a short run, whose number of rays is given with it."""
    short: dict[str, Any] = {"rel_err": None, "noise": None, "seed": PILOT_SEED}
    return replace(settings, **short, batches=PILOT_BATCHES)


def _controls(setup: Setup) -> bool:
    return setup.method.controls(setup)


def _hides_bright_places(
    settings: MeasurementSettings, deposits: MeasurementSettings, sent: Tally
) -> bool:
    """Whether few rays of `deposits` meet what makes those of `weighted` scatter.

    Or one of them, by chance met or not, is more than the error of `weighted`.
    """
    rays = Estimates(sent)
    part = deposits.rays / rays.rays
    hemispheres = range(len(sent.hits))
    if any(np.any(rays.n_heavy(i) * part < MIN_EVEN_HITS) for i in hemispheres):
        return True
    scatter = [np.nansum(rays.patches(i).noise) for i in hemispheres]
    return 1 / deposits.rays > sum(scatter) * np.sqrt(rays.rays / settings.rays)


def _error(settings: MeasurementSettings, sent: Tally) -> float:
    """Scatter between short batches: of the worst patch, or of all.

    Relative to itself for `rel_err`; else the sum over patches, as of `noise`.
    """
    # of few rays, all may miss a specimen with openings in some batch
    fractions = sent.sums / sent.incident.mean(axis=0)
    mean, scatter = fractions.mean(axis=0), fractions.std(axis=0, ddof=1)
    if settings.rel_err is None:
        return float(scatter.sum())
    solid = settings.collector.projected_solid_angles
    inside = np.stack(
        [
            lobe(flux / solid, solid, settings.floor)
            for flux in np.moveaxis(mean, -1, 0)
        ],
        axis=-1,
    )
    return float(max(scatter[inside] / mean[inside], default=np.inf))
