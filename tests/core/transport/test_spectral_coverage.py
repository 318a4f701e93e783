"""Wavelengths beyond the data of a scene are refused, and no others."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from specimens import both_sided, lamp

import gonio_mi as gonio
from gonio_mi.instrument.setup import set_up
from gonio_mi.settings import MeasurementSettings
from gonio_mi.specimen.loading import specimen_of

pytestmark = pytest.mark.usefixtures("spectral")


def spectrum(kind, low, high):
    """Spectrum from 0.2 at `low` to 0.6 at `high`, in nm."""
    if kind == "irregular":
        values = [(low, 0.2), (0.7 * low + 0.3 * high, 0.3), (high, 0.6)]
        return {"type": "spectrum", "value": values}
    ends = {"wavelength_min": float(low), "wavelength_max": float(high)}
    return {"type": "regular", "values": "0.2, 0.4, 0.6", **ends}


def rgb(*value):
    return {"type": "rgb", "value": list(value)}


def diffuse(reflectance):
    return {"type": "diffuse", "reflectance": reflectance}


def bitmap(channels, **settings):
    """Texture of random texels, each of them grey if it has one channel only."""
    texels = np.random.default_rng(1).uniform(0.2, 0.8, (4, 4, channels))
    image = mi.Bitmap(texels.astype(np.float32))
    return {"type": "bitmap", "bitmap": image, **settings}


def shade(kind):
    """Python texture: without a range, with one, or that ends at 700 nm unsaid."""

    class Shade(mi.Texture):
        def __init__(self, props):
            super().__init__(props)

        def eval(self, si, active=True):
            value = si.wavelengths / 2000
            if kind == "ends":
                value = dr.select(si.wavelengths <= 700, value, 0)
            return value & active

        def to_string(self):
            return "Shade[]"

    class Ranged(Shade):
        def wavelength_range(self):
            return mi.ScalarVector2f(500, 1000)

    made = Ranged if kind == "ranged" else Shade
    mi.register_texture(f"shade_{kind}", made)
    return {"type": f"shade_{kind}"}


def conductor(material):
    return {"type": "roughconductor", "material": material, "alpha": 0.3}


def chequered(one, other):
    return diffuse({"type": "checkerboard", "color0": one, "color1": other})


GREY, COLOUR = rgb(0.5, 0.5, 0.5), rgb(0.2, 0.5, 0.1)
COVERED = {
    "uniform number": (lambda: diffuse(0.4), [200, 900, 1550]),
    "uniform": (lambda: diffuse({"type": "uniform", "value": 0.4}), [200, 9000]),
    "grey": (lambda: diffuse(GREY), [300, 1550]),
    "black": (lambda: {"type": "plastic", "diffuse_reflectance": rgb(0, 0, 0)}, [1000]),
    "colour": (lambda: diffuse(COLOUR), [360, 550, 830]),
    "d65": (lambda: diffuse({"type": "d65", "scale": 0.5}), [360, 830]),
    "irregular": (lambda: diffuse(spectrum("irregular", 400, 700)), [400, 700]),
    "regular": (lambda: diffuse(spectrum("regular", 900, 1700)), [900, 1700]),
    "aluminium": (lambda: conductor("Al"), [299, 550, 885.6]),
    "perfect mirror": (lambda: conductor("none"), [1550]),
    "glass": (lambda: {"type": "roughdielectric", "int_ior": "bk7"}, [1550]),
    "principled": (lambda: {"type": "principled", "base_color": GREY}, [250, 1550]),
    "grey bitmap": (lambda: diffuse(bitmap(1)), [1550]),
    "raw bitmap": (lambda: diffuse(bitmap(1, raw=True)), [1550]),
    "normal map": (
        lambda: {
            "type": "normalmap",
            "normalmap": bitmap(3, raw=True),
            "b": diffuse(0.5),
        },
        [1550],
    ),
    "chequered": (
        lambda: chequered(spectrum("irregular", 300, 2000), 0.5),
        [900, 1550],
    ),
    "in Python": (lambda: diffuse(shade("open")), [300, 900]),
    "in Python, ranged": (lambda: diffuse(shade("ranged")), [500, 1000]),
}

BEYOND = {
    "conductor": (
        lambda: conductor("Al"),
        900,
        "RoughConductor.eta covers the wavelengths from 298.757 to 885.601 nm, got 900",
    ),
    "gold": (
        lambda: {"type": "conductor", "material": "Au"},
        1550,
        "SmoothConductor.eta .* got 1550 nm",
    ),
    "irregular": (
        lambda: diffuse(spectrum("irregular", 360, 700)),
        300,
        "SmoothDiffuse.reflectance covers .* 360 to 700 nm, got 300 nm",
    ),
    "regular": (
        lambda: diffuse(spectrum("regular", 900, 1700)),
        None,
        "900 to 1700 nm, got 550 nm",
    ),
    "d65": (lambda: diffuse({"type": "d65", "scale": 0.5}), 831, "360 to 830"),
    "blackbody": (
        lambda: diffuse({"type": "blackbody", "temperature": 3000.0}),
        900,
        "360 to 830",
    ),
    "k alone": (
        lambda: {"type": "conductor", "eta": 1.5, "k": spectrum("irregular", 400, 700)},
        720,
        "SmoothConductor.k covers .* 400 to 700",
    ),
    "colour": (
        lambda: {"type": "roughplastic", "diffuse_reflectance": COLOUR},
        900,
        "RoughPlastic.diffuse_reflectance .* 360 to 830 nm, got 900",
    ),
    "coloured bitmap": (lambda: diffuse(bitmap(3)), 340, "got 340 nm"),
    "inside": (
        lambda: (
            {"type": "blendbsdf", "weight": 0.5}
            | {"one": both_sided(conductor("Ag")), "two": diffuse(0.5)}
        ),
        1550,
        "BlendBSDF.bsdf_0.brdf_0.eta",
    ),
    "chequered": (
        lambda: chequered(0.5, spectrum("regular", 400, 700)),
        390,
        "reflectance.color1 covers",
    ),
    "in Python, 0": (lambda: diffuse(shade("ends")), 900, "got 900 nm"),
    "in Python, ranged": (
        lambda: diffuse(shade("ranged")),
        450,
        "500 to 1000 nm, got 450",
    ),
}


@pytest.mark.parametrize("name", COVERED)
def test_covered_wavelengths(name):
    """Right inputs are not refused, at the ends of their data neither."""
    specimen, nm = COVERED[name]
    settings = MeasurementSettings().changed(wavelengths=nm)
    (found,) = set_up(specimen_of(specimen()), settings, [(30.0, 0.0)])
    assert found.settings.wavelengths == tuple(nm)


@pytest.mark.parametrize("name", BEYOND)
def test_wavelengths_beyond(name):
    """Refused by the parameter's name, its range and the wavelength, default too."""
    specimen, nm, said = BEYOND[name]
    settings = {} if nm is None else {"wavelengths": [550, nm]}
    with pytest.raises(gonio.SpecimenError, match=said):
        gonio.measure(specimen(), theta_i=30, rays=2000, **settings)


