"""Parameters are found with honest uncertainties, and a wrong model is told."""

import json
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from budget import agree, disagree, normal_scores, single, verdict

import gonio_mi as gonio
from gonio_mi.analysis.fitting.figure import fit_figure
from gonio_mi.analysis.fitting.least_squares import (
    FREE,
    REL_STEP,
    FittedModel,
    LoadedModel,
)
from gonio_mi.analysis.fitting.observations import smoothed
from gonio_mi.analysis.points.predictions import INTEGRAL_ERR
from gonio_mi.cli import main
from gonio_mi.collector.directions import direction
from gonio_mi.commands.arguments import variant_of
from gonio_mi.errors import SettingError, SpecimenError
from gonio_mi.files.measured_table import MeasuredTable
from gonio_mi.specimen.specimen_text import parse_specimen

# isort: split
import drjit as dr
import mitsuba as mi

METAL = {
    "type": "roughconductor",
    "material": "none",
    "distribution": "ggx",
    "alpha": 0.3,
    "specular_reflectance": 0.8,
}
MODEL = "roughconductor:distribution=ggx"
DIFFUSE = {"type": "diffuse", "reflectance": 0.5}
N_FITS = 8

# Convergence: record and prediction are integrals, each right to INTEGRAL_ERR.
INTEGRALS = 2 * INTEGRAL_ERR

# Rounding: values of a BSDF in single precision, of some 16 operations each, and steps
# of the search, which ends below them.
SINGLE = 16 * np.finfo(np.float32).eps


def measured(bsdf, theta_i=40, phi_i=0, **settings):
    settings = {"collector": "projected:4x8", "rays": 20_000} | settings
    return gonio.measure(bsdf, theta_i, phi_i, **settings)


@pytest.fixture(scope="module")
def fits():
    """Fits of records of independent rays, counted one by one."""
    mi.set_variant("llvm_ad_mono")
    settings = {"sampler": "independent", "estimator": "analog"}
    records = [measured(METAL, seed=seed, **settings) for seed in range(N_FITS)]
    return [gonio.fit(one, "roughconductor:distribution=ggx") for one in records]


def pulls(fits, truth):
    """Normal scores of what was found, of which the error has 15 degrees of freedom."""
    each = [(one.values - truth) / one.std_errs for one in fits]
    return normal_scores(np.array(each), 15)


def test_uncertainties_are_honest(fits):
    """What is found scatters about the truth as its error bars say; twin: 5 % off."""
    truth = np.array([METAL[name] for name in fits[0].names])
    for right, wrong in zip(pulls(fits, truth).T, pulls(fits, 1.05 * truth).T):
        agree(verdict(right))
        disagree(verdict(wrong))


def test_residual_is_noise_for_the_right_model_only(fits):
    """Chi-square of all fits; twin: the same records with the other distribution."""

    def score(fits):
        dof = sum(one.dof for one in fits)
        return (sum(one.chi2 for one in fits) - dof) / np.sqrt(2 * dof)

    agree(single(score(fits)))
    other = gonio.fit(fits[0].record, "roughconductor:distribution=beckmann")
    disagree(single(score([other])))
    assert "does not follow the record within its noise" in str(other)
    assert "does not follow" not in str(fits[0])
    assert other.misplaced > 2 * fits[0].misplaced


@pytest.mark.parametrize(
    ("known", "truth"),
    [
        ("diffuse", {"reflectance": 0.4}),
        (
            "roughconductor:specular_reflectance=0.8,distribution=ggx",
            {"alpha_u": 0.4, "alpha_v": 0.2},
        ),
        ("roughdielectric", {"alpha": 0.35, "int_ior": 1.6}),
        ("roughplastic:int_ior=1.5", {"alpha": 0.25, "diffuse_reflectance": 0.4}),
        (
            "principled",
            {"base_color": 0.6, "roughness": 0.5, "metallic": 0.3, "specular": 0.4},
        ),
    ],
    ids=lambda x: x.partition(":")[0] if isinstance(x, str) else "",
)
def test_every_model_is_found_from_integrals(known, truth):
    """Convergence: from a record without noise, to the error of its integrals."""
    fixed = parse_specimen(known)
    phi_i = [0, 90] if "alpha_u" in truth else 0
    record = measured(fixed | truth, 50, phi_i, estimator="quadrature")
    found = gonio.fit(record, fixed, list(truth))
    assert found.names == tuple(truth)
    expected = list(truth.values())
    assert np.allclose(found.values, expected, rtol=INTEGRALS, atol=0), str(found)


