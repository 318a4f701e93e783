"""What a new user does wrong in Python is told: by a warning, or by what was meant."""

import re
import warnings

import gonio_mi as gonio

# isort: split
import mitsuba as mi
import numpy as np
import pytest

from gonio_mi.campaigns.measure import measure_whole
from gonio_mi.cli import main
from gonio_mi.errors import LostLightWarning

BALL = {"type": "sphere", "bsdf": {"type": "diffuse"}}
FEW = {"rays": 2000, "batches": 2, "collector": "projected:2x2"}


def warned(specimen, *args, **settings):
    """Warnings of a measurement."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        gonio.measure(specimen, *args, **FEW | settings)
    return caught


# -------------------------------------------------------------------------- roughness


@pytest.mark.parametrize(
    ("bsdf", "told"),
    [
        ({"type": "roughconductor", "alpha": -0.2}, "alpha of the BSDF RoughConductor"),
        (
            {"type": "roughdielectric", "alpha_u": 0.1, "alpha_v": -0.3},
            "alpha_v of the BSDF RoughDielectric must be 0 or more, got -0.3",
        ),
        ({"type": "roughplastic", "alpha": -0.2}, "alpha of the BSDF RoughPlastic is"),
        (
            {"type": "roughconductor", "alpha": 1e9},
            "alpha of the BSDF RoughConductor is 1e+09: facets so steep",
        ),
        (
            {"type": "principled", "roughness": 1.5},
            "roughness of the BSDF Principled must be from 0 to 1, got 1.5",
        ),
        (
            {"type": "twosided", "bsdf": {"type": "roughconductor", "alpha": -1.0}},
            "alpha of the BSDF TwoSidedBRDF must be 0 or more, got -1",
        ),
    ],
)
def test_a_roughness_out_of_range_is_told(bsdf, told):
    """Mitsuba loads it without a word; the message names plugin, parameter, value."""
    [found] = warned(bsdf, 30)
    assert told in str(found.message)
    assert found.filename == __file__


@pytest.mark.parametrize(
    "bsdf",
    [
        {"type": "roughconductor", "alpha": 0.0},
        {"type": "roughconductor", "alpha": 4.0},
        {"type": "roughplastic", "alpha": 0.001},
        {"type": "principled", "roughness": 1.0},
        {
            "type": "roughconductor",
            "alpha": {"type": "bitmap", "data": np.full((2, 2, 1), 0.3), "raw": True},
        },
    ],
)
def test_twin_a_roughness_in_range_is_not(bsdf):
    if isinstance(bsdf.get("alpha"), dict):
        texture = bsdf["alpha"] | {"data": mi.TensorXf(bsdf["alpha"]["data"])}
        bsdf = bsdf | {"alpha": texture}
    assert warned(bsdf, 30) == []


# ------------------------------------------------------------------------- lost light


def test_light_that_misses_is_told_once():
    """Of a stack too, at the line of the user, in a category of its own."""
    found = warned(BALL, [0, 10])
    assert {one.category for one in found} == {LostLightWarning}
    assert {one.filename for one in found} == {__file__}
    (text,) = (str(one.message) for one in found)
    assert "rays missed the specimen" in text


def test_twin_light_that_is_all_collected():
    assert warned({"type": "diffuse"}, 30) == []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        measure_whole(BALL, 0, **FEW)  # for what reports it in its own way


def test_quiet_hides_no_warning(tmp_path, capsys):
    """Neither those of the summary, nor twice without -q."""
    scene = tmp_path / "ball.xml"
    scene.write_text('<scene version="3.0.0"><shape type="sphere"/></scene>')
    command = ["measure", str(scene), "--theta-i", "0", "--rays", "2000"]
    command += ["--collector", "projected:2x2"]
    assert main([*command, "-q"]) == 0
    printed = capsys.readouterr()
    assert printed.err.count("missed the specimen") == 1
    assert printed.out == ""
    assert main(command) == 0
    printed = capsys.readouterr()
    shown = " ".join((printed.out + printed.err).split())
    assert shown.count("missed the specimen") == 1


# --------------------------------------------------------------------- names and words


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("thetai", "theta_i"),
        ("n_rays", "rays"),
        ("emiter", "emitter"),
        ("orders", "order"),
    ],
)
def test_the_argument_that_was_meant(word, meant):
    with pytest.raises(TypeError, match=rf"did you mean {meant}\?"):
        gonio.measure({"type": "diffuse"}, **{word: 5})


@pytest.mark.parametrize("bsdf", [{}, {"reflectance": 0.5}, {"type": None}])
def test_a_dictionary_without_a_type_is_told(bsdf):
    with pytest.raises(gonio.SpecimenError, match=r"^specimen must have a type"):
        gonio.measure(bsdf, 0)


@pytest.mark.parametrize("wrong", [5, [], {"1": None}, ["run.npz"]])
def test_what_is_no_record_is_told(wrong):
    told = re.escape(repr(wrong))
    with pytest.raises(TypeError, match=rf"^record must be a Record, got {told}$"):
        gonio.plot(wrong)
    with pytest.raises(TypeError, match=r"^record must be a Record or several, got "):
        gonio.report(wrong, "page.html")


def test_a_bsdf_in_one_word_is_told_as_a_dictionary():
    with pytest.raises(gonio.SpecimenError) as told:
        gonio.measure("diffuse:reflectance=0.5", 0)
    assert "{'type': 'diffuse', 'reflectance': 0.5}" in str(told.value)
    with pytest.raises(gonio.SpecimenError) as told:
        gonio.measure("scene.xml", 0)
    assert "dictionary" not in str(told.value)


@pytest.mark.parametrize(
    ("plugin", "wrong", "meant"),
    [
        ("diffuse", "reflectence", "; did you mean reflectance?"),
        ("roughconductor", "alhpa", "; did you mean alpha?"),
        ("principled", "rougness", "; did you mean roughness?"),
        ("hair", "eumelnin", "; did you mean eumelanin?"),
        ("dielectric", "eta", ""),  # which Mitsuba gives for its two indices
        ("diffuse", "x", ""),
    ],
)
def test_the_parameter_of_a_bsdf_that_was_meant(plugin, wrong, meant):
    """Of those that Mitsuba gives; what is unlike all of them is named alone."""
    with pytest.raises(gonio.SpecimenError) as told:
        gonio.measure({"type": plugin, wrong: 1.0}, 0)
    assert str(told.value).endswith(
        f"the plugin {plugin} has no use for {wrong}{meant}"
    )


def _empty(self, _):
    self.value = 1


def _early(self, _):
    self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide


def _wrong(self, props):
    mi.BSDF.__init__(self, props)
    self.m_flags = "diffuse"


CALL = r"mi\.{}\.__init__\(self, props\) first"


@pytest.mark.filterwarnings("ignore:nanobind")
@pytest.mark.parametrize(
    ("init", "family", "said"),
    [
        (_empty, "bsdf", "the class of first_mistake must derive .* call mi.BSDF"),
        (_empty, "phase", "the class of first_mistake must derive"),
        (_early, "bsdf", "BsdfFirst.__init__ must call " + CALL.format("BSDF")),
        (
            _early,
            "phase",
            "PhaseFirst.__init__ must call " + CALL.format("PhaseFunction"),
        ),
        (_wrong, "bsdf", "incompatible function arguments"),
    ],
)
def test_a_base_class_that_is_not_initialised_is_named(init, family, said):
    """Twin: flags of a wrong type in a class that initialises its base."""
    base = {"bsdf": mi.BSDF, "phase": mi.PhaseFunction}[family]
    whole = type(f"{family.title()}First", (base,), {"__init__": init})
    getattr(mi, f"register_{family}")("first_mistake", whole)
    with pytest.raises(gonio.SpecimenError, match=said):
        gonio.measure({"type": "first_mistake"}, 0)


CHECKERS = {"type": "checkerboard", "color0": 0.2}
DIFFUSE = {"type": "diffuse"}


@pytest.mark.parametrize(
    ("bsdf", "meant"),
    [
        ({"type": "mask", "opacty": 0.5, "bsdf": DIFFUSE}, None),  # needs a BSDF
        ({"type": "twosided", "bsdf": {"type": "hair", "eumelnin": 1.0}}, "eumelanin"),
        ({"type": "blendbsdf", "weigth": 0.5, "1": DIFFUSE, "2": DIFFUSE}, None),
        ({"type": "diffuse", "reflectance": CHECKERS | {"colour1": 0.1}}, "color1"),
        ({"type": "first_mistakes", "rougness": 0.5, "tint": 1.0}, None),
        ({"type": "first_mistake_told", "rougness": 0.5}, "roughness"),
    ],
)
def test_a_nested_texture_or_own_parameter_that_was_meant(bsdf, meant):
    """Twins: plugins that cannot be loaded without parameters, or tell none."""

    class FirstMistakes(mi.BSDF):
        def __init__(self, props):
            super().__init__(props)
            self.roughness, self.tint = props.get("roughness", 0.3), props["tint"]

    class FirstMistakeTold(mi.BSDF):
        def __init__(self, props):
            super().__init__(props)
            self.roughness = mi.Float(props.get("roughness", 0.3))

        def traverse(self, callback):
            callback.put("roughness", self.roughness, mi.ParamFlags.Differentiable)

    mi.register_bsdf("first_mistakes", FirstMistakes)
    mi.register_bsdf("first_mistake_told", FirstMistakeTold)
    with pytest.raises(gonio.SpecimenError) as told:
        gonio.measure(bsdf, 0)
    message = str(told.value)
    assert message.endswith(f"; did you mean {meant}?") == (meant is not None), message


@pytest.mark.parametrize(
    "bsdf",
    [
        {
            "type": "roughconductor",
            "alpha_u": 0.1,
            "alpha_v": 0.2,
            "eta": 1.5,
            "k": 2.0,
        },
        {"type": "principled", "specular": 0.4, "clearcoat_sampling_rate": 0.5},
        {"type": "plastic", "int_ior": "water", "ext_ior": 1, "nonlinear": True},
        {"type": "twosided", "bsdf": {"type": "pplastic", "alpha": 0.3, "id": "x"}},
        {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.3}},
        {
            "type": "blendbsdf",
            "weight": CHECKERS,
            "a": DIFFUSE,
            "b": DIFFUSE | {"id": "b"},
        },
        {"type": "mask", "opacity": CHECKERS, "whatever its name": DIFFUSE},
    ],
)
def test_twin_right_parameters_are_taken(bsdf):
    gonio.measure(bsdf, 0, **FEW)


@pytest.mark.needs("validation")
def test_a_refractive_index_may_be_an_integer():
    """Exact: the same light as of a float, and so nested, and in scripts."""
    from gonio_mi.validation.reproducers import source_of

    whole = {"type": "dielectric", "int_ior": 2, "ext_ior": 1}
    real = {"type": "dielectric", "int_ior": 2.0, "ext_ior": 1.0}
    nested = {"type": "mask", "bsdf": whole}
    expected = gonio.measure(real, 60, **FEW).tallies
    assert gonio.measure(whole, 60, **FEW).tallies == expected
    assert gonio.measure(nested, 60, **FEW).ledger.absorbed == 0
    asked = ["--theta-i", "60", "--rays", "2000"]
    assert main(["measure", "dielectric:int_ior=2,ext_ior=1", *asked]) == 0
    assert "2.0" in source_of(whole)
    with pytest.raises(gonio.SpecimenError, match="int_ior"):
        gonio.measure({"type": "dielectric", "int_ior": True}, 60, **FEW)


def test_version():
    """That of the installed package."""
    from importlib.metadata import version

    assert gonio.__version__ == version("gonio-mi")
    with pytest.raises(AttributeError, match="__verison__"):
        gonio.__verison__  # noqa: B018


# -------------------------------------------------------------------------- intervals


def test_no_limit_of_a_few_hits_is_negative():
    """Of a total of one hit Student's t alone would reach far below 0."""
    leaky = {"type": "mask", "opacity": 0.9995, "bsdf": {"type": "diffuse"}}
    single = False
    for seed in range(8):
        record = gonio.measure(leaky, 0, rays=2048, seed=seed, sampler="independent")
        hits = int(record.counts[1].sum())
        single |= hits == 1
        for quantity in ("dhr", "dht"):
            low, high = record.interval(0.95, of=quantity)
            assert np.all(low >= 0)
            assert np.all(high > low)
    assert single


def test_what_only_the_instrument_says_is_no_setting():
    with pytest.raises(TypeError, match="measure has no setting 'whole'"):
        gonio.measure({"type": "diffuse"}, 30, whole=True)
