"""Parameters within scenes are found by measurements with gradients."""

import numpy as np
import pytest
from budget import agree, disagree, normal_scores, verdict

import gonio_mi as gonio
from gonio_mi.analysis.fitting import scene_model
from gonio_mi.cli import main
from gonio_mi.errors import SettingError
from gonio_mi.single_precision import FEW_ROUNDINGS

# isort: split
import mitsuba as mi

LAYERS = """<scene version="3.0.0">
<shape type="disk" id="top">
  <transform name="to_world"><scale value="0.4"/><translate z="0.5"/></transform>
  <bsdf type="twosided"><bsdf type="roughconductor">
    <float name="alpha" value="{alpha}"/></bsdf></bsdf>
</shape>
<shape type="rectangle" id="base">
  <bsdf type="blendbsdf"><float name="weight" value="0.5"/>
    <bsdf type="roughconductor"><string name="distribution" value="ggx"/>
      <float name="alpha" value="{alpha}"/></bsdf>
    <bsdf type="diffuse"><spectrum name="reflectance" value="{reflectance}"/></bsdf>
  </bsdf>
</shape>
</scene>"""
TRUTH = {"alpha": 0.25, "reflectance": 0.5}
BOTH = "brdf_0.alpha.value+bsdf_0.alpha.value"
SHARED = [BOTH, "reflectance.value"]
BATCHES, N_FITS, CELLS = 16, 8, {"period": "box"}


def layers(**values):
    return mi.load_string(LAYERS.format(**values))


def blend(alpha, kind="roughconductor"):
    """A BSDF with another in it, half of it diffuse."""
    rough = {"type": kind, "alpha": alpha}
    return {"type": "blendbsdf", "weight": 0.5, "a": rough, "b": {"type": "diffuse"}}


def small(specimen, seed=0, **settings):
    own = {"rays": 10_000, "collector": "projected:6x12", "batches": BATCHES}
    return gonio.measure(specimen, 40, seed=seed, **own | settings)


def fitted_layers(n):
    """Fits of records of other seeds, from where the scene is not."""
    mi.set_variant("llvm_ad_mono")
    start = layers(alpha=0.4, reflectance=0.3)
    records = [small(layers(**TRUTH), 17 * seed, **CELLS) for seed in range(n)]
    return [gonio.fit(one, start, SHARED) for one in records]


def pulls(fits, truth):
    each = [(one.values - truth) / one.std_errs for one in fits]
    return normal_scores(np.array(each), BATCHES - 1)


def test_one_parameter_of_two_bsdfs():
    """Within its error bars, and with both of its keys; twin: 5 % off."""
    (fit,) = fitted_layers(1)
    truth = np.array([*TRUTH.values()])
    agree(verdict(pulls([fit], truth)[0]))
    disagree(verdict(pulls([fit], 1.05 * truth)[0]))
    assert fit.derivatives == "exact"
    both = [v for k, v in fit.bsdf.items() if k.endswith("alpha.value")]
    assert both == [fit.values[0]] * 2
    fit.quantity("dhr", rays=1000)
    # the scene that was given is the user's, and as it was
    params = mi.traverse(fit.model.scene)
    kept = [params[key] for key in fit.bsdf if key.endswith("alpha.value")]
    assert np.ravel(kept).tolist() == [np.float32(0.4)] * 2
    assert fit.prediction.asked.collector == fit.record.asked.collector


@pytest.mark.slow
def test_uncertainties_of_scenes_are_honest():
    """They know the noise of record and model; twin: 2 % off."""
    fits, truth = fitted_layers(N_FITS), np.array([*TRUTH.values()])
    for right, wrong in zip(pulls(fits, truth).T, pulls(fits, 1.02 * truth).T):
        agree(verdict(right))
        disagree(verdict(wrong))


def counted(monkeypatch, refused):
    """Measurements of the model, as a list that grows; perhaps without gradients."""
    found, own = [], scene_model.measure_like

    def measure_like(*args, **settings):
        asked = settings.get("gradients", ())
        if (refused is True and asked) or any(str(refused) in one for one in asked):
            raise gonio.SpecimenError("no derivative")
        found.append(settings)
        return own(*args, **settings)

    monkeypatch.setattr(scene_model, "measure_like", measure_like)
    return found


