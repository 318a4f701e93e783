"""Whether patches resolve the lobes of a specimen, and which would."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from ..array_types import Floats
from ..collector import EqualAngle, RingsAndSectors, Subdivision
from ..errors import SettingError, SpecimenError
from ..results.prediction_error import prediction_error
from ..results.record import Record
from .prediction import SPARED, Prediction

__all__ = [
    "TooCoarseError",
    "check_equal_sectors",
    "check_peaks",
    "check_resolved",
    "delta_share",
]

# By which power of their width finer patches are better, where they nearly resolve a
# lobe, and up to which part of the light in the wrong place they do; above which part
# the finest patches of all are tried before those in between.
ORDER, NEARLY, FAR = 1.7, 0.05, 0.4

# Part of what coarse patches lose that fine ones lose of mirrors too; of the rough
# conductor 0.1 on 6x16 patches half is left after one doubling.
LIKE_MIRRORS = 3 / 4

# Part of the tolerance that patches may take of it.
SHARE = 1 / 2

# Patches of a collector that is tried to find the one that would do.
MOST_PATCHES = 10**5

Incident = tuple[float, float]
# A peak that no patches resolve holds so many times the light of any patch beside it,
# of the finest, and at least so much of all: of a Gaussian lobe in the middle of a
# patch, where its standard deviation is about a third of the patch.
STANDS_OUT, LEAST_PEAK = 10, 1e-3

# What to do where no patches resolve the lobes.
INSTEAD = "name angles (theta_i) instead of a tolerance"

Records = Callable[[Sequence[Incident], Subdivision | None], Record]


class TooCoarseError(SpecimenError):
    """Patches that do not resolve the lobes, where `enough` would."""

    def __init__(self, sentence: str, enough: EqualAngle) -> None:
        super().__init__(sentence)
        self.enough = enough


def check_equal_sectors(patches: Subdivision) -> None:
    """Raise ValueError unless patches are of rings of equal sectors, at least eight."""
    edges = patches.phi_edges if isinstance(patches, RingsAndSectors) else np.zeros(2)
    if len(edges) < 9 or not np.allclose(np.diff(edges), edges[-1] / (len(edges) - 1)):
        raise SettingError(
            "tolerance needs a collector of rings with at least 8 equal sectors, such "
            f"as projected:30x90, got {patches!s:.60}"
        )


def check_resolved(
    tolerance: float,
    n_points: int,
    angles: Sequence[float],
    records: Records,
    phi_i: float = 0.0,
) -> None:
    """Raise SpecimenError if patches are too coarse to say what is between directions.

    Where they are, and more of the light than the tolerance is in delta lobes, no
    others would do either. Otherwise a :class:`TooCoarseError` names a collector that
    would, from what finer ones would measure: of equal steps of angle, which resolve
    lobes at grazing incidence with the fewest patches.

    Parameters
    ----------
    tolerance : float
    n_points : int
        Points per side of a patch.
    angles : sequence of float
        Of incidence in degrees, where it is looked at.
    records : callable
        Stack of incident directions in degrees, with another collector if one is given.
    phi_i : float
        Azimuth in degrees, where it is looked at.
    """
    incidents = [(theta_i, phi_i) for theta_i in angles]
    first = records(incidents, None)
    asked = patches = first.subdivision
    lost_at = partial(_lost, tolerance, n_points, records)
    lost = at_first = lost_at(incidents, patches, own=True)
    if max(lost) <= tolerance:
        return
    _check_delta(tolerance, first, max(angles))
    said = (
        f"the lobes of {first.provenance.name:.60} are too narrow for "
        f"{asked!s:.40}: moved by half a patch, {max(at_first):.2g} of the light would "
        f"be in the wrong place at an angle up to {max(angles):.3g}"
    )
    nearly = max(NEARLY, tolerance)
    if max(lost) > FAR and min(lost) > nearly:
        # rings and sectors would be doubled each time, for mirrors to the end
        finest = _finest(patches)
        of_finest = lost_at(incidents[:1], finest)
        if min(of_finest) > nearly:
            patches, lost = finest, of_finest
    while max(lost) > nearly:
        sizes = [n * (1 + (one > nearly)) for n, one in zip(patches.shape, lost)]
        if math.prod(sizes) > MOST_PATCHES:
            mirrors = max(lost) > LIKE_MIRRORS * max(at_first)
            as_of = ", as of smooth mirrors" if mirrors else ""
            raise SpecimenError(
                f"{said}, and {max(lost):.2g} with {patches!s:.40}{as_of}; {INSTEAD}"
            )
        patches = EqualAngle(*sizes)
        lost = lost_at(incidents, patches)
    factors = [max(1.0, (one / (SHARE * tolerance)) ** (1 / ORDER)) for one in lost]
    sizes = [math.ceil(n * f / 4) * 4 for n, f in zip(patches.shape, factors)]
    enough = EqualAngle(*sizes)
    raise TooCoarseError(
        f"{said}; take a smaller theta_max or a collector such as {enough}", enough
    )


def check_peaks(tolerance: float, theta_i: float, probe: Callable[..., Record]) -> None:
    """Raise SpecimenError for more light than two tolerances in unresolvable peaks.

    Moved by half a patch, half of it would be in the wrong place. Rays through geometry
    do not tell whether they met delta components only: their light is looked at in the
    finest patches.

    Parameters
    ----------
    tolerance : float
    theta_i : float
        Angle of incidence in degrees, where mirrors are brightest: the largest.
    probe : callable
        Record of a few rays from a direction, with another collector if one is given.
    """
    own = probe((theta_i, 0.0)).subdivision
    check_equal_sectors(own)
    finest = _finest(own)
    # the mirror image is in the middle of a patch
    edges = np.degrees(finest.theta_edges)
    ring = int(np.searchsorted(edges, theta_i).clip(1, len(edges) - 1))
    middle = float(edges[ring - 1 : ring + 1].mean())
    record = probe((middle, 180 + 180 / finest.n_phi), finest)
    share = _peak_share(record)
    if share > 2 * tolerance:
        raise _delta_error(share, record, theta_i)


def _peak_share(record: Record) -> float:
    """Part of the light of one incident direction that stands out of its patches."""
    flux = record.flux_fraction.sum(axis=-1)
    total = flux.sum()
    stands_out = flux > np.maximum(STANDS_OUT * _beside(flux), LEAST_PEAK * total)
    return float(flux[stands_out].sum() / total) if total > 0 else 0.0


def _check_delta(tolerance: float, record: Record, theta_i: float) -> None:
    """Raise SpecimenError for more of the light than the tolerance in delta lobes."""
    delta = max(map(delta_share, (record[number] for number in range(len(record)))))
    if delta > tolerance:
        raise _delta_error(delta, record, theta_i)


def _delta_error(share: float, record: Record, theta_i: float) -> SpecimenError:
    """Error for a share of the light in delta lobes."""
    window = "make a window file of it (gonio-mi bsdf)"
    other = window if record.has_lower and np.any(record.dht) else "take a rough BSDF"
    return SpecimenError(
        f"{share:.2g} of the light of {record.provenance.name:.60} leaves in "
        "delta lobes (mirror images, or straight on) at an angle up to "
        f"{theta_i:.3g}, and no patches tell where these are between directions: "
        f"{INSTEAD}, or {other}"
    )


def _finest(patches: Subdivision) -> EqualAngle:
    """Patches whose rings and sectors are doubled as often as may be."""
    doublings = max(int(math.log(MOST_PATCHES / patches.n_patches, 4)), 0)
    return EqualAngle(*(n << doublings for n in patches.shape))


def delta_share(record: Record) -> float:
    """Part of the light of one incident direction that is seen to be in delta lobes.

    What passed openings straight on; and beside integrals what was sampled, of which
    patches hold more than those around them.
    """
    total = record.flux_fraction.sum()
    delta = record.direct.sum()
    if record.asked.estimator.integrates:
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
    tolerance: float,
    n_points: int,
    records: Records,
    looked_at: Sequence[Incident],
    patches: Subdivision,
    own: bool = False,
) -> tuple[float, ...]:
    """Light in the wrong place where only the patches are in the way: at the worst.

    By rings and by sectors: lobes are moved by half a ring, and by half a sector, from
    directions next to them. `own`: whether records have these patches anyway.
    """
    moved = [_moved(*incident, patches) for incident in looked_at]
    every = {
        incident
        for both in moved
        for to, stacks in both
        for incident in itertools.chain([to], *stacks)
    }
    incidents = sorted(every)
    record = records(incidents, None if own else patches)
    known = {one: record[number] for number, one in enumerate(incidents)}

    def lost_by(to: Incident, stacks: Sequence[Sequence[Incident]]) -> float:
        """Light in the wrong place in a direction, as the mean of `stacks` tells."""
        around = [Record.stack(known[one] for one in stack) for stack in stacks]
        ways = [Prediction(one, n_points, SPARED * tolerance) for one in around]
        error = prediction_error(
            known[to], np.mean([one.flux(*to) for one in ways], axis=0)
        )
        return max(error.total_variation - 2 * error.std_err, 0.0)

    each = [[lost_by(to, stacks) for to, stacks in both] for both in moved]
    return tuple(map(max, zip(*each)))


def _moved(
    theta_i: float, phi_i: float, patches: Any
) -> list[tuple[Incident, list[list[Incident]]]]:
    """Directions half a ring and half a sector from one, in degrees.

    Each with the stacks that predict it, of whose predictions the mean is taken.
    """
    edges = np.degrees(patches.theta_edges)
    ring = int(np.searchsorted(edges, theta_i).clip(1, len(edges) - 1))
    width = min(float(edges[ring] - edges[ring - 1]), theta_i)
    sector = 360 / patches.shape[1]
    start = theta_i, phi_i
    return [
        ((theta_i - width / 2, phi_i), [[(theta_i - width, phi_i), start]]),
        ((theta_i, phi_i + sector / 2), [[start], [(theta_i, phi_i + sector)]]),
    ]
