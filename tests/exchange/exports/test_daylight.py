"""Records of wavelengths as visible and solar light, in tables and in BSDF files."""

import importlib
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import synthetic
from budget import agree, disagree, normal_scores, verdict
from closed_forms import slab

import gonio_mi as gonio
from gonio_mi import cli
from gonio_mi.collector.klems import Klems
from gonio_mi.exchange.exports import exporting
from gonio_mi.exchange.exports.daylight import (
    SOLAR,
    VISIBLE,
    VISIBLE_NM,
    incandescent,
    of_daylight,
)
from gonio_mi.exchange.formats import radiance

EPS = np.finfo(float).eps

# Seven digits in the file.
DIGITS = 1e-6

# Between two of these there is no more than half of either kind of light.
ALL_NM = (300, 450, 540, 600, 699, 701, 1000, 2494)

# Four times more up to 700 nm than beyond: of glass, and of paint.
SHORT, LONG = 0.8, 0.2
SPECTRUM = {
    "type": "irregular",
    "wavelengths": "300,699.9,700.1,2500",
    "values": f"{SHORT},{SHORT},{LONG},{LONG}",
}
GLASS = {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0}
GLASS["specular_transmittance"] = SPECTRUM
PAINT = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": SPECTRUM}}
FILE = {"basis": "klems-quarter", "wavelengths": ALL_NM}


def of_step(light):
    """Closed form: what the step is in a kind of light; at 700 nm it is a half."""
    return LONG + (SHORT - LONG) * light.parts @ np.heaviside(700 - light.nm, 0.5)


# --------------------------------------------------------------------------- tables


@pytest.mark.usefixtures("spectral")
def test_visible_light_is_that_of_mitsubas_tables():
    """The published product beside CIE's tables as Mitsuba has them."""
    d65 = mi.load_dict({"type": "d65"})
    si = dr.zeros(mi.SurfaceInteraction3f, 1)
    parts = []
    for nm in VISIBLE.nm.tolist():
        si.wavelengths = mi.Spectrum(nm)
        parts.append(np.ravel(mi.cie1931_y(mi.Float(nm)) * d65.eval(si)[0])[0])
    parts = np.array(parts) / np.sum(parts)
    # ISO's table stands for intervals of 10 nm, these for their middles: the error of
    # the midpoint rule, h^2 f''/24 with f'' about f / (42 nm)^2 at the peak
    rounding = VISIBLE.parts.max() * 10**2 / 42**2 / 24 + 1e-6
    assert np.abs(parts - VISIBLE.parts).max() <= rounding
    assert np.abs(np.roll(parts, 1) - VISIBLE.parts).max() > 10 * rounding


def test_sunlight_has_the_published_ordinates():
    """ASTM E891-87, table 3: a fiftieth of the power about each of 50 wavelengths."""
    published = {0: 361.2, 9: 536.4, 19: 681.4, 29: 861.5, 39: 1189.0, 45: 1638.4}
    whole = 768.3  # W/m2 up to 4045 nm, of which the table has 756.5
    steps = np.diff(SOLAR.nm) / 2
    # the parts are by the trapezoidal rule, a half on either side of a wavelength
    widths = np.append(0, steps) + np.append(steps, 0)
    power = SOLAR.parts / widths
    cumulative = np.append(0, np.cumsum((power[1:] + power[:-1]) * steps)) * 756.5
    found = np.interp(list(published.values()), SOLAR.nm, cumulative) / whole
    wanted = (2 * np.array(list(published)) + 1) / 100
    # both powers are rounded to 0.1 W/m2, and wavelengths to 0.1 nm, each of which has
    # up to 1.1 W/m2
    rounding = (2 * 0.05 + 0.05 * 1.1) / whole
    assert np.abs(found - wanted).max() <= rounding
    assert np.abs(found * (1 + 3 * rounding) - wanted).max() > rounding


@pytest.mark.parametrize("light", [VISIBLE, SOLAR], ids=["visible", "solar"])
def test_weights_are_of_lines_between_wavelengths(light):
    nm = np.array([2000, 450, 550, 650, 650, 800.0, 300])
    weights = light.weights(nm)
    assert abs(weights.sum() - 1) <= len(light.nm) * EPS
    assert weights[3] == weights[4]
    line = np.interp(light.nm, np.sort(nm), 3 + np.sort(nm) / 100)
    exact = light.parts @ line
    assert abs(weights @ (3 + nm / 100) - exact) <= 9 * len(light.nm) * EPS * exact


