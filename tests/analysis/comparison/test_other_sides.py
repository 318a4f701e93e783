"""Comparisons of tables with each other, and of fits with what they were not fitted to.

And one question for every source: quantities of specimens, records, tables and fits.
"""

from dataclasses import replace

import numpy as np
import pytest
from budget import agree, disagree, of_comparison, often_enough

import gonio_mi as gonio
from gonio_mi.analysis.comparison import uncertainty_budget
from gonio_mi.analysis.comparison.table_pairs import _means
from gonio_mi.analysis.points.predictions import INTEGRAL_ERR
from gonio_mi.cli import main
from gonio_mi.files.measured_table import MeasuredTable
from gonio_mi.single_precision import FEW_ROUNDINGS

# isort: split
import mitsuba as mi

METAL = {"type": "roughconductor", "alpha": 0.2, "material": "none"}
FREE = ["alpha", "specular_reflectance"]
BEAM = {"collector": "projected:8x16", "sampler": "independent"}


@pytest.fixture(autouse=True)
def grey():
    """Tables without a channel are grey."""
    mi.set_variant("llvm_ad_mono")


def table(rng=None, scale=0.0, relative=0.02, shift=0.0):
    """A grid of cosines at 30 degrees, with independent errors and a common one."""
    theta, phi = np.meshgrid(np.arange(4, 80, 8.0), np.arange(0, 360, 45.0))
    theta, phi = theta.ravel(), phi.ravel()
    value = 0.3 * np.cos(np.radians(theta)) + shift
    if rng is not None:
        common = 1 + scale * rng.normal()
        value = common * value * (1 + relative * rng.normal(size=theta.size))
    columns = np.full(theta.size, 30.0), np.zeros(theta.size), theta, phi
    stated = {"uncertainty": relative, "scale_uncertainty": scale}
    return MeasuredTable(*columns, value, quantity="brdf", **stated)


def fitted(seed=3, rays=20_000):
    """A fit of metal to rays from 60 degrees."""
    record = gonio.measure(METAL, 60, rays=rays, seed=seed, **BEAM)
    return gonio.fit(record, "roughconductor:material=none", FREE)


# -------------------------------------------------------------------------- two tables


@pytest.mark.parametrize("scale", [0.0, 0.03])
def test_two_tables_of_the_same_values_agree_as_often_as_promised(scale):
    """200 pairs with errors of their own, at 5 %; twin: errors stated a third less."""
    right, wrong = [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        pair = table(rng, scale), table(rng, scale)
        right.append(gonio.compare(*pair, alpha=0.05).passed)
        surer = [replace(one, uncertainty=0.02 / 1.5) for one in pair]
        wrong.append(gonio.compare(*surer, alpha=0.05).passed)
    agree(often_enough(right))
    disagree(often_enough(wrong))


def test_a_difference_of_two_tables_is_found_where_it_is():
    rng = np.random.default_rng(1)
    one, other = table(rng), table(rng)
    agree(of_comparison(gonio.compare(one, other)))
    value = other.value.copy()
    value[17] *= 1.5
    found = gonio.compare(one, replace(other, value=value))
    disagree(of_comparison(found))
    assert found.worst[0]["theta_o"] == other.theta_o[17]
    assert found.worst[0]["other"] == value[17]


def test_directions_that_one_table_lacks_are_left_out():
    rng = np.random.default_rng(2)
    one, other = table(rng), table(rng)
    names = ("theta_i", "phi_i", "theta_o", "phi_o", "value")
    part = replace(one, **{name: getattr(one, name)[10:] for name in names})
    found = gonio.compare(part, other)
    assert len(found.z) == len(part)
    assert any(note.startswith(f"{len(part)} of the 80") for note in found.notes)
    np.testing.assert_array_equal(found.value, part.value)
    np.testing.assert_array_equal(found.other, other.value[10:])


def repeated(one, factor):
    """A table with all of its directions once more, of other values."""
    names = ("theta_i", "phi_i", "theta_o", "phi_o")
    both = {name: np.tile(getattr(one, name), 2) for name in names}
    return replace(one, **both, value=np.r_[one.value, factor * one.value])


@pytest.mark.parametrize("place", [0, 1])
def test_values_of_one_direction_count_together(place):
    """As their mean, on either side; twin: of one of them nothing would be seen."""
    one = table()
    pair = [one, one]
    pair[place] = repeated(one, 1.1)
    found = gonio.compare(*pair)
    assert len(found.z) == len(one)
    mean = (found.value, found.other)[place]
    np.testing.assert_allclose(mean, 1.05 * one.value, rtol=1e-12)
    # 2 % each, independent
    error = (found.std_err, found.other_std_err)[place]
    np.testing.assert_allclose(error / mean, 0.02 * np.hypot(1, 1.1) / 2.1, rtol=1e-12)
    name = ("the first table", "the second table")[place]
    said = f"{name} has several values in 80 directions: their means are compared"
    assert said in found.notes
    assert found.labels == ("the first table", "the second table")
    assert not found.passed
    pair[place] = repeated(one, 1.0)
    assert gonio.compare(*pair).passed


def test_repeats_with_degrees_of_freedom_are_known_better():
    """Of 4 each, a mean of two alike has 8."""
    one = table(relative=0.0)
    sigma = np.tile(0.02 * one.value, 2)
    both = replace(repeated(one, 1.0), sigma=sigma, degrees_of_freedom=4.0)
    points = _means(both)[0]
    np.testing.assert_allclose(points.dof, 8, rtol=1e-12)
    np.testing.assert_allclose(points.std_err, 0.02 * one.value / 2**0.5, rtol=1e-12)


def test_large_uncertainties_of_tables_do_not_overflow():
    """Whose squares over the least number were beyond what numbers hold."""
    bright = replace(table(), value=1e4 * table().value)
    assert gonio.compare(bright, bright).passed
    assert not gonio.compare(bright, replace(bright, value=1.2 * bright.value)).passed


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"theta_i": np.full(80, 31.0)},
            "has none of the second table within 0.01 degrees",
        ),
        ({"quantity": "btdf", "theta_o": np.full(80, 150.0)}, "same quantity"),
        ({"channel": "550nm"}, "same channel"),
    ],
)
def test_tables_that_cannot_be_compared(changes, words):
    with pytest.raises(ValueError, match=words):
        gonio.compare(replace(table(), **changes), table())


