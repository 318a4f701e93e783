"""Whether the samples of a `goniometric` follow its values, and keep all light."""

import drjit as dr
import mitsuba as mi
import numpy as np
from budget import agree, disagree, scores, verdict

import gonio_mi as gonio
from gonio_mi.collector.directions import direction

# Eight standard deviations of which hemisphere 2**17 rays choose, twice.
RAYS = 2**17
SHARES_OF_RAYS = 8 * np.sqrt(1 / RAYS)


class SamplingDensity:
    """The ``pdf`` of a BSDF in place of its ``eval``, to be integrated."""

    def __init__(self, bsdf):
        self.bsdf, self.class_name, self.sample = bsdf, bsdf.class_name, bsdf.sample

    def eval(self, ctx, si, wo, active):
        return [self.bsdf.pdf(ctx, si, wo, active)]


def check_samples(record, theta_i, other, folder):
    """Assert it of a record with a fourth of the light in either hemisphere.

    Lit from the azimuth of 10 degrees; twin: not of values for light from the `other`.
    """
    record.save(folder / "record.npz")
    plugin = {"type": "goniometric", "filename": str(folder / "record.npz")}
    coarse = gonio.subdivision("projected:6x8")
    how = {"collector": coarse, "rays": RAYS, "sampler": "independent"}
    seen = gonio.measure(plugin, theta_i, 10, **how)
    assert abs(seen.dhr[0] - 0.25) + abs(seen.dht[0] - 0.25) <= SHARES_OF_RAYS
    bsdf = mi.load_dict(plugin)
    right, rough, wrong = (
        means(bsdf, coarse, theta_i, phi_i, n_points)
        for phi_i, n_points in ((10, 48), (10, 24), (other, 48))
    )
    # of the first order at least: what points leave is below what twice as many change
    assert abs(right.sum() - 0.5) <= np.abs(right - rough).sum()
    for hemisphere in (0, 1):
        agree(verdict(scores(seen, right[hemisphere], hemisphere)))
        disagree(verdict(scores(seen, wrong[hemisphere], hemisphere)))


def means(bsdf, patches, theta_i, phi_i, n_points):
    """Flux fractions of both hemispheres by the values of a plugin at points."""
    upper = patches.points(n_points).reshape(-1, 3)
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(direction(*np.radians([theta_i, phi_i])).tolist())
    dr.make_opaque(si.wi)  # one kernel for all directions
    context = mi.BSDFContext(mi.TransportMode.Importance)
    found = []
    for wo in (upper, upper * [1, 1, -1]):
        value = bsdf.eval(context, si, mi.Vector3f(*wo.T.tolist())).numpy()[0]
        value = (value / upper[:, 2]).reshape(*patches.shape, -1).mean(axis=-1)
        found.append(value * patches.projected_solid_angles)
    return np.array(found)
