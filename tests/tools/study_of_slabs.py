"""Media against exact theory over a grid of 216 layers: a study, not a test.

::

    PYTHONPATH=tests:tests/references python tests/tools/study_of_slabs.py

prints, for each thickness, albedo, g and angle of incidence, the least p-value of the
patches of both hemispheres, and the normal scores of both totals; some minutes. Without
an index step the patches are those of discrete ordinates, with azimuth; with one of 1.5
the rings of adding and doubling.
"""

import itertools

import gonio_mi as gonio

# isort: split
import mitsuba as mi
import numpy as np
from benchmark.discrete_ordinates import henyey_greenstein, theory
from budget import normal_scores, scores, verdict
from plates import plate, rings
from slabs import medium, stack

from gonio_mi.collector.directions import direction

PATCHES = "projected:6x8"
RINGS = "projected:8x1"
GRID = ((0.1, 1.0, 10.0, 100.0), (0.5, 0.99, 1.0), (-0.5, 0.0, 0.9), (0.0, 60.0, 85.0))


def compared(tau, albedo, g, theta_i):
    """P-values of hemispheres, scores of totals, and the rays that did not leave."""
    layer = (tau, albedo, henyey_greenstein(g))
    patches, totals, direct = theory([layer], theta_i, PATCHES)
    record = measured(stack(medium(tau, albedo, g)), tau, theta_i, PATCHES)
    along = direction(np.radians(theta_i), np.pi)[None]
    patches[1].ravel()[record.subdivision.patch(along)[0]] += direct
    return judged(record, patches, totals + [0, direct])


def compared_behind_faces(tau, albedo, g, theta_i, index=1.5):
    """The same of a plate between smooth faces."""
    edges = gonio.subdivision(RINGS).theta_edges
    theta_i, fluxes = rings(tau, albedo, g, index, edges, theta_i)
    record = measured(plate(tau, albedo, g, index), tau, theta_i, RINGS)
    return judged(record, fluxes[..., None], fluxes.sum(axis=1))


def measured(scene, tau, theta_i, collector):
    return gonio.measure(
        scene,
        theta_i=theta_i,
        period="box",
        rays=200_000 if tau < 100 else 50_000,
        collector=collector,
        sampler="independent",
        seed=11,
    )


def judged(record, patches, totals):
    """P-values, scores and lost rays of a record whose flux fractions are known."""
    each = [scores(record, fluxes, i) for i, fluxes in enumerate(patches)]
    p = [len(v.p) * min(v.p.values()) for v in (verdict(z) for z in each if z.size)]
    values = np.array([record.dhr, record.dht])[:, 0]
    errors = np.array([record.dhr_std_err, record.dht_std_err])[:, 0]
    known = errors > 0
    t = (values - totals)[known] / errors[known]
    ledger = record.ledger
    lost = ledger.emitted - ledger.reflected - ledger.transmitted - ledger.direct
    return np.minimum(p, 1), normal_scores(t, record.n_batches - 1), lost


def main():
    mi.set_variant("llvm_ad_mono")
    every_p, every_z = [], []
    for compare in (compared, compared_behind_faces):
        for case in itertools.product(*GRID):
            p, z, lost = compare(*case)
            every_p += p.tolist()
            every_z += z.tolist()
            print(*case, "p", p.round(4), "z", z.round(2), "lost", lost, flush=True)
    print(f"{len(every_p)} maps, least p {min(every_p):.3g}")
    rms, worst = np.sqrt(np.mean(np.square(every_z))), np.abs(every_z).max()
    print(f"{len(every_z)} totals, rms score {rms:.3f}, worst {worst:.2f}")


if __name__ == "__main__":
    main()
