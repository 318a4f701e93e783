# ruff: noqa: ARG002 (every method has Mitsuba's signature)
"""Right phase functions, and the same with one mistake each, as `broken_bsdfs`."""

import drjit as dr
import mitsuba as mi

# Name of a broken phase function, and the guilty function.
MISTAKES = {
    "draws_backward": "sample",
    "draws_another_g": "sample",
    "draws_local": "sample",
    "not_unit": "sample",
    "weight_is_value": "sample",
    "weight_of_albedo": "sample",
    "returns_another_pdf": "sample",
    "eval_with_cosine": "eval",
    "eval_without_quarter": "eval",
    "eval_loses_three_percent": "eval",
    "eval_nan_straight_on": "eval",
    "gains_one_percent": "eval",
    "pdf_uniform": "pdf",
    "of_one_way": "eval",
    "flags_isotropic": "flags",
    "gradient_detached": "eval",
}
RIGHT = ("right_lobe", "right_dipole")


def _classes():
    """Classes for the variant that is set, by name."""

    class RightLobe(mi.PhaseFunction):
        """Lobe of Henyey and Greenstein, of a parameter g."""

        def __init__(self, props):
            mi.PhaseFunction.__init__(self, props)
            self.g = mi.Float(props.get("g", 0.6))
            self.m_flags = int(mi.PhaseFunctionFlags.Anisotropic)

        def density(self, cosine, g):
            below = 1 + g * g - 2 * g * cosine
            return dr.inv_four_pi * (1 - g * g) / (below * dr.sqrt(below))

        def draw(self, g, u):
            term = (1 - g * g) / (1 - g + 2 * g * u.x)
            cosine = (1 + g * g - term * term) / (2 * g)
            sine = dr.safe_sqrt(1 - cosine * cosine)
            s, c = dr.sincos(dr.two_pi * u.y)
            return mi.Vector3f(sine * c, sine * s, -cosine)

        def sample(self, ctx, mei, u1, u2, active=True):
            wo = mei.to_world(self.draw(self.g, u2))
            return wo, mi.Spectrum(1.0), self.eval_pdf(ctx, mei, wo, active)[1]

        def eval_pdf(self, ctx, mei, wo, active=True):
            pdf = self.density(-dr.dot(wo, mei.wi), self.g)
            return mi.Spectrum(pdf), pdf

        def traverse(self, callback):
            callback.put("g", self.g, mi.ParamFlags.Differentiable)

        def to_string(self):
            return "Lobe[]"

    class DrawsBackward(RightLobe):
        def sample(self, ctx, mei, u1, u2, active=True):
            wo = -mei.to_world(self.draw(self.g, u2))
            return wo, mi.Spectrum(1.0), self.eval_pdf(ctx, mei, wo, active)[1]

    class DrawsAnotherG(RightLobe):
        def sample(self, ctx, mei, u1, u2, active=True):
            wo = mei.to_world(self.draw(0.95 * self.g, u2))
            return wo, mi.Spectrum(1.0), self.eval_pdf(ctx, mei, wo, active)[1]

    class DrawsLocal(RightLobe):
        def sample(self, ctx, mei, u1, u2, active=True):
            wo = self.draw(self.g, u2)
            return wo, mi.Spectrum(1.0), self.eval_pdf(ctx, mei, wo, active)[1]

    class NotUnit(RightLobe):
        def sample(self, ctx, mei, u1, u2, active=True):
            wo, weight, pdf = super().sample(ctx, mei, u1, u2, active)
            return 1.01 * wo, weight, pdf

    class WeightIsValue(RightLobe):
        def sample(self, ctx, mei, u1, u2, active=True):
            wo, _, pdf = super().sample(ctx, mei, u1, u2, active)
            return wo, mi.Spectrum(pdf), pdf

    class WeightOfAlbedo(RightLobe):
        def sample(self, ctx, mei, u1, u2, active=True):
            wo, weight, pdf = super().sample(ctx, mei, u1, u2, active)
            return wo, 0.9 * weight, pdf

    class ReturnsAnotherPdf(RightLobe):
        def sample(self, ctx, mei, u1, u2, active=True):
            wo, weight, pdf = super().sample(ctx, mei, u1, u2, active)
            return wo, weight, dr.two_pi * pdf

    class EvalWithCosine(RightLobe):
        def eval_pdf(self, ctx, mei, wo, active=True):
            value, pdf = super().eval_pdf(ctx, mei, wo, active)
            return value * dr.abs(dr.dot(wo, mei.wi)), pdf

    class EvalWithoutQuarter(RightLobe):
        def eval_pdf(self, ctx, mei, wo, active=True):
            value, pdf = super().eval_pdf(ctx, mei, wo, active)
            return 4 * value, pdf

    class EvalLosesThreePercent(RightLobe):
        def eval_pdf(self, ctx, mei, wo, active=True):
            _, pdf = super().eval_pdf(ctx, mei, wo, active)
            return 0.97 * mi.Spectrum(pdf), pdf

    class EvalNanStraightOn(RightLobe):
        def eval_pdf(self, ctx, mei, wo, active=True):
            value, pdf = super().eval_pdf(ctx, mei, wo, active)
            half = dr.norm(wo + mei.wi)
            return value * (half / half), pdf

    class GainsOnePercent(RightLobe):
        def sample(self, ctx, mei, u1, u2, active=True):
            wo, weight, pdf = super().sample(ctx, mei, u1, u2, active)
            return wo, 1.01 * weight, pdf

        def eval_pdf(self, ctx, mei, wo, active=True):
            value, pdf = super().eval_pdf(ctx, mei, wo, active)
            return 1.01 * value, pdf

    class PdfUniform(RightLobe):
        def eval_pdf(self, ctx, mei, wo, active=True):
            value, pdf = super().eval_pdf(ctx, mei, wo, active)
            return value, dr.inv_four_pi + 0 * pdf

        def sample(self, ctx, mei, u1, u2, active=True):
            wo = mei.to_world(self.draw(self.g, u2))
            pdf = RightLobe.eval_pdf(self, ctx, mei, wo, active)[1]
            return wo, mi.Spectrum(1.0), pdf

    class FlagsIsotropic(RightLobe):
        def __init__(self, props):
            super().__init__(props)
            self.m_flags = int(mi.PhaseFunctionFlags.Isotropic)

    class GradientDetached(RightLobe):
        def eval_pdf(self, ctx, mei, wo, active=True):
            pdf = self.density(-dr.dot(wo, mei.wi), dr.detach(self.g))
            return mi.Spectrum(pdf), pdf

    class RightDipole(mi.PhaseFunction):
        """Light that is scattered along an axis of the world, and across it, alike."""

        strength = 0.8

        def __init__(self, props):
            mi.PhaseFunction.__init__(self, props)
            self.m_flags = int(mi.PhaseFunctionFlags.Anisotropic)

        def tilt(self, wi):
            return self.strength * wi.x

        def eval_pdf(self, ctx, mei, wo, active=True):
            pdf = dr.inv_four_pi * (1 + self.tilt(mei.wi) * wo.x)
            return mi.Spectrum(pdf), pdf

        def sample(self, ctx, mei, u1, u2, active=True):
            # a cosine x of the density (1 + a x) / 2: turned about, if u1 says so
            wo = mi.warp.square_to_uniform_sphere(u2)
            turned = u1 > 0.5 * (1 + self.tilt(mei.wi) * wo.x)
            wo.x = dr.select(turned, -wo.x, wo.x)
            return wo, mi.Spectrum(1.0), self.eval_pdf(ctx, mei, wo, active)[1]

        def to_string(self):
            return "Dipole[]"

    class OfOneWay(RightDipole):
        def tilt(self, wi):
            return self.strength + 0 * wi.x

    return {
        "".join("_" * (i > 0 and c.isupper()) + c.lower() for i, c in enumerate(k)): v
        for k, v in locals().items()
        if isinstance(v, type)
    }


def register():
    """Register all for the variant that is set."""
    for name, cls in _classes().items():
        mi.register_phase(name, cls)