def table_of(bsdf, **settings):
    """Table of a BSDF in directions, by its own `eval`, without any noise."""
    theta_o, phi_o = (a.ravel() for a in np.meshgrid(np.arange(0, 80, 10), [0, 70]))
    columns = []
    for theta_i in (10, 50):
        frame = mi.SurfaceInteraction3f()
        frame.wi = mi.Vector3f(direction(np.radians(theta_i), 0.0).tolist())
        wo = direction(np.radians(theta_o), np.radians(phi_o))
        value = mi.load_dict(bsdf).eval(mi.BSDFContext(), frame, mi.Vector3f(wo.T))
        values = np.array(value[0]) / wo[:, 2]
        columns.append((np.full(16, theta_i), 0 * theta_o, theta_o, phi_o, values))
    columns = [np.concatenate(parts) for parts in zip(*columns)]
    return MeasuredTable(*columns, **settings)


def test_a_table_is_fitted_in_its_directions():
    """Rounding: a table without noise gives what it was made of, and says it exactly.

    Twin: the same values taken for means over wide apertures are of another roughness,
    by a hundred times that.
    """
    found = gonio.fit(table_of(METAL), "roughconductor:distribution=ggx")
    assert np.allclose(found.values, [0.3, 0.8], rtol=SINGLE, atol=0)
    assert found.scatter <= SINGLE
    assert found.to_dict()["scatter"] == found.scatter
    assert np.allclose(found.prediction.bsdf, found.record.bsdf, rtol=SINGLE, atol=0)
    wide = table_of(METAL, aperture_half_angle=10)
    assert gonio.fit(wide, "roughconductor:distribution=ggx").values[0] < 0.297


# A narrow lobe over a diffuse base: a table in and beside the lobe, with 0.5 % noise.
GLOSSY = {"type": "roughplastic", "distribution": "ggx", "alpha": 0.005}
GLOSSY |= {"int_ior": 1.49, "diffuse_reflectance": 0.3}


def glossy_table(seed):
    angles = np.r_[np.arange(0, 80, 10), 19, 19.5, 20.5, 21]
    wo = direction(np.radians(angles), np.pi)
    frame = mi.SurfaceInteraction3f()
    frame.wi = mi.Vector3f(direction(np.radians(20), 0.0).tolist())
    value = mi.load_dict(GLOSSY).eval(mi.BSDFContext(), frame, mi.Vector3f(wo.T))
    exact = np.array(value[0]) / wo[:, 2]
    noise = np.random.default_rng(seed).standard_normal(exact.size)
    own, column = exact * (1 + 0.005 * noise), np.full(exact.size, 20.0)
    return MeasuredTable(
        column,
        0 * column,
        angles,
        column * 9,
        own,
        quantity="brdf",
        sigma=0.005 * exact,
    )


def test_a_peak_far_above_the_rest_is_found_with_honest_errors():
    """Scores of both parameters; twins: errors ten times narrower, and a bad start.

    A part of 1e-4 of the mean value would be 3 times what the base is known to.
    """
    known = {k: GLOSSY[k] for k in ("type", "distribution", "int_ior")}
    scores = []
    for seed in range(N_FITS):
        table = glossy_table(seed)
        found = gonio.fit(table, known, ["alpha", "diffuse_reflectance"])
        off = found.values - [GLOSSY[name] for name in found.names]
        scores.append(off / found.std_errs)
    agree(verdict(scores))
    disagree(verdict(10 * np.array(scores)))
    assert 3 * found.std_errs[1] < 1e-4 * np.abs(table.value).mean()
    lost = gonio.fit(
        table, known, ["alpha", "diffuse_reflectance"], start={"alpha": 0.4}
    )
    assert lost.reduced_chi2 > 100 * found.reduced_chi2


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ({"x": 0.1}, "start must be one of alpha, specular_reflectance, got 'x'"),
        ({"alpha": 2}, "start of alpha must be from 0.001 to 1, got 2"),
    ],
)
def test_a_start_that_is_none_is_one_sentence(start, message):
    with pytest.raises(SettingError, match=message):
        gonio.fit(table_of(METAL), MODEL, start=start)


@pytest.mark.parametrize("quantity", ["brdf", "btdf"])
def test_a_table_of_patch_means_is_fitted_as_such(quantity, tmp_path):
    """Convergence: as the integrals it holds; twin: as points it is another alpha."""
    model, bsdf = "roughconductor:distribution=ggx", METAL
    if quantity == "btdf":
        model = "roughdielectric:distribution=ggx"
        bsdf = {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.3}
    record = measured(bsdf, estimator="quadrature", rays=None, hemispheres="both")
    gonio.export(record, tmp_path / "a.csv")
    (path,) = [
        one
        for one in sorted(tmp_path.iterdir())
        if gonio.read_measured(one).quantity == quantity
    ]
    table = replace(gonio.read_measured(path), sigma=None)
    alpha = gonio.fit(table, model).values[0]
    assert np.isclose(alpha, 0.3, rtol=INTEGRALS, atol=0)
    of_points = gonio.fit(replace(table, header={}), model).values[0]
    assert not np.isclose(of_points, 0.3, rtol=10 * INTEGRALS, atol=0)


