"""Gloss and so on of measured tables, against integrals of the models they are of."""

import json
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from budget import agree, disagree, often_enough
from closed_forms import eval_flux, fresnel

import gonio_mi as gonio
from gonio_mi.analysis.points import Points
from gonio_mi.cli import main
from gonio_mi.collector.directions import direction
from gonio_mi.files.measured_table import MeasuredTable

# isort: split
import mitsuba as mi

GLOSSY = {"type": "roughplastic", "alpha": 0.2}
WHITE = 0.5
AROUND_MIRROR = (np.arange(50, 71, 2.0), np.arange(160, 201, 2.5))
HEMISPHERE = (np.arange(0, 81, 5.0), np.arange(0, 360, 15.0))


def table_of(bsdf, theta_i, rings, sectors, **stated):
    """Table of a grid of directions: `eval` of a BSDF, or of a grey Lambertian."""
    theta, phi = (a.ravel() for a in np.meshgrid(rings, sectors, indexing="ij"))
    value = np.full(theta.size, WHITE / np.pi)
    if bsdf is not None:
        wo = direction(np.radians(theta), np.radians(phi))
        value = eval_flux(bsdf, theta_i, 0, wo)[:, 0] / np.abs(wo[:, 2])
    columns = np.full(theta.size, float(theta_i)), np.zeros(theta.size), theta, phi
    quantity = "btdf" if theta.max() > 90 else "brdf"
    return MeasuredTable(*columns, value, quantity=quantity, **stated)


@pytest.fixture(scope="module")
def glossy():
    """Table about the mirror direction at 60 degrees, without noise."""
    mi.set_variant("llvm_ad_mono")
    return table_of(mi.load_dict(GLOSSY), 60, *AROUND_MIRROR)


def rectangle(theta, phi, along, across, n):
    """Directions of a focal plane's rectangle, Gauss-Legendre, and solid angles."""
    x, w = np.polynomial.legendre.leggauss(n)
    u = np.tan(np.radians(along) / 2) * x[:, None]
    v = np.tan(np.radians(across) / 2) * x
    norm = np.sqrt(1 + u**2 + v**2)
    local = np.stack([u / norm, v / norm, 1 / norm], axis=-1)
    theta, phi = np.radians([theta, phi])
    frame = [direction(theta + np.pi / 2, phi), [-np.sin(phi), np.cos(phi), 0]]
    scale = np.tan(np.radians(along) / 2) * np.tan(np.radians(across) / 2)
    solid = np.outer(w, w) * scale / norm**3
    return (local @ [*frame, direction(theta, phi)]).reshape(-1, 3), solid.ravel()


def gloss60(bsdf):
    """Flux of the source in the receptor over that of black glass, times 100."""
    wo, solid = rectangle(60, 180, 4.4, 11.7, 24)
    light, weight = rectangle(60, 0, 0.75, 2.5, 4)
    flux = glass = 0.0
    for wi, part in zip(light, weight / weight.sum()):
        angles = np.degrees([np.arccos(wi[2]), np.arctan2(wi[1], wi[0])])
        flux += part * eval_flux(bsdf, *angles, wo)[:, 0] @ solid
        glass += part * fresnel(wi[2], 1.567)
    return 100 * flux / glass


# ------------------------------------------------------------------------ coverage


@pytest.mark.slow
def test_gloss_of_a_tables_noise_and_calibration(glossy):
    """Intervals of 100 noisy tables hold the model's gloss; twin: a model 3 % rougher.

    The values have independent errors of 2 % and a common factor of 1 %.
    """
    truth, other = (gloss60(mi.load_dict(GLOSSY | {"alpha": a})) for a in (0.2, 0.206))
    rng = np.random.default_rng(0)
    found = []
    for _ in range(100):
        errors = 1 + 0.02 * rng.normal(size=len(glossy)) + 0.01 * rng.normal()
        stated = {"uncertainty": 0.02, "scale_uncertainty": 0.01}
        noisy = replace(glossy, value=glossy.value * errors, **stated)
        found.append(gonio.quantity("gloss60", noisy))
    low, high = np.transpose([one.interval for one in found])
    agree(often_enough((low < truth) & (truth < high)))
    disagree(often_enough((low < other) & (other < high)))
    # and of chance alone: the scatter of the values is what is stated of them
    spread = np.std([one.value for one in found], ddof=1)
    typical = np.mean([one.std_err for one in found])
    assert 0.75 < spread / typical < 1.3  # chi of 99, 4 standard errors
    assert not 0.75 < spread / (2 * typical) < 1.3