@pytest.mark.parametrize("settings", [{"trace": True}, {"estimator": "quadrature"}])
def test_wavelengths_beyond_by_any_transport(settings):
    """Traced and integrated specimens are no exception, nor other shapes."""
    for shape in ("rectangle", "sphere") if "trace" in settings else ("rectangle",):
        specimen = {"type": shape, "bsdf": conductor("Cu")}
        with pytest.raises(gonio.SpecimenError, match="got 900 nm"):
            gonio.measure(specimen, theta_i=30, wavelengths=[900], **settings)


def fresnel(cosine, eta, k):
    """Mean reflectance of a smooth conductor (Born and Wolf, section 14.2)."""
    m = (eta + 1j * k) ** 2
    root = np.sqrt(m - 1 + cosine**2)
    s = abs((cosine - root) / (cosine + root)) ** 2
    p = abs((m * cosine - root) / (m * cosine + root)) ** 2
    return (s + p) / 2


@pytest.mark.parametrize("theta_i", [0, 80])
def test_reflectance_up_to_the_ends(theta_i):
    """A mirror of given data, against Fresnel's formula; rounding of single ones."""
    nm = np.array([700.0, 1100.0, 1700.0])
    eta, k = np.array([0.6, 1.3, 1.4]), np.array([4.0, 9.5, 15.0])
    mirror = {
        "type": "conductor",
        "eta": {"type": "spectrum", "value": list(zip(nm, eta))},
        "k": {"type": "spectrum", "value": list(zip(nm, k))},
    }
    asked = [700, 900, 1100, 1500, 1700]
    record = gonio.measure(mirror, theta_i=theta_i, rays=1000, wavelengths=asked)
    truth = fresnel(
        np.cos(np.radians(theta_i)), np.interp(asked, nm, eta), np.interp(asked, nm, k)
    )
    np.testing.assert_allclose(record.dhr, truth, rtol=64 * np.finfo(np.float32).eps)
    assert record.channels == tuple(f"{x:g}nm" for x in asked)