def test_uncertainties_of_few_repetitions_are_larger():
    """By the variance of Student's t with 5 degrees of freedom, 5/3.

    Rounding: of derivatives, by differences of values in single precision over a step;
    and the floor of 1e-4 of the mean beside 5 % of the least value, squared.
    """
    exact = table_of(METAL)
    noise = 0.05 * np.random.default_rng(5).standard_normal(len(exact))
    table = replace(exact, value=exact.value * (1 + noise), sigma=0.05 * exact.value)
    few, many = (
        gonio.fit(
            replace(table, degrees_of_freedom=n), "roughconductor:distribution=ggx"
        )
        for n in (5, None)
    )
    floor = 1e-4 * table.value.mean() / (0.05 * exact.value.min())
    rounding = np.finfo(np.float32).eps / REL_STEP + floor**2
    assert np.isclose(few.chi2, many.chi2 * 3 / 5, rtol=rounding)
    assert np.allclose(few.std_errs, many.std_errs * (5 / 3) ** 0.5, rtol=rounding)


@pytest.mark.parametrize("stated", [True, False])
def test_uncertainties_of_tables_are_honest(stated):
    """Normal scores over 30 tables with noise of 5 %; twin: 5 % off.

    Those of a table that states nothing have the 30 degrees of freedom of its points.
    """
    exact = table_of(METAL, uncertainty=0.05 * stated)
    noise = np.random.default_rng(3).standard_normal((30, len(exact)))
    each = []
    for row in noise:
        noisy = replace(exact, value=exact.value * (1 + 0.05 * row))
        each.append(gonio.fit(noisy, "roughconductor:distribution=ggx"))
    for factor, judge in ((1, agree), (1.05, disagree)):
        pulls = [
            (one.values - factor * np.array([0.3, 0.8])) / one.std_errs for one in each
        ]
        scores = np.array(pulls) if stated else normal_scores(np.array(pulls), 30)
        for column in scores.T:
            judge(verdict(column))


def test_a_common_factor_makes_a_reflectance_uncertain():
    """Its 10 % are those of the reflectance, and none of the roughness's.

    Rounding: of derivatives, by differences of values in single precision over a step.
    """
    known = [
        gonio.fit(
            table_of(METAL, uncertainty=0.01, scale_uncertainty=scale),
            "roughconductor:distribution=ggx",
        )
        for scale in (0.0, 0.1)
    ]
    without, with_ = (one.std_errs for one in known)
    derivatives = np.finfo(np.float32).eps / REL_STEP
    assert np.isclose(with_[0], without[0], rtol=derivatives)
    assert np.isclose(with_[1], np.hypot(without[1], 0.08), rtol=derivatives)
    assert without[1] < 0.08 / 10, "twin: without the factor it is far more certain"


def test_apertures_of_a_record_are_fitted(tmp_path):
    """Normal scores, and the twin; its prediction by another rule of integration."""
    axes = tuple(
        (theta, phi) for theta in (20.0, 40.0, 60.0) for phi in (0.0, 90.0, 180.0)
    )
    cones = gonio.Apertures(8.0, axes)
    records = [
        gonio.measure(METAL, 40, collector=cones, rays=2**14, seed=seed)
        for seed in range(N_FITS)
    ]
    fits = [gonio.fit(one, "roughconductor:distribution=ggx") for one in records]
    truth = np.array([0.3, 0.8])
    for right, wrong in zip(pulls(fits, truth).T, pulls(fits, 1.05 * truth).T):
        agree(verdict(right))
        disagree(verdict(wrong))
    fits[0].plot(tmp_path / "a.png")
    # flux fractions of the detectors, by two programs' rules of integration
    flux = fits[0].prediction.flux_fraction.ravel()[: cones.n_detectors]
    assert np.allclose(fits[0].predicted, flux, rtol=1e-4)
    assert not np.allclose(fits[1].predicted, flux, rtol=1e-4)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"emitter_half_angle": 1}, "emitter_half_angle of 1 degrees"),
        ({"value": np.zeros(32)}, "all values of the table are 0"),
        ({"value": np.linspace(-1, 0.9, 32)}, "negative on average"),
        (
            {"theta_o": np.linspace(100, 180, 32), "quantity": "btdf"},
            r"must send light to where .* \(btdf\)",
        ),
    ],
)
def test_tables_that_cannot_be_fitted(settings, message):
    """Of no light, or not of the light that the model sends."""
    with pytest.raises(SettingError, match=message):
        gonio.fit(replace(table_of(METAL), **settings), "diffuse")