def test_gloss_of_a_table_without_noise(glossy):
    """Within what interpolation leaves open; twin: a rougher model is not."""
    found = gonio.quantity("gloss60", glossy)
    truth, other = (gloss60(mi.load_dict(GLOSSY | {"alpha": a})) for a in (0.2, 0.206))
    assert abs(found.value - truth) < found.unresolved < 0.03 * truth
    assert abs(found.value - other) > found.unresolved
    assert found.std_err == 0
    assert "of which +- " in str(found)
    assert "by interpolation, source" in str(found)
    assert "states no uncertainty" in str(found)


@pytest.mark.slow
def test_haze_of_a_table(glossy):  # noqa: ARG001
    """Transmitted light of rough glass, as rays tell; twin: another roughness."""
    glass = {"type": "roughdielectric", "alpha": 0.3}
    table = table_of(mi.load_dict(glass), 0, np.arange(96, 181, 2.0), HEMISPHERE[1])
    found = gonio.quantity("haze", table)
    truth = gonio.quantity("haze", glass, rays=2**18)
    off = abs(found.value - truth.value)
    assert off < found.unresolved + 6 * truth.std_err < 2
    other = gonio.quantity("haze", glass | {"alpha": 0.1}, rays=2**18)
    assert abs(found.value - other.value) > found.unresolved + 6 * other.std_err


# -------------------------------------------------------- what a table does not cover


def lambertian(theta_i, keep=None, **stated):
    """Table of a grey Lambertian over most of the hemisphere."""
    table = table_of(None, theta_i, *HEMISPHERE, **stated)
    if keep is None:
        return table
    wo = direction(np.radians(table.theta_o), np.radians(table.phi_o))
    names = ("theta_i", "phi_i", "theta_o", "phi_o", "value")
    return replace(table, **{name: getattr(table, name)[keep(wo)] for name in names})


@pytest.mark.parametrize(
    ("name", "theta_i", "expected"),
    [
        ("45/0", 45, WHITE),
        ("0/45", 0, WHITE),
        ("brf:theta_i=60,theta_o=20,phi_o=90", 60, WHITE),
        ("8/di", 8, WHITE),
        ("dhr:theta_i=30", 30, WHITE),
        ("8/de", 8, WHITE * (1 - np.sin(np.radians(5)) ** 2 * np.cos(np.radians(8)))),
        ("R_L:entrance=-40,observation=1", 40, WHITE / np.pi * np.cos(np.radians(40))),
        ("tis", 0, 1 - (np.sin(np.radians(2.5)) / np.sin(np.radians(70))) ** 2),
    ],
)
def test_a_lambertian_table(name, theta_i, expected):
    """Exact but for the points of the integrals, 1e-3; twin: 1 % of scale."""
    found = gonio.quantity(name, lambertian(theta_i, scale_uncertainty=0.01))
    assert found.value == pytest.approx(expected, rel=1e-3)
    assert found.interval[0] < expected < found.interval[1]
    # a common factor leaves a ratio as it is
    scale = 0 if name == "tis" else 0.01 * found.value
    assert found.std_err == pytest.approx(scale, rel=1e-6, abs=1e-9)


def test_directions_beyond_a_table_are_told():
    """Those beyond 80 degrees: the nearest values stand for them, as uncertain."""
    found = gonio.quantity("dhr:theta_i=30", lambertian(30))
    part = np.cos(np.radians(80)) ** 2  # of the projected solid angle, or a little more
    assert WHITE * part < found.parts["missing"] < 1.3 * WHITE * part
    assert found.interval[1] == pytest.approx(found.value + found.parts["missing"])
    assert "missing directions" in str(found)
    assert "is beyond the table's directions" in found.notes[-1]


@pytest.mark.parametrize(("size", "missing"), [(2, False), (25, True)])
def test_a_hole(size, missing):
    """Without one direction neighbours are next to it; without many there is a hole."""
    axis = direction(np.radians(45), np.radians(180))
    low = np.cos(np.radians(size))
    table = lambertian(45, lambda wo: wo @ axis < low)
    name = "brf:theta_i=45,theta_o=45,receptor=10"
    if missing:
        match = r"covers 0 % of that projected solid angle and misses 100 %"
        with pytest.raises(ValueError, match=match):
            gonio.quantity(name, table)
    else:
        assert gonio.quantity(name, table).value == pytest.approx(WHITE, rel=1e-3)


