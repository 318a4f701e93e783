"""Lobes between polar angles: by micro-normals where the records say so."""

import mitsuba as mi
import numpy as np
import pytest
import synthetic
from budget import agree, disagree, scores, verdict
from synthetic import facet_lobes, facets_through, plugin_means

import gonio_mi as gonio
from gonio_mi.instrument.prediction import Prediction
from gonio_mi.materials.leg_trials import best_face
from gonio_mi.materials.lit_face import LitFace
from gonio_mi.materials.lobes import LobeTable
from gonio_mi.results.misplacement import misplaced

pytestmark = pytest.mark.usefixtures("mono")

ANGLES = (0, 20, 40, 60)

# Eight standard deviations of which hemisphere 2**17 rays choose, twice.
SHARES_OF_RAYS = 8 * np.sqrt(2.0**-17)


def record_of(patches, angles, *hemispheres):
    """Record without noise, of one azimuth."""
    return synthetic.exact(np.stack(hemispheres, axis=1), angles, str(patches))


def facets_both(patches, angles, eta=1.5):
    """Half of the light reflected and half refracted by the same facets, about."""
    incidents = [(theta, 0) for theta in angles]
    upper = facet_lobes(patches, incidents, (0.1, 0.1))
    how = {"of": facets_through, "eta": eta}
    lower = facet_lobes(patches, incidents, (0.15, 0.15), **how)
    return upper / 2, lower / 2


@pytest.mark.parametrize("eta", [1.5, 1 / 1.5])
def test_records_say_how_their_lobes_move(eta):
    """Those of facets by micro-normals; what stays where it is, by quantiles."""
    patches = gonio.subdivision("projected:24x48")
    # from inside, below where most facets reflect all light
    angles = ANGLES if eta > 1 else (0, 10, 20, 30)
    upper, lower = facets_both(patches, angles, eta)
    fixed = np.stack([synthetic.specular(patches, 20, 90, 20)] * len(angles)) / 4
    for reflected, transmitted, moving in (
        (upper, lower, [0, 1]),
        (upper, fixed, [0]),
        (fixed, lower, [1]),
        (fixed, fixed, []),
    ):
        record = record_of(patches, angles, reflected, transmitted)
        face = best_face(LobeTable.of(record))
        assert [way.hemisphere for way in face.normals.ways if all(way.legs)] == moving
        if 1 in moving:
            assert (face.normals.ways[-1].eta > 1) == (eta > 1)


def test_each_leg_moves_as_the_nearest_records_say():
    """Lobes that are fixed up to 40 degrees, and of facets beyond."""
    patches = gonio.subdivision("projected:24x48")
    angles = (0, 10, 20, 30, 40, 50, 60, 70)
    upper, _ = facets_both(patches, angles)
    upper[:5] = synthetic.specular(patches, 20, 90, 20) / 4
    record = record_of(patches, angles, upper)
    ((way,),) = [best_face(LobeTable.of(record)).normals.ways]
    # the record at 40 degrees is between two that have nothing in common
    assert way.legs[:3] == (False,) * 3
    assert way.legs[5:] == (True,) * 2


def test_too_few_angles_say_nothing():
    """Of two no one is between others."""
    patches = gonio.subdivision("projected:24x48")
    record = record_of(patches, ANGLES[:2], *facets_both(patches, ANGLES[:2]))
    assert not best_face(LobeTable.of(record)).normals.ways


@pytest.mark.parametrize("theta_i", [10, 50])
def test_narrow_lobes_are_predicted_by_micro_normals(theta_i):
    """Up to what patches leave, of the second order; twin: not so by quantiles."""
    errors = []
    for size in ("projected:16x40", "projected:32x80"):
        patches = gonio.subdivision(size)
        incidents = [(theta, 0) for theta in (*ANGLES, theta_i)]
        *known, truth = facet_lobes(patches, incidents, (0.1, 0.1))
        record = record_of(patches, ANGLES, np.array(known))
        own = Prediction(record, 8)
        quantiles = Prediction(record, 8)
        quantiles.face = LitFace(LobeTable.of(record))
        true = record_of(patches, (theta_i,), truth[None])
        errors.append(
            [misplaced(true, one.flux(theta_i, 0)).light for one in (own, quantiles)]
        )
    coarse, fine = np.array(errors)
    assert fine[0] < coarse[0] / 2
    assert fine[1] > coarse[1] / 2
    assert fine[0] < fine[1] / 2


@pytest.mark.parametrize("theta_i", [30, 75])
def test_samples_follow_the_values(theta_i, tmp_path):
    """Also beyond the last angle, where light stays; twin: of another direction."""
    patches = gonio.subdivision("projected:24x36")
    record = record_of(patches, ANGLES, *facets_both(patches, ANGLES))
    assert len(best_face(LobeTable.of(record)).normals.ways) == 2
    record.save(tmp_path / "facets.npz")
    plugin = {"type": "goniometric", "filename": str(tmp_path / "facets.npz")}
    coarse = gonio.subdivision("projected:6x8")
    how = {"collector": coarse, "rays": 2**17, "sampler": "independent"}
    seen = gonio.measure(plugin, theta_i, 10, **how)
    # all light of the records is kept
    assert abs(seen.dhr[0] - 0.25) + abs(seen.dht[0] - 0.25) <= SHARES_OF_RAYS
    bsdf = mi.load_dict(plugin)
    right, rough, wrong = (
        plugin_means(bsdf, coarse, theta_i, phi_i, n_points)
        for phi_i, n_points in ((10, 96), (10, 48), (40, 96))
    )
    # of the first order at least: what points leave is below what twice as many change
    assert abs(right.sum() - 0.5) <= np.abs(right - rough).sum()
    for hemisphere in (0, 1):
        agree(verdict(scores(seen, right[hemisphere], hemisphere)))
        disagree(verdict(scores(seen, wrong[hemisphere], hemisphere)))
