"""Pictures of records whose patches are no rings of equal sectors."""

import numpy as np
import pytest
import synthetic

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.plots.profile import drawn_in_rings, profile

COLLECTORS = ["klems", "klems-half", "klems-quarter", "shirley-chiu:8"]


@pytest.mark.parametrize("collector", COLLECTORS)
def test_each_place_has_the_value_of_its_patch(collector):
    patches = gonio.subdivision(collector)
    values = 1.0 + np.arange(patches.n_patches).reshape(*patches.shape, 1)
    rings, drawn = drawn_in_rings(patches, values)
    index = patches.patch(direction(*rings.middles))
    assert np.array_equal(drawn[..., 0], 1.0 + index)


@pytest.mark.parametrize("collector", COLLECTORS[-2:])
def test_they_are_drawn(collector):
    pytest.importorskip("matplotlib")
    record = synthetic.record(collector, both=True)
    assert len(gonio.plot(record)._repr_png_()) > 10_000


def record_of_apertures(collector):
    """Record of light that is spread evenly over the hemisphere, from phi_i = 20."""
    like, patches = synthetic.record(), gonio.subdivision(collector)
    flux = [0.5 * patches.solid_angles / (2 * np.pi)]
    tally = synthetic.tally(patches, flux, 20_000, np.random.default_rng(1))
    directions = like.theta_i, like.phi_i, like.channels
    return gonio.Record(patches, *directions, (tally,), like.asked, like.provenance)


def test_an_aperture_is_drawn_once():
    """Rounding: one mark each of those in the plane of incidence, where they stand.

    Twin: what lies between them has a place, but neither value nor limit; and that in
    the legend if an aperture is empty.
    """
    pytest.importorskip("matplotlib")
    record = record_of_apertures("apertures:2@0/0,30/200,60/20,45/110,41/202")
    cut = profile(record)
    there = np.isfinite(cut.value[:, 0])
    # the last one is beside the plane by 2 degrees of azimuth
    tilted = np.degrees(np.arctan(np.tan(np.radians(41)) * np.cos(np.radians(2))))
    assert cut.theta[there] == pytest.approx([-60, 0, 30, tilted], abs=1e-12)
    assert np.array_equal(cut.value[there], record.brdf[[2, 0, 1, 4], 0])
    widths = np.diff(cut.edges)[there]
    assert widths[:3] == pytest.approx(4, abs=1e-12)
    assert 0 < widths[3] < 4
    assert np.isnan(cut.high[~there]).all()
    assert cut.empty[~there].all()
    figure = gonio.plot(record)
    (cones,) = figure.subfigs[0].axes[0].collections
    assert np.array_equal(cones.get_array(), record.brdf[:5, 0, 0])
    said = [text.get_text() for text in figure.subfigs[1].axes[0].get_legend().texts]
    assert said == ["95 % interval", "mirror direction"]
    empty = record_of_apertures("apertures:0.01@0/0,30/200")
    said = gonio.plot(empty).subfigs[1].axes[0].get_legend().texts
    assert said[0].get_text() == "upper limit, no hit"


def test_a_patch_that_the_plane_crosses_is_drawn_once():
    """Of squares mapped to a disc: no two cells beside each other are one patch."""
    record = synthetic.record("shirley-chiu:8")
    cut = profile(record)
    middles = np.radians(cut.theta)
    azimuth = np.radians(record.phi_i[0]) + np.pi * (middles > 0)
    index = record.subdivision.patch(direction(np.abs(middles), azimuth))
    assert np.all(np.diff(index) != 0)
    assert np.array_equal(cut.value, record.brdf.reshape(-1, 1)[index])
