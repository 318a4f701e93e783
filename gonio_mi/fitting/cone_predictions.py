"""What a BSDF sends into cones about directions, or is in these directions alone."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..collector.directions import direction
from .patch_predictions import REL_ERR, Nodes, Predictions

__all__ = ["ConePredictions"]

# Nodes along the radius of a cone, to begin with and at most; four times as many about
# its axis.
FEWEST, MOST = 2, 16


class ConePredictions(Predictions):
    """Values of cones for one incident direction of a table, or of apertures.

    Parameters
    ----------
    incident, side, channels
        As of :class:`Predictions`.
    axes : ndarray, shape (n, 2)
        Polar angles from the pole of their hemisphere, and azimuths, in degrees.
    lower : bool
        Whether the cones are in the lower hemisphere.
    half_angle : float
        Of the cones in degrees; 0 for their axes alone, and means.
    means : bool
        Whether values are means of the BSDF in 1/sr, weighted with the cosine, and not
        flux fractions. What would lie below the horizon is left out.
    """

    def __init__(
        self,
        incident: tuple[float, float],
        side: str,
        channels: Sequence[str],
        axes: Floats,
        *,
        lower: bool,
        half_angle: float,
        means: bool,
    ) -> None:
        super().__init__(incident, side, channels)
        self.axes, self.lower, self.means = np.radians(axes), lower, means
        self.half_angle = np.radians(half_angle)

    def begin(self) -> None:
        """Take a few nodes in each cone."""
        self._take(FEWEST)

    def adapt(self, bsdf: mi.BSDF) -> Floats:
        """:meth:`of` a BSDF, with the nodes that it needs from now on."""
        n = FEWEST
        self._take(n)
        before, found = None, self.of(bsdf)
        while self.half_angle and n < MOST and not _alike(before, found):
            n *= 2
            self._take(n)
            before, found = found, self.of(bsdf)
        return found

    def _take(self, n: int) -> None:
        """Take `n` nodes along the radius of each cone."""
        wo, weight = self._about(n)
        place = np.repeat(np.arange(len(wo)), wo.shape[1])
        if self.means:
            solid = np.bincount(place, (weight * wo[..., 2]).ravel())
            weight = weight / solid[:, None]
        theta = np.arctan2(np.hypot(wo[..., 0], wo[..., 1]), wo[..., 2])
        phi = np.arctan2(wo[..., 1], wo[..., 0])
        kept = weight.ravel() > 0
        angles = (
            theta.ravel()[kept],
            phi.ravel()[kept],
            np.full(kept.sum(), self.lower),
        )
        self._nodes = [
            Nodes(self._light(nm), place[kept], angles, weight.ravel()[kept], len(wo))
            for nm in self.passes
        ]

    def _about(self, n: int) -> tuple[Floats, Floats]:
        """Directions about each axis, shape (n_axes, m, 3), and weights in sr."""
        theta, phi = self.axes.T
        axis = direction(theta, phi)
        if not self.half_angle:
            return axis[:, None], np.ones((len(axis), 1))
        down = direction(theta + np.pi / 2, phi)
        across = np.cross(axis, down)
        x, w = np.polynomial.legendre.leggauss(n)
        low = np.cos(self.half_angle)
        cosine = np.repeat(low + (1 - low) * (x + 1) / 2, 4 * n)
        weight = np.repeat(w * (1 - low) / 2, 4 * n) * (2 * np.pi / (4 * n))
        turn = np.tile((np.arange(4 * n) + 0.5) * (2 * np.pi / (4 * n)), n)
        sine = np.sqrt(1 - cosine**2)
        local = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine])
        wo = np.einsum("kij,km->imj", np.stack([down, across, axis]), local)
        return wo, np.where(wo[..., 2] > 0, weight, 0.0)


def _alike(before: Floats | None, found: Floats) -> bool:
    """Whether no value has changed by a relevant part."""
    if before is None:
        return False
    change = np.abs(found - before)
    return bool(np.all(change <= REL_ERR * (np.abs(found) + np.abs(found).mean())))
