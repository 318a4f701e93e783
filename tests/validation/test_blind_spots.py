"""Verdicts on plugins as others write them: right ones pass, and no mistake hides."""

import contextlib
import io
import re
from functools import cache, reduce
from operator import or_

import drjit as dr
import mitsuba as mi
import pytest
from plain_bsdf import changed

from gonio_mi.specimen.bsdf_trial import PluginFault
from gonio_mi.validation import reproducer, validate
from gonio_mi.validation.checks import cost
from gonio_mi.validation.conditions import PLACES, Condition
from gonio_mi.validation.probe import Probe, uniform

ALBEDO = 0.5
HARMLESS = "interface only (no effect on images)"


def flags(words):
    """Flags of Mitsuba by their names."""
    return reduce(or_, (int(getattr(mi.BSDFFlags, word)) for word in words.split()))


class Matte:
    """Right; `active` has no default in any function, as in Mitsuba's own."""

    lobes = ("DiffuseReflection FrontSide",)

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self.m_components = list(map(flags, self.lobes))
        self.m_flags = reduce(or_, self.m_components)

    def weight(self, si, wo, sample1):  # noqa: ARG002
        return ALBEDO

    def density(self, si, wo):  # noqa: ARG002
        return dr.inv_pi * wo.z

    def sample(self, ctx, si, sample1, sample2, active):
        bs = dr.zeros(mi.BSDFSample3f)
        active &= si.wi.z > 0
        if dr.none(active):
            return bs, 0.0
        bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
        bs.pdf, bs.eta = self.pdf(ctx, si, bs.wo, active), 1.0
        bs.sampled_type = mi.UInt32(flags("DiffuseReflection"))
        weight = mi.Spectrum(self.weight(si, bs.wo, sample1))
        return bs, weight & active & (bs.pdf > 0)

    def eval(self, ctx, si, wo, active):  # noqa: ARG002
        lit = active & (si.wi.z > 0) & (wo.z > 0)
        return mi.Spectrum(ALBEDO * dr.inv_pi * wo.z) & lit

    def pdf(self, ctx, si, wo, active):  # noqa: ARG002
        lit = active & (si.wi.z > 0) & (wo.z > 0)
        return dr.select(lit, self.density(si, wo), 0)

    def eval_diffuse_reflectance(self, si, active):
        return mi.Spectrum(ALBEDO) & (active & (si.wi.z > 0))

    def to_string(self):
        return "Matte[]"


def verdict(base, **changes):
    return validate(changed(base, **changes), effort="quick")


@cache
def right(base):
    """Verdict on a plugin that has no change."""
    return verdict(base)