@pytest.mark.parametrize("uncertainty", [0.0, 0.01])
def test_as_many_parameters_as_values_are_refused(uncertainty):
    table = gonio.MeasuredTable(
        [30, 30], [0, 0], [20, 40], [180, 180], [0.5, 0.4], uncertainty=uncertainty
    )
    with pytest.raises(SettingError, match=r"needs more than 2 values, got 2"):
        gonio.fit(table, "roughconductor:distribution=ggx")
    assert gonio.fit(table, "diffuse").dof == 1


def test_a_table_needs_a_variant_of_one_channel(rgb):  # noqa: ARG001
    angles = np.array([10.0, 40.0])
    with pytest.raises(SettingError, match="needs the variant llvm_ad_mono"):
        gonio.fit(MeasuredTable(angles, 0 * angles, *[angles] * 3), "diffuse")


def test_what_is_told_of_a_table_is_as_if_it_said_it():
    """Exact; what it says of its aperture itself counts, as in `compare`."""
    told = {"uncertainty": 0.02, "aperture_half_angle": 5.0}
    model = "roughconductor:distribution=ggx"
    says = gonio.fit(table_of(METAL, scale_uncertainty=0.01, **told), model)
    is_told = gonio.fit(table_of(METAL), model, scale_uncertainty=0.01, **told)
    assert np.array_equal(is_told.values, says.values)
    assert np.array_equal(is_told.covariance, says.covariance)
    assert not np.array_equal(says.values, gonio.fit(table_of(METAL), model).values)
    again = gonio.fit(says.record, model, aperture_half_angle=1.0)
    assert np.array_equal(again.values, says.values)
    with pytest.raises(SettingError, match="uncertainty applies to tables only"):
        gonio.fit(measured({"type": "diffuse"}, rays=2000), "diffuse", uncertainty=0.1)


@pytest.mark.parametrize("name", FREE)
def test_a_colour_that_is_changed_is_as_loaded(name, rgb):  # noqa: ARG001
    """Exact: the same bits for all but the colours that were changed meanwhile."""
    model = FittedModel({"type": name}, None, ("R", "G", "B"))
    held = LoadedModel(model)
    start = model.starts()[0]
    colours = np.array(["." in one.name for one in model.parameters])
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0.6, 0, 0.8)
    wo = mi.Vector3f(*direction(np.linspace(0.1, 3, 20), np.full(20, 2.5)).T)
    for share in (1.0, 0.6, 0.9):
        values = np.where(colours, start * share, start)
        fresh = mi.load_dict(model.bsdf(values))
        each = [
            bsdf.eval(mi.BSDFContext(), si, wo).numpy()
            for bsdf in (held.bsdf(values), fresh)
        ]
        assert np.array_equal(*each)
        assert each[0].any()
    other = start * np.where(colours, 1, 0.9)
    assert (held.bsdf(other) is held.bsdf(start)) == bool(colours.all())


def test_command_fits_a_table(tmp_path, capsys):
    table_of(METAL, uncertainty=0.02).save(tmp_path / "a.csv")
    model = "roughconductor:distribution=ggx"
    outputs = [str(tmp_path / name) for name in ("a.png", "b.csv")]
    assert main(["fit", str(tmp_path / "a.csv"), model, "-o", *outputs]) == 0
    said = capsys.readouterr().out
    assert "points differ by" in said
    assert "closest" not in said  # of one
    assert len(gonio.read_measured(outputs[1])) == 32
    table_of(METAL).save(tmp_path / "exact.csv")
    assert main(["fit", str(tmp_path / "exact.csv"), "diffuse", model]) == 0
    said = capsys.readouterr().out
    assert said.startswith("closest of 2 models, by scatter about the model:\n")
    assert main(["fit", str(tmp_path / "a.csv"), model, "-o", "b.npz"]) == 1
    named = tmp_path / "named.csv"
    text = (tmp_path / "a.csv").read_text().replace(",value", ",BRDF*cos")
    named.write_text(text.replace("# quantity: brdf\n", ""))
    said = ["--quantity", "brdf", "--json"]
    told = ["--uncertainty", "0.1", "--scale-uncertainty", "0"]
    told += ["--aperture-half-angle", "1"]
    assert main(["fit", str(named), "diffuse", *said, *told]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)[0]["scatter"] is None
    assert json.loads(out)[0]["bsdf"]["type"] == "diffuse"
    assert "the values are brdf, as specified" in err


