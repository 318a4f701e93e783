"""Settings and specimens that were measured wrongly, or crashed: one sentence each."""

import warnings

import gonio_mi as gonio

# isort: split
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from budget import agree, disagree, normal_scores, single
from specimens import diffuse_groove_dhr

from gonio_mi.cli import main
from gonio_mi.instrument.incidence import USUAL_ANGLES, incident_angles
from gonio_mi.specimen import specimen_text

PLATE = {"type": "diffuse", "reflectance": 0.5}


def groove(place=(0, 0, 0), half_angle=30.0, rho=0.7):
    """Two diffuse walls of a groove of width 1, with its valley at `place`."""
    scene = {"type": "scene"}
    length = 0.5 / np.sin(np.radians(half_angle))
    for sign in (-1, 1):
        transform = mi.ScalarTransform4f().translate(list(place))
        transform = transform.rotate([0, 1, 0], sign * (half_angle - 90))
        transform = transform.translate([sign * length / 2, 0, 0])
        scene[f"wall_{1 + sign}"] = {
            "type": "rectangle",
            "to_world": transform.scale([length / 2, 0.5, 1]),
            "bsdf": {"type": "diffuse", "reflectance": rho},
        }
    return scene


def score(record, reference):
    """Normal score of a reflectance from batches."""
    t = (record.dhr[0] - reference) / record.dhr_std_err[0]
    return float(normal_scores(t, record.settings["batches"] - 1))


# ------------------------------------------------------------------ few rays, variants


@pytest.mark.parametrize(
    ("sampler", "estimator"),
    [
        *(("sobol", "weighted"), ("sobol", "next_event"), ("independent", "analog")),
        *(("independent", "next_event"), ("multijitter", "weighted")),
    ],
)
def test_batches_of_one_ray(sampler, estimator):
    """Traced batches of one ray end: one alone, and sixteen of them."""
    common = {"theta_i": 30, "period": "box", "sampler": sampler}
    for rays in (1, 16):
        record = gonio.measure(groove(), rays=rays, estimator=estimator, **common)
        assert record.ledger.emitted == rays
        assert record.tallies[0].n_batches == rays


def test_one_ray_is_the_first_of_a_longer_batch():
    """The lane that is added changes no number of the others."""
    one = gonio.measure(PLATE, theta_i=30, rays=1, batches=1, trace=True)
    two = gonio.measure(PLATE, theta_i=30, rays=2, batches=1, trace=True)
    first = np.argwhere(one.tallies[0].hits)
    assert len(first) == 1
    assert two.tallies[0].hits[tuple(first[0])] >= 1


@pytest.mark.usefixtures("variant")
def test_analog_estimator_in_any_variant():
    """Counted rays in a groove against its radiosity; twin: the walls' reflectance."""
    record = gonio.measure(
        groove(), theta_i=20, period="box", rays=2**17, estimator="analog"
    )
    agree(single(score(record, diffuse_groove_dhr(30, 20, 0.7))))
    disagree(single(score(record, 0.7)))


@pytest.mark.usefixtures("spectral")
def test_analog_estimator_of_channels():
    """The same at several wavelengths, each of its own reflectance."""
    rho = {"type": "spectrum", "value": [(400, 0.2), (800, 0.9)]}
    record = gonio.measure(
        groove(rho=rho),
        theta_i=20,
        period="box",
        rays=2**17,
        estimator="analog",
        wavelengths=[400, 500, 600, 700, 800],
    )
    for channel, own in enumerate(np.linspace(0.2, 0.9, 5)):
        t = record.dhr[channel] - diffuse_groove_dhr(30, 20, own)
        t /= record.dhr_std_err[channel]
        agree(single(float(normal_scores(t, 15))))


# ------------------------------------------------------------------------ hair


def fibre(**hair):
    turn = mi.ScalarTransform4f().rotate([0, 1, 0], 90).scale([0.1, 0.1, 1])
    return {"type": "cylinder", "to_world": turn, "bsdf": {"type": "hair", **hair}}


