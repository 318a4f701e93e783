"""Incident directions of a record as polar angles times azimuths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..collector import RingsAndSectors, Subdivision
from ..errors import SettingError
from ..formats.scatter import PatchMeans
from ..results.azimuth_symmetry import AzimuthSymmetry, Motion, symmetry_of
from ..results.record import Record
from .azimuth_cross_validation import AzimuthCrossValidation, azimuth_gaps
from .half_vectors import predicted_lobes

Floats = NDArray[np.float64]

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
    """

    theta_i: Floats
    phi_i: Floats
    index: NDArray[np.int64]
    normal: NDArray[np.bool_]
    patches: Subdivision
    reflects: bool
    eta: float | None = None
    symmetry: AzimuthSymmetry | None = None

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
        theta_i, of_theta = _levels(record.theta_i)
        # along the normal there is no azimuth: what was measured there is for all
        normal = (of_theta == 0) & (theta_i[0] < ANGLE_TOLERANCE)
        turned = np.mod(record.phi_i + ANGLE_TOLERANCE / 2, 360) - ANGLE_TOLERANCE / 2
        phi_i, of_phi = _levels(turned if normal.all() else turned[~normal])
        grid = np.full((len(phi_i), len(theta_i)), -1)
        index = np.flatnonzero(~normal)
        if len(index):
            grid[of_phi, of_theta[index]] = index
        tilted = grid[:, int(normal.any()) :]
        if np.count_nonzero(tilted >= 0) != len(index) or not _is_filled(
            tilted, phi_i, record.subdivision
        ):
            raise SettingError(
                f"the record's {len(flux)} incident directions must be each of its "
                f"{len(theta_i)} polar angles at each of its {len(phi_i)} azimuths, "
                "once; or azimuths that are whole sectors apart"
            )
        gaps = [_widest(phi_i[of_angle >= 0]) for of_angle in tilted.T]
        widest = max(gaps, default=0)
        if len(phi_i) > 1 and widest > MAX_GAP:
            raise SettingError(
                "the azimuths of incidence of an anisotropic record must go all "
                f"around, with gaps of at most {MAX_GAP} degrees, got one of "
                f"{widest:g}"
            )
        first = np.flatnonzero(normal)[:1]
        if len(first):
            grid[:, 0] = first
        found = cls(theta_i, phi_i, grid, normal, record.subdivision, False)
        if not isinstance(found.patches, RingsAndSectors) or len(phi_i) == 1:
            return found
        begin = int(normal.any())
        trials = AzimuthCrossValidation(
            theta_i[begin:], phi_i, grid[:, begin:], found.patches
        )
        lower = flux.shape[1] > 1
        return replace(
            found,
            reflects=trials.reflects(flux[:, 0]),
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


def _is_filled(grid: NDArray[np.int64], phi_i: Floats, patches: Subdivision) -> bool:
    """Whether each angle has all azimuths, or can get them by turns of whole sectors.

    `grid` holds the record of each azimuth and angle, -1 for none.
    """
    if (grid >= 0).all():
        return True
    edges = np.degrees(getattr(patches, "phi_edges", np.zeros(1)))
    if not np.allclose(
        np.diff(edges), 360 / max(len(edges) - 1, 1), atol=ANGLE_TOLERANCE
    ):
        return False
    sectors = (phi_i - phi_i[0]) * (len(edges) - 1) / 360
    whole = np.abs(sectors - np.round(sectors)) * 360 < ANGLE_TOLERANCE * (
        len(edges) - 1
    )
    return bool(whole.all() and (grid >= 0).any(axis=0).all())


def _widest(phi_i: Floats) -> float:
    """Widest gap between ascending azimuths, all around, in degrees."""
    return float(np.diff([*phi_i, phi_i[0] + 360]).max())


def _levels(
    angles: Floats,
) -> tuple[Floats, NDArray[np.int64]]:
    """Distinct angles in degrees, ascending, and the number of each angle's.

    They come from directions in single precision.
    """
    order = np.argsort(angles, kind="stable")
    steps = np.diff(angles[order], prepend=angles[order[0]]) > ANGLE_TOLERANCE
    number = np.empty(len(angles), dtype=int)
    number[order] = np.cumsum(steps)
    levels = [angles[number == n].mean() for n in range(number.max() + 1)]
    return np.array(levels), number