def area(radiance):
    """Emitter above the specimen."""
    return lamp() | {"emitter": {"type": "area", "radiance": radiance}}


def test_emitter_that_is_dark_elsewhere():
    """An emitter that has no light at 550 nm lights at 450 nm."""
    blue = {"type": "spectrum", "value": [(400, 0.5), (450, 1.0), (500, 0.5)]}
    for radiance in (blue, blue | {"value": [(400, 1), (500, 1), (501, 0), (900, 0)]}):
        record = gonio.measure(
            diffuse(spectrum("regular", 400, 900)),
            emitter=area(radiance),
            rays=2000,
            wavelengths=[450, 480],
        )
        expected = np.interp([450, 480], [400, 650, 900], [0.2, 0.4, 0.6])
        np.testing.assert_allclose(record.dhr, expected, rtol=1e-5)


def test_emitter_that_is_dark_there():
    """An emitter dark at one of the wavelengths is refused, where that matters."""
    dark = {"type": "spectrum", "value": [(400, 1), (500, 1), (501, 0), (900, 0)]}
    with pytest.raises(gonio.SpecimenError, match="light the specimen at 550 nm"):
        gonio.measure(
            diffuse(0.5), emitter=area(dark), rays=100, wavelengths=[450, 550]
        )
    for emitter in (area({"type": "d65"}), {"type": "point", "position": [0, 0, 3]}):
        with pytest.raises(gonio.SpecimenError, match=r"covers .* to 830 nm, got 9"):
            gonio.measure(diffuse(0.5), emitter=emitter, rays=100, wavelengths=[900])
    flat = area({"type": "uniform", "value": 2.0})
    even = {"emission": "equal_power", "emitter": area({"type": "d65"})}
    for settings in ({"emitter": flat}, even, {"theta_i": 10}):
        record = gonio.measure(diffuse(0.5), rays=100, wavelengths=[900], **settings)
        np.testing.assert_allclose(record.dhr, 0.5, rtol=1e-6)


@pytest.mark.needs("materials")
def test_records_as_materials(tmp_path):
    """A record of some wavelengths holds between them."""
    record = gonio.measure(
        diffuse(spectrum("regular", 400, 700)),
        theta_i=[0, 40, 80],
        rays=4096,
        wavelengths=[450, 650],
    )
    record.save(tmp_path / "two.npz")
    material = {"type": "goniometric", "filename": str(tmp_path / "two.npz")}
    found = gonio.measure(material, theta_i=30, rays=1000, wavelengths=[450, 500, 650])
    assert (np.diff(found.dhr) > 0).all()
    with pytest.raises(gonio.SpecimenError, match=r"Goniometric covers .* 450 to 650"):
        gonio.measure(material, theta_i=30, rays=1000, wavelengths=[900])