def difference(script):
    """By how many standard errors or roundings the numbers of a script differ."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(script, {})
    last = out.getvalue().splitlines()[-1]
    return float(re.search(r": (\S+) (standard errors|roundings)$", last)[1])


def test_functions_get_a_mask_always():
    """Where `active` has no default, a call without it would raise."""
    assert verdict(Matte).passed
    bsdf = mi.load_dict(changed(Matte))
    cost._call(bsdf, Condition(40.0))()


def test_reproducers_give_a_mask():
    judged = verdict(Matte, weight=lambda *_: 1.1 * ALBEDO)
    assert judged.failures
    for one in judged.failures:
        assert difference(reproducer(judged, one.name)) > 5, one.name


class Normal(Matte):
    """All light goes along the normal: one direction for all rays."""

    lobes = ("DeltaReflection FrontSide",)

    def sample(self, ctx, si, sample1, sample2, active):  # noqa: ARG002
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo, bs.pdf, bs.eta = mi.Vector3f(0, 0, 1), 1.0, 1.0
        bs.sampled_type = mi.UInt32(flags("DeltaReflection"))
        return bs, mi.Spectrum(ALBEDO) & (active & (si.wi.z > 0))

    def eval(self, ctx, si, wo, active):  # noqa: ARG002
        return mi.Spectrum(0.0)

    def pdf(self, ctx, si, wo, active):  # noqa: ARG002
        return mi.Float(0.0)


def test_one_direction_may_be_that_of_all_rays():
    found = verdict(Normal)["delta"]
    assert "is not that of a mirror" in found.mistake


@pytest.mark.parametrize("kind", [list, iter])
def test_answers_may_be_lists(kind):
    """As Mitsuba takes them; an iterator it refuses."""

    def eval_pdf(self, *asked):
        return kind((self.eval(*asked), self.pdf(*asked)))

    def sample(self, *asked):
        return kind(Matte.sample(self, *asked))

    bsdf = mi.load_dict(changed(Matte, sample=sample, eval_pdf=eval_pdf))
    caller = Probe(mi.load_dict({"type": "mask", "bsdf": bsdf}), Condition(40.0))
    takes = contextlib.nullcontext() if kind is list else pytest.raises(PluginFault)
    with takes:
        caller.sample(*uniform(8, (0,)))
    assert validate(bsdf, effort="quick").passed == (kind is list)


@pytest.mark.parametrize("kept", [True, False])
def test_arguments_may_be_changed_in_place(kept):
    """Callers in C++ pass copies; the twin keeps its direction for the next call."""

    def evaluate(self, ctx, si, wo, active):
        value = Matte.eval(self, ctx, si, wo, active)
        wo.z, si.wi.z = -wo.z, -si.wi.z
        self.last = wo
        return value

    def density(self, si, wo):  # noqa: ARG001
        last = getattr(self, "last", wo)
        own = wo if kept or dr.width(last) != dr.width(wo) else last
        return dr.inv_pi * dr.abs(own.z)

    judged = verdict(Matte, eval=evaluate, density=density)
    assert judged.passed == kept, str(judged)
    if kept:
        assert not judged["answers"].statistic, str(judged)


@pytest.mark.parametrize("kept", [True, False])
def test_time_is_that_of_one_call(kept):
    """Not of all changes in place before; the twin keeps a direction of its own."""
    own = dr.opaque(mi.Vector3f, [0, 0, 1], cost.N_RAYS)

    def evaluate(self, ctx, si, wo, active):  # noqa: ARG001
        wi = si.wi if kept else own
        wi.z = dr.sqrt(wi.z)
        return mi.Spectrum(wi.z + wo.z) & active

    call = cost._call(mi.load_dict(changed(Matte, eval=evaluate)), Condition(40.0))
    call()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        call()
        hashes = {k["hash"] for k in dr.kernel_history() if "cache_hit" in k}
        call()
        again = {k["hash"] for k in dr.kernel_history() if "cache_hit" in k}
    assert (hashes == again) == kept


# ------------------------------------------------------------------------ both modes


class Glass(Matte):
    """Rough glass whose radiance mode is off by a factor for wi on either side."""

    lobes = (
        "GlossyReflection FrontSide BackSide",
        "GlossyTransmission FrontSide BackSide NonSymmetric",
    )
    front, back = 1.0, 1.0

    def __init__(self, props):
        Matte.__init__(self, props)
        self.right = mi.load_dict(
            {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.3}
        )

    def factor(self, ctx, si, wo):
        crosses = si.wi.z * wo.z < 0
        if ctx.mode == mi.TransportMode.Importance:
            return dr.select(crosses, 1.0, 1.0)
        return dr.select(crosses, dr.select(si.wi.z > 0, self.front, self.back), 1.0)

    def sample(self, ctx, si, sample1, sample2, active):
        bs, weight = self.right.sample(ctx, si, sample1, sample2, active)
        return bs, weight * self.factor(ctx, si, bs.wo)

    def eval(self, ctx, si, wo, active):
        return self.right.eval(ctx, si, wo, active) * self.factor(ctx, si, wo)

    def pdf(self, ctx, si, wo, active):
        return self.right.pdf(ctx, si, wo, active)

    def eval_pdf(self, ctx, si, wo, active):
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)


@pytest.mark.parametrize(("side", "factor"), [("front", 3.0), ("back", 0.2)])
def test_radiance_may_be_wrong_from_one_side_only(side, factor):
    """The right one is the twin: it is reciprocal, and radiance over eta^2."""
    assert right(Glass)["adjoint"].status == "holds"
    judged = verdict(Glass, **{side: factor})
    found = judged["adjoint"]
    assert found.effect == "biases images"
    assert "path and all that trace rays from the sensor" in found.consequence
    assert f"{factor:g} times the expected one for wi on the {side}" in found.mistake
    assert difference(reproducer(judged, "adjoint")) > 5


class Even(Glass):
    """The same in both modes: of radiance with `divided`, else of importance."""

    divided = False

    def factor(self, ctx, si, wo):
        eta2 = dr.square(dr.select(si.wi.z > 0, 1.5046 / 1.000277, 1.000277 / 1.5046))
        radiance = ctx.mode == mi.TransportMode.Radiance
        own = 1.0
        if radiance and not self.divided:
            own = eta2
        if self.divided and not radiance:
            own = 1 / eta2
        return dr.select(si.wi.z * wo.z < 0, own, 1.0)


@pytest.mark.parametrize("divided", [False, True])
def test_a_mode_without_its_power_of_eta_is_named(divided):
    found = verdict(Even, divided=divided)["adjoint"]
    if divided:
        assert found.effect == "breaks some integrators"
        assert "is the same in both modes" in found.mistake
    else:
        assert found.effect == "biases images"
        assert found.mistake == "`eval` lacks 1/eta^2 in radiance mode"


class Moody(Matte):
    """Matte; beyond 60 degrees, in radiance mode, `wrong` functions are times 1.5."""

    wrong = ()

    def factor(self, ctx, si, name):
        own = name in self.wrong and ctx.mode == mi.TransportMode.Radiance
        return dr.select(own & (si.wi.z < 0.5), 1.5, 1.0)

    def sample(self, ctx, si, sample1, sample2, active):
        bs, weight = Matte.sample(self, ctx, si, sample1, sample2, active)
        bs.pdf = Matte.pdf(self, ctx, si, mi.Vector3f(bs.wo), active)
        return bs, weight * self.factor(ctx, si, "weight")

    def eval(self, ctx, si, wo, active):
        value = Matte.eval(self, ctx, si, wo, active)
        return value * self.factor(ctx, si, "eval")

    def pdf(self, ctx, si, wo, active):
        return Matte.pdf(self, ctx, si, wo, active) * self.factor(ctx, si, "pdf")

    def eval_pdf(self, ctx, si, wo, active):
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)


@pytest.mark.parametrize(
    ("wrong", "names"),
    [
        (("weight",), ("sampled_weight",)),
        (("pdf",), ("sampled_pdf",)),
        (("eval", "weight"), ("adjoint",)),
    ],
)
def test_radiance_mode_is_asked_at_all_angles(wrong, names):
    """Not only where maps are; the right one is the twin, of which nothing is found."""
    assert right(Moody).passed
    assert right(Glass).passed  # over eta^2
    judged = verdict(Moody, wrong=wrong)
    for name in names:
        assert judged[name].effect == "biases images"


def verdict_of_phase(weight, value):
    """Of an isotropic phase function whose factors may depend on the context."""

    class Scatterer(mi.PhaseFunction):
        def __init__(self, props):
            mi.PhaseFunction.__init__(self, props)
            self.m_flags = mi.PhaseFunctionFlags.Isotropic
            self.m_components = [self.m_flags]

        def sample(self, ctx, mei, sample1, sample2, active):  # noqa: ARG002
            wo = mi.warp.square_to_uniform_sphere(sample2)
            return wo, mi.Spectrum(weight(ctx)), mi.Float(dr.inv_four_pi)

        def eval_pdf(self, ctx, mei, wo, active):  # noqa: ARG002
            of_value = mi.Spectrum(value(ctx) * dr.inv_four_pi)
            return of_value, mi.Float(dr.inv_four_pi)

        def to_string(self):
            return "Scatterer[]"

    mi.register_phase("blind_scatterer", Scatterer)
    return validate({"type": "blind_scatterer"}, effort="quick")


@pytest.mark.parametrize(
    ("of_weight", "name"), [(1.0, "sampled_weight"), (1.2, "energy")]
)
def test_phase_functions_are_asked_in_radiance_mode(of_weight, name):
    """As `volpath` asks them; where both functions are off, integrals tell."""

    def seen(factor):
        return lambda ctx: factor if ctx.mode == mi.TransportMode.Radiance else 1.0

    assert verdict_of_phase(seen(1.0), seen(1.0)).passed
    found = verdict_of_phase(seen(of_weight), seen(1.2))[name]
    assert found.status == "fails"
    assert "radiance mode" in found.statistic


# --------------------------------------------------------------------- weights, places


def test_weights_that_are_wrong_by_direction_bias_images():
    """Their mean is right; the twin's are noise, whose mean is right everywhere."""

    def tilted(self, si, wo, u):  # noqa: ARG001
        return ALBEDO * (1 + 0.05 * (1.5 * wo.z - 1))

    def noisy(self, si, wo, u):  # noqa: ARG001
        return ALBEDO * (0.95 + 0.1 * u)

    judged = verdict(Matte, weight=tilted)
    assert judged["sampled_weight"].effect == "biases images"
    assert not judged.passed
    judged = verdict(Matte, weight=noisy)
    assert judged["sampled_weight"].effect == HARMLESS
    assert judged.passed