@pytest.mark.slow
def test_gradients_save_measurements(monkeypatch):
    """At least half of those that differences take."""
    record, numbers = small(layers(**TRUTH), **CELLS), {}
    for way in ("exact", "differences"):
        measurements = counted(monkeypatch, way == "differences")
        fit = gonio.fit(record, layers(alpha=0.35, reflectance=0.4), SHARED)
        monkeypatch.undo()
        assert fit.derivatives == way
        agree(verdict(pulls([fit], [*TRUTH.values()])[0]))
        numbers[way] = len(measurements)
    assert 2 * numbers["exact"] <= numbers["differences"]


@pytest.mark.slow
def test_what_has_no_derivative_is_found_by_differences():
    """Mitsuba's own derivative of `roughplastic` by alpha is wrong, and refused."""
    mi.set_variant("llvm_ad_mono")
    record = small(blend(0.2, "roughplastic"))
    fit = gonio.fit(record, blend(0.25, "roughplastic"), ["bsdf_0.alpha"])
    assert fit.derivatives == "differences"
    (note,) = fit.notes
    assert note.startswith("derivatives by bsdf_0.alpha are differences: the derivativ")
    assert f"note: {note}" in str(fit)
    assert fit.to_dict()["notes"] == [note]
    agree(verdict(pulls([fit], [0.2])[0]))
    disagree(verdict(pulls([fit], [0.3])[0]))


def searched(specimen, free, record=None, values=None):
    """A search that has measured the model once, with derivatives."""
    mi.set_variant("llvm_ad_mono")
    record = small(blend(0.2), rays=2000) if record is None else record
    model = scene_model.FittedScene(specimen, free, None, record)
    search = scene_model.SceneSearch(model, None, {})
    (start,) = model.starts()
    return search, search._jacobian(start if values is None else values)


def test_only_what_is_refused_is_differenced(monkeypatch):
    """The other's derivative is Dr.Jit's; twin: it is as well where none is refused."""
    own = scene_model.try_gradients
    exact, right = searched(blend(0.25), ["alpha.value", "weight.value=0:1"])
    assert exact.derivatives == "exact"
    assert exact.notes == ()

    def refuse(gradients, *more):
        if any("alpha" in one.name for one in gradients.columns):
            raise gonio.SpecimenError("no derivative of it")
        own(gradients, *more)

    monkeypatch.setattr(scene_model, "try_gradients", refuse)
    asked = counted(monkeypatch, "alpha")
    search, found = searched(blend(0.25), ["alpha.value", "weight.value=0:1"])
    assert search.notes == (
        "derivatives by alpha.value are differences: no derivative of it",
    )
    differentiated = [one["gradients"] for one in asked if "gradients" in one]
    assert [len(one) for one in differentiated] == [1]
    np.testing.assert_array_equal(found[:, 1], right[:, 1])
    assert not np.array_equal(found[:, 0], right[:, 0])
    # differences over a tenth of the value, of the same rays
    assert np.corrcoef(found[:, 0], right[:, 0])[0, 1] > 0.9


def test_joined_parameters_are_one_launch():
    """The derivative by both is the sum; twin: that of one alone is not."""
    two = {"type": "blendbsdf", "weight": 0.5}
    two |= {key: {"type": "roughconductor", "alpha": 0.2} for key in "ab"}
    names = "bsdf_0.alpha.value", "bsdf_1.alpha.value"
    settings = {"rays": 2000, "collector": "projected:4x8"}
    mi.set_variant("llvm_ad_mono")
    record = gonio.measure(two, 40, gradients=["+".join(names), *names], **settings)
    assert record.gradients == ("+".join(names), *names)
    both, one, other = (record.gradient(name) for name in record.gradients)
    # single precision of rays, whose gains and losses are 30 times what is left
    size = np.abs(both).max()
    np.testing.assert_allclose(
        both, one + other, rtol=0, atol=30 * FEW_ROUNDINGS * size
    )
    assert np.abs(both - one).max() > 0.1 * size
    search, _ = searched(two, ["+".join(names)])
    ((key,),) = [search._held["guide"][1].gradients]
    assert key.count("+") == 1