def test_hair_in_colour(variant):
    """Its absorption or its pigments are what tells it from others."""
    settings = {"theta_i": 30, "rays": 2000}
    given = [{"sigma_a": 0.2}, {"sigma_a": 0.3}]
    if variant == "llvm_ad_mono":
        with pytest.raises(gonio.SpecimenError, match="the BSDF Hair fails in the var"):
            gonio.measure(fibre(), **settings)
    else:
        given += [{}, {"eumelanin": 0.1}, {"pheomelanin": 0.1}]
    records = [gonio.measure(fibre(**each), **settings) for each in given]
    assert len({record.settings["digest"] for record in records}) == len(given)
    assert all((record.dhr > 0).all() for record in records)


def test_colour_of_one_number():
    grey = {"type": "rgb", "value": 0.05}
    name = specimen_text.specimen_name({"type": "diffuse", "reflectance": grey})
    assert name == "diffuse:reflectance=0.05"


# ---------------------------------------------------------- plugins that raise


@pytest.mark.parametrize("shape", ["rectangle", "sphere"])
@pytest.mark.parametrize("nested", [False, True])
def test_plugin_that_raises(shape, nested):
    """Its own error, whose traceback names the line, wherever it stands."""

    class Moody(mi.BSDF):
        def __init__(self, props):
            super().__init__(props)
            self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
            self.m_components = [self.m_flags]
            self.calm = False

        def sample(self, *_):
            if self.calm:
                return dr.zeros(mi.BSDFSample3f), mi.Spectrum(0)
            raise ZeroDivisionError("of what")

        def eval(self, *_):
            return mi.Spectrum(0)

        def pdf(self, *_):
            return mi.Float(0)

        def eval_pdf(self, *_):
            return mi.Spectrum(0), mi.Float(0)

        def to_string(self):
            return "Moody[]"

    mi.register_bsdf("moody", Moody)
    bsdf = mi.load_dict({"type": "moody"})
    try:
        specimen = {"type": "twosided", "bsdf": bsdf} if nested else bsdf
        with pytest.raises(ZeroDivisionError, match="of what") as caught:
            gonio.measure({"type": shape, "bsdf": specimen}, theta_i=30, rays=100)
        assert caught.traceback[-1].name == "sample"
    finally:
        bsdf.calm = True  # Dr.Jit asks every BSDF that is still alive


# ------------------------------------------------------------------- geometry


def flat(x, y, z=0.0):
    """Rectangle of these half widths."""
    scale = mi.ScalarTransform4f().translate([0, 0, z]).scale([x, y, 1])
    return {"type": "rectangle", "to_world": scale, "bsdf": PLATE}


def triangle(*corners):
    mesh = mi.Mesh("triangle", 3, 1)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.ravel(corners).astype(np.float32)
    parameters["faces"] = [0, 1, 2]
    parameters.update()
    return mesh


@pytest.mark.parametrize(
    "specimen",
    [
        lambda: triangle([1, 1, 1], [1, 1, 1], [1, 1, 1]),
        lambda: triangle([0, 0, 0], [1, 0, 0], [2, 0, 0]),
        lambda: triangle([0, 0, 0], [0, 1, 0], [0, 0, 1]),
        lambda: flat(1, 0),
        lambda: flat(1e-30, 1e-30),
        lambda: flat(1e20, 1e20),
        lambda: {"type": "sphere", "radius": 1e-25},
    ],
    ids=["point", "line", "upright", "no width", "atom", "galaxy", "tiny sphere"],
)
@pytest.mark.parametrize("trace", [False, True])
def test_collapsed_geometry(specimen, trace):
    """Nothing to light, or nothing that single precision resolves."""
    with pytest.raises(gonio.SpecimenError, match="must be at least 1e-09 scene units"):
        gonio.measure(specimen(), theta_i=30, rays=100, trace=trace)


