"""Light of one event of the estimator `split`, as an integral over the surface.

Of a periodic, opaque surface: points all over it are joined by `eval` to each incident
direction and to a point of every patch, if nothing stands in the way. All incident
directions share the points, and what these see of the patches. Rays are left with what
comes of more events, a small part of the light on most surfaces.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..errors import LABEL, SpecimenError, abridged
from ..loops import syntax
from ..mitsuba_compat import PARTIALS
from ..results.estimates import MIN_EVEN_HITS, Estimates
from ..results.statistics import student_interval, student_score
from ..results.tally import Fate, Tally
from ..settings.measurement_settings import BRANCHES
from ..specimen.rays import NEARBY, departure, escapes, intersect
from ..specimen.specimen import Specimen
from ..transport.polarisation import n_channels
from ..transport.sampling import seeded, split_lanes
from ..transport.setup import Setup
from ..transport.surface_events import MAX_POWER, flux_context

# Points of each batch to begin with, and at least of a number of rays.
N_FIRST, N_FIXED = 2**5, 2**7

# Part of `noise` that the integral may have: rays keep sqrt(1 - 1/16), 97 % of it.
PART_OF_NOISE = 1 / 4

# Points of all batches times the square of `noise`, at most: rays cost less than more.
# For m patches a noise x takes m / (44 x^2) rays of 170 ns (measured on rough grooves),
# and a point 20 ns for each patch: as much at 170 / (44 * 20) = 0.19.
MAX_POINTS_NOISE2 = 1 / 6

# Standard errors by which the light that meets points may be off, in either direction:
# by chance in 2e-9 of all directions.
MAX_SCORE = 6

# Level of intervals of points and of rays that must overlap in every patch.
AGREEMENT = 1 - 1e-8

# Lanes of a launch: pairs of a point and a patch, or sums over points.
MAX_LANES = 2**24

# Digits that sums keep, to 1e-6 of a patch in 16 batches: all others are chance, which
# would make files twice as large.
BITS = 16

# Tells the points from the rays of the same seed, of any direction.
SEED = 0x73706C69 << 64


@dataclass(frozen=True)
class SingleScattering:
    """Light of one event of an incident direction: sums over points of each batch.

    Attributes
    ----------
    sums : ndarray, shape (n_batches, n_patches, channels)
        Of flux fractions.
    lit : ndarray, shape (n_batches,)
        Of the part of all incident light that meets a point: 1 on average.
    n_points : int
    """

    sums: Floats
    lit: Floats
    n_points: int

    def __add__(self, more: SingleScattering) -> SingleScattering:
        """Light of the points of both."""
        n_points = self.n_points + more.n_points
        return SingleScattering(self.sums + more.sums, self.lit + more.lit, n_points)

    @cached_property
    def flux(self) -> Floats:
        """Flux fractions, shape ``(n_batches, n_patches, channels)``.

        Where points met more than all incident light, or less, by chance, that much is
        taken away: as a part of what the other batches found, which is another chance.
        Not in dim patches, of which it would be more than a batch has.
        """
        found = self.sums / self.n_points
        others = (found.sum(axis=0) - found) / max(len(found) - 1, 1)
        due = found - others * (self.lit / self.n_points - 1)[:, None, None]
        return np.where((due < 0).any(axis=0), found, due)

    def noise(self) -> float:
        """Total variation distance that its standard errors make on average.

        Infinite where no light was found, and in a single batch.
        """
        if len(self.flux) == 1 or not self.flux.any():
            return np.inf
        error = self.flux.std(axis=0, ddof=1).sum() / np.sqrt(2 * np.pi)
        total = self.flux.mean(axis=0).sum() * np.sqrt(len(self.flux))
        return float(error / total)

    def check_lit(self) -> None:
        """Raise SpecimenError if points met more than all incident light, or less."""
        lit = self.lit / self.n_points
        if len(lit) == 1:
            return
        # points lie in strata alike in all batches, which miss up to one of them alike
        std_err = np.hypot(lit.std(ddof=1) / np.sqrt(len(lit)), 1 / self.n_points)
        t = (lit.mean() - 1) / std_err
        if lit.any() and abs(student_score(t, len(lit) - 1)) > MAX_SCORE:
            raise SpecimenError(
                "the estimator split needs surfaces that do not coincide: "
                f"{lit.mean():.3g} of the incident light meets points of them; "
                "take weighted instead"
            )

    def _check_rays(self, first: Tally) -> None:
        """Raise SpecimenError where rays met bright places that few points know.

        Or where they found light of one event (`first`) that points exclude.
        """
        rays, n_batches = Estimates(first), len(self.flux)
        n_points = n_batches * self.n_points
        if np.any(rays.n_heavy(0) * n_points < MIN_EVEN_HITS * rays.rays):
            raise SpecimenError(
                "the estimator split needs bright places that points meet: rays found "
                f"some that are far brighter than the rest, and by chance {n_points} "
                f"points meet fewer than {MIN_EVEN_HITS} times; take weighted instead"
            )
        if n_batches == 1:
            return
        each = self.flux.reshape(n_batches, *first.sums.shape[2:])
        std_err = each.std(axis=0, ddof=1) / np.sqrt(n_batches)
        value = each.mean(axis=0)
        low, high = student_interval(value, std_err, n_batches, AGREEMENT)
        least, most = rays.patches(0).interval(AGREEMENT)
        if np.any((least > high) | (most < low)):
            raise SpecimenError(
                "the estimator split needs points that tell what rays find, but light "
                "of one event differs in some patches beyond chance: most of it meets "
                "few points, as at grazing incidence; take weighted instead"
            )

    def completed(self, tally: Tally) -> Tally:
        """Tally of rays of more events, with this light in place of what they found.

        `tally` holds light of more events and of one, as `tallies` of `split` says.
        """
        tally, first = tally.apart()
        self._check_rays(first)
        n = tally.n_batches
        sums, hits, fates = tally.sums.astype(float), tally.hits.copy(), tally.fates
        flux = self.flux[:n] * tally.incident[:, None]
        sums[:, 0] += flux.reshape(sums[:, 0].shape)
        digits, power = np.frexp(sums)
        sums = np.ldexp(np.rint(digits * 2**BITS), power - BITS)
        seen = self.flux.any(axis=(0, 2)).reshape(hits[0].shape)
        hits[0] += (seen * n * self.n_points).astype(np.uint64)
        fates = fates.copy()
        fates[:, Fate.REFLECTED] += fates[:, Fate.OTHER_ORDER]
        fates[:, Fate.OTHER_ORDER] = 0
        return replace(tally, sums=sums, hits=hits, fates=fates)


def single_scattering(
    setups: Sequence[Setup], report: Callable[[float], Any] | None
) -> list[SingleScattering]:
    """Light of one event of each setup, as precise as their settings ask.

    Points are doubled, of each direction until it is precise enough: it has the bits
    that it would have alone. Setups differ in their incident direction only. `report`
    is called with how many points have been joined to all of them.

    Raises
    ------
    SpecimenError
        Where rays would need less time.
    """
    settings = setups[0].settings
    waiting, begin = list(setups), 0
    found: dict[Setup, SingleScattering] = {}
    # as many joined to patches as rays have branches
    end = BRANCHES * settings.rays // (settings.batches * setups[0].n_patches)
    end = N_FIRST if settings.noise else max(N_FIXED, 1 << end.bit_length() >> 1)
    while waiting:
        more_of_each = SurfacePoints(waiting).single_scattering(begin, end, report)
        for setup, more in zip(waiting, more_of_each):
            found[setup] = found[setup] + more if setup in found else more
        if settings.noise is None:
            if not all(light.sums.any() for light in found.values()):
                raise SpecimenError(
                    "the estimator split needs wide lobes: "
                    f"{end * settings.batches} points of the surface send no light to "
                    "any patch; take weighted instead"
                )
            break
        goal = PART_OF_NOISE * settings.noise
        waiting = [setup for setup in waiting if found[setup].noise() > goal]
        begin, end = end, 2 * end
        if waiting and end * settings.batches * settings.noise**2 > MAX_POINTS_NOISE2:
            raise SpecimenError(
                "the estimator split needs wide lobes, and no rare bright places: the "
                f"noise of {settings.noise:g} takes more than "
                f"{begin * settings.batches} points of the surface; take weighted "
                "instead"
            )
    for light in found.values():
        light.check_lit()
    return [found[setup] for setup in setups]


class SurfacePoints:
    """Points of a surface, joined to the incident directions of setups and to patches.

    Parameters
    ----------
    setups : sequence of Setup
        They differ in their incident direction only.
    """

    def __init__(self, setups: Sequence[Setup]) -> None:
        self.setup = setup = setups[0]
        self.specimen, self.side = setup.specimen, setup.beam.side
        self.n_batches, self.n_patches = setup.settings.batches, setup.n_patches
        self.n_wi = len(setups)
        towards = np.array([one.beam.direction for one in setups], np.float32)
        # two at least: what is gathered from a single one is another kernel
        towards = np.repeat(towards, 2, axis=0) if self.n_wi == 1 else towards
        self.wi = mi.Vector3f(np.ascontiguousarray(towards.T))
        theta_low, theta_high, phi_low, phi_high = setup.collector.subdivision.cells.T
        low, high = np.sin(theta_low / 2) ** 2, np.sin(theta_high / 2) ** 2
        solid_angles = 2 * (high - low) * (phi_high - phi_low)
        table = (low, high - low, phi_low, phi_high - phi_low, solid_angles)
        self.table = [mi.Float(column.tolist()) for column in table]
        scene = self.specimen.scene
        self.shapes = scene.shapes_dr()
        areas = [float(np.ravel(one.surface_area())[0]) for one in scene.shapes()]
        self.below = mi.Float((np.cumsum(areas) / np.sum(areas)).tolist())
        # area of the surface over that of the cell
        extent = (self.specimen.high - self.specimen.low)[:2]
        self.area = float(np.sum(areas) / np.prod(extent))

    def single_scattering(
        self, begin: int, end: int, report: Callable[[float], Any] | None
    ) -> list[SingleScattering]:
        """Light of points `begin` to `end` of each batch, by incident direction."""
        piece = max(1, MAX_LANES // (self.n_batches * self.n_patches))
        shape = self.n_batches, self.n_wi, self.n_patches, n_channels()
        sums, lit = np.zeros(shape), np.zeros(shape[:2])
        for start in range(begin, end, piece):
            n = min(piece, end - start)
            seed = SEED + self.setup.settings.seed
            keys = [(seed, batch) for batch in range(self.n_batches)]
            sampler = seeded(self.setup.sampler, keys, start, n)
            si = self._points(sampler)
            place = mi.Point2f(sampler.next_2d())
            dr.eval(si, place)
            gone = self._gone(si, place, n)
            most = max(1, min(piece, MAX_LANES // (self.n_batches * n)))
            for first in range(0, self.n_wi, most):
                m = min(most, self.n_wi - first)
                part = slice(first, first + m)
                came, met = self._came(si, n, first, m)
                sums[:, part] += self._sums(si, came, gone, n, m)
                each = met.astype(float).reshape(self.n_batches, n, m)
                lit[:, part] += each.sum(axis=1)
                if report is not None:
                    report(self.n_batches * n * m / self.n_wi)
        n = end - begin
        return [SingleScattering(sums[:, i], lit[:, i], n) for i in range(self.n_wi)]

    def _points(self, sampler: mi.Sampler) -> Any:
        """Points all over the surface, uniformly; not valid if rounding hides one."""
        sample, u = mi.Point2f(sampler.next_2d()), sampler.next_1d()
        number, n = mi.UInt32(0), dr.width(self.below)
        if n > 1:
            number = dr.binary_search(
                0, n - 1, lambda i: dr.gather(mi.Float, self.below, i) <= u
            )
        shape = dr.gather(mi.ShapePtr, self.shapes, number)
        position = shape.sample_position(0.0, sample)
        above = self.specimen.box.reach * NEARBY
        ray = mi.Ray3f(position.p + above * position.n, -position.n)
        si = intersect(self.specimen.scene, ray, PARTIALS, True)
        # of surfaces that coincide rays meet one: points of the others are none
        met = (si.shape == shape) & (dr.norm(si.p - position.p) < above / 2)
        si.t = dr.select(si.is_valid() & met, si.t, dr.inf)
        return si

    def _came(self, si: Any, n: int, first: int, m: int) -> tuple[mi.Float, Floats]:
        """Light of `m` incident directions from the `first` at each of `n` points.

        By :meth:`_kept`, with the part of all incident light that meets the point.
        """
        lanes = dr.arange(mi.UInt32, n * self.n_batches * m)
        point, incident = split_lanes(lanes, m)
        incident += dr.opaque(mi.UInt32, first)
        here = dr.gather(mi.SurfaceInteraction3f, si, point)
        wi = dr.gather(mi.Vector3f, self.wi, incident)
        cosine = dr.abs(dr.dot(here.n, wi))
        seen = sees(self.specimen, self.side, here, wi, here.is_valid() & (cosine > 0))
        met = dr.select(seen, self.area * cosine / dr.abs(wi.z), 0.0)
        kept = self._kept(here, wi, met * _shading_ratio(here, wi))
        dr.eval(kept, met)
        return kept, met.numpy()

    def _gone(self, si: Any, place: mi.Point2f, n: int) -> mi.Float:
        """Towards a place in each patch from each point, by :meth:`_kept`."""
        lanes = dr.arange(mi.UInt32, n * self.n_batches * self.n_patches)
        point, patch = split_lanes(lanes, self.n_patches)
        low, span, phi_low, phi_span = (
            dr.gather(mi.Float, column, patch) for column in self.table[:4]
        )
        at = dr.gather(mi.Point2f, place, point)
        s = low + span * at.x
        radius = 2 * dr.sqrt(s * (1 - s))
        sin_phi, cos_phi = dr.sincos(phi_low + phi_span * at.y)
        wo = mi.Vector3f(radius * cos_phi, radius * sin_phi, self.side * (1 - 2 * s))
        here = dr.gather(mi.SurfaceInteraction3f, si, point)
        seen, ratio = (
            sees(self.specimen, self.side, here, wo, here.is_valid()),
            _shading_ratio(here, wo),
        )
        kept = self._kept(here, wo, dr.select(seen & (ratio > 0), 1 / ratio, 0.0))
        dr.eval(kept)
        return kept

    def _kept(self, si: Any, w: mi.Vector3f, weight: mi.Float) -> mi.Float:
        """Direction in the frame of a point, and a weight: four numbers in a row.

        The weight is 0 where something is in the way.
        """
        row = mi.Vector4f(*si.to_local(w), weight)
        kept = dr.empty(mi.Float, 4 * dr.width(w))
        dr.scatter(kept, row, dr.arange(mi.UInt32, dr.width(w)))
        return kept

    def _sums(self, si: Any, came: mi.Float, gone: mi.Float, n: int, m: int) -> Floats:
        """Sums of light over `n` points, of `m` incident directions.

        Shape ``(n_batches, m, n_patches, channels)``.
        """
        lanes = dr.arange(mi.UInt32, self.n_batches * m * self.n_patches)
        pair, patch = split_lanes(lanes, self.n_patches)
        batch, incident = split_lanes(pair, m)
        numbers = [dr.opaque(mi.UInt32, x) for x in (n, m, self.n_patches)]
        where = batch, incident, patch
        total, sound = _added_up(si, came, gone, where, numbers)
        total *= dr.gather(mi.Float, self.table[4], patch)
        dr.eval(total, sound)
        if not dr.all(sound):
            raise SpecimenError(
                f"eval() of {abridged(self.specimen.name, LABEL)} returned a negative, "
                "infinite or NaN value: take weighted instead of split"
            )
        light = np.stack([one.numpy() for one in total], axis=-1)
        return light.astype(float).reshape(self.n_batches, m, self.n_patches, -1)


def sees(
    specimen: Specimen, side: int, si: Any, w: mi.Vector3f, active: mi.Bool
) -> mi.Bool:
    """Whether nothing stands in the way from a point, on either of its sides."""
    d = -dr.copysign(mi.Float(1), dr.dot(si.n, w)) * si.n
    start, offset = departure(specimen, si, d, w)
    ray = mi.Ray3f(start + dr.copysign(offset, dr.dot(si.n, w)) * si.n, w)
    return escapes(specimen, side, ray, si.n, offset, active)


def _shading_ratio(si: Any, w: mi.Vector3f) -> mi.Float:
    """Cosine to the shading normal over that to the surface's own.

    0 where both disagree about the side. Of both directions they make the correction
    that :func:`~.surface_events.shading_normal_correction` is.
    """
    shading, own = dr.dot(si.sh_frame.n, w), dr.dot(si.n, w)
    ratio = dr.select(shading * own > 0, dr.abs(shading / own), 0.0)
    return dr.select(dr.all(si.sh_frame.n == si.n), mi.Float(1.0), ratio)


@syntax
def _added_up(
    si: Any,
    came: mi.Float,
    gone: mi.Float,
    where: tuple[mi.UInt32, mi.UInt32, mi.UInt32],
    sizes: Sequence[mi.UInt32],
) -> tuple[mi.UnpolarizedSpectrum, mi.Bool]:
    """Sums of light over the points of a batch, from a direction to a patch."""
    batch, incident, patch = where
    n, m, n_patches = sizes
    total = mi.UnpolarizedSpectrum(0.0)
    sound = mi.Bool(True)
    point, end = batch * n, (batch + 1) * n
    while point < end:
        wi = dr.gather(mi.Vector4f, came, point * m + incident)
        wo = dr.gather(mi.Vector4f, gone, point * n_patches + patch)
        power = wi.w * wo.w
        here = dr.gather(mi.SurfaceInteraction3f, si, point)
        here.wi = mi.Vector3f(wi.x, wi.y, wi.z)
        active = power > 0
        local = mi.Vector3f(wo.x, wo.y, wo.z)
        value = here.bsdf().eval(flux_context(), here, local, active)
        # comparisons with NaN are false
        good = (dr.min(value) >= 0) & (dr.max(value) <= MAX_POWER)
        total += dr.select(active & good, value * power, 0.0)
        sound &= good | ~active
        point += 1
    return total, sound
