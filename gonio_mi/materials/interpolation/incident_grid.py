"""Incident directions of a record as polar angles times azimuths.

Whether lobes turn with the azimuth of incidence, or keep their micro-normals, is
cross-validated where a record lies between two others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...array_types import Flags, Floats, Integers
from ...collector import RingsAndSectors, Subdivision
from ...collector.directions import direction
from ...errors import SettingError
from ...results.azimuth_symmetry import AzimuthSymmetry, Motion, symmetry_of
from ...results.patch_means import PatchMeans
from ...results.record import Record
from .half_vectors import predicted_lobes

# Records that are predicted from their neighbours; azimuths below which none is.
MAX_TRIALS, MIN_AZIMUTHS = 4, 4

# Refractive indices that are tried, relative to what Snell's law makes of the mean of
# the transmitted flux; so near to 1 no refraction can be distinguished.
INDEX_FACTORS, MIN_BENDING = (0.9, 1.0, 1.1), 0.05


def azimuth_gaps(phi_i: Floats) -> tuple[float, float]:
    """How far the second of three azimuths is past the first and before the third."""
    return float((phi_i[1] - phi_i[0]) % 360), float((phi_i[2] - phi_i[1]) % 360)


def tried_indices(
    flux: Floats, theta_i: Floats, phi_i: Floats, patches: RingsAndSectors
) -> list[float]:
    """Refractive indices to try: near that of Snell's law for the mean direction.

    Parameters
    ----------
    flux : ndarray, shape (n, n_theta, n_phi)
        Transmitted flux fractions.
    theta_i, phi_i : ndarray, shape (n,)
        In degrees.
    patches : RingsAndSectors
    """
    middles = patches.points(1)[:, 0, :2].reshape(*flux.shape[1:], 2)
    sines = means = 0.0
    for lobe, theta, phi in zip(flux, np.radians(theta_i), np.radians(phi_i)):
        away = -(middles @ np.array([np.cos(phi), np.sin(phi)]))
        means += float((lobe * away).sum())
        sines += float(np.sin(theta) * lobe.sum())
    if not (means > 0 and sines > 0):  # it goes back, or came along the normal alone
        return []
    tried = [sines / means * factor for factor in INDEX_FACTORS]
    return [eta for eta in tried if abs(eta - 1) > MIN_BENDING]


@dataclass(frozen=True)
class _Trial:
    """A record between two others at one polar angle: their numbers in the stack."""

    theta_i: float
    phi_i: Floats
    numbers: list[int]


class AzimuthCrossValidation:
    """Lobes predicted in both ways: as they turn, and by micro-normals that stay.

    Parameters
    ----------
    theta_i, phi_i : ndarray, shapes (N,), (P,)
        In degrees, ascending; polar angles without the normal.
    index : ndarray of int, shape (P, N)
        Of the stack; -1 for none.
    patches : RingsAndSectors
    """

    def __init__(
        self, theta_i: Floats, phi_i: Floats, index: Integers, patches: RingsAndSectors
    ) -> None:
        self.theta_i, self.phi_i, self.index = theta_i, phi_i, index
        self.patches = patches
        trials = []
        for angle, theta in enumerate(theta_i.tolist()):
            known = np.flatnonzero(index[:, angle] >= 0)
            if len(known) >= MIN_AZIMUTHS:
                ways = zip(np.roll(known, 1), known, np.roll(known, -1))
                trials += [(angle, theta, list(one)) for one in ways]
        chosen = np.unique(np.linspace(0, len(trials) - 1, MAX_TRIALS, dtype=int))
        self.trials = [
            _Trial(theta, phi_i[of], index[of, angle].tolist())
            for angle, theta, of in (trials[n] for n in (chosen if trials else []))
        ]

    def index_of_refraction(self, flux: Floats) -> float | None:
        """That by which micro-normals predict transmitted lobes better, or None.

        Near what Snell's law gives for the mean of all flux, relative to the side of
        incidence: that which predicts a record best.
        """
        azimuth, angle = np.nonzero(self.index >= 0)
        known = flux[self.index[azimuth, angle]].sum(axis=-1)
        incidents = self.theta_i[angle], self.phi_i[azimuth]
        tried = tried_indices(known, *incidents, self.patches)
        if not (tried and self.trials):
            return None
        middle = self.trials[len(self.trials) // 2]
        eta = min(tried, key=lambda one: self._errors(flux, one, middle)[1])
        return eta if self.are_better(flux, eta) else None

    def are_better(self, flux: Floats, eta: float | None = None) -> bool:
        """Whether micro-normals predict lobes better, of transmission with an `eta`.

        `flux` has the shape ``(n, n_theta, n_phi, channels)``, as that of the stack.
        """
        wrong = [self._errors(flux, eta, one) for one in self.trials]
        turned, moved = np.sum(wrong, axis=0) if wrong else (0.0, 0.0)
        return bool(moved < turned)

    def _errors(self, flux: Floats, eta: float | None, trial: _Trial) -> Floats:
        """Sums of absolute errors of the flux: if lobes turn, and if normals stay."""
        low, known, high = flux[trial.numbers].mean(axis=-1, keepdims=True)
        theta_i, (first, own, other) = trial.theta_i, trial.phi_i.tolist()
        past, left = azimuth_gaps(trial.phi_i)
        of_low, of_high = (
            np.stack(predicted_lobes(lobe, self.patches, theta_i, (phi, own), eta))
            for lobe, phi in ((low, first), (high, other))
        )
        mixed = (left * of_low + past * of_high) / (past + left)
        errors: Floats = np.abs(mixed - known).sum(axis=(1, 2, 3))
        return errors


# ----------------------------------------------------------------------------- the grid

# Gaps between azimuths of incidence that may be bridged, in degrees.
MAX_GAP = 120

# Angles of incidence that differ by less are the same, in degrees.
ANGLE_TOLERANCE = 1e-3

# Of azimuths in degrees that are compared after means over many were taken.
AZIMUTH_DIGITS = 6


@dataclass(frozen=True, eq=False)
class IncidentGrid:
    """``P`` azimuths x ``N`` polar angles of incidence of a record.

    Attributes
    ----------
    theta_i, phi_i : ndarray, shapes (N,), (P,)
        In degrees, ascending.
    index : ndarray of int, shape (P, N)
        Which of the stack was measured there; -1 for none. Along the normal it is the
        first of all that were.
    normal : ndarray of bool
        Of the stack, which were measured along the normal.
    patches : Subdivision
    reflects : bool
        Whether between azimuths reflected light moves by :mod:`.half_vectors`, as
        records say that are predicted from their neighbours; else lobes turn with
        incidence.
    eta : float, optional
        The same for transmitted light, with this refractive index of the other side.
    symmetry : AzimuthSymmetry, optional
        By which a campaign copied directions.
    incident : Subdivision, optional
        Patches of incidence instead of azimuths and angles: the second axis of `index`
        is their number, `theta_i` are their middles, and there is one azimuth, 0.
    isotropic : bool
        Whether one azimuth is all that the record has, of directions.
    """

    theta_i: Floats
    phi_i: Floats
    index: Integers
    normal: Flags
    patches: Subdivision
    reflects: bool
    eta: float | None = None
    symmetry: AzimuthSymmetry | None = None
    incident: Subdivision | None = None
    isotropic: bool = False

    @classmethod
    def of(cls, record: Record | PatchMeans, flux: Floats) -> IncidentGrid:
        """Grid of a record, whose stack has these flux fractions.

        Raises
        ------
        ValueError
            If the incident directions are unknown, no grid, or too far apart in
            azimuth.
        """
        if not np.isfinite([record.theta_i, record.phi_i]).all():
            raise SettingError("the record must know its incident directions, got NaN")
        incident = patches_of_incidence(record)
        if incident is not None:
            order = np.argsort(_incident_patch(record, incident))
            theta_i, none = record.theta_i[order], np.zeros(len(order), bool)
            axes = theta_i, np.zeros(1), order[None], none
            return cls(*axes, record.subdivision, reflects=False, incident=incident)
        theta_i, of_theta = _levels(record.theta_i)
        # along the normal there is no azimuth: what was measured there is for all
        normal = (of_theta == 0) & (theta_i[0] < ANGLE_TOLERANCE)
        turned = np.mod(record.phi_i + ANGLE_TOLERANCE / 2, 360) - ANGLE_TOLERANCE / 2
        phi_i, of_phi = _levels(turned if normal.all() else turned[~normal])
        grid = np.full((len(phi_i), len(theta_i)), -1)
        index = np.flatnonzero(~normal)
        if len(index):
            grid[of_phi, of_theta[index]] = index
        begin = int(normal.any())
        tilted = grid[:, begin:]
        if np.count_nonzero(tilted >= 0) != len(index) or not _is_filled(
            tilted, phi_i, record.subdivision
        ):
            raise SettingError(
                f"the record's {len(flux)} incident directions must be each of its "
                f"{len(theta_i)} polar angles at each of its {len(phi_i)} azimuths, "
                "once; or azimuths that are whole sectors apart"
            )
        # between azimuths of each polar angle, all around
        some = [phi_i[of_angle >= 0] for of_angle in tilted.T]
        widest = max((np.diff([*x, x[0] + 360]).max() for x in some), default=0)
        if len(phi_i) > 1 and widest > MAX_GAP:
            raise SettingError(
                "the azimuths of incidence of an anisotropic record must go all "
                f"around, with gaps of at most {MAX_GAP} degrees, got one of "
                f"{widest:g}"
            )
        first = np.flatnonzero(normal)[:1]
        if len(first):
            grid[:, 0] = first
        one = len(phi_i) == 1
        axes = theta_i, phi_i, grid, normal
        found = cls(*axes, record.subdivision, reflects=False, isotropic=one)
        if not isinstance(found.patches, RingsAndSectors) or one:
            return found
        trials = AzimuthCrossValidation(theta_i[begin:], phi_i, tilted, found.patches)
        lower = flux.shape[1] > 1
        return replace(
            found,
            reflects=trials.are_better(flux[:, 0]),
            eta=trials.index_of_refraction(flux[:, 1]) if lower else None,
            symmetry=symmetry_of(record) if isinstance(record, Record) else None,
        )

    def filled(
        self,
        values: Floats,
        azimuths: Sequence[int] | None = None,
        angles: Sequence[int] | None = None,
    ) -> Floats:
        """Values of the stack at azimuths and angles, all of them unless some are said.

        Shape ``(P, N, ...)``. What was not measured is filled in: lobes
        ``(H, n_theta, n_phi, channels)`` as they would be looked up, and totals of them
        by what is between the neighbours.
        """
        azimuths = range(len(self.phi_i)) if azimuths is None else azimuths
        angles = range(len(self.theta_i)) if angles is None else angles
        lobes = np.empty((len(azimuths), len(angles), *values.shape[1:]))
        for column, angle in enumerate(angles):
            if angle == 0 and self.normal.any():
                lobes[:, column] = values[self.normal].mean(axis=0)
                continue
            self._fill(lobes[:, column], values, azimuths, angle)
        return lobes

    def _fill(
        self, lobes: Floats, values: Floats, azimuths: Sequence[int], angle: int
    ) -> None:
        """Fill in one polar angle; images of what was found there are not sought."""
        motions = self.symmetry.motions if self.symmetry and values.ndim == 5 else []
        images: dict[float, tuple[int, Motion]] = {}
        for row, azimuth in enumerate(azimuths):
            phi_i = float(self.phi_i[azimuth])
            source, motion = images.get(round(phi_i, AZIMUTH_DIGITS), (None, None))
            if motion is not None and self.index[azimuth, angle] < 0:
                lobes[row] = motion.moved(lobes[source], 2)
                continue
            lobes[row] = self._filled(values, azimuth, angle)
            if self.index[azimuth, angle] < 0:
                found = [(one.azimuth(phi_i), (row, one)) for one in motions]
                images |= {round(phi, AZIMUTH_DIGITS): where for phi, where in found}

    def _filled(self, values: Floats, azimuth: int, angle: int) -> Floats:
        """Values at one direction; where it was not measured, of what is around it.

        That is the two neighbours, turned with incidence by whole sectors, or with
        their micro-normals where they are, and mixed.
        """
        column = self.index[:, angle]
        if column[azimuth] >= 0:
            measured: Floats = values[column[azimuth]]
            return measured
        known = np.flatnonzero(column >= 0)
        last = np.searchsorted(known, azimuth) - 1
        ends = int(known[last]), int(known[(last + 1) % len(known)])
        past, left = azimuth_gaps(self.phi_i[[ends[0], azimuth, ends[1]]])
        low, high = values[column[list(ends)]]
        if values.ndim == 5:
            low = self._sent(low, angle, ends[0], azimuth)
            high = self._sent(high, angle, ends[1], azimuth)
        mixed: Floats = (left * low + past * high) / (past + left)
        return mixed

    def part(self, azimuths: Sequence[int], angles: Sequence[int]) -> IncidentGrid:
        """Grid of some azimuths and polar angles, ascending, between which it moves."""
        some, few = list(azimuths), list(angles)
        return replace(
            self,
            theta_i=self.theta_i[few],
            phi_i=self.phi_i[some],
            index=self.index[np.ix_(some, few)],
        )

    def around(
        self, theta_i: float, phi_i: float
    ) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Azimuths and polar angles of the records that make the lobe of a direction.

        Numbers, ascending: one or two of either.
        """
        n_azimuths, n_angles = self.index.shape
        low = int(np.searchsorted(self.theta_i, theta_i, side="right")) - 1
        low = min(max(low, 0), max(n_angles - 2, 0))
        angles = tuple(range(low, min(low + 2, n_angles)))
        past = int(np.searchsorted(self.phi_i, phi_i % 360, side="right")) - 1
        ends = {past % n_azimuths, (past + 1) % n_azimuths}
        return tuple(sorted(ends)), angles

    def _sent(self, lobes: Floats, angle: int, end: int, azimuth: int) -> Floats:
        """Lobes of one azimuth for another one, shape ``(H, n_theta, n_phi, ...)``."""
        phi_i = float(self.phi_i[end]), float(self.phi_i[azimuth])
        sectors = round((phi_i[1] - phi_i[0]) * lobes.shape[2] / 360)
        moved, patches, theta_i = np.roll(lobes, sectors, 2), self.patches, self.theta_i
        for number, lobe in enumerate(lobes):
            if self.moves(number) and isinstance(patches, RingsAndSectors):
                eta = self.eta if number else None
                moved[number] = predicted_lobes(
                    lobe, patches, theta_i[angle], phi_i, eta
                )[1]
        return moved

    def moves(self, hemisphere: int) -> bool:
        """Whether light moves between azimuths by its micro-normals."""
        return self.eta is not None if hemisphere else self.reflects