@pytest.mark.parametrize("joined", ["weight.value+weight.value", "weight.value+alpha"])
def test_what_cannot_be_joined(joined):
    mi.set_variant("llvm_ad_mono")
    with pytest.raises(SettingError, match=r"must (join|name) parameters"):
        gonio.measure(blend(0.2), 40, rays=1000, gradients=[joined])


def test_joined_parameters_that_begin_apart_say_where():
    """Twins: with one start, and with the same values."""
    record = small(blend(0.2), rays=2000)
    free = ["bsdf_0.alpha.value+bsdf_1.alpha.value"]

    def notes(first, second, start=None):
        parts = {
            key: {"type": "roughconductor", "alpha": alpha}
            for key, alpha in (("a", first), ("b", second))
        }
        scene = {"type": "blendbsdf", "weight": 0.5} | parts
        model = scene_model.FittedScene(scene, free, start, record)
        return model.notes, model.parameters[0].starts

    mi.set_variant("llvm_ad_mono")
    (note,), starts = notes(0.1, 0.3)
    assert note == (
        f"the search for {free[0]} began at the first of the scene's values, 0.1, 0.3: "
        "start (--start) gives another"
    )
    assert starts == (np.float32(0.1),)
    assert notes(0.1, 0.3, {free[0]: 0.2}) == ((), (0.2,))
    assert notes(0.1, 0.1)[0] == ()


def test_a_derivative_that_is_no_number_is_no_0(monkeypatch):
    """Where nothing came it is 0; twin: NaN of the BSDF is told in a sentence."""
    record = small(blend(0.1), rays=200)
    _, found = searched(blend(0.1), ["alpha.value"], record)
    assert np.any(found == 0)
    assert np.any(found != 0)
    assert np.isfinite(found).all()
    own = gonio.Record.gradient

    def gradient(self, *asked):
        value = own(self, *asked)
        value[0, 0] = np.nan
        return value

    monkeypatch.setattr(gonio.Record, "gradient", gradient)
    with pytest.raises(gonio.SpecimenError, match="is NaN at 1 of 72 detectors"):
        searched(blend(0.1), ["alpha.value"], record)


@pytest.mark.parametrize(
    ("free", "said"),
    [
        (None, "must name parameters of a scene as mi.traverse does"),
        (["alfa.value"], "such as weight.value, bsdf_0.alpha.value"),
        (["weight.value"], r"limits as in weight.value=0:1"),
        (["weight.value=1:0"], "limits as in weight.value=0:1"),
        (["a.b"], "gradients must name parameters"),
    ],
)
def test_refused(free, said):
    mi.set_variant("llvm_ad_mono")
    scene = mi.load_dict({"type": "scene", "it": {"type": "disk", "bsdf": blend(0.2)}})
    with pytest.raises(SettingError, match=said):
        gonio.fit(small(blend(0.2), rays=1000), scene, free)


def test_command(tmp_path, capsys):
    """A scene file is a model; its table is refused in one sentence."""
    mi.set_variant("llvm_ad_mono")
    record, scene = tmp_path / "run.npz", tmp_path / "scene.xml"
    small(layers(**TRUTH), rays=2000, **CELLS).save(record)
    scene.write_text(LAYERS.format(alpha=0.3, reflectance=0.4))
    words = ["fit", str(record), str(scene), "--free", BOTH]
    assert main(words) == 0
    assert f"{BOTH}  0." in capsys.readouterr().out
    table = tmp_path / "t.csv"
    table.write_text("theta_i,phi_i,theta_o,phi_o,brdf\n30,0,10,0,.3\n30,0,20,0,.3\n")
    assert main(["fit", str(table), str(scene), "--free", BOTH]) == 1
    assert "needs a record, got the table" in capsys.readouterr().err