@pytest.mark.parametrize("place", PLACES)
def test_a_mistake_in_one_place_is_found(place):
    """``pdf``, the pdf of a sample and its weight are off there, all alike."""

    def density(_, si, wo):
        own = dr.all(dr.abs(si.uv - mi.Point2f(*place)) < 0.01)
        return dr.select(own, 1.5, 1) * dr.inv_pi * wo.z

    def weight(self, si, wo, _):
        return ALBEDO * dr.inv_pi * wo.z / self.density(si, wo)

    lobes = ("DiffuseReflection FrontSide SpatiallyVarying",)
    judged = verdict(Matte, density=density, weight=weight, lobes=lobes)
    found, named = judged["sampling"], f"uv ({place[0]:g}, {place[1]:g})"
    assert found.status == "fails"
    if place != PLACES[0]:  # where maps are, too
        assert named in found.statistic
        # of all ratios, a sweep's are wrong there only
        assert named in verdict(Matte, density=density, lobes=lobes).mistake


# ----------------------------------------------------------------------------- lobes


class Painted(Matte):
    """Right: matte under gloss, each asked for by its type alone.

    ``ctx.is_enabled(type)`` means component 0: that component is the whole.
    """

    lobes = ("DiffuseReflection FrontSide", "GlossyReflection FrontSide")
    drawn = 0.5  # share of the matte lobe

    def __init__(self, props):
        Matte.__init__(self, props)
        gloss = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.3}
        self.gloss = mi.load_dict(gloss | {"specular_reflectance": 0.4})

    def shares(self, ctx, share=0.5):
        matte, glossy = map(
            ctx.is_enabled,
            (mi.BSDFFlags.DiffuseReflection, mi.BSDFFlags.GlossyReflection),
        )
        return (share, 1 - share) if matte and glossy else (matte, glossy)

    def sample(self, ctx, si, sample1, sample2, active):
        bs, _ = self.gloss.sample(mi.BSDFContext(), si, sample1, sample2, active)
        matte = sample1 < self.shares(ctx, self.drawn)[0]
        bs.wo = dr.select(matte, mi.warp.square_to_cosine_hemisphere(sample2), bs.wo)
        bs.pdf, bs.eta = self.pdf(ctx, si, bs.wo, active), 1.0
        bs.sampled_type = dr.select(
            matte,
            mi.UInt32(flags("DiffuseReflection")),
            mi.UInt32(flags("GlossyReflection")),
        )
        bs.sampled_component = dr.select(matte, mi.UInt32(0), mi.UInt32(1))
        value = self.eval(ctx, si, bs.wo, active)
        return bs, (value / bs.pdf) & (bs.pdf > 0)

    def eval(self, ctx, si, wo, active):
        matte, glossy = map(
            ctx.is_enabled,
            (mi.BSDFFlags.DiffuseReflection, mi.BSDFFlags.GlossyReflection),
        )
        gloss = self.gloss.eval(mi.BSDFContext(), si, wo, active)
        return matte * 0.8 * Matte.eval(self, ctx, si, wo, active) + glossy * gloss

    def pdf(self, ctx, si, wo, active):
        matte, glossy = self.shares(ctx)
        gloss = self.gloss.pdf(mi.BSDFContext(), si, wo, active)
        return matte * Matte.pdf(self, ctx, si, wo, active) + glossy * gloss


