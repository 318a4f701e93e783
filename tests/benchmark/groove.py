"""Exact BRDF of a diffuse V-groove: radiosity of two endless strips at right angles.

The walls of slope 45 degrees meet in a bottom along y, and their crests lie in the
plane z = 0, so that light which has left a groove meets no other one. Of perpendicular
strips that share an edge, a wall point at the distance s from it sees the part between
a and b of the other wall under the form factor s/2 (1/sqrt(s^2+a^2) - 1/sqrt(s^2+b^2)).
"""

from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from gonio_mi.array_types import Floats

REFLECTANCE = 0.8

# Panels of a wall. They shrink towards the bottom, where the form factors vary fastest.
N_PANELS = 100


def walls() -> dict[str, Any]:
    """Both walls as Mitsuba's shape dictionaries: 2 wide, and practically endless."""
    shapes = {}
    for name, x, slope in (("left", -0.5, 45.0), ("right", 0.5, -45.0)):
        to_world = mi.ScalarTransform4f().translate([x, 0, -0.5])
        to_world = to_world.rotate([0, 1, 0], slope).scale([0.5**0.5, 1000, 1])
        shapes[name] = {
            "type": "rectangle",
            "to_world": to_world,
            "bsdf": {"type": "diffuse", "reflectance": REFLECTANCE},
        }
    return shapes


def brdf(wi: ArrayLike, wo: ArrayLike) -> Floats:
    """BRDF in 1/sr for every pair of directions.

    Parameters
    ----------
    wi, wo : array_like, shapes (n, 3) and (m, 3)
        Unit vectors with z > 0.

    Returns
    -------
    ndarray, shape (n, m)
    """
    edges = np.sqrt(2) * np.linspace(0, 1, N_PANELS + 1) ** 2
    middles = (edges[1:] + edges[:-1]) / 2
    s = middles[:, None]
    seen = s / 2 * np.diff(-1 / np.hypot(s, edges), axis=1)
    # radiosity of both walls for irradiances (a, b): a linear map that couples them
    none = np.zeros_like(seen)
    coupling = np.eye(2 * N_PANELS) - REFLECTANCE * np.block(
        [[none, seen], [seen, none]]
    )
    wi, wo = np.asarray(wi, dtype=float), np.asarray(wo, dtype=float)
    radiosity = REFLECTANCE * np.linalg.solve(coupling, _exposure(wi, edges).T)
    area = np.tile(np.diff(edges), 2)
    power = (_exposure(wo, edges) * area) @ radiosity / np.pi
    # the groove's opening has the width 2
    return power.T / (2 * wi[:, 2:] * wo[:, 2])


def _exposure(w: Floats, edges: Floats) -> Floats:
    """Cosine to both walls times each panel's exposed part, shape (n, 2 panels)."""
    exposures = []
    for x in (w[:, 0], -w[:, 0]):  # left wall, whose normal has +x; right wall
        cosine = np.maximum(x + w[:, 2], 0) / np.sqrt(2)
        # the other crest hides what is below this fraction of the wall
        hidden = np.maximum(x - w[:, 2], 0) / np.maximum(x + w[:, 2], 1e-300)
        edge = np.sqrt(2) * np.where(x > w[:, 2], hidden, 0)[:, None]
        part = np.clip((edges[1:] - edge) / np.diff(edges), 0, 1)
        exposures.append(cosine[:, None] * part)
    return np.concatenate(exposures, axis=1)


def patch_means(wi: Floats, points: Floats) -> Floats:
    """Mean BRDF of patches over ``points``, shape (len(wi), patches)."""
    patches, n, _ = points.shape
    return brdf(wi, points.reshape(-1, 3)).reshape(len(wi), patches, n).mean(axis=2)
