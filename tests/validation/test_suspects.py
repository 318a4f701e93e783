# ruff: noqa: ARG002 (every method has Mitsuba's signature)
"""Which function is wrong: of a density but for a factor, or beside another mistake."""

import broken_bsdfs
import drjit as dr
import mitsuba as mi
import pytest

from gonio_mi.validation import validate

# Probability with which `sample` gives a direction that it has drawn, and the factor of
# `pdf`.
HALF, COSINE, ALL = "half", "cosine", "all"

# What is wrong, the functions that may be guilty, and what is said of them.
OF_SAMPLE = "`sample`: its density has an extra factor cos(theta_o) ("
CASES = [
    ({"kept": HALF}, "sample", "`sample`: its density lacks the factor 2 ("),
    ({"kept": COSINE}, "sample", OF_SAMPLE),
    ({"factor": COSINE}, "pdf", "`pdf` has an extra factor cos(theta_o) ("),
    ({"kept": COSINE, "weighed": True}, "pdf", "`pdf` lacks the factor cos(theta_o) ("),
    ({"kept": COSINE, "cut": True}, "sample", OF_SAMPLE),
    (
        {"kept": COSINE, "cut": True, "hidden": True},
        "sample or pdf",
        "`pdf` lacks the factor cos(theta_o), or the density of `sample` has an extra",
    ),
]


def register(kept=ALL, factor=ALL, cut=False, weighed=False, hidden=False):
    """Define and register the plugin ``suspects``.

    Some directions are `cut` off, where ``eval`` and ``pdf`` are 0, too; weights are
    those of the true density if they are `weighed`; directions that are lost are not
    told if they are `hidden`.
    """
    flags = mi.BSDFFlags
    cosine = mi.Frame3f.cos_theta

    def part(name, wo):
        return {HALF: mi.Float(0.5), COSINE: cosine(wo), ALL: mi.Float(1)}[name]

    class Suspects(mi.BSDF):
        def __init__(self, props):
            super().__init__(props)
            self.m_flags = flags.DiffuseReflection | flags.FrontSide
            self.m_components = [self.m_flags]

        def above(self, si, wo):
            seen = wo.x < 0.7 if cut else True
            return (cosine(si.wi) > 0) & (cosine(wo) > 0) & seen

        def sample(self, ctx, si, sample1, sample2, active):
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
            bs.pdf, bs.eta = self.pdf(ctx, si, bs.wo, active), 1.0
            bs.sampled_type = mi.UInt32(+flags.DiffuseReflection)
            weight = self.eval(ctx, si, bs.wo, active) / bs.pdf
            weight /= part(kept, bs.wo) if weighed else 1
            given = (bs.pdf > 0) & (sample1 < part(kept, bs.wo))
            if hidden:
                bs.wo = dr.select(given, bs.wo, 0)
            return bs, dr.select(given, weight, 0)

        def eval(self, ctx, si, wo, active):
            value = mi.Spectrum(0.5 * dr.inv_pi * cosine(wo))
            return value & (active & self.above(si, wo))

        def pdf(self, ctx, si, wo, active):
            density = dr.inv_pi * cosine(wo) * part(factor, wo)
            return dr.select(active & self.above(si, wo), density, 0)

        def eval_pdf(self, ctx, si, wo, active):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def to_string(self):
            return "Suspects[]"

    mi.register_bsdf("suspects", Suspects)


@pytest.mark.parametrize(("changes", "function", "said"), CASES)
def test_the_guilty_one_or_both_are_named(changes, function, said):
    register(**changes)
    verdict = validate({"type": "suspects"}, effort="quick")
    assert not verdict.passed
    assert verdict.function == function, str(verdict)
    assert verdict.mistake.startswith(said)


def test_a_density_that_is_cut_off_is_right():
    """The twin: what is lost is where `pdf` is 0."""
    register(cut=True)
    verdict = validate({"type": "suspects"}, effort="quick", allow="reciprocity")
    assert verdict.passed, str(verdict)
    assert verdict["sampling"].status == "holds"


# Broken ones that are lit from above alone, one of each kind of mistake.
ONE_SIDED = (
    *("eval_without_cosine", "eval_gains_one_percent", "eval_nan_at_grazing"),
    *("weight_with_cosine", "sample_not_unit", "pdf_half_a_percent_off"),
    *("phi_with_wrong_sign", "density_without_jacobian", "value_without_cosine"),
    "gradient_detached",
)


@pytest.fixture
def unguarded(mono):
    """A function that registers a plugin whose ``pdf`` does not look at wi.z."""
    del mono
    plugins = broken_bsdfs.register()

    def add(name):
        class Unguarded(plugins[name]):
            def pdf(self, ctx, si, wo, active=True):
                above = mi.SurfaceInteraction3f(si)
                above.wi = mi.Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))
                return super().pdf(ctx, above, wo, active)

        mi.register_bsdf("unguarded", Unguarded)
        return {"type": "unguarded"}

    return add


@pytest.mark.parametrize("name", ONE_SIDED)
def test_an_unguarded_pdf_is_blamed_for_nothing_else(name, unguarded):
    verdict = validate(unguarded(name), effort="quick")
    assert verdict.function == broken_bsdfs.judged(name, "quick").function, str(verdict)
    assert "sampling" in {one.name for one in verdict.failures}


def test_twin_an_unguarded_pdf_alone_is_named(unguarded):
    verdict = validate(unguarded("lambert"), effort="quick")
    assert verdict.passed
    assert verdict.function == "pdf"
    assert [one.name for one in verdict.failures] == ["sampling"]


# What is said where a factor or a rejection is known.
SAID = {
    "weight_five_percent_less": "`eval` or the weight of `sample`: they differ by",
    "roulette_without_its_probability": "`sample` rejects 0.29",
    "lobes_picked_the_wrong_way": "`sample` draws another lobe for component 0 alone",
    "sample_reused": "`sample` draws other directions of component 0 in the whole than",
    "axes_swapped": "`sample` draws directions of half vectors with x and y swapped",
    "pdf_with_axes_swapped": "`pdf` is that of directions of half vectors with x and",
}


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize("name", SAID)
def test_the_mistake_is_known(name):
    broken_bsdfs.register()
    assert broken_bsdfs.judged(name, "quick").mistake.startswith(SAID[name])