@pytest.mark.parametrize("drawn", [0.5, 0.55])
def test_a_lobe_drawn_too_often_is_told_so(drawn):
    judged = verdict(Painted, drawn=drawn)
    assert judged["flags"].status == "holds"
    assert judged.passed == (drawn == 0.5)
    if not judged.passed:
        assert judged.mistake.startswith("`sample` or `pdf`: directions are drawn")


class Stub(Matte):
    """A second component of density 0, or the whole, where ``eval`` ignores both."""

    lobes = ("DiffuseReflection FrontSide", "GlossyReflection FrontSide")
    dark = 1

    def pdf(self, ctx, si, wo, active):
        asked = ctx.component if ctx.component < 2 else None  # 2^32 - 1 means all
        return Matte.pdf(self, ctx, si, wo, active) * (asked != self.dark)


@pytest.mark.parametrize("dark", [1, None])
def test_light_of_a_single_component_concerns_the_interface(dark):
    judged = verdict(Stub, dark=dark)
    assert judged.passed == (dark == 1), str(judged)
    if judged.passed:
        found = judged["weights"]
        assert "component 1" in found.statistic
        assert found.effect == HARMLESS


class Deaf(Painted):
    """Its samples heed no mask, not even of types; its values do."""

    def sample(self, ctx, si, sample1, sample2, active):
        ctx = mi.BSDFContext(ctx.mode)
        return Painted.sample(self, ctx, si, sample1, sample2, active)


