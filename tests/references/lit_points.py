"""BSDFs asked at single points, and records that goniometric materials are made of."""

import drjit as dr
import mitsuba as mi
import numpy as np
import synthetic

from gonio_mi.collector.directions import direction

EPS = float(np.finfo(np.float32).eps)

# `eval` multiplies some ten float32 numbers, and the integral adds 16 per cell.
ROUNDING = 32 * EPS

IMPORTANCE = mi.TransportMode.Importance
RADIANCE = mi.TransportMode.Radiance


def isotropic(**settings):
    """Record of three polar angles; the lobe follows the mirror direction."""
    settings = {"theta_i": (0, 30, 60), "phi_i": (0, 0, 0)} | settings
    return synthetic.record(**settings)


def interaction(theta_i, phi_i=0.0, side=1):
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.t = 1.0
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)
    wi = direction(np.radians(theta_i), np.radians(phi_i)) * [1, 1, side]
    si.wi = mi.Vector3f(wi.tolist())
    dr.make_opaque(si.wi)
    return si


def patch_middles(record):
    """Where the lobe of a patch is its mean, whatever its gradient: of two patches."""
    near = direction(np.radians([30.0, 10.0]), np.radians([180.0, 20.0]))
    return record.subdivision.points(1)[record.subdivision.patch(near), 0]


def values(bsdf, wo, theta_i, phi_i=0.0, side=1, mode=IMPORTANCE):
    """BSDF without cosine, shape ``(n, channels)``, at unit vectors ``(n, 3)``."""
    ctx = mi.BSDFContext(mode)
    # from lists: what NumPy has allocated may not be aligned, which is another kernel
    vectors = mi.Vector3f(*wo.T.tolist())
    cosines = bsdf.eval(ctx, interaction(theta_i, phi_i, side), vectors).numpy()
    return (cosines / np.abs(wo[:, 2])).T