def test_colours_have_a_value_in_each_channel(rgb):  # noqa: ARG001
    """Convergence, as above; and the dictionary is one that Mitsuba loads."""
    colour = {"type": "rgb", "value": [0.2, 0.5, 0.7]}
    record = measured(
        {"type": "roughconductor", "material": "none", "alpha": 0.3}
        | {"specular_reflectance": colour},
        collector="projected:3x4",
        estimator="quadrature",
    )
    found = gonio.fit(record, "roughconductor")
    assert found.names[1:] == tuple(f"specular_reflectance.{c}" for c in "RGB")
    assert np.allclose(found.values, [0.3, 0.2, 0.5, 0.7], rtol=INTEGRALS, atol=0)
    assert found.prediction.channels == ("R", "G", "B")
    assert np.allclose(found.prediction.dhr, record.dhr, rtol=INTEGRALS, atol=0)


def test_a_grey_record_takes_no_coloured_model(rgb):  # noqa: ARG001
    """Its one channel is no more the red of a model than the green."""
    record = measured({"type": "diffuse"}, collector="projected:3x4")
    assert record.channels == ("Y",)
    with pytest.raises(SettingError, match=r"one channel.* and the model is coloured"):
        gonio.fit(record, "roughconductor:material=Au")
    grey = gonio.fit(record, "diffuse")
    assert grey.names == ("reflectance",)
    # convergence, as above: each ray has the weight 1/2, so that the total has no noise
    assert np.isclose(grey.values[0], 0.5, rtol=INTEGRALS)
    # and so in apertures
    cones = gonio.Apertures(8.0, ((20.0, 0.0), (50.0, 90.0)))
    record = measured({"type": "diffuse"}, collector=cones)
    with pytest.raises(SettingError, match=r"one channel.* and the model is coloured"):
        gonio.fit(record, "roughconductor:material=Au")
    assert gonio.fit(record, "diffuse").names == ("reflectance",)


@pytest.mark.usefixtures("spectral")
def test_three_wavelengths_are_no_colour():
    """One value for all: convergence, as above."""
    metal = {"type": "roughconductor", "material": "none", "alpha": 0.3}
    record = measured(
        metal | {"specular_reflectance": 0.6},
        collector="projected:3x4",
        estimator="quadrature",
        wavelengths=[450, 550, 650],
    )
    found = gonio.fit(record, "roughconductor")
    assert found.names == ("alpha", "specular_reflectance")
    assert np.allclose(found.values, [0.3, 0.6], rtol=INTEGRALS, atol=0)
    assert found.prediction.channels == record.channels


def test_a_colour_stays_within_what_mitsuba_loads(rgb):  # noqa: ARG001
    """A record brighter than the model may be: its limit is told, in each channel."""
    bright = {"type": "roughconductor", "alpha": 0.3}
    bright["specular_reflectance"] = {"type": "rgb", "value": [1, 0.99, 0.98]}
    record = measured(bright, collector="projected:3x4", estimator="quadrature")
    names = tuple(f"specular_reflectance.{channel}" for channel in "RGB")
    found = gonio.fit(record, "roughconductor:material=Al")
    assert found.at_limit == names
    assert np.all(found.values[1:] <= 1)
    # the model reflects less than the record in every channel, but is loaded
    assert np.all(found.prediction.dhr < record.dhr)
    asked = {"type": "roughconductor"}, ["specular_reflectance=0.5:3"], record.channels
    assert np.array(FittedModel(*asked).limits).tolist() == [[0.5] * 3, [1.0] * 3]
    with pytest.raises(SettingError, match=r"specular_reflectance from 0 to 1, got 2:"):
        gonio.fit(record, "roughconductor", ["specular_reflectance=2:3"])


@pytest.mark.parametrize("name", FREE)
def test_words_mean_the_same_bsdf_as_in_a_measurement(name):
    """Exact: a fit adds nothing to what is said but the numbers that it finds.

    Twin: with a vacuum outside, which is not Mitsuba's air, glass is another.
    """

    def loaded(bsdf):
        return str(mi.load_dict(bsdf))

    model = FittedModel({"type": name}, None, ("Y",))
    (values, *_) = model.starts()
    free = dict(zip((one.name for one in model.parameters), values.tolist()))
    in_a_measurement = {"type": name, **free}
    assert loaded(model.bsdf(values)) == loaded(in_a_measurement)
    if "int_ior" in free:
        assert loaded(model.bsdf(values)) != loaded(in_a_measurement | {"ext_ior": 1.0})


def test_variances_are_a_power_of_the_flux():
    """Rounding: those of counts of a mean flux, and of patches all alike, as they are.

    Convergence: of the power, to the root of rounding. Twin: one common variance.
    """
    flux, hit = np.geomspace(1, 1e4, 48), 0.5
    power = hit * (flux + hit)  # of counts, and one more
    close = np.finfo(float).eps ** 0.5 * np.log(1e4) * 16
    np.testing.assert_allclose(smoothed(power - hit**2, flux, hit), power, rtol=close)
    assert not np.allclose(power.mean(), power, rtol=0.5)
    alike = smoothed(np.arange(48.0), np.ones(48), hit)
    np.testing.assert_allclose(alike, 23.5 + hit**2, rtol=48 * np.finfo(float).eps)


