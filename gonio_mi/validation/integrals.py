"""Integrals of ``pdf`` and ``eval`` over patches, as precise as samples can judge.

A randomised lattice comes first: its error is known without assumptions, so that tables
and kinks do no harm. Lobes that are too sharp for it are integrated adaptively, within
a number of evaluations.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..collector.directions import direction
from ..errors import SpecimenError
from ..quadrature import integrate

__all__ = ["SUM_ERROR", "Integrals", "integrals"]

# Numbers of points and generators of Fibonacci lattices, where patches need ever more,
# and random shifts of each.
LATTICES = (21, 13), (89, 55), (377, 233), (1597, 987), (6765, 4181)
SHIFTS = 16

# Standard error of a lattice, as part of what samples leave unknown of a patch: it
# widens a score by 2 %.
SHARE = 0.2

# Standard errors within which a sum lies, of 16 shifts: in all but 1 of 1000 cases.
WIDE = 4.0

# What a sum must be known to: a tenth of the 1e-3, spread evenly, that must be seen.
SUM_ERROR = 1e-4

# A density that is larger by this where samples are than at all points of the patch
# shows a lobe that was missed.
MISSED = 3.0

# Of adaptive integrals: relative error of a patch, how many times its estimate kinks
# may hide (see there), and evaluations for each sample.
REL_ERR = 1e-3
HIDDEN = 2
EVALUATIONS = 4
LEAST_EVALUATIONS = 2**21


@dataclass(frozen=True)
class Integrals:
    """What a function sends into each patch, and how well that is known.

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

    values: np.ndarray
    bound: np.ndarray
    std_err: np.ndarray
    sum_bound: float

    @staticmethod
    def mean(several):
        """Mean of several, whose errors may go together."""
        columns = zip(*((x.values, x.bound, x.std_err, x.sum_bound) for x in several))
        return Integrals(*(np.mean(column, axis=0) for column in columns))


def integrals(probe, subdivision, totals):
    """Integrals of ``pdf`` and of each channel of ``eval``.

    Parameters
    ----------
    probe : Probe
    subdivision : Subdivision
    totals : Totals
        Samples that are to be compared with them.

    Returns
    -------
    list of Integrals
        The first is of ``pdf``.

    Raises
    ------
    SpecimenError
        If they do not converge.
    """
    found = _lattice(probe, subdivision, totals)
    return found or _adaptive(probe, subdivision, totals)


# --------------------------------------------------------------------------- lattices


def _lattice(probe, subdivision, totals):
    """Integrals by shifted lattices; None where that takes too many points."""
    m = 2 * subdivision.n_patches
    means, largest = None, np.zeros(m)
    refined, rough = np.arange(m), np.ones(m, bool)
    left = _most_evaluations(totals) // 2
    for n_points, generator in LATTICES:
        left -= len(refined) * SHIFTS * n_points
        if left < 0:
            break
        wo = _points(probe.condition, subdivision, refined, n_points, generator)
        values = np.stack(_values(probe, wo), axis=-1)
        values = values.reshape(len(refined), SHIFTS, n_points, -1)
        if means is None:
            means = np.zeros((m, SHIFTS, values.shape[-1]))
        area = subdivision.solid_angles.ravel()[refined % subdivision.n_patches]
        means[refined] = values.mean(axis=2) * area[:, None, None]
        largest[refined] = values[..., 0].max(axis=(1, 2))
        rough = _rough(means, totals) | (totals.peaks > MISSED * largest)
        refined = np.flatnonzero(rough | _rough_in_sum(means))
        if not refined.size:
            break
    # how well the sum is known, it says itself
    return None if rough.any() else _of_means(means)


def _rough(means, totals):
    """Patches that must be known better for the samples to judge."""
    values, n = means.mean(axis=1), totals.n
    std_err = means.std(axis=1, ddof=1) / np.sqrt(SHIFTS)
    noise = np.sqrt(np.maximum(values[:, 0], 1 / n) / n)
    weight_noise = np.sqrt(np.maximum(totals.squares, totals.usual_weight**2)) / n
    rough = std_err[:, 0] > SHARE * noise
    return rough | (std_err[:, 1:].mean(axis=1) > SHARE * weight_noise)


