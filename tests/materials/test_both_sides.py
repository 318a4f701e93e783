"""Materials that transmit: one campaign, one file, both sides."""

from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
from lit_points import RADIANCE, isotropic, values

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.commands.campaign_options import is_imprecise
from gonio_mi.errors import FileFormatError
from gonio_mi.materials import whole_bsdf
from gonio_mi.results.record import both_sides
from gonio_mi.results.summary import summarize
from gonio_mi.results.summary_text import summary_text

GLASS = {"type": "roughdielectric", "alpha": 0.6, "int_ior": 1.2, "ext_ior": 1.0}


@pytest.fixture
def sides():
    """A record with its back, in other patches and at other angles."""
    front = isotropic(both=True)
    back = isotropic(both=True, collector="projected:4x8", theta_i=(0, 20, 40))
    return replace(front, back=back.with_settings(side="back"))


@pytest.mark.parametrize("ending", [".npz", ".exr"])
def test_one_file_holds_both_sides(sides, tmp_path, ending):
    """Exact; twin: another back is another record."""
    sides.save(tmp_path / f"both{ending}")
    loaded = gonio.load(tmp_path / f"both{ending}")
    assert loaded == sides
    assert loaded.back == sides.back
    assert replace(sides, back=sides.back[:2]) != sides
    # a part of the directions has no back, whose directions are others
    assert sides[0].back is sides[:2].back is gonio.Record.stack(sides).back is None
    assert both_sides([sides]) == [replace(sides, back=None), sides.back]
    assert len(summarize(sides).as_mapping()["back"]["directions"]) == 3
    assert "lit from behind:" in summary_text(summarize(sides))


@pytest.mark.parametrize("ending", [".npz", ".exr"])
def test_a_back_that_was_lit_from_the_front_is_refused(sides, tmp_path, ending):
    wrong = replace(sides, back=replace(sides, back=None))
    wrong.save(tmp_path / f"wrong{ending}")
    with pytest.raises(FileFormatError, match="its back was lit from the front"):
        gonio.load(tmp_path / f"wrong{ending}")


@pytest.mark.usefixtures("mono")
def test_one_name_is_a_whole_material(sides, tmp_path):
    """To the bit that of two names; twin: not with the front as its own back."""
    wo = direction(np.radians([20.0, 160.0]), np.radians([190.0, 40.0]))
    files = {"both": sides, "front": replace(sides, back=None), "back": sides.back}
    for name, record in files.items():
        record.save(tmp_path / f"{name}.npz")
    seen = {}
    for front, back in [("both", None), ("front", "back"), ("front", "front")]:
        made = {"type": "goniometric", "filename": str(tmp_path / f"{front}.npz")}
        if back:
            made["back_filename"] = str(tmp_path / f"{back}.npz")
        bsdf = mi.load_dict(made)
        seen[front, back] = values(bsdf, wo, 35, side=-1, mode=RADIANCE).tolist()
    one, two, other = seen.values()
    assert one == two != other
    assert min(one) > [0]


@pytest.fixture
def measured(monkeypatch, sides):
    """What a campaign finds on each side, without any measurement."""
    found = {"front": replace(sides, back=None), "back": sides.back}

    def one(self):
        record = found[self.directions.settings.get("side") or "front"]
        if isinstance(record, str):
            raise gonio.SpecimenError(record)
        return record

    monkeypatch.setattr(whole_bsdf.WholeBsdf, "measured", one)
    return found


@pytest.mark.usefixtures("mono")
def test_a_campaign_measures_the_back_of_what_transmits(measured, sides):
    how = {"specimens": {"glass": GLASS}, "tolerance": 0.1}
    assert gonio.campaign(**how)["glass"] == sides
    # a side that is asked for is alone
    assert gonio.campaign(**how, side="front")["glass"] == measured["front"]
    assert gonio.campaign(**how, side="back")["glass"] == measured["back"]
    measured["front"] = isotropic()
    assert gonio.campaign(**how)["glass"] == measured["front"]


@pytest.mark.usefixtures("mono")
def test_a_back_that_is_refused_costs_no_front(measured):
    measured["back"] = "too narrow"
    told = "glass transmits, and its back was not measured: too narrow"
    with pytest.warns(RuntimeWarning, match=told):
        record = gonio.campaign({"glass": GLASS}, tolerance=0.1)["glass"]
    assert record == measured["front"]


@pytest.mark.slow
@pytest.mark.usefixtures("mono")
def test_a_ball_of_glass_is_as_bright_as_its_model(monkeypatch, tmp_path):
    """Within the tolerance; twin: not without its back."""
    monkeypatch.setattr(whole_bsdf, "N_UNSEEN", 8)
    record = gonio.campaign({"glass": GLASS}, tolerance=0.2, theta_max=70)["glass"]
    assert record.back.asked.side == "back"
    assert not is_imprecise(record)
    record.save(tmp_path / "both.npz")
    replace(record, back=None).save(tmp_path / "front.npz")
    names = [str(tmp_path / f"{name}.npz") for name in ("both", "front")]
    materials = [{"type": "goniometric", "filename": name} for name in names]
    model, both, front = map(light_of_ball, (GLASS, *materials))
    assert abs(both / model - 1) < 0.2 < abs(front / model - 1)


def light_of_ball(bsdf):
    """Mean radiance of the middle of a ball in a white room."""
    to_world = mi.ScalarTransform4f().look_at([0, 0, 9], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 4, "height": 4}
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 8},
        "sensor": {"type": "perspective", "fov": 5, "to_world": to_world, "film": film},
        "light": {"type": "constant"},
        "ball": {"type": "sphere", "bsdf": bsdf},
    }
    return np.array(mi.render(mi.load_dict(scene), spp=64, seed=1)).mean()
