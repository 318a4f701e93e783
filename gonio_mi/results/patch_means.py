"""Patch means of a material that was not counted here, for one or many directions."""

from dataclasses import dataclass

import numpy as np

from ..collector.hemisphere import Subdivision


@dataclass(frozen=True, eq=False)
class PatchMeans:
    """Patch means of a material, from a file that holds no counts.

    Attributes
    ----------
    subdivision : Subdivision
    theta_i, phi_i : ndarray, shape (n_incident,)
        In degrees.
    channels : tuple of str
    flux_fraction : ndarray
        ``(n_incident, n_hemispheres, n_theta, n_phi, channels)``.
    stacked : bool
    notes : tuple of str
        Sentences on how the file was read.
    incident : Subdivision, optional
        Patches of incidence, each of which has the means of one incident direction for
        all of its own. Default: they hold at these directions alone.
    """

    subdivision: Subdivision
    theta_i: np.ndarray
    phi_i: np.ndarray
    channels: tuple[str, ...]
    flux_fraction: np.ndarray
    stacked: bool = True
    notes: tuple[str, ...] = ()
    incident: Subdivision | None = None

    @classmethod
    def of(
        cls,
        means: np.ndarray,
        patches: Subdivision,
        incident: tuple[np.ndarray, np.ndarray],
        channels: tuple[str, ...],
    ) -> "PatchMeans":
        """Means of the BSDF in 1/sr, of the shape of `flux_fraction`."""
        fractions = means * patches.projected_solid_angles[..., None]
        return cls(patches, *incident, channels, fractions)