def test_wavelengths_that_do_not_stand_for_light_are_refused():
    VISIBLE.check(np.array(VISIBLE_NM))
    VISIBLE.check(np.array([450, 550, 650.0]))
    SOLAR.check(np.array(ALL_NM))
    with pytest.raises(ValueError, match="at least 95% of solar light, got 39"):
        SOLAR.check(np.array(VISIBLE_NM))
    with pytest.raises(ValueError, match=r"of visible light between.*500 and 600 nm"):
        VISIBLE.check(np.array([300, 400, 500, 600, 2500.0]))
    with pytest.raises(ValueError, match="at least 95% of visible light, got"):
        VISIBLE.check(np.array([700, 800.0]))


# -------------------------------------------------------------------------- records


@pytest.mark.filterwarnings("ignore:the file has no block Solar")
def test_errors_know_that_wavelengths_share_rays():
    """Those of the weighted sums; of a weighted sum of equal channels the channel's."""
    record = synthetic.record(channels=("450nm", "550nm", "650nm"), power=4)
    (seen,), _ = of_daylight([record])
    weights = VISIBLE.weights(np.array([450, 550, 650.0]))
    assert seen.channels == ("Y",)
    assert np.allclose(seen.brdf[..., 0], record.brdf @ weights, rtol=1e-12)
    (tally,) = record.tallies
    tally = tally.of_each_channel(lambda one: np.repeat(one[..., :1], 3, axis=-1))
    grey = replace(record, tallies=(tally,))
    (seen,), _ = of_daylight([grey])
    one = grey.brdf_std_err[..., 0]
    assert np.allclose(seen.brdf_std_err[..., 0], one, rtol=1e-9, equal_nan=True)
    assert np.allclose(seen.dhr_std_err, grey.dhr_std_err[0], rtol=1e-9)


@pytest.mark.usefixtures("spectral")
def test_a_step_of_reflectance_is_in_both_blocks(tmp_path):
    """Every ray has the weight, so that nothing but rounding is left."""
    path = tmp_path / "step.xml"
    records = gonio.bsdf(PAINT, path, **FILE, rays=64)
    assert list(records) == ["front", "back", "solar front", "solar back"]
    with open(path, "rb") as stream:
        blocks = radiance.read(stream)
    assert {name for name, _ in blocks} == {"Visible", "Solar"}
    projected = Klems("quarter").projected_solid_angles
    for name, light, other in (("Visible", VISIBLE, SOLAR), ("Solar", SOLAR, VISIBLE)):
        for side in ("Back", "Front"):
            found = (blocks[name, f"Reflection {side}"] * projected).sum(axis=0)
            assert np.abs(found - of_step(light)).max() <= DIGITS
            assert np.abs(found - of_step(other)).min() > 1e4 * DIGITS
    text = path.read_text()
    assert text.count(">ASTM E891 Table 1 Direct AM1_5.ssp<") == 2
    assert text.count(">CIE Illuminant D65 1nm.ssp<") == 2
    # records of wavelengths, exported, say the same
    same = {"incident": "klems-quarter", "collector": "klems-quarter", "rays": 64}
    sides = [
        gonio.measure(PAINT, **same, side=side, seed=seed, wavelengths=ALL_NM)
        for seed, side in enumerate(["front", "back"])
    ]
    exporting.export(sides, path, "klems-quarter")
    with open(path, "rb") as stream:
        again = radiance.read(stream)
    assert all(np.array_equal(again[key], blocks[key]) for key in blocks)


@pytest.mark.usefixtures("spectral")
def test_a_step_of_transmittance_has_its_weights():
    """Times Fresnel's formulas, with the standard errors of the weighted records."""
    theta_i = np.arange(0, 80, 10)
    spectral = {"wavelengths": ALL_NM, "rays": 2**12, "sampler": "independent"}
    record = gonio.measure(GLASS, theta_i, collector="klems-quarter", **spectral)
    clear = np.array([1 - slab(cosine, 1.5) for cosine in np.cos(np.radians(theta_i))])
    (visible,), (solar,) = of_daylight([record])
    for seen, light, other in ((visible, VISIBLE, SOLAR), (solar, SOLAR, VISIBLE)):
        for kind, judge in ((light, agree), (other, disagree)):
            t = (seen.dht[:, 0] - of_step(kind) * clear) / seen.dht_std_err[:, 0]
            judge(verdict(normal_scores(t, seen.n_batches - 1)))