BAD = [
    ("gloss60", 45, {}, "needs light from theta_i 60 degrees, but the nearest of the"),
    ("haze", 0, {}, "needs transmitted light, got reflected light"),
    ("di/8", 8, {}, "needs light from all directions, got 1 of the table"),
    ("8/di", 8, {"phi_i": 90}, r"azimuth of incidence of the table \(0\), got 90"),
    ("8/di", 8, {"rays": 100}, "rays applies to a specimen, got a table"),
    ("brf:theta_o=88,receptor=3", 45, {}, "covers 0 % of that projected solid angle"),
    ("gloss", 20, {}, "gloss at 60 degrees needs light from theta_i 60"),
]


@pytest.mark.parametrize(("name", "theta_i", "settings", "message"), BAD)
def test_what_a_table_cannot_tell(name, theta_i, settings, message):
    with pytest.raises((ValueError, TypeError), match=message):
        gonio.quantity(name, lambertian(theta_i), **settings)


def test_rings_about_a_pole_without_a_value():
    """Middles of rings of 4 degrees, as of patch means; twin: a hole of 14 degrees."""
    sectors = np.arange(2.5, 360, 5.0)
    table = table_of(None, 45, np.arange(2, 60, 4.0), sectors)
    assert gonio.quantity("45/0", table).value == pytest.approx(WHITE, rel=1e-3)
    table = table_of(None, 45, np.arange(14, 60, 4.0), sectors)
    with pytest.raises(ValueError, match="covers 0 % of that"):
        gonio.quantity("45/0", table)


@pytest.mark.parametrize(
    ("keep", "part", "hint"),
    [
        (lambda wo: wo[:, 1] >= 0, "covers 50", "add it, if the specimen is isotropic"),
        (lambda wo: wo[:, 1] == 0, "covers 0 %", "its directions lie in one plane"),
    ],
)
def test_half_a_table_and_one_plane(keep, part, hint):
    """Twins: the half with its mirror image, the plane with an aperture."""
    table, name = lambertian(45), "brf:theta_i=45,theta_o=20,phi_o=180,receptor=10"
    half = lambertian(45, lambda wo: keep(np.round(wo, 9)))
    with pytest.raises(ValueError, match=f"{part}.*{hint}"):
        gonio.quantity(name, half)
    wide = replace(half, aperture_half_angle=6) if "plane" in hint else table
    assert gonio.quantity(name, wide).value == pytest.approx(WHITE, rel=1e-3)


def test_a_record_is_no_table():
    with pytest.raises(ValueError, match="the table that export writes of it"):
        gonio.quantity("gloss60", synthetic.record())


def test_a_lobe_between_directions_is_refused(glossy):
    """Neighbours that differ by a factor of 3 resolve no lobe; twin: a wider one."""
    sharp = mi.load_dict(GLOSSY | {"alpha": 0.02})
    with pytest.raises(ValueError, match="whose directions resolve the light"):
        gonio.quantity("gloss60", table_of(sharp, 60, *AROUND_MIRROR))
    assert gonio.quantity("gloss60", glossy).value > 0


def test_one_direction_and_its_aperture():
    """An instrument of one detector as wide as the receptor; twin: a narrower one."""
    row = [45], [0], [0], [0], [WHITE / np.pi]
    table = MeasuredTable(*row, aperture_half_angle=5, emitter_half_angle=5)
    found = gonio.quantity("45/0", table)
    assert found.value == pytest.approx(WHITE, rel=1e-6)
    with pytest.raises(ValueError, match=r"covers 36.1 % of that"):
        gonio.quantity("45/0", replace(table, aperture_half_angle=3))


def test_repeated_values_count_together():
    """Four times the same directions: half the independent error, the same scale."""
    table = lambertian(45, uncertainty=0.1, scale_uncertainty=0.01)
    names = ("theta_i", "phi_i", "theta_o", "phi_o", "value")
    four = replace(table, **{name: np.tile(getattr(table, name), 4) for name in names})
    once, often = (gonio.quantity("45/0", one) for one in (table, four))
    assert often.value == pytest.approx(once.value, rel=1e-9)
    assert often.parts["values"] == pytest.approx(once.parts["values"] / 2, rel=1e-6)
    assert often.parts["calibration"] == pytest.approx(once.parts["calibration"])