def patches_of_incidence(record: Record | PatchMeans) -> Subdivision | None:
    """Patches of incidence, each of which has its own lobes; None for directions.

    Those of a matrix of patches, or of a record whose light filled patches that are no
    rings of equal sectors, and so no azimuths and angles to interpolate between.
    """
    if isinstance(record, PatchMeans):
        return record.incident
    incident = record.asked.incident
    if incident is None or isinstance(incident, RingsAndSectors):
        return None
    filled = np.sort(_incident_patch(record, incident))
    is_whole = np.array_equal(filled, np.arange(incident.n_patches))
    return incident if is_whole else None


def _incident_patch(record: Record | PatchMeans, incident: Subdivision) -> Integers:
    """Patch of incidence of each of the stack."""
    towards = direction(np.radians(record.theta_i), np.radians(record.phi_i))
    return incident.patch(towards)


def _is_filled(grid: Integers, phi_i: Floats, patches: Subdivision) -> bool:
    """Whether each angle has all azimuths, or can get them by turns of whole sectors.

    `grid` holds the record of each azimuth and angle, -1 for none.
    """
    if (grid >= 0).all():
        return True
    edges = np.degrees(getattr(patches, "phi_edges", np.zeros(1)))
    n = len(edges) - 1
    if not np.allclose(np.diff(edges), 360 / max(n, 1), atol=ANGLE_TOLERANCE):
        return False
    sectors = (phi_i - phi_i[0]) * n / 360
    whole = np.abs(sectors - np.round(sectors)) * 360 < ANGLE_TOLERANCE * n
    return bool(whole.all() and (grid >= 0).any(axis=0).all())


def _levels(angles: Floats) -> tuple[Floats, Integers]:
    """Distinct angles in degrees, ascending, and the number of each angle's.

    They come from directions in single precision.
    """
    order = np.argsort(angles, kind="stable")
    steps = np.diff(angles[order], prepend=angles[order[0]]) > ANGLE_TOLERANCE
    number = np.empty(len(angles), dtype=int)
    number[order] = np.cumsum(steps)
    levels = [angles[number == n].mean() for n in range(number.max() + 1)]
    return np.array(levels), number
