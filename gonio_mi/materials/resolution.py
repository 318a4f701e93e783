"""Whether patches resolve the lobes of a specimen, and which would."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from ..array_types import Floats
from ..collector import EqualAngle, RingsAndSectors, Subdivision
from ..errors import LABEL, SettingError, SpecimenError, abridged
from ..results.prediction_error import prediction_error
from ..results.record import Record
from ..results.tally import holds_integrals
from .measured_directions import MeasuredDirections
from .prediction import Prediction

# By which power of their width finer patches are better, where they nearly resolve a
# lobe, and up to which part of the light in the wrong place they do; above which part
# the finest patches of all are tried before those in between.
ORDER, NEARLY_RESOLVED, FAR_FROM_RESOLVED = 1.7, 0.05, 0.4

# Part of what coarse patches lose that fine ones lose of mirrors too; of the rough
# conductor 0.1 on 6x16 patches half is left after one doubling.
LIKE_MIRRORS = 3 / 4

# Part of the tolerance that patches may take of it.
MAX_OF_TOLERANCE = 1 / 2

# Patches of a collector that is tried to find the one that would do.
MAX_PATCHES = 10**5

Incident = tuple[float, float]
# A peak that no patches resolve holds so many times the light of any patch beside it,
# of the finest, and at least so much of all: of a Gaussian lobe in the middle of a
# patch, where its standard deviation is about a third of the patch.
STANDS_OUT, MIN_PEAK = 10, 1e-3

# What to do where no patches resolve the lobes.
INSTEAD = "name angles (theta_i) instead of a tolerance"


class TooCoarseError(SpecimenError):
    """Patches that do not resolve the lobes, where `enough` would."""

    def __init__(self, sentence: str, enough: EqualAngle) -> None:
        super().__init__(sentence)
        self.enough = enough


def checked_sectors(patches: Subdivision) -> RingsAndSectors:
    """Return patches if they are rings of eight equal sectors or more, else raise."""
    if isinstance(patches, RingsAndSectors):
        edges = patches.phi_edges
        n = len(edges) - 1
        if n >= 8 and np.allclose(np.diff(edges), edges[-1] / n):
            return patches
    raise SettingError(
        "tolerance needs a collector of rings with at least 8 equal sectors, such as "
        f"projected:30x90, got {patches!s:.60}"
    )


def check_patches_resolve(
    directions: MeasuredDirections, angles: Sequence[float], phi_i: float = 0.0
) -> None:
    """Raise SpecimenError if patches are too coarse to say what is between directions.

    Where they are, and more of the flux than the tolerance is in delta lobes, no
    others would do either. Otherwise a :class:`TooCoarseError` names a collector that
    would, from what finer ones would measure: of equal steps of angle, which resolve
    lobes at grazing incidence with the fewest patches.

    Parameters
    ----------
    directions : MeasuredDirections
    angles : sequence of float
        Of incidence in degrees, where it is looked at.
    phi_i : float
        Azimuth in degrees, where it is looked at.
    """
    tolerance = directions.tolerance
    incidents = [(theta_i, phi_i) for theta_i in angles]
    first = directions.stack(incidents)
    own = patches = first.subdivision
    lost = lost_at_first = _lost(directions, incidents)
    if max(lost) <= tolerance:
        return
    delta = max(map(delta_fraction, first))
    if delta > tolerance:
        raise _delta_error(delta, first, max(angles))
    finding = (
        f"the lobes of {abridged(first.provenance.name, LABEL)} are too narrow for "
        f"{own!s:.40}: moved by half a patch, {max(lost_at_first):.2g} of the flux "
        f"would be in other patches at an angle up to {max(angles):.3g}"
    )
    nearly = max(NEARLY_RESOLVED, tolerance)
    if max(lost) > FAR_FROM_RESOLVED and min(lost) > nearly:
        # rings and sectors would be doubled each time, for mirrors to the end
        finest = _finest(patches)
        of_finest = _lost(directions, incidents[:1], finest)
        if min(of_finest) > nearly:
            patches, lost = finest, of_finest
    while max(lost) > nearly:
        sizes = [n * 2 if one > nearly else n for n, one in zip(patches.shape, lost)]
        if math.prod(sizes) > MAX_PATCHES:
            mirrors = max(lost) > LIKE_MIRRORS * max(lost_at_first)
            as_of = ", as of smooth mirrors" if mirrors else ""
            raise SpecimenError(
                f"{finding}, and {max(lost):.2g} with {patches!s:.40}{as_of}; {INSTEAD}"
            )
        patches = EqualAngle(*sizes)
        lost = _lost(directions, incidents, patches)
    factors = [
        max(1.0, (one / (MAX_OF_TOLERANCE * tolerance)) ** (1 / ORDER)) for one in lost
    ]
    sizes = [math.ceil(n * f / 4) * 4 for n, f in zip(patches.shape, factors)]
    enough = EqualAngle(*sizes)
    raise TooCoarseError(
        f"{finding}; take a smaller theta_max or a collector such as {enough}", enough
    )


def check_peaks(directions: MeasuredDirections, theta_i: float) -> None:
    """Raise SpecimenError for more flux than two tolerances in unresolvable peaks.

    Moved by half a patch, half of it would be in other patches. Rays through geometry
    do not tell whether they met delta components only: their flux is looked at in the
    finest patches.

    Parameters
    ----------
    directions : MeasuredDirections
    theta_i : float
        Angle of incidence in degrees, where mirrors are brightest: the largest.
    """
    own = checked_sectors(directions.probe((theta_i, 0.0)).subdivision)
    finest = _finest(own)
    # the mirror image is in the middle of a patch
    middle = sum(_ring(theta_i, finest)) / 2
    record = directions.probe((middle, 180 + 180 / finest.n_phi), finest)
    flux = record.flux_fraction.sum(axis=-1)
    total = flux.sum()
    stands_out = flux > np.maximum(STANDS_OUT * _beside(flux), MIN_PEAK * total)
    fraction = float(flux[stands_out].sum() / total) if total > 0 else 0.0
    if fraction > 2 * directions.tolerance:
        raise _delta_error(fraction, record, theta_i)


def _delta_error(fraction: float, record: Record, theta_i: float) -> SpecimenError:
    """Error for a fraction of the flux in delta lobes."""
    window = "make a window file of it (gonio-mi bsdf)"
    other = window if record.has_lower and np.any(record.dht) else "take a rough BSDF"
    return SpecimenError(
        f"{fraction:.2g} of the flux of {abridged(record.provenance.name, LABEL)} "
        "leaves in delta lobes (mirror images, or straight on) at an angle up to "
        f"{theta_i:.3g}, and no patches tell where these are between directions: "
        f"{INSTEAD}, or {other}"
    )


def _finest(patches: Subdivision) -> EqualAngle:
    """Patches whose rings and sectors are doubled as often as may be."""
    doublings = max(int(math.log(MAX_PATCHES / patches.n_patches, 4)), 0)
    return EqualAngle(*(n << doublings for n in patches.shape))


def delta_fraction(record: Record) -> float:
    """Fraction of the flux of one incident direction that is seen to be in delta lobes.

    What passed openings straight on; and beside integrals what was sampled, of which
    patches hold more than those around them.
    """
    total = record.flux_fraction.sum()
    delta = record.direct.sum()
    if holds_integrals(record.tallies):
        flux = record.flux_fraction.sum(axis=-1)
        excess = np.maximum(flux - _beside(flux), 0)
        delta += excess[record.counts > 0].sum()
    return float(delta / total) if total > 0 else 0.0


def _beside(flux: Floats) -> Floats:
    """Largest of the four patches beside each; (n_hemispheres, n_theta, n_phi)."""
    outer = np.pad(flux, ((0, 0), (1, 1), (0, 0)))
    sides = [outer[:, :-2], outer[:, 2:], np.roll(flux, 1, -1), np.roll(flux, -1, -1)]
    return np.asarray(np.max(sides, axis=0))


def _lost(
    directions: MeasuredDirections,
    incidents: Sequence[Incident],
    patches: Subdivision | None = None,
) -> tuple[float, ...]:
    """Error of predictions where only the patches are in the way: the worst.

    By rings and by sectors: lobes are moved by half a ring, and by half a sector, from
    directions next to them. In other `patches` directions are measured anew.
    """
    rings = checked_sectors(directions.patches if patches is None else patches)
    moved = [_moved(*one, rings) for one in incidents]
    needed = sorted(
        {
            incident
            for both in moved
            for to, stacks in both
            for incident in itertools.chain([to], *stacks)
        }
    )
    known = dict(zip(needed, directions.stack(needed, patches)))

    def distance(to: Incident, stacks: Sequence[Sequence[Incident]]) -> float:
        """Total variation distance in a direction from the mean of `stacks`."""
        around = [Record.stack(known[one] for one in stack) for stack in stacks]
        ways = [Prediction.within(directions.tolerance, one) for one in around]
        error = prediction_error(
            known[to], np.mean([one.flux(*to) for one in ways], axis=0)
        )
        return max(error.total_variation - 2 * error.std_err, 0.0)

    each = [[distance(to, stacks) for to, stacks in both] for both in moved]
    return tuple(map(max, zip(*each)))


def _moved(
    theta_i: float, phi_i: float, patches: RingsAndSectors
) -> list[tuple[Incident, list[list[Incident]]]]:
    """Directions half a ring and half a sector from one, in degrees.

    Each with the stacks that predict it, of whose predictions the mean is taken.
    """
    low, high = _ring(theta_i, patches)
    width = min(high - low, theta_i)
    sector = 360 / patches.shape[1]
    start = theta_i, phi_i
    return [
        ((theta_i - width / 2, phi_i), [[(theta_i - width, phi_i), start]]),
        ((theta_i, phi_i + sector / 2), [[start], [(theta_i, phi_i + sector)]]),
    ]


def _ring(theta_i: float, patches: RingsAndSectors) -> tuple[float, float]:
    """Edges, in degrees, of the ring that holds a polar angle."""
    edges = np.degrees(patches.theta_edges)
    ring = int(np.searchsorted(edges, theta_i).clip(1, len(edges) - 1))
    return float(edges[ring - 1]), float(edges[ring])