def test_few_hits_do_not_pull_a_fit_down():
    """Normal scores of 24 fits of counts, of eight hits to a patch on average.

    Twin: an eighth off, as by weights that follow each value.
    """
    settings = {"sampler": "independent", "estimator": "analog", "rays": 2000}
    scores, twins = [], []
    for seed in range(24):
        record = measured(DIFFUSE, seed=seed, collector="projected:8x16", **settings)
        fitted = gonio.fit(record, "diffuse")
        for truth, found in ((0.5, scores), (0.5 * 7 / 8, twins)):
            found.append((fitted.values[0] - truth) / fitted.std_errs[0])
    agree(verdict(normal_scores(scores, 15)))
    disagree(verdict(normal_scores(twins, 15)))


def test_all_light_makes_a_fit_exact_to_single_precision():
    """Rounding: where every ray came back, whatever patches it fell into."""
    for rays, few in ((1000, False), (100, True)):
        fitted = gonio.fit(measured(DIFFUSE, [0, 30], rays=rays), "diffuse")
        assert abs(fitted.values[0] - 0.5) < 4 * fitted.std_errs[0] < 1e-5
        assert ("hits are few" in str(fitted)) == few


@pytest.mark.parametrize(
    ("make", "model", "free", "message"),
    [
        ({"batches": 1}, "diffuse", None, "error bars"),
        ({"divergence": 5}, "diffuse", None, "collimated"),
        ({"incident": "projected:2x2"}, "diffuse", None, "collimated"),
        ({"order": 2}, "diffuse", None, r"a fit needs light, got none \(order: 2\)"),
        ({}, "diffuse", ["colour"], "free must name parameters such as"),
        ({}, "roughplastic", ["alhpa"], "got 'alhpa'; did you mean alpha"),
        ({}, {"reflectance": 0.5}, None, "must be a BSDF with a type, got {'refl"),
        ({}, None, None, "must be a BSDF with a type, got None"),
        ({}, "roughplastik", None, "only; did you mean roughplastic"),
        ({}, "diffuse", ["x=1:0"], "limits as in x=0:1"),
        ({}, "diffuse:reflectance=0.5", None, "got nothing"),
        ({}, "diffuse:reflectance=0.5", ["reflectance"], "got reflectance"),
        ({}, "absent", ["weight=0:1"], "the model cannot be loaded"),
        (
            {},
            "diffuse",
            ["reflectance", "y=0:1"],
            "the model cannot be loaded|determine",
        ),
    ],
)
def test_bad_input_is_one_sentence(make, model, free, message):
    record = measured({"type": "diffuse"}, **make)
    with pytest.raises(SettingError, match=message) as caught:
        gonio.fit(record, model, free)
    assert "\n" not in str(caught.value)


def test_records_by_order_are_fitted_one_by_one():
    """Exact: light that is scattered once is that of a flat specimen."""
    records = gonio.measure_orders(METAL, [30], rays=2**16, collector="angle:2x2")
    with pytest.raises(SettingError, match=r"must be one record.*: take one of these"):
        gonio.fit(records, "roughconductor:distribution=ggx")
    of_all = measured(METAL, [30], rays=2**16, collector="angle:2x2")
    model = "roughconductor:distribution=ggx,alpha=0.3"
    once, at_all = (gonio.fit(one, model) for one in (records["1"], of_all))
    assert once.values.tolist() == at_all.values.tolist()


def test_what_a_record_does_not_determine_is_told():
    """A coat that is not there has any gloss; of two indices only the ratio counts."""
    record = measured({"type": "diffuse"}, estimator="quadrature")
    coated = {"type": "principled", "roughness": 0.5, "clearcoat": 0.0}
    found = gonio.fit(record, coated, ["base_color", "clearcoat_gloss"])
    assert np.isnan(found.std_errs).tolist() == [False, True]
    assert "(any value would do)" in str(found)
    assert json.dumps(found.to_dict(), allow_nan=False)
    glass = {"type": "roughdielectric", "alpha": 0.3}
    record = measured(glass, estimator="quadrature")
    with pytest.raises(SpecimenError, match="does not determine int_ior, ext_ior"):
        gonio.fit(record, glass, ["int_ior=1.2:3", "ext_ior=0.5:2"])


def test_a_limit_is_told():
    """A lobe that is narrower than the model may be."""
    record = measured(METAL, estimator="quadrature")
    known = {name: value for name, value in METAL.items() if name != "alpha"}
    found = gonio.fit(record, known, ["alpha=0.4:0.6"])
    assert found.at_limit == ("alpha",)
    assert "(at its limit)" in str(found)


