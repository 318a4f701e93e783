"""Recognition of a specimen's symmetry by measurement: isotropy, rotations, mirrors."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from ..results.azimuth_symmetry import AzimuthSymmetry, Motion, azimuth_of
from ..results.prediction_error import prediction_error
from .measured_directions import TESTING, MeasuredDirections

logger = logging.getLogger(__name__)

# Azimuths at which it is measured whether a specimen is isotropic, in whole turns, not
# all eighths, after which pyramids of eight sides are what they were; and those of them
# whose images are measured for its symmetry.
TURNS, IMAGED = (0.125, 0.25, 0.7), (0.125, 0.25)
N_TURNED = 2 * len(TURNS)

# Equal parts of a whole turn that are tried; of a mirror's azimuth, in whole turns,
# those that are tried before the one that fits the light along the normal best.
PARTS, MIRRORS = (6, 4, 3, 2), (0, 0.25, 0.125, 0.375)


class SymmetryRecognition:
    """Symmetries of a specimen, as far as its tolerance tells.

    What is moved may be wrong by half the tolerance, beyond the error bars.

    Parameters
    ----------
    directions : MeasuredDirections
        Of them that along the normal, and `angles` at azimuth 0.
    angles : sequence of float
        Polar angles in degrees, three or more from 0 upwards.
    """

    def __init__(self, directions: MeasuredDirections, angles: Sequence[float]) -> None:
        self.directions = directions
        self.angles, self.looked_at = angles, angles[1:3]
        self.limit = directions.tolerance / 2
        self.normal = self.directions.records[0.0, 0.0]
        self.n_sectors = self.normal.subdivision.shape[1]

    def is_isotropic(self) -> bool:
        """Whether turned by whole sectors the specimen is the same."""
        name = self.directions.name
        sectors = {round(self.n_sectors * turn) for turn in TURNS} - {0}
        turned = [
            (theta, azimuth_of(sector, self.n_sectors))
            for theta in self.looked_at
            for sector in sectors
        ]
        self.directions.measure(turned, "is it isotropic?")
        line = self.directions.prediction((theta, 0.0) for theta in self.angles)
        errors = [self.directions.error(line, *one) for one in turned]
        isotropic = not any(one.exceeds(self.limit) for one in errors)
        found = "isotropic" if isotropic else "anisotropic"
        logger.info(
            "%s is %s: turned by %d azimuths, total variation distance %.2g",
            *(name, found, len(sectors), max(one.total_variation for one in errors)),
        )
        return isotropic

    def symmetry(self) -> AzimuthSymmetry:
        """Turns and mirrors after which an anisotropic specimen is what it was."""
        n = self.n_sectors
        parts = [one for one in PARTS if n % one == 0 and n // one >= 4]
        turns = (one for one in parts if self._holds(Motion(n // one, False, n)))
        mirrors = (one for one in self._mirrors() if self._holds(Motion(one, True, n)))
        found = AzimuthSymmetry(n, next(turns, 1), next(mirrors, None))
        logger.info("%s has the symmetry %s", self.directions.name, found)
        return found

    def is_any_refuted(
        self, motions: Sequence[Motion], theta: float, phi: float
    ) -> bool:
        """Whether at a direction a motion changes the specimen after all."""
        images = [(theta, motion.azimuth(phi)) for motion in motions]
        start = theta, phi
        self.directions.measure([start, *images], "is it symmetric?", TESTING)
        return any(
            self._changes(motion, start, image)
            for motion, image in zip(motions, images)
        )

    def _mirrors(self) -> list[int]:
        """Mirrors to try: along the axes, and the one that fits best.

        By twice their azimuth in sectors.
        """
        n = self.n_sectors
        axes = [round(2 * n * turn) for turn in MIRRORS if 2 * n * turn % 1 == 0]
        flux = self.normal.flux_fraction
        changes = [
            np.abs(Motion(by, True, n).moved(flux, 2) - flux).sum() for by in range(n)
        ]
        return list(dict.fromkeys([*axes, int(np.argmin(changes))]))

    def _holds(self, motion: Motion) -> bool:
        """Whether a motion changes neither light along the normal, nor from beside."""
        normal = 0.0, 0.0
        if self._changes(motion, normal, normal):
            return False
        n = self.n_sectors
        starts = {azimuth_of(round(n * turn), n) for turn in IMAGED}
        return not any(
            self.is_any_refuted([motion], theta, phi)
            for theta in self.looked_at
            for phi in sorted(starts)
        )

    def _changes(
        self, motion: Motion, start: tuple[float, float], image: tuple[float, float]
    ) -> bool:
        """Whether a known direction is not the image of another one."""
        known = self.directions.records
        moved = motion.moved(known[start].flux_fraction, 2)
        return prediction_error(known[image], moved).exceeds(self.limit)
