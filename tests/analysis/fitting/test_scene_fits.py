"""Parameters within scenes are found by measurements with gradients."""

import numpy as np
import pytest
from budget import agree, disagree, normal_scores, verdict

import gonio_mi as gonio
from gonio_mi.analysis.fitting import scene_model
from gonio_mi.cli import main
from gonio_mi.errors import SettingError

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
        if refused and "gradients" in settings:
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
    agree(verdict(pulls([fit], [0.2])[0]))
    disagree(verdict(pulls([fit], [0.3])[0]))


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