@pytest.mark.usefixtures("spectral")
def test_wavelengths_of_visible_light_make_no_solar_block(tmp_path):
    """They are the default; what is not visible is refused before it is measured."""
    path = tmp_path / "matt.xml"
    matt = {"type": "twosided", "bsdf": {"type": "diffuse"}}
    with pytest.warns(RuntimeWarning, match="no block Solar: wavelengths must hold"):
        records = gonio.bsdf(matt, path, "klems-quarter", rays=16)
    assert list(records) == ["front", "back"]
    for words, message in (
        ({"wavelengths": [450, 550]}, "at least 95% of visible light"),
        ({"solar": {"type": "diffuse"}}, "at least 95% of solar light"),
    ):
        with pytest.raises(ValueError, match=message):
            gonio.bsdf("is not even loaded", path, **words)


# --------------------------------------------------------------- campaigns of a file


@pytest.fixture
def measured(monkeypatch):
    """Directions that campaigns measure; the task of the 60th is interrupted."""
    module = importlib.import_module("gonio_mi.campaigns.tasks")
    measure, seen = module.measure_each, []

    def measure_each(specimen, incidents, **settings):
        before = len(seen)
        seen.extend([settings["side"]] * len(incidents))
        if before < 60 <= len(seen):
            raise KeyboardInterrupt
        return measure(specimen, incidents, **settings)

    monkeypatch.setattr(module, "measure_each", measure_each)
    return seen


def test_an_interrupted_file_goes_on(tmp_path, capsys, measured):
    """From the folder: only what is missing is measured, and the bits are the same."""
    whole, folder = tmp_path / "whole.xml", tmp_path / "blind"
    words = ["bsdf", "diffuse:reflectance=0.4", "--basis", "klems-quarter"]
    words += ["--rays", "64", "-q"]
    assert cli.main([*words, "-o", str(whole)]) == 0
    words += ["-o", str(tmp_path / "a.xml"), "--folder", str(folder)]
    with pytest.raises(SystemExit) as stopped:
        cli.main(words)
    assert stopped.value.code == 2
    assert f"{folder} holds what was finished" in capsys.readouterr().err
    assert not (tmp_path / "a.xml").exists()
    kept = sum(len(gonio.load(path)) for path in (folder / "back").glob("*.npz"))
    assert measured.count("back") > kept > 10
    measured[:] = [None] * 100
    assert cli.main(words) == 0
    assert measured[100:] == ["back"] * (41 - kept)
    assert (tmp_path / "a.xml").read_bytes() == whole.read_bytes()
    capsys.readouterr()
    assert cli.main(["show", str(folder / "back.npz")]) == 0
    assert "klems-quarter" in capsys.readouterr().out


@pytest.mark.usefixtures("spectral")
def test_one_wavelength_is_told_to_be_all_that_is_seen(tmp_path, capsys):
    words = ["bsdf", "diffuse", "--basis", "klems-quarter", "--rays", "16"]
    words += ["--variant", "llvm_ad_spectral", "--wavelengths", "550"]
    assert cli.main([*words, "-o", str(tmp_path / "a.xml")]) == 0
    assert "klems-quarter as at 550nm, no block Solar" in capsys.readouterr().out


def test_illuminant_a_has_its_chromaticity():
    """x = 0.44758, y = 0.40745 (ISO/CIE 11664-2), rounded; twin: D65 is bluer.

    By sums where Mitsuba's table of the observer has its entries, every 5 nm.
    """
    light = incandescent()
    nm = light.nm[::5]
    observer = np.array(mi.cie1931_xyz(mi.Float(nm.tolist())), dtype=float)
    x, y, z = (observer / observer[1]) @ light.parts[::5]
    assert [round(c / (x + y + z), 5) for c in (x, y)] == [0.44758, 0.40745]
    x, y, z = (observer / observer[1]) @ np.interp(nm, VISIBLE.nm, VISIBLE.parts)
    assert x / (x + y + z) < 0.33
