"""Specimens of instances: what a shape group holds, many times over."""

import mitsuba as mi
import numpy as np
import pytest
from budget import agree, disagree, of_total
from specimens import OnGPU, diffuse_groove_dhr

import gonio_mi as gonio
from gonio_mi.specimen import loading
from gonio_mi.specimen.specimen import Specimen

HALF_ANGLE = 30.0


def walls():
    """Transforms of a square of 2 x 2 onto both walls of a groove of width 1."""
    length = 0.5 / np.sin(np.radians(HALF_ANGLE))
    for sign in (-1, 1):
        transform = mi.ScalarTransform4f().rotate([0, 1, 0], sign * (HALF_ANGLE - 90))
        transform = transform.translate([sign * length / 2, 0, 0])
        yield transform.scale([length / 2, 0.5, 1])


def instances(shapes, transforms):
    """Scene of a group of `shapes` at each of the `transforms`."""
    scene = {"type": "scene", "group": {"type": "shapegroup", **shapes}}
    for number, transform in enumerate(transforms):
        scene[f"instance_{number}"] = {
            "type": "instance",
            "to_world": transform,
            "group": {"type": "ref", "id": "group"},
        }
    return scene


BALLS = """<scene version="3.0.0">
    <shape type="shapegroup" id="group"><shape type="sphere"/></shape>
    <shape type="instance"><ref id="group"/></shape>
    <emitter type="directional"/>
</scene>"""


def square(**bsdf):
    return {"square": {"type": "rectangle", "bsdf": {"type": "diffuse", **bsdf}}}


@pytest.mark.parametrize(
    ("theta_i", "rho", "estimator"),
    [(20, 0.7, "weighted"), (50, 0.9, "analog"), (0, 0.3, "next_event")],
)
def test_groove_of_two_instances(theta_i, rho, estimator):
    """A diffuse groove against its radiosity; twin: the square's own reflectance."""
    record = gonio.measure(
        instances(square(reflectance=rho), walls()),
        theta_i=theta_i,
        period="box",
        rays=2**17,
        estimator=estimator,
    )

    agree(of_total(record, diffuse_groove_dhr(HALF_ANGLE, theta_i, rho)))
    disagree(of_total(record, rho))
    assert "Rectangle with SmoothDiffuse" in record.settings["surface"]


def test_digest_and_flags_look_into_the_group():
    """What the group holds is part of the specimen: colours, flags, geometry."""
    common = {"theta_i": 40, "rays": 64, "hemispheres": "both"}
    plates = [mi.ScalarTransform4f().translate([x, 0, 0]) for x in (-1, 1)]
    glass = {"pane": {"type": "rectangle", "bsdf": {"type": "thindielectric"}}}
    turned = mi.ScalarTransform4f().rotate([0, 0, 1], 10)
    moved = square()["square"] | {"to_world": turned}
    specimens = [square(), square(reflectance=0.1), glass, {"square": moved}]
    settings = [
        gonio.measure(instances(shapes, plates), **common).settings
        for shapes in specimens
    ]
    assert len({each["digest"] for each in settings}) == len(specimens)
    assert settings[2]["transmission"] == "declared"
    assert settings[0]["transmission"] != "declared"


def test_same_geometry_other_group():
    """The acceleration structure that is kept belongs to the group, too."""
    scene = mi.load_dict(instances(square(), walls()), optimize=False)
    common = {"theta_i": 40, "period": "box", "rays": 2**12}
    first = gonio.measure(scene, **common)
    other = gonio.measure(instances(square(reflectance=0.2), walls()), **common)
    again = gonio.measure(scene, **common)
    assert first.dhr == again.dhr
    assert other.dhr < 0.5 * first.dhr


def test_a_scene_is_built_once_on_a_gpu(tmp_path, monkeypatch):
    """Of files too: a group in a second scene would crash there; twin: with Embree."""
    path = tmp_path / "balls.xml"
    path.write_text(BALLS)
    scene = loading.load_specimen(path)
    assert Specimen(scene).scene is not scene
    monkeypatch.setattr(loading, "mi", OnGPU())
    for specimen in (path, mi.load_file(str(path))):
        scene = loading.load_specimen(specimen)
        assert Specimen(scene).scene is scene


def test_instance_without_a_scene():
    """One instance alone has lost its group."""
    alone = {"type": "instance", "group": {"type": "shapegroup", **square()}}
    with pytest.raises(gonio.SpecimenError, match="a scene that holds its shapegroup"):
        gonio.measure(alone, theta_i=30, rays=100)


def test_medium_in_a_group():
    """What a group holds is checked like any shape."""
    filled = {"ball": {"type": "sphere", "interior": {"type": "homogeneous"}}}
    with pytest.raises(gonio.SpecimenError, match="a BSDF that transmits"):
        gonio.measure(instances(filled, [mi.ScalarTransform4f()]), theta_i=30, rays=100)
