"""Whether lobes turn with the azimuth of incidence, or keep their micro-normals.

Cross-validated where a record lies between two others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import Floats, Integers
from ..collector import RingsAndSectors
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

    def reflects(self, flux: Floats) -> bool:
        """Whether micro-normals predict reflected lobes better.

        `flux` has the shape ``(n, n_theta, n_phi, channels)``, as that of the stack.
        """
        return bool(self.trials) and self._are_better(flux, None)

    def index_of_refraction(self, flux: Floats) -> float | None:
        """That by which micro-normals predict transmitted lobes better, or None.

        Near what Snell's law gives for the mean of all flux, relative to the side of
        incidence: that which predicts a record best.
        """
        if not self.trials:
            return None
        azimuth, angle = np.nonzero(self.index >= 0)
        known = flux[self.index[azimuth, angle]].sum(axis=-1)
        incidents = self.theta_i[angle], self.phi_i[azimuth]
        tried = tried_indices(known, *incidents, self.patches)
        if not tried:
            return None
        middle = self.trials[len(self.trials) // 2]
        eta = min(tried, key=lambda one: self._errors(flux, one, middle)[1])
        return eta if self._are_better(flux, eta) else None

    def _are_better(self, flux: Floats, eta: float | None) -> bool:
        wrong = np.sum([self._errors(flux, eta, one) for one in self.trials], axis=0)
        return bool(wrong[1] < wrong[0])

    def _errors(self, flux: Floats, eta: float | None, trial: _Trial) -> Floats:
        """Sums of absolute errors of the flux: if lobes turn, and if normals stay."""
        low, known, high = flux[trial.numbers].mean(axis=-1, keepdims=True)
        theta_i, (first, own, other) = trial.theta_i, trial.phi_i.tolist()
        past, left = azimuth_gaps(trial.phi_i)
        of_low = np.stack(
            predicted_lobes(low, self.patches, theta_i, (first, own), eta)
        )
        of_high = np.stack(
            predicted_lobes(high, self.patches, theta_i, (other, own), eta)
        )
        mixed = (left * of_low + past * of_high) / (past + left)
        errors: Floats = np.abs(mixed - known).sum(axis=(1, 2, 3))
        return errors