def test_two_tables_need_an_uncertainty():
    silent = table(relative=0.0)
    with pytest.raises(ValueError, match="neither the first table nor the second"):
        gonio.compare(silent, silent)
    found = gonio.compare(silent, silent, uncertainty=0.01)
    assert found.passed
    assert found.statistics["chi2"] == 0


def test_two_tables_by_command(tmp_path, capsys):
    rng = np.random.default_rng(3)
    paths = [str(tmp_path / name) for name in ("one.csv", "other.csv")]
    for path in paths:
        table(rng, 0.01).save(path)
    budget = str(tmp_path / "budget.csv")
    assert main(["compare", *paths, "--budget", budget]) == 0
    assert "verdict     agree" in capsys.readouterr().out
    # of two tables with 1 % each, beside independent 2 %; six digits of a text
    value = gonio.read_measured(paths[1]).value
    told = np.genfromtxt(budget, names=True, delimiter=",")
    common = 0.01 * 2**0.5 * value
    np.testing.assert_allclose(told["calibration"], common, rtol=1e-5)
    np.testing.assert_allclose(told["instrument"], 0.02 * value, rtol=1e-5)
    assert main(["compare", paths[0], "diffuse"]) == 1
    assert "a table comes second" in capsys.readouterr().err
    assert main(["compare", *paths, "--rays", "100"]) == 1
    assert "--rays applies to a specimen" in capsys.readouterr().err


def test_a_table_comes_second_in_the_result(tmp_path):
    """Beside a record, and beside a specimen that is measured as the table was."""
    white = {"type": "diffuse"}
    record = gonio.measure(white, 30, rays=20_000, **BEAM)
    path = str(tmp_path / "white.csv")
    gonio.export(record, path)
    exported = gonio.read_measured(path)
    found = gonio.compare(exported, record)
    np.testing.assert_array_equal(found.z, gonio.compare(record, exported).z)
    np.testing.assert_array_equal(found.other, exported.value)
    measured = replace(table(), aperture_half_angle=2.0)
    # by groups of apertures that do not overlap
    other = np.sort(gonio.compare(measured, white).other)
    np.testing.assert_array_equal(other, np.sort(measured.value))


# --------------------------------------------------------------------------------- fits