def _rough_in_sum(means):
    """Patches that have more than their part of the variance of a rough sum."""
    values = means.mean(axis=1)
    std_err = means.std(axis=1, ddof=1) / np.sqrt(SHIFTS)
    allowed = SUM_ERROR * np.maximum(values.sum(axis=0), 1)
    off = WIDE * means.sum(axis=0).std(axis=0, ddof=1) / np.sqrt(SHIFTS) > allowed
    return np.any((std_err * np.sqrt(len(means)) * WIDE > allowed) & off, axis=1)


def _of_means(means):
    """Integrals from those of each shift, shape (2 n_patches, SHIFTS, functions)."""
    errors = means.std(axis=1, ddof=1) / np.sqrt(SHIFTS)
    sum_errors = means.sum(axis=0).std(axis=0, ddof=1) / np.sqrt(SHIFTS)
    nothing = np.zeros(len(means))
    return [
        Integrals(values, nothing, std_err, float(WIDE * sum_error))
        for values, std_err, sum_error in zip(
            means.mean(axis=1).T, errors.T, sum_errors
        )
    ]


def _points(condition, subdivision, patches, n_points, generator):
    """Directions, shape (n, 3): lattices on some patches, uniform over solid angle."""
    lattice = np.arange(n_points)[:, None] * [1, generator] / n_points
    # always the same, so that an integral does not depend on the seed
    shifts = np.random.default_rng(n_points).random((len(patches), SHIFTS, 1, 2))
    # folded, so that values need not agree on opposite borders of a patch
    u = np.abs(2 * ((lattice + shifts) % 1) - 1)
    half, patch = np.divmod(patches, subdivision.n_patches)
    ring, sector = np.divmod(patch, subdivision.n_phi)
    cosines = np.cos(subdivision.theta_edges)
    first, last = (cosines[ring + k][:, None, None] for k in (0, 1))
    begin, end = (subdivision.phi_edges[sector + k][:, None, None] for k in (0, 1))
    z = first + (last - first) * u[..., 0]
    wo = direction(np.arccos(z), begin + (end - begin) * u[..., 1])
    face = 1 if condition.side == "front" else -1
    wo[..., 2] *= np.where(half, -face, face)[:, None, None]
    return wo.reshape(-1, 3)


def _values(probe, wo):
    """Arrays of ``pdf`` and of each channel of ``eval`` towards `wo`."""
    n = len(wo)
    values = _finite_values(probe, mi.Vector3f(np.ascontiguousarray(wo.T)))
    return [np.broadcast_to(value.numpy(), n).astype(float) for value in values]


def _finite_values(probe, wo):
    """The same for Dr.Jit; what is not finite has a property of its own."""
    pdf, value = probe.pdf(wo), probe.eval(wo)
    return [dr.select(dr.isfinite(x), x, 0.0) for x in (pdf, *value)]


# --------------------------------------------------------------------------- adaptive


def _adaptive(probe, subdivision, totals):
    """Integrals by cells that are split where that changes something."""
    condition = probe.condition
    found = integrate(
        _Integrand(probe, _most_evaluations(totals)),
        condition.theta_i,
        condition.phi_i,
        subdivision,
        rel_err=REL_ERR,
        side=condition.side,
    )
    flux = found.flux.reshape(2 * subdivision.n_patches, -1)
    error = HIDDEN * found.error.reshape(flux.shape)
    nothing = np.zeros(len(flux))
    return [
        Integrals(flux[:, c], error[:, c], nothing, float(error[:, c].sum()))
        for c in range(flux.shape[1])
    ]


def _most_evaluations(totals):
    """After which we give up."""
    return max(EVALUATIONS * totals.n, LEAST_EVALUATIONS)


class _Integrand:
    """A BSDF to :func:`integrate`, whose channels are its density and its values."""

    def __init__(self, probe, most):
        self.probe, self.left = probe, most

    def class_name(self):
        """Return the name of the BSDF."""
        return self.probe.bsdf.class_name()

    def sample(self, _, si, sample1, sample2):
        """Return record and weight."""
        del si
        one = self.probe.sample(sample1, sample2)
        return one.bs, one.weight

    def eval(self, _, si, wo):
        """Return all channels, as long as there are evaluations left."""
        del si
        self.left -= dr.width(wo)
        if self.left < 0:
            raise SpecimenError("the integral takes too many evaluations")
        return _finite_values(self.probe, wo)