def test_covariance_of_sums_of_points():
    """Exact up to rounding: of the whole matrix; and Welch's degrees of freedom."""
    rng = np.random.default_rng(1)
    value, std_err = rng.normal(size=5), rng.uniform(1, 2, 5)
    points = Points(value, std_err, rng.normal(size=(2, 5)), dof=np.full(5, 7.0))
    whole = np.diag(std_err**2) + points.roots.T @ points.roots
    weights = rng.normal(size=(3, 5))
    np.testing.assert_allclose(points.covariance(weights), weights @ whole @ weights.T)
    alone = replace(points, roots=np.zeros((0, 5)))
    assert alone.dof_of(np.eye(5)[0]) == pytest.approx(7)
    assert alone.dof_of(np.ones(5) / std_err) == pytest.approx(35)


def test_command(glossy, tmp_path, capsys):
    """One command states gloss of a file; options of specimens are refused."""
    path = str(tmp_path / "table.csv")
    glossy.save(path)
    words = ["quantity", "gloss60", path, "--uncertainty", "0.03"]
    assert main(words) == 0
    text = capsys.readouterr().out
    assert text.startswith("gloss60: ")
    assert " GU +- " in text
    assert "values of the table" in text
    assert main([*words, "--scale-uncertainty", "0.01", "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    # to how far linear weights are from smooth interpolation
    scale = 0.01 * found["value"]
    assert found["parts"]["calibration"] == pytest.approx(scale, rel=0.02)
    for more in (["--rays", "100"], ["--size", "2"], ["--bsdf", "diffuse"]):
        assert main([*words, *more]) == 1
        assert f"{more[0]} applies to a specimen" in capsys.readouterr().err
    assert main(["quantity", "8/di", "diffuse", "--uncertainty", "0.1"]) == 1
    assert "--uncertainty applies to tables only" in capsys.readouterr().err


# ------------------------------------------------------------------------------- fits


METAL = {"type": "roughconductor", "alpha": 0.2, "material": "none"}


@pytest.mark.slow
def test_gloss_of_a_fit_against_draws_of_its_parameters():
    """The spread of 100 models of a fit's covariance; twin: errors twice as large."""
    mi.set_variant("llvm_ad_mono")
    settings = {"rays": 20_000, "collector": "projected:8x16", "seed": 3}
    record = gonio.measure(METAL, 60, sampler="independent", **settings)
    free = ["alpha", "specular_reflectance"]
    fit = gonio.fit(record, "roughconductor:material=none", free)
    found = fit.quantity("gloss60")
    rng, models = np.random.default_rng(0), []
    wo, solid = rectangle(60, 180, 4.4, 11.7, 8)
    for values in rng.multivariate_normal(fit.values, fit.covariance, 100):
        bsdf = mi.load_dict(fit.model.bsdf(values))
        models.append(eval_flux(bsdf, 60, 0, wo)[:, 0] @ solid)
    spread = np.std(models, ddof=1) / np.mean(models) * found.value
    # of 100 draws an error of 7 %, at 5 standard errors
    assert abs(found.parts["parameters"] / spread - 1) < 0.35
    assert abs(2 * found.parts["parameters"] / spread - 1) > 0.35
    assert found.parts["rays"] < 0.2 * found.parts["parameters"]
    truth, far = (gloss60(mi.load_dict(METAL | {"alpha": a})) for a in (0.2, 0.22))
    assert abs(found.value - truth) < 5 * found.std_err < abs(found.value - far)


def test_a_parameter_at_its_limit_is_noted():
    """It moves nothing; a step beyond a limit is taken to the other side."""
    mi.set_variant("llvm_ad_mono")
    white = {"type": "diffuse", "reflectance": 0.5}
    settings = {"collector": "projected:2x4", "rays": 2000}
    settings |= {"estimator": "analog", "sampler": "independent"}
    fit = gonio.fit(gonio.measure(white, 30, **settings), "diffuse")
    found = fit.quantity("8/di")
    assert found.value == pytest.approx(fit.values[0], rel=1e-5)
    assert found.parts["parameters"] == pytest.approx(fit.std_errs[0], rel=1e-3)
    unknown = replace(fit, covariance=np.array([[np.nan]]))
    found = unknown.quantity("8/di")
    assert found.parts["parameters"] == 0
    assert "the uncertainty of reflectance is not known" in found.notes[0]
    with pytest.raises(ValueError, match="needs a fit that `fit` has made"):
        replace(fit, model=None).quantity("8/di")