def test_a_fit_agrees_with_other_light_from_other_directions():
    """Twin: the record of a metal that is a tenth rougher."""
    fit = fitted()
    for alpha, passes in ((0.2, agree), (0.22, disagree)):
        bsdf = METAL | {"alpha": alpha}
        record = gonio.measure(bsdf, [20, 45], rays=20_000, seed=9, **BEAM)
        found = gonio.compare(record, fit)
        passes(of_comparison(found))
        np.testing.assert_array_equal(gonio.compare(fit, record).z, found.z)
        assert found.labels[1] == "fit of roughconductor"


@pytest.mark.slow
def test_the_covariance_of_a_fit_is_in_the_comparison():
    """60 fits of few rays beside a record of many; twin: their parameters exact."""
    record = gonio.measure(METAL, 45, rays=3_000_000, seed=1, **BEAM)
    right, wrong = [], []
    for seed in range(60):
        fit = fitted(seed + 10, rays=4000)
        right.append(gonio.compare(record, fit, alpha=0.05).passed)
        exact = replace(fit, covariance=np.zeros_like(fit.covariance))
        wrong.append(gonio.compare(record, exact, alpha=0.05).passed)
    agree(often_enough(right))
    disagree(often_enough(wrong))


def test_points_of_a_fit_are_integrals_of_its_model():
    """To the errors of integrals; its roots, of one parameter, are derivatives."""
    white = {"type": "diffuse", "reflectance": 0.5}
    record = gonio.measure(white, 30, rays=10_000, estimator="analog", **BEAM)
    fit = gonio.fit(record, "diffuse")
    relative = fit.std_errs[0] / fit.values[0]
    for like in (record, table()):
        points = fit.points(like)
        np.testing.assert_allclose(points.value, fit.values[0] / np.pi, rtol=2e-4)
        # single precision of both ends of a difference
        rtol = 2 * FEW_ROUNDINGS / relative
        np.testing.assert_allclose(points.roots[0], relative * points.value, rtol=rtol)


def test_a_fit_and_its_own_data_are_no_strangers():
    fit = fitted(rays=4000)
    (note,) = [n for n in gonio.compare(fit.record, fit).notes if "fitted" in n]
    assert note.startswith("roughconductor was fitted to these values")
    again = gonio.measure(METAL, 45, rays=4000, seed=3, **BEAM)
    notes = gonio.compare(again, fit).notes
    assert any("roughconductor and the record have the seed 3" in n for n in notes)


def test_a_near_collector_is_told():
    """Of a fit to it, and of a comparison; twin: from a point it is as far away."""
    near = BEAM | {"rays": 20_000, "collector_radius": 4.0, "seed": 7}
    record = gonio.measure(METAL, 60, footprint=1.0, **near)
    point = gonio.measure(METAL, 60, footprint="point", **near)
    said = "the collector is 4 away from a footprint (1.0), and the model's light"
    fit = fitted()
    assert any(said in note for note in gonio.compare(record, fit).notes)
    assert not any(said in note for note in gonio.compare(point, fit).notes)
    (note,) = gonio.fit(record, "roughconductor:material=none", FREE).notes
    assert note.startswith(said)
    assert f"note: {said}" in str(gonio.fit(record, "roughconductor", FREE))
    assert gonio.fit(point, "roughconductor:material=none", FREE).notes == ()


def test_a_fit_beside_another_wavelength_is_told():
    """Of a record and of a table; twin: of the same one there is nothing to say."""
    mi.set_variant("llvm_ad_spectral")
    white = {"type": "diffuse", "reflectance": 0.5}
    records = [
        gonio.measure(white, 30, rays=2000, seed=nm, wavelengths=[nm], **BEAM)
        for nm in (550, 650)
    ]
    fit = gonio.fit(records[0], "diffuse")
    again = gonio.measure(white, 45, rays=2000, seed=1, wavelengths=[550], **BEAM)
    said = "and may change what is measured: channels 650nm and 550nm"
    notes = [
        " ".join(gonio.compare(one, fit).notes)
        for one in (
            records[1],
            replace(table(), channel="650nm"),
            again,
            replace(table(), channel="550nm"),
        )
    ]
    assert [said in one for one in notes] == [True, True, False, False]


def test_a_fit_beside_another_order_is_told():
    fit = fitted()
    record = gonio.measure(METAL, 45, rays=2000, seed=9, order="1", **BEAM)
    assert any("order 1 and" in note for note in gonio.compare(record, fit).notes)


