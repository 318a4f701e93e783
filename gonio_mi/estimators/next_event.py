"""The estimator `next_event`: at every event `eval` is deposited towards patches.

Of mirror facets, whose first order is known, it is taken off along each ray's line.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import SpecimenError
from ..loops import syntax
from ..single_precision import FEW_ROUNDINGS
from ..specimen.rays import Flight, departure, escapes
from ..transport.exits import Exits
from ..transport.launch import LaunchedRays
from ..transport.method import Method
from ..transport.polarisation import in_instrument_frames, power_of, product
from ..transport.setup import Setup
from ..transport.surface_events import (
    MAX_POWER,
    flux_context,
    is_delta,
    shading_normal_correction,
)
from .mirror_facets import MirrorFacets, has_mirror_facets

# Part of the points that goes to the lower hemisphere, if there is one; and where all
# surfaces are opaque, and no gap was seen or light gets there over edges alone. It
# changes what is learned, never the result.
LOWER = 1 / 2
LOWER_IF_DIM = 1 / 16

# Steps of the sequence R2 in x and y, as fractions of 2**32.
R2 = (0xC13FA9A9, 0x91E10DA6)


# CPU time of a point, over that of a ray that is traced: 0.13 to 0.7 were measured.
POINT_COST = 0.5

# Levels of rare powers from 2**-87 on, which is what a glossy BSDF sends to points
# beside its lobe.
LEVELS_OF_POINTS = range(5, 15)


class NextEvent(Method):
    """Every event deposits `eval` towards points in patches, beside the rays."""

    deposits = True
    follows_exits = False
    levels = LEVELS_OF_POINTS

    def check(self, setup: Setup) -> None:
        """Raise SpecimenError for a flat specimen, which needs no points in patches."""
        if setup.specimen.plane is not None and not setup.settings.trace:
            raise SpecimenError(
                "the estimator next_event needs geometry, got a flat rectangle: take "
                "quadrature, which integrates eval over all patches"
            )
        if setup.gradients is not None and self.controls(setup):
            raise SpecimenError(
                "gradients of mirror facets need the estimator weighted, got next_event"
            )

    def functions(self, bsdf: mi.BSDF) -> set[str]:  # noqa: ARG002
        """Both: rays are drawn by `sample`, and `eval` is deposited."""
        return {"sample", "eval"}

    def controls(self, setup: Setup) -> bool:
        """Whether mirror facets tell the first order."""
        return has_mirror_facets(setup)

    def control(self, setup: Setup, wavelengths: Any) -> MirrorFacets | None:
        """Light of the first order, where facets tell it."""
        return MirrorFacets(setup, wavelengths) if self.controls(setup) else None

    def cost(self, setup: Setup) -> float:
        """A ray and its points, of which facets need none."""
        return 1.0 if self.controls(setup) else 1 + POINT_COST * setup.settings.points

    def add(self, rays: LaunchedRays, sampler: mi.Sampler, ray: mi.UInt32) -> None:
        """Add what the events of one ray per lane deposit, and the rays themselves."""
        deposits = Deposits(rays, ray < rays.size)
        exits = rays.path(deposits=deposits)(sampler)
        bins, exits = rays.collect(exits, deposits.lanes)
        deposits.add_exits(bins, exits)


class Deposits:
    """What the events of one launch send to points in randomly chosen patches.

    What an event sends to the collector is learned in two ways. Points are drawn in
    patches, uniformly in solid angle: with the density ``q = probability of the patch /
    its solid angle`` per point, and each adds ``throughput * eval / q`` to its patch if
    nothing stands in the way. And `sample` draws a direction with the density ``p``,
    whose ray may get there. The balance heuristic (Veach and Guibas 1995, *Optimally
    Combining Sampling Techniques for Monte Carlo Rendering*, eq. 8) takes of each point
    the part ``n q / (n q + p)``, `n` being the points of an event, and of the ray the
    rest. The parts add up to 1 in every direction, so that the sum is unbiased whatever
    `pdf` says; and no point adds more than ``throughput * eval / p``, which is what a
    ray carries: there are no rare deposits of great weight. Delta components have no
    points, and their rays count whole.

    Patches of one hemisphere are equally likely. Of the points one half goes to the
    lower hemisphere; one sixteenth if that seems to be dim, which is not relied upon.

    Parameters
    ----------
    rays : LaunchedRays
        The settings of their setup tell the points for each event. The patches of these
        are chosen from equal shares of the collector, and all of them by three random
        numbers, which a low-discrepancy sequence distributes well: one point per patch
        leaves nothing to chance but where in the patch it lies.
    lanes : mi.Bool
        Which lanes carry a ray.
    """

    def __init__(self, rays: LaunchedRays, lanes: mi.Bool) -> None:
        self.setup, self.sums = rays.setup, rays.sums
        self.derivative = rays.derivative
        setup = rays.setup
        self.facets: Any = rays.control  # MirrorFacets, or None
        self.points = setup.settings.points
        self.lanes, self.batch = lanes, rays.batch
        self.scatters = any(
            mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Smooth)
            for shape in setup.specimen.surfaces
        )
        self.lower = 0.0
        if setup.shape[0] == 2:
            specimen = setup.specimen
            dim = specimen.closed_to_light and specimen.edges == "open"
            self.lower = LOWER_IF_DIM if dim or specimen.appears_opaque else LOWER
        subdivision = setup.collector.subdivision
        theta_low, theta_high, phi_low, phi_high = subdivision.cells.T
        if subdivision.axes is not None:  # rounding takes points out of it, and in
            theta_high = np.minimum(theta_high + FEW_ROUNDINGS, np.pi / 2)
        # sin^2(theta / 2) is proportional to solid angle, and exact at the pole
        low, high = np.sin(theta_low / 2) ** 2, np.sin(theta_high / 2) ** 2
        table = (low, high - low, phi_low, phi_high - phi_low)
        self.table = [mi.Float(column.tolist()) for column in table]
        axes = subdivision.axes
        self.axes = None if axes is None else mi.Vector3f(axes.T.tolist())

    @syntax
    def add(
        self,
        si: mi.SurfaceInteraction3f,
        bsdf: mi.BSDF,
        flight: Flight,
        β: mi.Spectrum,
        depth: mi.UInt32,
        sampler: mi.Sampler,
        active: mi.Bool,
        slope: mi.Spectrum | None = None,
    ) -> mi.Bool:
        """Deposit what one event of each active ray sends, from its throughput `β`.

        Only where a BSDF `scatters`, with other than delta components.

        Parameters
        ----------
        si : mi.SurfaceInteraction3f
        bsdf : mi.BSDF
        flight : Flight
            That came here.
        β : mi.Spectrum
        depth : mi.UInt32
            Events before this one.
        sampler : mi.Sampler
        active : mi.Bool
        slope : mi.Spectrum, optional
            Logarithmic derivative of the throughput.

        Returns
        -------
        mi.Bool
            False where `eval` returned what is no flux.
        """
        order = self.setup.settings.order
        low, high = (dr.opaque(mi.UInt32, n) for n in (order.least, order.most))
        wanted = active & self.lanes & (depth + 1 >= low) & (depth + 1 <= high)
        wanted &= mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        sound = mi.Bool(True)
        i = mi.UInt32(0)
        n_points = dr.opaque(mi.UInt32, self.points)
        specimen = self.setup.specimen
        # variables of the loop, which a whole flight would make another one
        ray, shift = flight.ray, flight.shift
        part = dr.rcp(mi.Float(n_points))  # of the collector, for each point
        first, place = sampler.next_1d(active), sampler.next_2d()
        while i < n_points:
            share = (mi.Float(i) + first) * part
            number, wo, spread = self._point(si.p + shift, share, _after(place, i))
            local_wo = si.to_local(wo)
            value, pdf = bsdf.eval_pdf(flux_context(), si, local_wo, wanted)
            value = in_instrument_frames(si, value, ray.d, local_wo, wo)
            corrected = shading_normal_correction(si, ray, local_wo, wo)
            value *= corrected
            spread *= part
            light, realisable = product(value, β)
            weight = spread * dr.rcp(1 + _finite(pdf) * spread)
            light *= weight
            change = None
            if self.derivative is not None and slope is not None:
                own, _ = self.derivative.of_eval(bsdf, si, local_wo, wanted)
                change = light * slope + own * (corrected * weight) * β
            power = power_of(light)
            # comparisons with NaN are false
            good = (dr.min(power) >= 0) & (dr.max(power) <= MAX_POWER) & realisable
            sound &= good | ~wanted
            shines = wanted & good & (dr.max(power) > 0)

            start, offset = departure(specimen, si, ray.d, wo)
            onward = mi.Ray3f(start + dr.copysign(offset, dr.dot(si.n, wo)) * si.n, wo)
            side = self.setup.beam.side
            shines &= escapes(specimen, side, onward, si.n, offset, shines)
            self.sums.deposit(number, light, shines, self.batch, change=change)
            i += 1
        return sound

    def subtract_facets(self, ray: mi.Ray3f, active: mi.Bool) -> None:
        """Take off what is known: what facets send along the line of active rays."""

        def take(number: mi.UInt32, entered: mi.Bool) -> None:
            self.take_facet_off(number, active & entered)

        self.facets.along(ray, active & self.lanes, take)

    def take_facet_off(self, number: mi.UInt32, active: mi.Bool) -> None:
        """Take off what one facet sends."""
        facets, active = self.facets, active & self.lanes
        patch = dr.gather(mi.UInt32, facets.patch, number, active)
        light = dr.gather(mi.Spectrum, facets.light, number, active)
        active &= patch < self.setup.n_patches
        self.sums.deposit(patch, light, active, self.batch, -1)

    def density(
        self,
        si: mi.SurfaceInteraction3f,
        bsdf: mi.BSDF,
        bs: mi.BSDFSample3f,
        wo: mi.Vector3f,
        active: mi.Bool,
    ) -> mi.Float:
        """Density with which `sample` draws `wo`, as `pdf` has it, in 1/sr.

        Infinite for components towards which there are no points.
        """
        pdf = bsdf.pdf(flux_context(), si, si.to_local(wo), active)
        counted = is_delta(bs) | ~mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        return dr.select(counted, dr.inf, _finite(pdf))

    def add_exits(self, bins: mi.UInt32, exits: Exits) -> None:
        """Deposit arriving rays with their MIS weight (balance heuristic)."""
        setup = self.setup
        active = self.lanes & (bins < setup.n_collected)
        if not self.scatters:  # there are no points
            light, change = exits.throughput, exits.change
            self.sums.deposit(bins, light, active, self.batch, change=change)
            return
        lower = bins >= setup.n_patches
        number = dr.select(active, bins, 0)
        patch = number - dr.select(active & lower, mi.UInt32(setup.n_patches), 0)
        u = setup.collector.arrival(exits.p, exits.d)
        _, change = setup.collector.seen(exits.left, u)
        spread = self._spread(patch, lower, change)
        spread *= dr.rcp(dr.opaque(mi.Float, self.points))
        expected = exits.density * spread  # times the density of all points
        part = dr.select(dr.isinf(exits.density), 1.0, expected * dr.rcp(1 + expected))
        active &= part > 0
        change = None if exits.change is None else exits.change * part
        light = exits.throughput * part
        self.sums.deposit(bins, light, active, self.batch, change=change)

    def _spread(self, patch: mi.UInt32, lower: mi.Bool, change: mi.Float) -> mi.Float:
        """Inverse of the density of a point in `patch`, in sr.

        `change`: solid angle as seen from the event, by that seen from the origin.
        """
        span, phi_span = (dr.gather(mi.Float, self.table[i], patch) for i in (1, 3))
        upper = dr.opaque(mi.Float, 1 - self.lower)
        chosen = dr.select(lower, 1 - upper, upper) / float(self.setup.n_patches)
        return 2 * span * phi_span * change / chosen

    def _point(
        self, p: mi.Point3f, share: mi.Float, sample: mi.Point2f
    ) -> tuple[mi.UInt32, mi.Vector3f, mi.Float]:
        """Random point of the patch that a number in [0, 1) chooses, seen from `p`.

        Returns
        -------
        number : mi.UInt32
            Of the patch, over both hemispheres.
        wo : mi.Vector3f
        spread : mi.Float
            Solid angle of the patch as seen from `p`, in sr, over the probability of
            the patch; 0 where the point belongs to another patch.
        """
        setup = self.setup
        upper = dr.opaque(mi.Float, 1 - self.lower)
        lower = share >= upper
        place = dr.select(lower, (share - upper) / (1 - upper), share / upper)
        patch = mi.UInt32(place * float(setup.n_patches))
        patch = dr.minimum(patch, setup.n_patches - 1)
        number = patch + dr.select(lower, mi.UInt32(setup.n_patches), 0)
        low, span, phi_low, phi_span = (
            dr.gather(mi.Float, column, patch) for column in self.table
        )
        s = low + span * sample.x
        radius = 2 * dr.sqrt(s * (1 - s))
        sin_phi, cos_phi = dr.sincos(phi_low + phi_span * sample.y)
        point = mi.Vector3f(radius * cos_phi, radius * sin_phi, 1 - 2 * s)
        inside = mi.Bool(True)
        if self.axes is not None:
            axis = dr.gather(mi.Vector3f, self.axes, patch)
            point = mi.Frame3f(axis).to_world(point)
            inside = setup.collector.patch_index(point) == patch
        up = dr.select(lower, -float(setup.beam.side), float(setup.beam.side))
        point.z *= up
        seen, change = setup.collector.seen(p, point)
        return number, seen, dr.select(inside, self._spread(patch, lower, change), 0.0)


def _after(place: mi.Point2f, i: mi.UInt32) -> mi.Point2f:
    """Point `i` of the unit square after `place`, evenly spread with those between.

    The low-discrepancy sequence R2 (Roberts 2018), shifted: each point is as random as
    the first one, and costs no further numbers of the sampler, which are distributed
    well jointly as long as they are few.
    """
    steps = (i * factor for factor in R2)
    moved = place + mi.Point2f(*(mi.Float(step >> 8) * 2.0**-24 for step in steps))
    return moved - dr.select(moved < 1, 0.0, 1.0)


def _finite(pdf: mi.Float) -> mi.Float:
    """A density that is one: 0 for what is infinite, NaN or negative."""
    return dr.select((pdf > 0) & (pdf < dr.inf), pdf, 0.0)
