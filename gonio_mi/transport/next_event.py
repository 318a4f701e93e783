"""The estimator `next_event`: at every event `eval` is deposited towards patches."""

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import SpecimenError
from .loop import LARGEST_POWER, flux_context, shading_normal_correction
from .ray_offsets import departure, escapes

__all__ = ["Deposits", "check_traced"]

# More would only repeat what a further ray tells better.
MOST_POINTS = 1024

# Part of the points that goes to the lower hemisphere, if there is one; and where all
# surfaces are opaque and no gap was seen. It changes what is learned, never the result.
LOWER = 1 / 2
LOWER_IF_DARK = 1 / 16


def check_traced(bench, settings):
    """Raise SpecimenError for a flat specimen, which needs no points in patches."""
    if bench.specimen.plane is not None and not settings["trace"]:
        raise SpecimenError(
            "the estimator next_event needs geometry, got a flat rectangle: take "
            "quadrature, which integrates eval over all patches"
        )


class Deposits:
    """What the events of one launch send to points in randomly chosen patches.

    An event that does not choose a delta component ends in every direction at once:
    for the direction of a point in patch j, drawn uniformly in its solid angle, the
    flux ``throughput * eval * solid angle / probability of j`` is added to j, if
    nothing stands in the way. That is an unbiased estimate of what those rays carry to
    the patch whose last event this is; those whose last event is a delta component
    are counted where they arrive.

    Patches of one hemisphere are equally likely. Of the points one half goes to the
    lower hemisphere; one sixteenth if that seems to be dark, which is not relied upon.

    Parameters
    ----------
    bench : Bench
    sums : Sums
        Where deposits are added up.
    points : int
        Points for each event; their patches are chosen from equal shares of the
        collector.
    orders : tuple of int
        Least and largest number of surface events that is collected.
    lanes, batch : mi.Bool, mi.UInt32
        Which lanes carry a ray, and its batch.
    """

    def __init__(self, bench, sums, points, orders, lanes, batch):
        self.bench, self.sums, self.points, self.orders = bench, sums, points, orders
        self.lanes, self.batch = lanes, batch
        self.scatters = any(
            mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Smooth)
            for shape in bench.specimen.scene.shapes()
        )
        self.lower = 0.0
        if bench.shape[0] == 2:
            self.lower = LOWER_IF_DARK if bench.specimen.seems_dark else LOWER
        subdivision = bench.film.subdivision
        theta_low, theta_high, phi_low, phi_high = subdivision.cells.T
        # sin^2(theta / 2) is proportional to solid angle, and exact at the pole
        low, high = np.sin(theta_low / 2) ** 2, np.sin(theta_high / 2) ** 2
        table = (low, high - low, phi_low, phi_high - phi_low)
        self.table = [mi.Float(column.tolist()) for column in table]
        axes = subdivision.axes
        self.axes = None if axes is None else mi.Vector3f(axes.T.tolist())

    def add(self, si, bsdf, ray, β, depth, shift, sampler, active):
        """Deposit what one event of each active ray sends, from its throughput `β`.

        Parameters
        ----------
        si : mi.SurfaceInteraction3f
        bsdf : mi.BSDF
        ray : mi.Ray3f
            That came.
        β : mi.Spectrum
        depth : mi.UInt32
            Events before this one.
        shift : mi.Vector3f
            How far this is from where it would be without a periodic cell.
        sampler : mi.Sampler
        active : mi.Bool

        Returns
        -------
        mi.Bool
            False where `eval` returned what is no flux.
        """
        if not self.scatters:
            return mi.Bool(True)
        return self._add(si, bsdf, ray, β, depth, shift, sampler, active)

    @dr.syntax
    def _add(self, si, bsdf, ray, β, depth, shift, sampler, active):
        """Deposit, as `add`, on a specimen that has other than delta components."""
        low, high = self.orders
        wanted = active & self.lanes & (depth + 1 >= low) & (depth + 1 <= high)
        wanted &= mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        sound = mi.Bool(True)
        i = mi.UInt32(0)
        n_points = dr.opaque(mi.UInt32, self.points)
        specimen = self.bench.specimen
        part = dr.rcp(mi.Float(n_points))  # of the collector, for each point
        while i < n_points:
            share = (mi.Float(i) + sampler.next_1d(active)) * part
            number, wo, spread = self._point(si.p + shift, share, sampler.next_2d())
            local_wo = si.to_local(wo)
            value = bsdf.eval(flux_context(), si, local_wo, wanted)
            value *= shading_normal_correction(si, ray, local_wo, wo)
            power = value * β * (spread * part)
            # comparisons with NaN are false
            good = (dr.min(power) >= 0) & (dr.max(power) <= LARGEST_POWER)
            sound &= good | ~wanted
            shines = wanted & good & (dr.max(power) > 0)

            start, offset = departure(specimen, si, ray.d, wo)
            onward = mi.Ray3f(start + dr.copysign(offset, dr.dot(si.n, wo)) * si.n, wo)
            side = self.bench.beam.side
            shines &= escapes(specimen, side, onward, si.n, offset, shines)
            self.sums.deposit(number, power, shines, self.batch)
            i += 1
        return sound

    def add_exits(self, bins, exits):
        """Count the rays whose last event was a delta component where they arrive."""
        collected = bins < self.bench.n_collected
        active = self.lanes & collected & exits.delta
        self.sums.deposit(bins, exits.throughput, active, self.batch)

    def _point(self, p, share, sample):
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
        bench = self.bench
        upper = dr.opaque(mi.Float, 1 - self.lower)
        lower = share >= upper
        part = dr.select(lower, 1 - upper, upper)
        place = dr.select(lower, share - upper, share) / part
        patch = mi.UInt32(place * float(bench.n_patches))
        patch = dr.minimum(patch, bench.n_patches - 1)
        number = patch + dr.select(lower, mi.UInt32(bench.n_patches), 0)
        low, span, phi_low, phi_span = (
            dr.gather(mi.Float, column, patch) for column in self.table
        )
        s = low + span * sample.x
        radius = 2 * dr.sqrt(s * (1 - s))
        sin_phi, cos_phi = dr.sincos(phi_low + phi_span * sample.y)
        point = mi.Vector3f(radius * cos_phi, radius * sin_phi, 1 - 2 * s)
        solid_angle = 2 * span * phi_span
        if self.axes is not None:
            axis = dr.gather(mi.Vector3f, self.axes, patch)
            point = mi.Frame3f(axis).to_world(point)
            inside = bench.film.patch_index(point) == patch
            solid_angle = dr.select(inside, solid_angle, 0.0)
        up = dr.select(lower, -float(bench.beam.side), float(bench.beam.side))
        point.z *= up
        seen, change = bench.sensor.seen(p, point)
        return number, seen, solid_angle * change * (float(bench.n_patches) / part)
