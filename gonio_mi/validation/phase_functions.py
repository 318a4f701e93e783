"""Phase functions, examined as BSDFs of the whole sphere without a cosine."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..specimen.media import N_RINGED, ask_phase_function
from .arrays import Sides, drawn, lit_from, rows, smooth, value
from .checks.energy import ENERGY, Energy
from .checks.reciprocity import RECIPROCITY, ratio_text
from .checks.sampling import SAMPLING
from .checks.weights import WEIGHTS
from .conditions import EFFORTS, Condition
from .evidence import Evidence
from .judgements import by_sample
from .mistakes import EVAL, SAMPLE, Claim, Function, Mistake
from .probe import Probe, numbers, vectors
from .samples import Samples, beyond_rounding, unequal


class OfVolumes(Mistake):
    """What is wrong with a phase function alone."""

    SCATTERS_OTHERWISE = "{who} scatters otherwise than `eval` says"
    DRAWS_OTHERWISE = "directions are drawn otherwise than `pdf` says"
    ASYMMETRIC = "{who} is not symmetric in wi and wo"
    PRODUCT_ASYMMETRIC = "{who}: their product is not symmetric in wi and wo"


# Directions of light that are asked: off all axes, on them, and grazing to a plane
# that no phase function knows of; every other one in a frame that is turned.
ASKED = (
    Condition(0.0, 25.0, uv=(0.35, 0.6)),
    Condition(40.0, 140.0, uv=(0.15, 0.7), turned=True),
    Condition(75.0, 260.0, uv=(0.35, 0.6)),
    Condition(50.0, 305.0, "back", (0.15, 0.7), turned=True),
)

# Those of maps, by effort.
MAPPED = dict(zip(EFFORTS.values(), (ASKED[1:2], ASKED[:3], ASKED)))


class Scatterer:
    """A phase function that is asked as a BSDF, in coordinates of the world."""

    def __init__(self, phase: mi.PhaseFunction) -> None:
        self.phase = phase

    def sample(self, ctx: Any, mei: Any, *u: Any) -> tuple[Any, Any]:
        """Samples, whose types are not known, and their weights."""
        bs, mei.sh_frame = dr.zeros(mi.BSDFSample3f), mi.Frame3f(mei.wi)
        bs.wo, weight, bs.pdf = self.phase.sample(ctx, mei, *u)
        return bs, weight

    def eval_pdf(self, ctx: Any, mei: Any, *asked: Any) -> tuple[Any, Any]:
        """Both answers."""
        mei.sh_frame = mi.Frame3f(mei.wi)
        return self.phase.eval_pdf(ctx, mei, *asked)

    def eval(self, *asked: Any) -> Any:
        """The first of them."""
        return self.eval_pdf(*asked)[0]

    def pdf(self, *asked: Any) -> Any:
        """The second."""
        return self.eval_pdf(*asked)[1]


def symmetric(bsdf: Any, ctx: Any, si: Any, u: Any) -> Sides:
    """Light goes both ways alike."""
    bs, weight = drawn(bsdf, ctx, si, u)
    back = value(bsdf, ctx, lit_from(si, bs.wo), si.wi)
    return value(bsdf, ctx, si, bs.wo), back, smooth(bs, weight)


def symmetric_flakes(bsdf: Any, ctx: Any, si: Any, u: Any) -> Sides:
    """Light goes both ways alike, times the projected area of microflakes."""
    bs, _ = drawn(bsdf, ctx, si, u)
    ways = [(si, bs.wo), (lit_from(si, bs.wo), si.wi)]
    areas = [rows(bsdf.phase.projected_area(at, mi.Bool(True))) for at, _ in ways]
    there, back = (value(bsdf, ctx, *way) * x for way, x in zip(ways, areas))
    return there, back, True


def as_bsdf(phase: mi.PhaseFunction) -> mi.BSDF:
    """BSDF with the answers of a phase function, in the frame of the surface.

    Its ``eval`` and ``pdf`` are the two answers of ``eval_pdf``; light goes to both
    sides; turned surfaces probe it off the axes of the world.
    """
    flags = mi.BSDFFlags
    back, on = int(flags.GlossyReflection), int(flags.GlossyTransmission)
    lobes = back | on | int(flags.FrontSide | flags.BackSide | flags.Anisotropic)

    class Scatterer(mi.BSDF):
        """Asks the phase function at a point of a medium."""

        phase_function = phase

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.m_flags = lobes
            self.m_components = [lobes] * max(1, phase.component_count())

        def _asked(self, ctx: Any, si: Any) -> tuple[Any, Any]:
            """Context and point of a medium."""
            context = mi.PhaseFunctionContext(None, ctx.mode)
            context.component = ctx.component
            mei = dr.zeros(mi.MediumInteraction3f)
            for name in ("t", "time", "p", "n", "wavelengths"):
                setattr(mei, name, getattr(si, name))
            mei.wi, mei.sh_frame = (wi := si.to_world(si.wi)), mi.Frame3f(wi)
            return context, mei

        def sample(
            self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True
        ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
            """Answer of the phase function, with the type of its side."""
            asked = *self._asked(ctx, si), sample1, sample2, active
            wo, weight, pdf = phase.sample(*asked)
            bs = dr.zeros(mi.BSDFSample3f, dr.width(si.wi, sample1, sample2))
            bs.wo, bs.pdf, bs.eta = si.to_local(mi.Vector3f(wo)), pdf, 1.0
            bs.sampled_type = dr.select(bs.wo.z * si.wi.z < 0, mi.UInt32(on), back)
            return bs, weight

        def eval_pdf(
            self, ctx: Any, si: Any, wo: Any, active: Any = True
        ) -> tuple[mi.Spectrum, mi.Float]:
            return phase.eval_pdf(*self._asked(ctx, si), si.to_world(wo), active)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> mi.Spectrum:
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> mi.Float:
            return self.eval_pdf(ctx, si, wo, active)[1]

        def traverse(self, callback: Any) -> None:
            phase.traverse(callback)

        def parameters_changed(self, keys: Any) -> None:
            phase.parameters_changed(keys)

        def class_name(self) -> str:
            return phase.class_name()

        def to_string(self) -> str:
            return str(phase)

    return Scatterer(mi.Properties("scatterer"))


class Densities:
    """A phase function whose values are its densities, and whose weights are 1."""

    def __init__(self, phase: mi.PhaseFunction) -> None:
        self.phase = phase

    def sample(self, *asked: Any) -> tuple[mi.Vector3f, mi.Spectrum, mi.Float]:
        """Directions of weight 1."""
        wo, _, pdf = self.phase.sample(*asked)
        return wo, mi.Spectrum(1.0) + 0 * pdf, pdf

    def eval_pdf(self, *asked: Any) -> tuple[mi.Spectrum, mi.Float]:
        """The density as both answers."""
        _, pdf = self.phase.eval_pdf(*asked)
        return mi.Spectrum(pdf), pdf


def check_rings(evidence: Evidence) -> None:
    """Check light and directions in rings about the incident direction.

    By the test of a measurement before it follows rays through a medium, which works
    for any sharp lobe.
    """
    phase = evidence.bsdf.phase_function
    wavelengths = Probe(evidence.bsdf, ASKED[0]).interaction().wavelengths
    light = ask_phase_function(phase, wavelengths)
    drawn = ask_phase_function(Densities(phase), wavelengths)
    for question, found, mistake in (
        (WEIGHTS, light, OfVolumes.SCATTERS_OTHERWISE),
        (SAMPLING, drawn, OfVolumes.DRAWS_OTHERWISE),
    ):
        size = float(found.misplaced.max())
        text = f"{size:.2g} of the light in other rings"
        evidence.remark(question.name, f"of 4 directions, in rings about them: {text}")
        if found.excess > 1:
            text += f", {found.excess:.3g} times the tolerance"
            how = {"size": size, "off": min(size, 1.0)}
            evidence.breach(question, mistake(SAMPLE), found=text, **how)
    flux = light.evaluated[:, :N_RINGED].sum(axis=1)
    limit = light.tolerance[:, :N_RINGED].sum(axis=1)
    k = int((np.abs(flux - 1) - limit).argmax())
    size = abs(float(flux[k]) - 1)
    if size > limit[k]:
        total = f"{flux[k]:.4g}"
        guess, text = Energy.NOT_1(EVAL, flux=total), f"`eval` integrates to {total}"
        evidence.breach(ENERGY, guess, found=text, size=size)


def check_symmetry(evidence: Evidence, samples: Samples) -> None:
    """Check symmetry, with the projected area of microflakes (Jakob et al. 2010)."""
    usable = samples.usable & np.isfinite(samples.reverse).all(axis=1)
    if not usable.any():
        return
    asked = evidence.bsdf, samples.condition
    areas = [_projected_area(*asked, one) for one in (samples.wi, samples.wo)]
    there, back = samples.eval * areas[0], samples.reverse * areas[1]
    slack = samples.eval_slack * areas[0] + samples.reverse_slack * areas[1]
    wrong = unequal(there, back, slack) & usable
    if beyond_rounding(wrong):
        guess, stated = OfVolumes.ASYMMETRIC(EVAL), symmetric
        if _is_of_microflakes(evidence.bsdf):
            guess = OfVolumes.PRODUCT_ASYMMETRIC(EVAL | Function.PROJECTED_AREA)
            stated = symmetric_flakes
        text = ratio_text(there, back, wrong, samples)
        shown = Claim(stated, by_sample)
        how = {"statistic": text, "off": None, "shown": shown}
        evidence.breach(RECIPROCITY, guess, samples, wrong, **how)


def _is_of_microflakes(bsdf: mi.BSDF) -> bool:
    """Whether a phase function declares microflakes."""
    microflake = mi.PhaseFunctionFlags.Microflake
    return bool(mi.has_flag(bsdf.phase_function.flags(), microflake))


def _projected_area(bsdf: mi.BSDF, condition: Condition, local: Floats) -> Floats:
    """Projected area of microflakes seen from local directions, (n, 1); else 1."""
    phase, n = bsdf.phase_function, len(local)
    if not _is_of_microflakes(bsdf):
        return np.ones((n, 1))
    si = Probe(bsdf, condition).interaction(vectors(local))
    mei = dr.zeros(mi.MediumInteraction3f, n)
    mei.wi, mei.p = si.to_world(si.wi), si.p
    area: Any = phase.projected_area(mei, mi.Bool(True))
    return numbers(area, n).astype(float)[:, None]