def test_a_fit_beside_a_table():
    """In both orders; two fits have no directions."""
    fit = fitted()
    measured = table()
    value = fit.points(measured).value
    measured = replace(measured, value=value * (1 + 0.02 * np.sin(np.arange(80.0))))
    one, other = gonio.compare(fit, measured), gonio.compare(measured, fit)
    assert one.passed
    assert other.passed
    # a few roundings, relative to 2 % of a value
    np.testing.assert_allclose(one.z, -other.z, atol=FEW_ROUNDINGS / 0.02)
    assert not gonio.compare(replace(measured, value=1.3 * value), fit).passed
    budget = uncertainty_budget(one)
    np.testing.assert_array_equal(budget.rays, one.std_err)
    with pytest.raises(TypeError, match="a fit is compared with a record or a table"):
        gonio.compare(fit, fit)
    with pytest.raises(TypeError, match="a fit is compared with a record or a table"):
        gonio.compare(METAL, fit)


# --------------------------------------------------------------- one question for all


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """The same Lambertian by its specimen, a record, a table and a fit; another one."""
    mi.set_variant("llvm_ad_mono")
    path = str(tmp_path_factory.mktemp("sources") / "white.csv")
    found = []
    for reflectance in (0.5, 0.6):
        white = {"type": "diffuse", "reflectance": reflectance}
        settings = BEAM | {"rays": 20_000, "estimator": "analog"}
        records = [gonio.measure(white, 30, seed=s, **settings) for s in (1, 2, 3)]
        gonio.export(records[1], path)
        measured, fit = gonio.read_measured(path), gonio.fit(records[2], "diffuse")
        found.append({"specimen": white, "record": records[0]})
        found[-1] |= {"table": measured, "fit": fit}
    return found


# What has no directions of its own.
ANYWHERE = ("specimen", "fit")


@pytest.mark.parametrize("second", ["specimen", "record", "table", "fit"])
@pytest.mark.parametrize("first", ["specimen", "record", "table", "fit"])
def test_any_two_are_compared(first, second, sources):
    """In either order, if one has directions; twin: of another reflectance."""
    right, wrong = sources
    if first in ANYWHERE and second in ANYWHERE:
        with pytest.raises(TypeError):
            gonio.compare(right[first], right[second])
        return
    agree(of_comparison(gonio.compare(right[first], right[second])))
    disagree(of_comparison(gonio.compare(right[first], wrong[second])))


@pytest.mark.parametrize("source", ["specimen", "record", "table"])
def test_any_of_them_is_fitted(source, sources):
    fit = gonio.fit(sources[0][source], "diffuse")
    # patches without noise are off by what their integrals may be
    assert abs(fit.values[0] - 0.5) < 5 * np.nan_to_num(fit.std_errs[0]) + INTEGRAL_ERR


def test_every_source_has_quantities():
    """0.5 of a Lambertian: its specimen, a record, a table and a fit."""
    white = {"type": "diffuse", "reflectance": 0.5}
    record = gonio.measure(white, 0, rays=20_000, seed=2, **BEAM)
    fit = gonio.fit(record, "diffuse")
    theta, phi = np.meshgrid(np.arange(0, 90, 3.0), np.arange(0, 360, 30.0))
    theta, phi = theta.ravel(), phi.ravel()
    columns = np.zeros(theta.size), np.zeros(theta.size), theta, phi
    value = np.full(theta.size, 0.5 / np.pi)
    grid = MeasuredTable(*columns, value, quantity="brdf", scale_uncertainty=0.01)
    sources = {"rays": (white, record), "calibration": (grid,), "parameters": (fit,)}
    for part, of in sources.items():
        for source in of:
            found = gonio.quantity("dhr", source)
            low, high = found.interval
            assert low <= 0.5 <= high or abs(found.value - 0.5) < 5 * found.std_err
            assert part in found.parts
            assert set(found.to_dict()["parts"]) == set(found.parts)


def test_a_record_tells_its_own_quantities():
    record = gonio.measure(METAL, 0, rays=2000, **BEAM)
    assert gonio.quantity("dhr", record).value == record.quantity("dhr").value
    for given in ({"rays": 10}, {"phi_i": 30}):
        with pytest.raises(TypeError, match=f"{min(given)} applies to a specimen"):
            gonio.quantity("dhr", record, **given)
    with pytest.raises(ValueError, match="needs light from"):
        gonio.quantity("gloss60", record)
