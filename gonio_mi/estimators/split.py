"""The estimator `split`: light of one event from points, of more from branched rays.

Rays that meet the surface again after their first event go on from there in several
directions. What they bring after one event is only compared with the light of points.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from ..errors import SpecimenError
from ..progress import bar
from ..results.tally import Fate, Tally
from ..settings.measurement_settings import BRANCHES
from ..settings.values import Order
from ..specimen.rays import Flight
from ..specimen.shapes import coincide
from ..transport.exits import of_order
from ..transport.launch import LaunchedRays
from ..transport.method import Method
from ..transport.sampling import is_joint, split_lanes
from ..transport.setup import Setup
from ..transport.sums import Totals
from .surface_points import SingleScattering, single_scattering

# Tells the random numbers of the branches of a ray from its own.
BRANCHED = 0x62726E63

# Beside meshes, shapes that are sampled uniformly.
SHAPES = ("Rectangle", "Disk", "Sphere", "Cylinder")

# Surface events of the light that rays bring.
FURTHER = Order(2)


class Split(Method):
    """Light of one event is joined by points; rays bring what comes of more events."""

    deposits = True
    resumes = False
    shares_points = True
    differentiable = False
    task = 32  # they share the points, and what these see of the patches

    def check(self, setup: Setup) -> None:
        """Raise SpecimenError for what the estimator is not made for."""
        specimen, settings = setup.specimen, setup.settings
        shapes = specimen.scene.shapes()
        singular = mi.BSDFFlags.Delta, mi.BSDFFlags.Delta1D, mi.BSDFFlags.Null
        reasons = {
            "a periodic cell, all of it in a collimated beam": setup.beam.fills_cell
            and not specimen.groups,
            "opaque surfaces without gaps": specimen.appears_opaque
            and not specimen.media,
            "BSDFs without delta components": not any(
                mi.has_flag(one.bsdf().flags(), flag)
                for one in shapes
                for flag in singular
            ),
            "meshes, rectangles, disks, spheres or cylinders": all(
                isinstance(one, mi.Mesh) or one.class_name() in SHAPES for one in shapes
            ),
            "triangles that do not coincide": specimen.is_height_map
            or not any(coincide(one) for one in shapes if isinstance(one, mi.Mesh)),
            "rays of all orders": not setup.orders
            and settings.order.least <= 1
            and settings.order.most >= settings.max_depth,
            "an unpolarised variant that is not spectral": not (
                mi.is_polarized or mi.is_spectral
            ),
            "a collector in the far field with patches of angles": (
                settings.collector_radius == 0
                and setup.collector.subdivision.axes is None
            ),
            "the sampler sobol": is_joint(setup.sampler),
            "noise or rays, not rel_err": settings.rel_err is None,
        }
        for needed, there in reasons.items():
            if not there:
                raise SpecimenError(
                    f"the estimator split needs {needed}: take weighted instead"
                )

    def functions(self, bsdf: mi.BSDF) -> set[str]:  # noqa: ARG002
        """Both: points are joined by `eval`, and rays are drawn by `sample`."""
        return {"sample", "eval"}

    def begin(
        self, setups: Sequence[Setup], progress: bool
    ) -> Sequence[SingleScattering]:
        """Light of one event of each setup, as precise as their settings ask."""
        how = {"unit": "point", "unit_scale": True, "delay": 1}
        with bar(progress, desc="points of the surface", **how) as report:
            return single_scattering(setups, report)

    def order(self, settings: object) -> Order:  # noqa: ARG002
        """Light of more events than one."""
        return FURTHER

    def kept_apart(self, orders: object) -> tuple[Order]:  # noqa: ARG002
        """That light, and beside it what rays bring of one event."""
        return (FURTHER,)

    def add(self, rays: LaunchedRays, sampler: mi.Sampler, ray: mi.UInt32) -> None:
        """Add to the sums what becomes of one ray per lane.

        Those that met a surface again after their first event go on from there in
        `BRANCHES` directions, each with its part of the power.
        """
        setup, sums = rays.setup, rays.sums
        active = ray < rays.size
        exits = rays.path(max_depth=1)(sampler)
        flight = exits.flight
        again = active & (exits.fate == mi.UInt32(Fate.TRUNCATED))
        ended = of_order(exits, setup.order)
        sums.add(setup.bins(ended), ended, active & ~again, rays.batch)
        bins = setup.bins(exits)  # of light of one event, to be compared with points
        first = active & ~again & (bins < setup.n_collected)
        sums.deposit(bins, exits.throughput, first, rays.batch + sums.capacity)
        state = flight.ray.o, flight.ray.d, flight.n, flight.offset
        own, none = (rays.batch, sampler.index, sampler.key), dr.zeros_like(exits.fate)
        batch, index, key = (mi.UInt32(x) + none for x in own)
        β = exits.throughput
        dr.eval(*state, β, batch, index, key, again)
        which = dr.compress(again)
        if not len(which):
            return
        lane, branch = split_lanes(
            dr.arange(mi.UInt32, BRANCHES * len(which)), BRANCHES
        )
        which = dr.gather(mi.UInt32, which, lane)
        batch, index, key = (
            dr.gather(mi.UInt32, x, which) for x in (batch, index, key)
        )
        o, d, n, offset = (dr.gather(type(x), x, which) for x in state)
        ray = mi.Ray3f(o, d)
        ray.wavelengths = rays.wavelengths
        # what they met is met indeed, from behind too
        flight = Flight(ray, mi.Vector3f(0), n, offset, mi.Bool(True), mi.UInt32(0))
        power = dr.gather(type(β), β, which)
        sampler = sampler.clone()
        # beyond 2**28 rays, whose branches have no index of 32 bits, by other keys
        sampler.key = (key ^ BRANCHED) + index // (2**32 // BRANCHES)
        sampler.index = index * BRANCHES + branch
        sampler.draw = mi.UInt32(0)
        exits = rays.path(begun=(flight, power))(sampler)
        exits = of_order(exits, setup.order)  # by rounding some meet nothing again
        bins = setup.bins(exits)
        sums.add(bins, exits, branch == 0, batch)
        collected = bins < setup.n_collected
        sums.deposit(bins, exits.throughput / BRANCHES, collected, batch)

    def tallies(self, totals: Totals, n: int) -> list[Tally]:
        """Pairs of tallies: of light of several events, and of one event."""
        return totals.tallies_by_class(n)

    def finish(
        self,
        setup: Setup,  # noqa: ARG002
        tallies: Sequence[Tally],
        known: SingleScattering,
    ) -> Tally:
        """Tally with the light of points in place of what rays found of one event."""
        return known.completed(Tally.join(tallies))