@pytest.mark.parametrize(
    ("scale", "trace"),
    [
        (1e-9, False),
        (1e-9, True),
        (1e-4, False),
        (1e5, True),
        (4e8, False),
        (4e8, True),
    ],
)
def test_geometry_of_any_sensible_size(scale, trace):
    """All light of a white plate comes back, but for the rounding of a weight."""
    plate = flat(scale, scale) | {"bsdf": {"type": "diffuse", "reflectance": 1.0}}
    record = gonio.measure(plate, theta_i=30, rays=4096, trace=trace)
    np.testing.assert_allclose(record.dhr, 1, rtol=4 * np.finfo(np.float32).eps)


@pytest.mark.parametrize(
    ("place", "half_angle", "theta_i", "rho"),
    [
        ((1e4, 0, 0), 30, 20, 0.7),
        ((0, -2e4, 0), 15, 10, 0.8),
        ((6e3, 8e3, 0), 45, 30, 0.9),
        ((0, 0, 2e4), 30, 40, 0.5),
    ],
)
def test_specimen_far_from_the_origin(place, half_angle, theta_i, rho):
    """A warning gives a bound of what rounding does there; it holds.

    Twin: without it, the error is beyond chance.
    """
    settings = {"theta_i": theta_i, "period": "box", "rays": 2**17}
    with pytest.warns(RuntimeWarning, match="move it to the origin") as warned:
        record = gonio.measure(groove(place, half_angle, rho), **settings)
    bound = float(str(warned[0].message).split("by up to ")[1].split()[0])
    truth = diffuse_groove_dhr(half_angle, theta_i, rho)
    error, std_err = abs(record.dhr[0] - truth), record.dhr_std_err[0]
    agree(single(max(0.0, error - bound * truth) / std_err))
    disagree(single(error / std_err))


@pytest.mark.parametrize("place", [(0, 0, 0), (3, -2, 1), (20, 0, 0)])
def test_specimen_near_the_origin(place):
    """There it is as exact as anywhere, and no warning."""
    record = gonio.measure(groove(place), theta_i=20, period="box", rays=2**17)
    agree(single(score(record, diffuse_groove_dhr(30, 20, 0.7))))


# -------------------------------------------------------------------- settings


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"trace": "false"}, "trace must be a boolean, true or false, got 'false'"),
        ({"trace": 1}, "trace must be a boolean"),
        ({"theta_i": True}, "theta_i must be an angle in degrees .* got True"),
        ({"theta_i": [10, np.True_]}, "theta_i must be an angle"),
        ({"phi_i": False}, "phi_i must be a finite angle in degrees, got False"),
        ({"footprint": True}, "footprint must be"),
        ({"period": True}, "period must be"),
        ({"sampler": "diffuse"}, "sampler must be a Mitsuba sampler, got SmoothDiff"),
        (
            {"sampler": {"type": "hdrfilm"}},
            "sampler must be a Mitsuba sampler, got HDR",
        ),
        (
            {"estimator": "next_event", "collector": "apertures:2@0/0"},
            "got a flat rectangle: take quadrature",
        ),
    ],
)
def test_settings_in_one_sentence(settings, said):
    """Each was measured as something else, crashed, or sent the user in a circle."""
    with pytest.raises((TypeError, ValueError), match=said):
        gonio.measure(PLATE, **({"theta_i": 30, "rays": 100} | settings))


def test_remedies_are_possible():
    """What these refusals advise is measured; the plate has 1 / pi times 1 / 2."""
    common = {"theta_i": 30, "rays": 2**16, "collector": "apertures:4@0/0,50/90"}
    traced = {"estimator": "next_event", "trace": True}
    for settings in ({}, traced, {"estimator": "quadrature"}):
        record = gonio.measure(PLATE, **common, **settings)
        t = record.brdf[:2, 0, 0] - 0.5 / np.pi
        t /= np.maximum(record.brdf_std_err[:2, 0, 0], 1e-6)
        for each in t:
            agree(single(float(normal_scores(each, 15))))


