"""The material that the known directions of a campaign make, and what it gets wrong."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..collector import Subdivision
from ..formats.scatter import PatchMeans
from ..interpolation.lobes import check_table, tells
from ..results.azimuth_symmetry import AzimuthSymmetry
from ..results.campaign_outcome import PredictionError
from ..results.prediction_error import prediction_error
from .known_directions import KnownDirections
from .prediction import SPARED, Prediction, points_for

__all__ = ["KnownMaterial"]


class KnownMaterial:
    """Material of known directions, and of their images by symmetries.

    Parameters
    ----------
    directions : KnownDirections
        Which are predicted as right as its tolerance asks.
    """

    def __init__(self, directions: KnownDirections) -> None:
        self.directions = directions
        self.n_points = points_for(directions.tolerance)

    @property
    def patches(self) -> Subdivision:
        """What all directions are measured in."""
        return next(iter(self.directions.records.values())).subdivision

    def prediction(
        self,
        incidents: Iterable[tuple[float, float]],
        symmetry: AzimuthSymmetry | None = None,
    ) -> Prediction:
        """Of some known directions, and their images, of which no counts are copied."""
        known = self.directions.records
        symmetry = symmetry or AzimuthSymmetry(self.patches.shape[1])
        sources = symmetry.sources(known, incidents)
        flux = [
            motion.moved(known[source].flux_fraction, 2)
            for source, motion in sources.values()
        ]
        theta_i, phi_i = np.array(list(sources)).T
        means = PatchMeans(self.patches, theta_i, phi_i, self._channels, np.array(flux))
        return Prediction(means, self.n_points, SPARED * self.directions.tolerance)

    def missed(
        self, prediction: Prediction, theta: float, phi: float
    ) -> PredictionError:
        """Error of a prediction at a known direction."""
        known = self.directions.records[theta, phi]
        return prediction_error(known, prediction.flux(theta, phi))

    def check_size(self, azimuths: Iterable[float], n_angles: int) -> None:
        """Raise TooLargeError if the table of such a material is too large.

        Parameters
        ----------
        azimuths : sequence of float
            Of all its directions, images included, in degrees.
        n_angles : int
            Polar angles.
        """
        light = self.directions.light
        n_hemispheres = 1 + tells(light[1], light.sum())
        lobes = n_hemispheres, *self.patches.shape, len(self._channels)
        check_table(len(set(azimuths)), n_angles, lobes)

    @property
    def _channels(self) -> tuple[str, ...]:
        return next(iter(self.directions.records.values())).channels
