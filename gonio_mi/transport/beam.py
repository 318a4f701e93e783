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
from ..specimen.wavelengths import passes, wavelength_lanes
from .collector_sphere import DRJIT
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


class Beam:
    """Rays from an emitter to the footprint on the plane of the specimen's top.

    Parameters
    ----------
    specimen : Specimen
    emitter : mi.Emitter
        A delta direction gives a collimated beam. Any other emitter is sampled through
        ``sample_direction``.
    footprint : str or float
        ``"point"``: the middle of the bounding box's top. ``"full"``: all of that top,
        uniformly. A number: a disk of that radius about the middle.
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
        radii = self.half if isinstance(footprint, str) else (footprint, footprint)
        self._radii = in_memory(radii)
        self.divergence = divergence
        if divergence:
            # 1 - cos, to the last bit for narrow cones too
            (self._cap,) = in_memory([2 * np.sin(np.radians(divergence) / 2) ** 2])
        self.incident: Any = incident
        self._aim()
        self._reference = None if self.uniform else self._power_counted_as_one(nm)

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
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Float, mi.UnpolarizedSpectrum]:
        """Draw one ray per lane.

        Returns
        -------
        p : mi.Point3f
            Point of the footprint.
        wi : mi.Vector3f
            Unit vector from there to the emitter, in world coordinates.
        distance : mi.Float
            To the emitter.
        weight : mi.UnpolarizedSpectrum
            Power of the ray, 1 on average over the beam; 0 where nothing is emitted.
        """
        p = self._point(sampler)
        if self.collimated:
            wi = self.wi
            if self.divergence:
                wi = self._diverging(sampler.next_2d())
            elif self.incident is not None:
                wi = self._filling(sampler.next_2d())
            return p, wi, mi.Float(dr.inf), mi.UnpolarizedSpectrum(1.0)
        wi, distance, weight = self._towards(p, sampler.next_2d(), wavelengths)
        return p, wi, distance, weight / self._reference

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
        self, p: mi.Point3f, sample: mi.Point2f, wavelengths: mi.Spectrum
    ) -> tuple[mi.Vector3f, mi.Float, mi.UnpolarizedSpectrum]:
        """Direction, distance and unnormalised weight from `p` to the emitter."""
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
        box = self.emitter.bbox()
        return (np.array(box.min) + np.array(box.max)).ravel() / 2

    def _power_counted_as_one(self, nm: tuple[float, ...] | None) -> float:
        """Power that counts as 1: about the mean over the beam, a power of two.

        That of the footprint's middle; but of all the footprint if the middle is dark,
        or if the spot under a small near emitter is so much brighter that single rays
        would exceed what the tally holds.
        """
        grid = mi.UInt32(dr.arange(mi.UInt32, N_GRID * N_GRID))
        x, y = mi.Float(grid % N_GRID), mi.Float(grid // N_GRID)
        sample = (mi.Point2f(x, y) + 0.5) / N_GRID
        powers = self._mean_weights(mi.Point3f(self.middle.tolist()), sample, nm)
        unit = powers.mean()
        spot = self._mean_weights(self._nearest(), sample, nm).mean()
        if self.footprint != "point" and (unit == 0 or spot > MAX_SPOT_CONTRAST * unit):
            # a low-discrepancy sequence all over it (Roberts 2018)
            places = mi.Point2f(mi.Float(grid) * 0.7548777, mi.Float(grid) * 0.5698403)
            places -= dr.floor(places)
            powers = self._mean_weights(self._spread(places), sample, nm)
            unit = max(powers.mean(), spot / MAX_SPOT)
        dark = [x for x, power in zip(nm or (), powers) if not power > 0]
        if dark or not unit > 0:
            at = f" at {dark[0]:g} nm" if dark else ""
            raise SpecimenError(
                f"the emitter {self.emitter.class_name()} must light the specimen{at}, "
                "got no light on the footprint"
            )
        # a power of two divides exactly
        return 2.0 ** np.round(np.log2(unit))

    def _mean_weights(
        self, p: mi.Point3f, sample: mi.Point2f, nm: tuple[float, ...] | None
    ) -> Floats:
        """Mean weight of rays from `p`, of each channel: of each of `nm`, if any."""
        weights = []
        for part in passes(nm):
            weight = self._towards(p, sample, wavelength_lanes(part))[2]
            means = np.array(weight, dtype=float).reshape(len(weight), -1).mean(axis=1)
            weights += means[: None if part is None else len(part)].tolist()
        return np.array(weights)

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


def _looked_up(rows: Sequence[Any], number: mi.UInt32) -> list[mi.Float]:
    """Columns of a table, one of its rows in each lane."""
    columns = [mi.Float(column) for column in np.array(rows, np.float32).T]
    return [dr.gather(mi.Float, column, number) for column in columns]