def test_sampler_of_a_scene_file():
    """No plugin of another kind is taken for a sampler, nor is it passed over."""
    with pytest.raises(
        RuntimeError, match=r"collector\.odd must be a sampler, got Smoo"
    ):
        mi.load_dict({"type": "collector", "film": {"type": "patches"}, "odd": PLATE})


# ---------------------------------------------------------------- angles in radians


@pytest.mark.parametrize("given", [0.785, 0.7854, [0, 0.785], np.radians([5, 45])])
def test_angles_in_radians_are_warned_of(given):
    said = "theta_i is in degrees, but 0.785.* looks like 45 degrees in radians"
    with pytest.warns(RuntimeWarning, match=said):
        incident_angles(given, 0)


def test_small_angles_in_degrees_are_not_taken_for_radians():
    """Exact: none of any step in hundredths; 18 in 1570 of thousandths."""
    incident_angles(np.arange(158) / 100, 0)
    for one in (0.2666, 1e-5, 1 / 3, 45.0, np.pi / 2, [0.785, 1.0], [0.785, 30], 0):
        incident_angles(one, 0)
    warned = 0
    for one in np.arange(1, 1571) / 1000:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            incident_angles(round(float(one), 3), 0)
        warned += len(caught)
    assert warned == len(USUAL_ANGLES) - 1  # 55 degrees are 0.96


# ---------------------------------------------------------------- words for specimens


@pytest.mark.needs("materials")
@pytest.mark.needs("exchange")
def test_material_file_in_one_word(tmp_path, monkeypatch, capsys):
    """A plugin's setting may end in .xml; a scene file may be absent."""
    monkeypatch.chdir(tmp_path)
    record = gonio.measure(PLATE, theta_i=[0, 45], rays=4096, collector="klems")
    for name in ("metal.npz", "metal.exr"):
        record.save(name)
        word = f"goniometric:filename={name}"
        assert main(["measure", word, "--theta-i", "30", "--rays", "1000"]) == 0
    (tmp_path / "metal.xml").write_text("<scene/>")
    for word, said in (
        (
            "goniometric:filename=metal.xml",
            "metal.xml: it is not a Radiance WindowElement",
        ),
        ("metal_.xml", "there is no file metal_.xml"),
    ):
        assert main(["measure", word, "--theta-i", "30"]) == 1
        assert said in capsys.readouterr().err


# ------------------------------------------------------------------- whole numbers


@pytest.mark.parametrize("name", ["rr_depth", "max_depth", "max_scatterings"])
@pytest.mark.parametrize("trace", [False, True])
def test_whole_numbers_as_large_as_32_bits(name, trace, capsys):
    """The largest is measured with; the next ones are refused in one sentence."""
    settings = {"rays": 64, "batches": 2, "trace": trace}
    record = gonio.measure(PLATE, 30, **settings, **{name: 2**31})
    assert record.ledger.reflected + record.ledger.absorbed == 64
    for value in (2**31 + 1, 2**32, 2**63, 10**30, -(2**31)):
        with pytest.raises(ValueError, match=f"^{name} must be at (most|least) "):
            gonio.measure(PLATE, 30, **settings, **{name: value})
    option = "--" + name.replace("_", "-")
    assert main(["measure", "diffuse", "--theta-i", "30", option, "4294967296"]) == 1
    assert f"{name} must be at most 2.15e+09, got 4294967296" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["threads", "executor"])
@pytest.mark.parametrize("value", [-1, 2**32, 2**63])
def test_workers_and_threads_that_cannot_be(name, value):
    with pytest.raises(ValueError, match=f"^{name} must be at (most|least) "):
        gonio.campaign({"plate": PLATE}, [0], rays=64, **{name: value})
