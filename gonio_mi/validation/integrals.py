"""Integrals of ``pdf`` and ``eval`` over patches, precise enough to judge samples.

A randomised lattice comes first: its error is known without assumptions, so that tables
and kinks do no harm. Lobes that are too sharp for it are integrated adaptively, with a
limited number of evaluations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Integers, Singles
from ..collector.directions import direction
from ..collector.hemisphere import RingsAndSectors
from ..errors import SpecimenError
from ..mitsuba_compat import floats
from ..quadrature.integrate import integrate
from .probe import Probe
from .tally import PatchTotals, patch_of

# Numbers of points and generators of Fibonacci lattices, where patches need ever more,
# and random shifts of each.
LATTICES = (21, 13), (89, 55), (377, 233), (1597, 987), (6765, 4181)
SHIFTS = 16

# Standard error of a lattice, as part of the standard error of samples in a patch: it
# widens a score by 2 %.
LATTICE_SHARE = 0.2

# Standard errors within which a sum lies, of 16 shifts: in all but 1 of 1000 cases.
SUM_WIDTH = 4.0

# What a sum must be known to: a tenth of the 1e-3, spread evenly, that must be seen.
SUM_ERROR = 1e-4

# A density that is larger by this where samples are than at all points of the patch
# shows a lobe that was missed.
MISSED_PEAK = 3.0

# Weights that are larger have no limit.
MAX_WEIGHT = 1e15

# Of adaptive integrals: relative error of a patch, how many times its estimate kinks
# may hide (see there), and evaluations for each sample.
INTEGRAL_ERR = 1e-3
HIDDEN = 2
EVALUATIONS = 4
MIN_EVALUATIONS = 2**21


@dataclass(frozen=True)
class PatchIntegrals:
    """Integrals of a function over each patch, and how well they are known.

    Attributes
    ----------
    values : ndarray, shape (2 n_patches,)
    bound : ndarray, shape (2 n_patches,)
        Within which `values` are right.
    std_err : ndarray, shape (2 n_patches,)
        Random error of `values`, beside that.
    sum_bound : float
        Within which the sum of `values` is right.
    """

    values: Floats
    bound: Floats
    std_err: Floats
    sum_bound: float


@dataclass(frozen=True)
class Expected:
    """Expected values of each patch, in the order of :func:`_finite_values`.

    Attributes
    ----------
    counts : PatchIntegrals
        Of ``pdf`` where ``eval`` is not black.
    weights, squares, cubes : PatchIntegrals
        Of damped weights, means over channels, and of their powers.
    unreached : PatchIntegrals
        Of ``eval`` where ``pdf`` is 0, a mean over channels.
    unused : PatchIntegrals
        Of ``pdf`` where ``eval`` is black.
    channels : list of PatchIntegrals
        Of each channel of ``eval``.
    least : float
        Smallest positive density that was seen; infinite where nobody looked.
    """

    counts: PatchIntegrals
    weights: PatchIntegrals
    squares: PatchIntegrals
    cubes: PatchIntegrals
    unreached: PatchIntegrals
    unused: PatchIntegrals
    channels: list[PatchIntegrals]
    least: float


def integrals(
    probe: Probe,
    subdivision: RingsAndSectors,
    totals: PatchTotals,
    weight_limits: Floats,
) -> Expected:
    """Integrals of ``pdf``, damped weights, and of each channel of ``eval``.

    Parameters
    ----------
    probe : Probe
    subdivision : RingsAndSectors
    totals : PatchTotals
        Samples that are to be compared with them.
    weight_limits : ndarray
        Of weights by patch, as of :class:`Damping`.

    Returns
    -------
    Expected

    Raises
    ------
    SpecimenError
        If they do not converge.
    """
    # a number that single precision can multiply
    weight_limits = np.minimum(weight_limits[: 2 * subdivision.n_patches], MAX_WEIGHT)
    found = _lattice(probe, subdivision, totals, weight_limits)
    return found or _adaptive(probe, subdivision, totals, weight_limits)


# --------------------------------------------------------------------------- lattices


def _lattice(
    probe: Probe,
    subdivision: RingsAndSectors,
    totals: PatchTotals,
    weight_limits: Floats,
) -> Expected | None:
    """Integrals by shifted lattices; None if they would need too many points."""
    m = 2 * subdivision.n_patches
    means: Any = None
    largest, least = np.zeros(m), np.inf
    refined, rough = np.arange(m), np.ones(m, bool)
    stopped: list[Integers] = []
    left = _most_evaluations(totals) // 2
    area = np.tile(subdivision.solid_angles.ravel(), 2)[:, None, None]
    for level, (n_points, _) in enumerate(LATTICES):
        left -= len(refined) * SHIFTS * n_points
        if left < 0:
            break
        values = _lattice_values(probe, subdivision, weight_limits, refined, level)
        if means is None:
            means = np.zeros((m, SHIFTS, len(values)))
        means[refined] = values.mean(axis=-1).transpose(1, 2, 0) * area[refined]
        density = values[0] + values[5]
        largest[refined] = density.max(axis=(1, 2))
        least = min(least, density.min(initial=np.inf, where=density > 0))
        rough = _rough(means, totals, weight_limits) | (
            totals.peaks > MISSED_PEAK * largest
        )
        further = np.flatnonzero(rough | _rough_in_sum(means))
        stopped.append(np.setdiff1d(refined, further))
        refined = further
        if not refined.size:
            break
    if rough.any():
        return None
    # A lattice that misses what is bright in a patch sees little and a small error, and
    # is not refined: patches that were stopped before others take other shifts.
    for level, patches in enumerate(stopped[:-1]):
        if patches.size:
            values = _lattice_values(
                probe, subdivision, weight_limits, patches, level, 1
            )
            means[patches] = values.mean(axis=-1).transpose(1, 2, 0) * area[patches]
    # how well the sum is known, it says itself
    found = _mean_integrals(means)
    each: Any = (*found[:6], found[6:], least)
    return Expected(*each)


def _rough(means: Floats, totals: PatchTotals, weight_limits: Floats) -> Flags:
    """Mask of patches whose integrals are too uncertain to judge the samples."""
    values, n = means.mean(axis=1), totals.n
    std_err = means.std(axis=1, ddof=1) / np.sqrt(SHIFTS)
    noise = np.sqrt(np.maximum(values[:, 0], 1 / n) / n)
    rough = std_err[:, 0] > LATTICE_SHARE * noise
    # one damped weight is a tenth of what a group leaves unknown
    least = np.where(weight_limits < MAX_WEIGHT, weight_limits, 1.0)
    weight_noise = np.sqrt(np.maximum(n * values[:, 2], least**2)) / n
    return rough | (std_err[:, 1] > LATTICE_SHARE * weight_noise)


def _rough_in_sum(means: Floats) -> Flags:
    """Mask of patches that add more than their part to the variance of a rough sum."""
    means = np.delete(means, [1, 2, 3], axis=2)  # powers need no such precision
    values = means.mean(axis=1)
    std_err = means.std(axis=1, ddof=1) / np.sqrt(SHIFTS)
    allowed = SUM_ERROR * np.maximum(values.sum(axis=0), 1)
    off = SUM_WIDTH * means.sum(axis=0).std(axis=0, ddof=1) / np.sqrt(SHIFTS) > allowed
    return np.any((std_err * np.sqrt(len(means)) * SUM_WIDTH > allowed) & off, axis=1)


def _mean_integrals(means: Floats) -> list[PatchIntegrals]:
    """Integrals and errors from `means`, (2 n_patches, SHIFTS, functions)."""
    errors = means.std(axis=1, ddof=1) / np.sqrt(SHIFTS)
    sum_errors = means.sum(axis=0).std(axis=0, ddof=1) / np.sqrt(SHIFTS)
    nothing = np.zeros(len(means))
    return [
        PatchIntegrals(values, nothing, std_err, float(SUM_WIDTH * sum_error))
        for values, std_err, sum_error in zip(
            means.mean(axis=1).T, errors.T, sum_errors
        )
    ]


def _lattice_values(
    probe: Probe,
    subdivision: RingsAndSectors,
    weight_limits: Floats,
    patches: Integers,
    level: int,
    repeat: int = 0,
) -> Floats:
    """Values of :func:`_finite_values` at shifted lattices on some patches.

    Uniform over solid angle; shape (functions, len(patches), SHIFTS, n_points). Another
    `repeat` has other shifts.
    """
    n = len(patches) * SHIFTS * LATTICES[level][0]
    if len(patches) == 2 * subdivision.n_patches and not repeat:
        x, y, z = _points_everywhere(subdivision, level)
    else:
        x, y, z = _points(subdivision, patches, level, repeat)
    wo = mi.Vector3f(*map(floats, (x, y, z if probe.condition.side == "front" else -z)))
    limit = floats(np.repeat(weight_limits[patches], n // len(patches)))
    found = _finite_values(probe, wo, limit)
    values = np.empty((len(found), n))
    for row, one in zip(values, found):
        row[:] = one.numpy()
    return values.reshape(len(found), len(patches), SHIFTS, -1)


@lru_cache(2)
def _points_everywhere(subdivision: RingsAndSectors, level: int) -> Singles:
    """Points of :func:`_points` in all patches, with which each integral begins."""
    return _points(subdivision, np.arange(2 * subdivision.n_patches), level, 0)


def _points(
    subdivision: RingsAndSectors, patches: Integers, level: int, repeat: int
) -> Singles:
    """Directions of shifted lattices, where light is on the front; shape ``(3, n)``."""
    n_points, generator = LATTICES[level]
    lattice = np.arange(n_points)[:, None] * [1, generator] / n_points
    # always the same, so that an integral does not depend on the seed
    random = np.random.default_rng(n_points + repeat)
    # folded, so that values need not agree on opposite edges of a patch
    shifts = random.random((len(patches), SHIFTS, 1, 2))
    u = np.abs(2 * ((lattice + shifts) % 1) - 1)
    half, patch = np.divmod(patches, subdivision.n_patches)
    ring, sector = np.divmod(patch, subdivision.n_phi)
    cosines = np.cos(subdivision.theta_edges)
    first, last = (cosines[ring + k][:, None, None] for k in (0, 1))
    begin, end = (subdivision.phi_edges[sector + k][:, None, None] for k in (0, 1))
    z = first + (last - first) * u[..., 0]
    wo = direction(np.arccos(z), begin + (end - begin) * u[..., 1])
    wo[..., 2] *= np.where(half, -1, 1)[:, None, None]
    return wo.reshape(-1, 3).T.astype(np.float32, order="C")


def _finite_values(probe: Probe, wo: mi.Vector3f, limit: mi.Float) -> list[mi.Float]:
    """Values as of :class:`Expected`; negative ones and NaN are judged elsewhere."""
    value, pdf = probe.eval_and_pdf(wo)
    pdf, *channels = (
        dr.select(dr.isfinite(x), dr.maximum(x, 0.0), 0.0) for x in (pdf, *value)
    )
    mean = sum(channels) / len(channels)
    damped = dr.minimum(mean, limit * pdf)
    ratio = dr.select(pdf > 0, damped / pdf, 0.0)
    powers = damped * ratio, damped * ratio**2
    unreached = dr.select(pdf > 0, 0.0, mean)
    used, unused = dr.select(mean > 0, pdf, 0.0), dr.select(mean > 0, 0.0, pdf)
    return [used, damped, *powers, unreached, unused, *channels]


# --------------------------------------------------------------------------- adaptive


def _adaptive(
    probe: Probe,
    subdivision: RingsAndSectors,
    totals: PatchTotals,
    weight_limits: Floats,
) -> Expected:
    """Integrals by cells that are split until that changes little."""
    condition, left = probe.condition, _most_evaluations(totals)
    limit_of = floats(weight_limits)

    def values(_ctx: Any, _si: Any, wo: mi.Vector3f, _active: Any) -> list[mi.Float]:
        """All of :class:`Expected`, as long as there are evaluations left."""
        nonlocal left
        left -= dr.width(wo)
        if left < 0:
            raise SpecimenError("the integral takes too many evaluations")
        index = patch_of(subdivision, condition, wo)
        return _finite_values(probe, wo, dr.gather(mi.Float, limit_of, index))

    found = integrate(
        # what is asked of a BSDF
        SimpleNamespace(
            class_name=probe.bsdf.class_name,
            sample=lambda _ctx, _si, u1, u2, _active: probe.sample(u1, u2),
            eval=values,
        ),
        condition.theta_i,
        condition.phi_i,
        subdivision,
        integral_err=INTEGRAL_ERR,
        side=condition.side,
    )
    flux = found.flux.reshape(2 * subdivision.n_patches, -1)
    error = HIDDEN * found.error.reshape(flux.shape)
    nothing = np.zeros(len(flux))
    several = [
        PatchIntegrals(flux[:, c], error[:, c], nothing, float(error[:, c].sum()))
        for c in range(flux.shape[1])
    ]
    each: Any = (*several[:6], several[6:], np.inf)
    return Expected(*each)


def _most_evaluations(totals: PatchTotals) -> int:
    """Number of evaluations after which integration is given up."""
    return max(EVALUATIONS * totals.n, MIN_EVALUATIONS)