def test_record_of_another_variant():
    with pytest.raises(SettingError, match="variant must be the record's"):
        gonio.fit(synthetic.record(channels=("R", "G", "B")), "diffuse")


def test_known_values_are_kept():
    """Exact: what is given is not free, and roughness has two axes if asked for."""
    model = FittedModel({"type": "roughconductor", "alpha": 0.2}, None, ("Y",))
    assert [one.name for one in model.parameters] == ["specular_reflectance"]
    model = FittedModel({"type": "x"}, ["tint=0:3"], ("Y",))
    assert model.bsdf(np.array([2.0])) == {"type": "x", "tint": 2.0}


def test_command(tmp_path, capfd):
    """Both distributions, the right one first; a picture, a record, numbers."""
    measured(METAL, [30]).save(tmp_path / "a.npz")
    outputs = [str(tmp_path / name) for name in ("a.png", "fit.npz")]
    command = ["fit", str(tmp_path / "a.npz"), "roughconductor"]
    assert main([*command, "-o", *outputs]) == 0
    said = capfd.readouterr().out
    first, other = said.split("further from it:\n")
    head, name, *_ = first.split("\n")
    assert head == "closest of 2 models, by chi-square:"
    assert name.startswith("roughconductor:distribution=ggx,")
    assert "(29 degrees of freedom), " in first  # 32 patches, a few less by their hits
    assert other.startswith("roughconductor:distribution=beckmann,")
    assert (tmp_path / "a.png").stat().st_size > 10_000
    prediction = gonio.load(tmp_path / "fit.npz")
    assert prediction.theta_i.tolist() == [30]
    command[2] += ":specular_reflectance=0.8,distribution=ggx"
    assert main([*command, "--json"]) == 0
    (found,) = json.loads(capfd.readouterr().out)
    alpha = found["parameters"]["alpha"]
    score = (alpha["value"] - 0.3) / alpha["std_err"]
    agree(single(normal_scores(score, 15)))
    assert found["dof"] == 30  # as above, of one parameter less
    assert main([*command, "--quantity", "brdf"]) == 1
    assert "--quantity applies to tables" in capfd.readouterr().err
    assert main(["fit", str(tmp_path / "a.npz"), "scenes/lambertian.xml"]) == 1
    assert "must be a BSDF with a type" in capfd.readouterr().err


def test_records_of_a_gpu_are_understood_without_one(tmp_path, capfd, monkeypatch):
    """In LLVM's variant of the same colours; twin: in its own, if there is a GPU."""
    record, path = measured(METAL), str(tmp_path / "a.npz")
    record = record.with_provenance(variant="cuda_ad_mono")
    record.save(path)
    monkeypatch.setattr(dr, "has_backend", lambda _: False)
    assert main(["fit", path, "roughconductor:distribution=ggx"]) == 0
    same = "roughconductor:material=none,distribution=ggx,alpha=0.3"
    same += ",specular_reflectance=0.8"
    assert main(["compare", path, same]) == 0
    assert "verdict     agree" in capfd.readouterr().out
    assert variant_of(record) == "llvm_ad_mono"
    monkeypatch.setattr(dr, "has_backend", lambda _: True)
    assert variant_of(record) == "cuda_ad_mono"


SHINY = "principled:roughness=0.5,metallic=1,base_color=1"


def test_a_specimen_is_measured_first():
    """Exact: as its record; convergence: alpha of a roughness is its square.

    Twin: of another roughness, or with another distribution, it is not.
    """
    model, how = "roughconductor:distribution=ggx", {"collector": "projected:3x4"}
    found = gonio.fit(SHINY, model, **how)
    assert np.allclose(found.values, [0.25, 1.0], rtol=INTEGRALS, atol=0)
    assert found.record.theta_i.tolist() == [24, 45, 66]
    assert "integrals have no noise" in str(found)
    again = gonio.fit(found.record, model)
    assert np.array_equal(again.values, found.values)
    assert np.array_equal(again.std_errs, found.std_errs)
    other = gonio.fit(SHINY.replace("0.5", "0.51"), model, **how)
    assert not np.isclose(other.values[0], 0.25, rtol=10 * INTEGRALS, atol=0)
    beckmann = gonio.fit(found.record, "roughconductor:distribution=beckmann")
    assert not np.isclose(beckmann.values[0], 0.25, rtol=10 * INTEGRALS, atol=0)
    assert beckmann.scatter > 1e3 * max(found.scatter, INTEGRAL_ERR)
    assert "the model does not follow the record" in str(beckmann)
    assert "does not follow" not in str(found)


