"""The light that meets the specimen: points of the footprint, directions, weights."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats, Numbers
from ..collector import Subdivision
from ..collector.directions import angles
from ..errors import SpecimenError
from ..kernels import in_memory
from ..specimen.specimen import Specimen
from ..specimen.wavelengths import lanes_of
from .collector_sphere import DRJIT
from .outline import Outline
from .polarisation import power_of
from .sampling import is_joint

# Points, along each of two sides, from which the mean power of a beam is taken.
N_GRID = 128

# Part of a patch of incidence at its borders that is left out: more than what counts as
# on them, so that light that goes straight on stays in one patch.
BORDER_MARGIN = 2.0**-14

# How much brighter than the footprint's middle the spot under an emitter may be, and
# at most than the unit of power: far less than what the tally's sums hold of one ray.
MAX_SPOT_CONTRAST = 2.0**10
MAX_SPOT = 2.0**20

# Part of the rays that each face of a solid's box gets at least that may be lit, in
# units of the mean: what its own points did not see is not lost.
MIN_SHARE = 1 / 64


class Beam:
    """Rays from an emitter to the footprint: on the plane of the specimen's top.

    Of a solid they start on all lit faces of its bounding box.

    Parameters
    ----------
    specimen : Specimen
    emitter : mi.Emitter
        A delta direction gives a collimated beam. Any other emitter is sampled through
        ``sample_direction``.
    footprint : str or float
        ``"point"``: the middle of the bounding box's top. ``"full"``: all of that top,
        uniformly; or the silhouette of the box, if the specimen is a solid: without a
        period, and its `edges` closed. A number: a disk of that radius about the
        middle.
    emission : {"radiometric", "equal_power"}
        ``"radiometric"`` weights a ray by radiance, cosines and distance, as light is.
        ``"equal_power"`` is the paper's section 2.2: uniform points on emitter and
        specimen, each ray carrying the same power.
    nm : sequence of float, optional
        Wavelengths in spectral variants.
    divergence : float
        Half angle in degrees of the cone about the direction of a collimated beam that
        its rays come from, uniformly in solid angle and all of the same power.
    incident : Subdivision, optional
        Patches of incidence, about the normal of the lit face: the directions of a
        collimated beam fill the one that holds its own, uniformly in projected solid
        angle and all of the same power.

    Raises
    ------
    SpecimenError
        If the emitter lights nothing of the footprint, or nothing at one of `nm`, or if
        a beam that diverges is not collimated, or reaches the horizon.
    """

    def __init__(
        self,
        specimen: Specimen,
        emitter: mi.Emitter,
        footprint: str | float,
        emission: str,
        nm: tuple[float, ...] | None = None,
        divergence: float = 0.0,
        incident: Subdivision | None = None,
    ) -> None:
        self.specimen = specimen
        self.emitter = emitter
        self.footprint = footprint
        self.emission = emission
        low, high = specimen.low, specimen.high
        self.middle = np.array([*(low + high)[:2] / 2, high[2]])
        self.half = (high - low)[:2] / 2
        self.collimated = mi.has_flag(emitter.flags(), mi.EmitterFlags.DeltaDirection)
        self.direction: Any = self._nominal_direction()
        self.side = -1 if self.direction is not None and self.direction[2] < 0 else 1
        if self.side < 0:
            self.middle[2] = low[2]
        self._middle = mi.Point3f(in_memory(self.middle))
        self.outline: Any = None
        if footprint == "full" and low[2] < high[2] and specimen.edges == "closed":
            self.outline = Outline(specimen, self.side)
        radii = self.half if isinstance(footprint, str) else (footprint, footprint)
        self._radii = in_memory(radii)
        self.divergence = divergence
        if divergence:
            # 1 - cos, to the last bit for narrow cones too
            (self._cap,) = in_memory([2 * np.sin(np.radians(divergence) / 2) ** 2])
        self.incident: Any = incident
        self._aim()
        if self.uniform:
            self._reference = None
        elif self.outline is None:
            self._reference = self._power_counted_as_one(nm)
        else:
            self._reference = self._share_faces(nm)

    def turned(self, direction: Floats) -> Beam:
        """The same collimated beam from another direction, on the same side."""
        other = copy(self)
        other.direction = direction
        other._aim()
        return other

    def _aim(self) -> None:
        """Set what follows from the direction, which is checked."""
        if self.direction is not None and abs(self.direction[2]) < 1e-6:
            raise SpecimenError(
                "the emitter must stand above or below the specimen's horizon, "
                f"got a direction of {self.direction}"
            )
        if self.collimated:
            self.wi = mi.Vector3f(in_memory(self.direction))
        if self.divergence:
            self._check_divergence()
        self._patch: tuple[float, ...] = ()
        if self.incident is not None:
            if not self.collimated:
                raise SpecimenError(
                    "incident must be none for light that is not collimated, got "
                    f"{self.incident!s:.40}"
                )
            patch = int(self.incident.patch(self.direction))
            self._patch = self.incident.frame_of(patch)
        self._frame = in_memory(self._patch)
        # of a solid's box, for rays of equal power from different directions
        self._most = in_memory([self._largest()] if self._spreads else [])

    @property
    def _spreads(self) -> bool:
        """Whether collimated light on a solid comes from more than one direction."""
        spread = self.divergence or self.incident is not None
        return self.outline is not None and self.collimated and bool(spread)

    def _largest(self) -> float:
        """Area of a solid's outline from any direction of a beam that spreads, at most.

        Of a patch over the cosine, in proportion to which it is filled.
        """
        if self.incident is None:
            near, far = self.theta_i - self.divergence, self.theta_i + self.divergence
            ends = np.radians([max(near, 0), far])
            return float(self.outline.most(np.cos(ends[0]), np.sin(ends[1])))
        corners = np.meshgrid(*[[BORDER_MARGIN, 1 - BORDER_MARGIN]] * 2)
        cosine = self.incident.drawn(np, self._patch, *corners)[2].min()
        return float(self.outline.most(1, np.sqrt(1 - cosine**2) / cosine))

    @property
    def uniform(self) -> bool:
        """Whether all rays carry the same power."""
        return self.collimated

    @property
    def fills_cell(self) -> bool:
        """Whether it is parallel light that falls on all of a periodic cell."""
        parallel = self.collimated and not self.divergence and self.incident is None
        return parallel and self.specimen.periodic and self.footprint == "full"

    @property
    def theta_i(self) -> float:
        """Angle of the nominal direction from the lit face's normal, in degrees."""
        if self.direction is None:
            return np.nan
        x, y, z = self.direction
        return float(np.degrees(angles([x, y, self.side * z])[0]))

    @property
    def phi_i(self) -> float:
        """Azimuth of the nominal direction, in degrees."""
        if self.direction is None:
            return np.nan
        return float(np.degrees(angles(self.direction)[1]))

    def sample(
        self, sampler: mi.Sampler, wavelengths: mi.Spectrum
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Float, mi.Float, mi.UnpolarizedSpectrum]:
        """Draw one ray per lane.

        Returns
        -------
        p : mi.Point3f
            Point of the footprint.
        wi : mi.Vector3f
            Unit vector from there to the emitter, in world coordinates.
        cosine : mi.Float
            Of it to the normal of the footprint, or of the face of a solid's box.
        distance : mi.Float
            To the emitter.
        weight : mi.UnpolarizedSpectrum
            Power of the ray, 1 on average over the beam; 0 where nothing is emitted.
        """
        place = None if self.outline is None else sampler.next_2d()
        p = self._point(sampler) if place is None else None
        if self.collimated:
            wi = self.wi
            if self.divergence:
                wi = self._diverging(sampler.next_2d())
            elif self.incident is not None:
                wi = self._filling(sampler.next_2d())
            cosine = dr.abs(wi.z)
            if place is not None:
                p, cosine = self._onto_faces(place, wi)
            return p, wi, cosine, mi.Float(dr.inf), mi.UnpolarizedSpectrum(1.0)
        n, gain = None, mi.Float(1)
        if place is not None:
            p, n, number, _ = self.outline.drawn(place, self._shares, self._total)
            gain = dr.gather(mi.Float, self._gains, number)
        sample = sampler.next_2d()
        wi, distance, weight = self._towards(p, sample, wavelengths, n)
        cosine = dr.abs(wi.z if n is None else dr.dot(wi, n))
        return p, wi, cosine, distance, weight * (gain / self._reference)

    def _onto_faces(
        self, sample: mi.Point2f, wi: mi.Vector3f
    ) -> tuple[mi.Point3f, mi.Float]:
        """Points all over the silhouette of a solid's box, and cosines to its faces."""
        widths = self.outline.widths(wi)
        total = sum(widths)
        if self._spreads:
            total = (
                self._most[0] if self.incident is None else self._most[0] * dr.abs(wi.z)
            )
        p, n, _, beside = self.outline.drawn(sample, widths, total)
        cosine = dr.dot(wi, n)
        if self._spreads:
            away = self.outline.beside(wi, self.specimen.box.reach)
            p, cosine = dr.select(beside, away, p), dr.select(beside, 1.0, cosine)
        return p, cosine

    def in_lanes(self, beams: Sequence[Beam], number: mi.UInt32) -> Beam:
        """Collimated beam that has in each lane the direction of one of several.

        Parameters
        ----------
        beams : sequence of Beam
            Two or more that differ from this one in their direction only.
        number : mi.UInt32
            Of the lane's beam among them.
        """
        joint = copy(self)
        joint.wi = mi.Vector3f(*_looked_up([beam.direction for beam in beams], number))
        if self.incident is not None:
            joint._frame = _looked_up([beam._patch for beam in beams], number)
        if self._spreads:
            joint._most = _looked_up([[x[0] for x in b._most] for b in beams], number)
        return joint

    def _check_divergence(self) -> None:
        """Raise SpecimenError unless the cone of directions is that of a beam."""
        if not self.collimated:
            raise SpecimenError(
                "divergence must be 0 for light that is not collimated, "
                f"got {self.divergence:g} degrees"
            )
        if self.theta_i + self.divergence >= 90:
            raise SpecimenError(
                "theta_i and divergence together must be below 90 degrees, "
                f"got {self.theta_i:g} and {self.divergence:g}"
            )

    def _diverging(self, sample: mi.Point2f) -> mi.Vector3f:
        """Directions that fill the cone about the nominal one, uniformly."""
        height = sample.x * self._cap  # of the cap of the unit sphere, above them
        sine = dr.sqrt(height * (2 - height))
        sin, cos = dr.sincos(2 * dr.pi * sample.y)
        local = mi.Vector3f(sine * cos, sine * sin, 1 - height)
        return dr.normalize(mi.Frame3f(self.wi).to_world(local))

    def _filling(self, sample: mi.Point2f) -> mi.Vector3f:
        """Directions that fill a patch, uniformly in projected solid angle."""
        sample = BORDER_MARGIN + (1 - 2 * BORDER_MARGIN) * sample
        x, y, z = self.incident.drawn(DRJIT, self._frame, sample.x, sample.y)
        return mi.Vector3f(x, y, self.side * z)

    def _point(self, sampler: mi.Sampler) -> mi.Point3f:
        """Points of the footprint."""
        if self.footprint == "point":
            if is_joint(sampler):
                # the best dimensions are those that come after the footprint's
                sampler.skip(2)
            return mi.Point3f(self._middle)
        return self._spread(sampler.next_2d())

    def _spread(self, sample: mi.Point2f) -> mi.Point3f:
        """Points all over a footprint that is more than a point."""
        x, y = self._radii
        if self.footprint != "full":
            disk = mi.warp.square_to_uniform_disk_concentric(sample)
            return self._middle + mi.Vector3f(x * disk.x, y * disk.y, 0)
        if self.specimen.plane is not None:
            centre = self.specimen.plane.interaction
            u, v = sample.x - 0.5, sample.y - 0.5
            return centre.p + u * centre.dp_du + v * centre.dp_dv
        offset = 2 * sample - 1
        return self._middle + mi.Vector3f(x * offset.x, y * offset.y, 0)

    def _towards(
        self,
        p: mi.Point3f,
        sample: mi.Point2f,
        wavelengths: mi.Spectrum,
        n: mi.Vector3f | None = None,
    ) -> tuple[mi.Vector3f, mi.Float, mi.UnpolarizedSpectrum]:
        """Direction, distance and unnormalised weight from `p` to the emitter.

        `n`: normal of the face there, if it is not the footprint's own.
        """
        it = dr.zeros(mi.SurfaceInteraction3f)
        it.p, it.wavelengths = p, wavelengths
        if self.emission == "equal_power" and self.emitter.get_shape() is not None:
            position = self.emitter.get_shape().sample_position(0.0, sample)
            to_emitter = position.p - p
            distance = dr.norm(to_emitter)
            wi = to_emitter / distance
            lit = dr.dot(wi, position.n) < 0
            weight = mi.UnpolarizedSpectrum(1.0)
        else:
            ds, weight = self.emitter.sample_direction(it, sample)
            weight = power_of(weight)  # of any polarisation
            wi, distance = ds.d, ds.dist
            lit = ds.pdf > 0
            if self.emission == "equal_power":
                lit &= dr.any(weight > 0)
                weight = mi.UnpolarizedSpectrum(1.0)
        cosine = self.side * wi.z
        lit &= cosine > 0
        if n is not None:
            cosine = dr.dot(n, wi)
            lit &= cosine > 0
        if self.emission == "radiometric":
            weight = weight * cosine
        return wi, distance, dr.select(lit, weight, 0.0)

    def _nominal_direction(self) -> Any:
        """Unit vector from the footprint's middle to the emitter's centre, or None."""
        if self.collimated:
            it = dr.zeros(mi.SurfaceInteraction3f)
            it.p = mi.Point3f(self.middle.tolist())
            ds, _ = self.emitter.sample_direction(it, mi.Point2f(0.5))
            vector = np.array([x[0] for x in ds.d])
        elif self.emitter.is_environment():
            return None
        else:
            vector = self._centre() - self.middle
        norm = np.linalg.norm(vector)
        if not np.isfinite(norm) or norm == 0:
            raise SpecimenError(
                f"the emitter {self.emitter.class_name()} must lie in a direction from "
                "the specimen, got none"
            )
        return vector / norm

    def _centre(self) -> Numbers:
        """Middle of the emitter's bounding box."""
        low, high = self._box()
        return (low + high) / 2

    def _box(self) -> tuple[Numbers, Numbers]:
        """Corners of the emitter's bounding box."""
        box = self.emitter.bbox()
        return np.array(box.min).ravel(), np.array(box.max).ravel()

    def _power_counted_as_one(self, nm: tuple[float, ...] | None) -> float:
        """Power that counts as 1: about the mean over the beam, a power of two.

        That of the footprint's middle; but of all the footprint if the middle is dark,
        or if the spot under a small near emitter is so much brighter that single rays
        would exceed what the tally holds.
        """
        sample = _grid()
        powers = self._mean_weights(mi.Point3f(self.middle.tolist()), sample, nm)
        unit = powers.mean()
        spot = self._mean_weights(self._nearest(), sample, nm).mean()
        if self.footprint != "point" and (unit == 0 or spot > MAX_SPOT_CONTRAST * unit):
            powers = self._mean_weights(self._spread(_places()), sample, nm)
            unit = max(powers.mean(), spot / MAX_SPOT)
        return self._checked_unit(powers, unit, nm)

    def _share_faces(self, nm: tuple[float, ...] | None) -> float:
        """Share rays among the faces of a solid's box; the power that counts as 1.

        In proportion to the power that each gets; of equal power, to their areas as
        seen from the middle of the emitter.
        """
        outline, equal = self.outline, self.emission == "equal_power"
        near = not self.emitter.is_environment()
        sizes = outline.areas
        if near:
            sizes = sizes * outline.faces_any_of(*self._box())
        if equal and self.direction is not None:
            sizes = sizes * np.maximum(outline.normals @ self.direction, 0)
        places = _places()
        faces = [outline.on_face(places, dr.opaque(mi.UInt32, i)) for i in range(5)]
        means = np.array([self._mean_weights(p, _grid(), nm, n) for p, n in faces])
        shares = sizes
        if not equal:
            powers = sizes * means.mean(axis=1)
            shares = np.maximum(powers, powers.mean() * MIN_SHARE) * (sizes > 0)
        shares = shares / max(shares.sum(), np.finfo(float).tiny)
        gains = np.ones(5)
        if not equal:
            gains = np.divide(sizes, shares, out=np.zeros(5), where=shares > 0)
        powers = (shares * gains) @ means
        unit = powers.mean()
        if near and not equal:
            spots = outline.nearest(self._centre())
            each = [self._mean_weights(p, _grid(), nm, n).mean() for p, n in spots]
            unit = max(unit, (gains * each).max() / MAX_SPOT)
        self._shares, (self._total,) = in_memory(shares), in_memory([shares.sum()])
        self._gains = mi.Float(gains.tolist())
        return self._checked_unit(powers, unit, nm)

    def _checked_unit(
        self, powers: Floats, unit: float, nm: tuple[float, ...] | None
    ) -> float:
        """Power of two that is near `unit`; SpecimenError if there is no light.

        `powers`: in each channel.
        """
        dark = [x for x, power in zip(nm or (), powers) if not power > 0]
        if dark or not unit > 0:
            at = f" at {dark[0]:g} nm" if dark else ""
            raise SpecimenError(
                f"the emitter {self.emitter.class_name()} must light the specimen{at}, "
                "got no light on the footprint"
            )
        # a power of two divides exactly
        return float(2.0 ** np.round(np.log2(unit)))

    def _mean_weights(
        self,
        p: mi.Point3f,
        sample: mi.Point2f,
        nm: tuple[float, ...] | None,
        n: mi.Vector3f | None = None,
    ) -> Floats:
        """Mean weight of rays from `p`, of each channel: of each of `nm`, if any."""
        weights = []
        for lanes in lanes_of(nm):
            weight = self._towards(p, sample, lanes, n)[2]
            means = np.array(weight, dtype=float).reshape(len(weight), -1).mean(axis=1)
            weights += means.tolist()
        return np.array(weights[: None if nm is None else len(nm)])

    def _nearest(self) -> mi.Point3f:
        """Point of the footprint, or of the box about it, nearest to the emitter.

        The footprint's middle for an emitter that is infinitely far.
        """
        if self.direction is None or self.emitter.is_environment():
            return mi.Point3f(self.middle.tolist())
        radius = self.footprint if isinstance(self.footprint, float) else self.half
        nearest = self.middle.copy()
        nearest[:2] += np.clip((self._centre() - self.middle)[:2], -radius, radius)
        return mi.Point3f(nearest.tolist())


def _grid() -> mi.Point2f:
    """Points all over the unit square, in rows."""
    grid = mi.UInt32(dr.arange(mi.UInt32, N_GRID * N_GRID))
    x, y = mi.Float(grid % N_GRID), mi.Float(grid // N_GRID)
    return (mi.Point2f(x, y) + 0.5) / N_GRID


def _places() -> mi.Point2f:
    """As many of a low-discrepancy sequence (Roberts 2018)."""
    number = mi.Float(dr.arange(mi.UInt32, N_GRID * N_GRID))
    places = mi.Point2f(number * 0.7548777, number * 0.5698403)
    return places - dr.floor(places)


def _looked_up(rows: Sequence[Any], number: mi.UInt32) -> list[mi.Float]:
    """Columns of a table, one of its rows in each lane."""
    columns = [mi.Float(column) for column in np.array(rows, np.float32).T]
    return [dr.gather(mi.Float, column, number) for column in columns]
