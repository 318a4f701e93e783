"""Specimens of plane-parallel media, and what theory says of a half space."""

from itertools import pairwise

import mitsuba as mi
import numpy as np

NULL = {"type": "null"}


def medium(sigma_t=1.0, albedo=0.9, phase=0.0, **more):
    """Medium object; `phase` is a dictionary or the g of Henyey and Greenstein."""
    if not isinstance(phase, dict):
        phase = {"type": "hg", "g": float(phase)} if phase else {"type": "isotropic"}
    coefficients = {"sigma_t": _float(sigma_t), "albedo": _float(albedo)}
    return mi.load_dict({"type": "homogeneous", **coefficients, "phase": phase, **more})


def rectangle(z, above=None, below=None, bsdf=NULL, size=1.0):
    """Horizontal square, with its media; `bsdf` belongs to its upper face."""
    to_world = mi.ScalarTransform4f().translate([0, 0, z]).scale(size)
    media = {"exterior": above, "interior": below}
    media = {side: one for side, one in media.items() if one is not None}
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf, **media}


def stack(*media, thickness=1.0, bsdf=NULL, base=None, size=1.0):
    """Scene of layers of `media` from above, all with `bsdf` above and below.

    `base` is a BSDF that lies below instead.
    """
    around = [None, *media, None]
    shapes = {
        f"interface_{i}": rectangle(-i * thickness, above, below, bsdf, size)
        for i, (above, below) in enumerate(pairwise(around))
    }
    if base is not None:
        bottom = rectangle(-len(media) * thickness, bsdf=base, size=size)
        shapes[f"interface_{len(media)}"] = bottom
    return {"type": "scene", **shapes}


def chandrasekhar(mu, albedo, nodes=200):
    """Chandrasekhar's H function of isotropic scattering, by iteration.

    His *Radiative Transfer* (1950), chapter V, in the form 1/H that converges.
    """
    x, weights = np.polynomial.legendre.leggauss(nodes)
    x, weights = (x + 1) / 2, weights / 2
    h = np.ones(nodes)

    def at(m):
        ratios = weights * x * h / (np.asarray(m)[..., None] + x)
        return 1 / (np.sqrt(1 - albedo) + albedo / 2 * ratios.sum(axis=-1))

    for _ in range(200):
        h = at(x)
    return at(mu)


def _float(value):
    """What Mitsuba takes, which wants no integer."""
    return float(value) if isinstance(value, int) else value
