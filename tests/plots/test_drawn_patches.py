"""Pictures of records whose patches are no rings of equal sectors."""

import numpy as np
import pytest
import synthetic

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.plots.profile import drawn_in_rings

COLLECTORS = [
    "klems",
    "klems-half",
    "klems-quarter",
    "shirley-chiu:8",
    "apertures:5@0/0,30/180,60/90",
]


@pytest.mark.parametrize("collector", COLLECTORS)
def test_each_place_has_the_value_of_its_patch(collector):
    """And NaN what is in no aperture."""
    patches = gonio.subdivision(collector)
    values = 1.0 + np.arange(patches.n_patches).reshape(*patches.shape, 1)
    rings, drawn = drawn_in_rings(patches, values)
    index = patches.patch(direction(*rings.middles))
    expected = np.where(index < patches.n_detectors, 1.0 + index, np.nan)
    assert np.array_equal(drawn[..., 0], expected, equal_nan=True)
    _, flags = drawn_in_rings(patches, values < 0)
    assert np.array_equal(flags[..., 0], index >= patches.n_detectors)


@pytest.mark.parametrize("collector", COLLECTORS)
def test_they_are_drawn(tmp_path, collector):
    pytest.importorskip("matplotlib")
    record = synthetic.record() if "apertures" in collector else None
    if record is None:
        record = synthetic.record(collector, both=True)
    else:
        patches = gonio.subdivision(collector)
        tally = synthetic.tally(
            patches,
            [0.5 * patches.solid_angles / (2 * np.pi)],
            20_000,
            np.random.default_rng(1),
        )
        record = gonio.Record(
            patches,
            record.theta_i,
            record.phi_i,
            record.channels,
            (tally,),
            record.asked,
            record.provenance,
        )
    gonio.plot(record, tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 10_000
