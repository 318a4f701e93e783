"""What the material `goniometric` makes of a record says of other directions."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..collector.directions import direction
from ..materials.lit_face import LitFace
from ..materials.lobes import LobeTable
from ..results.record import Record

__all__ = ["Prediction"]


class Prediction:
    """The material of a record, asked for flux fractions at any incident direction.

    Parameters
    ----------
    record : Record
        A stack that `goniometric` takes.
    n_points : int
        Points per side of each patch, at which its mean is taken.
    """

    def __init__(self, record: Record, n_points: int) -> None:
        self.face = LitFace(LobeTable.of(record))
        self.subdivision = record.subdivision
        self.n_hemispheres = 1 + record.has_lower
        points = self.subdivision.points(n_points)
        self.each = points.shape[1]
        upper = points.reshape(-1, 3).T
        wo = [upper, upper * np.array([[1], [1], [-1]])][: self.n_hemispheres]
        self.wo = mi.Vector3f(np.ascontiguousarray(np.concatenate(wo, axis=1)))
        dr.eval(self.wo)

    def flux(self, theta_i: float, phi_i: float) -> Floats:
        """Flux fractions, shape ``(n_hemispheres, n_theta, n_phi, channels)``.

        Parameters
        ----------
        theta_i, phi_i : float
            In degrees, from the normal of the lit face.
        """
        towards = direction(np.radians(theta_i), np.radians(phi_i))
        wi = mi.Vector3f(towards.tolist())
        dr.make_opaque(wi)
        values, _, wanted = self.face.values(wi, self.wo)
        means = [
            dr.block_sum(dr.select(wanted, value, 0.0), self.each) for value in values
        ]
        dr.eval(means)
        shape = self.n_hemispheres, *self.subdivision.shape
        brdf = np.stack([mean.numpy().reshape(shape) for mean in means], axis=-1)
        return brdf / self.each * self.subdivision.projected_solid_angles[..., None]