def test_what_cannot_be_integrated_is_sampled():
    """Delta components, and rays where they are asked for; else none is sent."""
    how = {"theta_i": 40, "collector": "projected:3x4"}
    for specimen, more in (("plastic", {}), ("diffuse", {"rays": 10_000})):
        record = gonio.fit(specimen, "diffuse", **how, **more).record
        assert record.ledger.emitted == more.get("rays", 1_000_000)
    assert gonio.fit("diffuse", "diffuse", **how).record.ledger.emitted == 0


def test_errors_of_integrals_are_those_of_what_is_left():
    """Rounding: of derivatives, as above. Weighted least squares of a scaled cosine.

    Twin: errors of the integrals alone are a hundred times smaller.
    """
    found = gonio.fit("roughconductor:alpha=0.5", "diffuse", collector="projected:3x4")
    record = found.record
    solid = record.subdivision.projected_solid_angles[..., None]
    share = np.broadcast_to(solid / np.pi, record.brdf.shape).ravel()
    flux, own = (record.brdf * solid).ravel(), (record.brdf_std_err * solid).ravel()
    means = np.repeat(flux.reshape(3, -1).mean(axis=1), 12)
    weights = 1 / (own**2 + (INTEGRAL_ERR * (flux + means)) ** 2)
    value = (weights * share * flux).sum() / (weights * share**2).sum()
    chi2 = (weights * (flux - value * share) ** 2).sum() / (len(flux) - 1)
    alone = 1 / np.sqrt((weights * share**2).sum())
    rounding = SINGLE / REL_STEP
    assert np.isclose(found.values[0], value, rtol=rounding, atol=0)
    assert np.isclose(found.std_errs[0], np.sqrt(chi2) * alone, rtol=rounding, atol=0)
    assert found.std_errs[0] > 100 * alone


def test_command_on_a_specimen(capfd):
    """The right distribution first, what was measured, and what is left."""
    how = ["--theta-i", "40", "--collector", "projected:4x8"]
    assert main(["fit", SHINY, "roughconductor", *how]) == 0
    first, other = capfd.readouterr().out.split("further from it:\n")
    assert first.startswith("closest of 2 models, by scatter about the model:\n")
    assert "distribution=ggx,alpha=0.25,specular_reflectance=1.0\n" in first
    assert other.startswith("roughconductor:distribution=beckmann,")
    assert other.count("% misplaced flux") == 1
    assert f"note: measured <Record of {SHINY}: projected:4x8, incident" in other


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("none.npz diffuse", "there is no file none.npz"),
        ("none.xml diffuse", "there is no file none.xml"),
        ("hg diffuse", "specimen must be a BSDF, a shape or a scene"),
        ("diffuse hg --free g=0:1", "model must be a BSDF, got HGPhaseFunction"),
        ("diffuse conductor", "free must name the parameters of conductor to fit"),
        ("diffuse diffuse:reflectance=0.5", "has a given value, got nothing"),
        ("diffuse diffuse --uncertainty 0.1", "--uncertainty applies to tables only"),
        ("diffuse diffuse --start reflectance", "--start must be NAME=VALUE such as"),
        ("diffuse diffuse -D a=1", "-D applies to scene files only"),
        ("a.npz diffuse --rays 1e4", "--rays applies to a specimen that is to be"),
        ("a.npz diffuse -D a=1", "-D applies to a specimen that is to be measured"),
        ("goniometric:filename=none.npz diffuse", "filename: there is no file none"),
    ],
)
def test_bad_lines_on_specimens_are_one_sentence(line, message, capfd):
    assert main(["fit", *line.split()]) == 1
    said = capfd.readouterr().err
    assert message in said
    assert said.count("\n") == 1


def test_fits_of_one_table_are_drawn_together(tmp_path):
    """Whatever each was told of it; twin: of another table they are not."""
    pytest.importorskip("matplotlib")
    table = table_of({"type": "diffuse", "reflectance": 0.4})
    other = table_of({"type": "diffuse", "reflectance": 0.3})
    told = {"uncertainty": 0.01}
    fits = [gonio.fit(table, "diffuse", **told) for _ in range(2)]
    figure = fit_figure(fits, tmp_path / "fits.png")
    assert (tmp_path / "fits.png").stat().st_size > 0
    half = len(figure.axes) // 2
    assert figure.axes[0].get_title() == "θᵢ = 10°, φᵢ = 0°"
    assert figure.axes[0].get_ylabel() == "BRDF (1/sr)"
    for axes in figure.axes[half:]:
        assert axes.get_xlabel().startswith("θₒ (degrees)")
        # 1 % beside a model that is right
        assert 0.01 < axes.get_ylim()[1] < 0.02
    with pytest.raises(ValueError, match="of one record"):
        fit_figure([*fits, gonio.fit(other, "diffuse", **told)])