def test_samples_of_types_that_are_excluded_are_told():
    found = verdict(Deaf)["flags"]
    assert found.mistake == "`sample` ignores ctx.type_mask"
    assert found.effect == HARMLESS


class Veil(Normal):
    """Lets half of the light from the front pass, and none from the back."""

    lobes = ("Null FrontSide",)
    reported = ALBEDO

    def sample(self, ctx, si, sample1, sample2, active):
        bs, weight = Normal.sample(self, ctx, si, sample1, sample2, active)
        bs.wo = -si.wi
        bs.sampled_type = mi.UInt32(flags("Null"))
        return bs, weight

    def eval_null_transmission(self, si, active):
        return mi.Spectrum(self.reported) & (active & (si.wi.z > 0))


def test_a_lobe_that_goes_one_way_is_a_property_of_the_model():
    """As of a smooth one; no index takes part. Declared so, it is no remark."""
    found = right(Veil)["reciprocity"]
    assert found.effect == "a property of the model"
    assert "eta" not in found.mistake
    declared = ("Null FrontSide NonSymmetric",)
    assert verdict(Veil, lobes=declared)["reciprocity"].status != "fails"


def test_a_null_lobe_is_compared_with_weight_times_pdf():
    assert right(Veil)["delta"].status == "holds"
    found = verdict(Veil, reported=0.3)["delta"]
    assert "is not weight times pdf of the null lobe" in found.mistake


def test_a_phase_function_that_loses_light_is_told_so():
    judged = verdict_of_phase(lambda _: 0.97, lambda _: 0.97)
    assert judged.mistake == "`eval` is not energy conserving: albedo 0.97"


@pytest.mark.parametrize("kept", [0.5, 0.6])
def test_a_roulette_of_a_phase_function_adds_noise(kept):
    """Its weight is 2; the twin's, for it rejects less, is too much."""

    class Rejecting(mi.PhaseFunction):
        def __init__(self, props):
            mi.PhaseFunction.__init__(self, props)
            self.m_flags = mi.PhaseFunctionFlags.Anisotropic
            self.m_components = [self.m_flags]
            self.inner = mi.load_dict({"type": "hg", "g": 0.6})

        def sample(self, ctx, mei, sample1, *others):
            wo, weight, pdf = self.inner.sample(ctx, mei, sample1, *others)
            return wo, weight * dr.select(sample1 < kept, 2.0, 0.0), pdf

        def eval_pdf(self, *arguments):
            return self.inner.eval_pdf(*arguments)

        def to_string(self):
            return "Rejecting[]"

    mi.register_phase("rejecting", Rejecting)
    judged = validate({"type": "rejecting"}, effort="quick")
    assert judged.passed == (kept == 0.5), str(judged)
    if judged.passed:
        assert judged["sampling"].effect == "adds noise"
        assert "Russian roulette of its own" in judged.mistake
