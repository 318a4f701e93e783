# ruff: noqa: ARG002 (every method has Mitsuba's signature)
"""What is next to nothing is told and passes; what is bright, or no chance, fails.

Right ones are those of the corpora; these are their broken twins.
"""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import pytest
from plain_bsdf import name_of, over, plain
from unusual_right import NanAtGrazing, Noisy, OwnRandomNumbers, StochasticEval

from gonio_mi.validation import validate


class HalfByChance(StochasticEval):
    """Its mean is half of what `sample` scatters."""

    def eval(self, ctx, si, wo, active=True):
        return 0.5 * super().eval(ctx, si, wo, active)


class JointHalf(StochasticEval):
    """`eval_pdf` has half of its mean."""

    def eval_pdf(self, ctx, si, wo, active=True):
        value, pdf = super().eval_pdf(ctx, si, wo, active)
        return 0.5 * value, pdf


class OwnUniform(OwnRandomNumbers):
    """Its own numbers have another density than `pdf`."""

    def direction(self, ctx, si, sample1, sample2):
        rng = self.own(dr.width(sample2, si.wi))
        point = mi.Point2f(rng.next_float32(), rng.next_float32())
        return mi.warp.square_to_uniform_hemisphere(point)


class UniformBesideNoise(StochasticEval):
    """Its directions are uniform, their density is said to be of the cosine."""

    def direction(self, ctx, si, sample1, sample2):
        return mi.warp.square_to_uniform_hemisphere(sample2)


class NanNearGrazing(NanAtGrazing):
    """NaN within a hundredth of a degree of the surface."""

    def eval(self, ctx, si, wo, active=True):
        value = super().eval(ctx, si, wo, active)
        near = (wo.z > 0) & (wo.z < 2e-4)
        return dr.select(near, dr.nan, value)


class Fireflies(Noisy):
    """One sample in fifty thousand has ten thousand times its weight."""

    def weight(self, ctx, si, bs):
        rare = dr.abs(bs.wo.x) < 1e-5
        return super().weight(ctx, si, bs) * dr.select(rare, 1e4, 1.0)


class LosesLittle:
    """Of 20 000 samples one fails, at all angles of incidence."""

    lost = 5e-5

    def weight(self, ctx, si, bs):
        return super().weight(ctx, si, bs) & self.kept

    def direction(self, ctx, si, sample1, sample2):
        self.kept = sample1 > self.lost
        return super().direction(ctx, si, sample1, sample2)


class DoubleAtGrazing:
    """A tenth of even samples have a hundredth of the light, which is doubled."""

    wrong, factor = "sample", 2.0

    def direction(self, ctx, si, sample1, sample2):
        return mi.warp.square_to_uniform_hemisphere(sample2)

    def density(self, ctx, si, wo):
        return dr.inv_two_pi + 0 * wo.z

    def by(self, function, wo):
        return dr.select((function == self.wrong) & (wo.z < 0.1), self.factor, 1)

    def weight(self, ctx, si, bs):
        return super().weight(ctx, si, bs) * self.by("sample", bs.wo)

    def eval(self, ctx, si, wo, active=True):
        return super().eval(ctx, si, wo, active) * self.by("eval", wo)

    def eval_pdf(self, ctx, si, wo, active=True):
        value, pdf = super().eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)
        return value * self.by("eval_pdf", wo), pdf


class JointDarkAtGrazing(DoubleAtGrazing):
    """What `eval_pdf` has not is a hundredth of the light, too."""

    wrong, factor = "eval_pdf", 0.0


def judged(mixin, **options):
    """Verdict on a mixin."""
    mi.register_bsdf(name_of(mixin), over(mixin, plain()))
    return validate({"type": name_of(mixin)}, **{"effort": "quick"} | options)


@pytest.mark.parametrize(
    ("mixin", "function", "property_"),
    [
        (HalfByChance, "eval", "sampled_weight"),
        (JointHalf, "eval_pdf", "eval_pdf"),
        (OwnUniform, "sample", "sampling"),
        (UniformBesideNoise, "sample", "sampling"),
        (NanNearGrazing, "eval", "ends"),
        (Fireflies, "sample", "weights"),
    ],
)
@pytest.mark.usefixtures("mono")
def test_what_is_no_chance_and_not_little_fails(mixin, function, property_):
    verdict = judged(mixin)
    assert not verdict.passed, str(verdict)
    assert verdict[property_].counts, str(verdict)
    assert function in str(verdict.function).split(" or "), str(verdict)


@pytest.mark.usefixtures("mono")
def test_next_to_nothing_is_told_and_fails_if_strict():
    """5e-5 of the flux are lost wherever light comes from."""
    verdict = judged(LosesLittle, effort="normal")
    assert verdict.passed, str(verdict)
    assert "passes, with a remark: biases images, but next to" in verdict.headline
    assert "of the flux from an illuminated surface" in verdict.headline
    told = {one["name"]: one for one in verdict.to_dict()["properties"]}
    assert told["sampling"]["status"] == "fails"
    assert told["sampling"]["minor"]
    assert 1e-6 < told["sampling"]["share"] < 1e-4
    strict = replace(verdict, settings=verdict.settings | {"strict": True})
    assert not strict.passed
    unknown = [replace(one, minor=False) for one in verdict.properties]
    assert not replace(verdict, properties=tuple(unknown)).passed


@pytest.mark.usefixtures("mono")
def test_what_is_little_at_some_angles_is_looked_at_between():
    """Beckmann facets lose 4e-5 of the flux at 80 degrees and 7e-4 at 75.

    By means of 2^24 samples and a midpoint rule: dhr 0.9144 and 0.9172 at 75 degrees.
    """
    verdict = validate({"type": "roughconductor", "alpha": 0.2}, effort="normal")
    assert not verdict.passed, str(verdict)
    assert 1e-4 < verdict["weights"].share < 2e-3


@pytest.mark.parametrize(
    ("mixin", "property_"),
    [
        (DoubleAtGrazing, "sampled_weight"),
        (JointDarkAtGrazing, "eval_pdf"),
    ],
)
@pytest.mark.usefixtures("mono")
def test_shares_are_of_the_light_not_of_samples(mixin, property_):
    """A hundredth of it, and a tenth of the samples."""
    verdict = judged(mixin)
    assert mixin.wrong in str(verdict.function), str(verdict)
    assert verdict[property_].counts, str(verdict)
    assert 0.005 < verdict[property_].share < 0.0125, str(verdict)
