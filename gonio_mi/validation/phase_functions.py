"""Phase functions, examined as BSDFs of the whole sphere without a cosine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..transport.media import N_RINGED, ask_phase_function
from .checks import (
    answers,
    components,
    cost,
    ends,
    masks,
    parameters,
    sampling,
    weights,
)
from .checks.consistency import check_again, check_identities
from .checks.reciprocity import ratio_text
from .conditions import Condition, Effort, sides_of
from .evidence import Evidence
from .integrals import SUM_ERROR
from .kinds import Kind
from .maps import FourMaps, four_maps
from .probe import Probe, numbers, vectors
from .samples import Samples, beyond_rounding, samples_of, unequal

# Directions of light that are asked: off all axes, on them, and grazing to a plane
# that no phase function knows of; every other one in a frame that is turned.
ASKED = (
    Condition(0.0, 25.0, uv=(0.35, 0.6)),
    Condition(40.0, 140.0, uv=(0.15, 0.7), turned=True),
    Condition(75.0, 260.0, uv=(0.35, 0.6)),
    Condition(50.0, 305.0, "back", (0.15, 0.7), turned=True),
)

# Those of maps at effort quick, and at others.
MAPPED = {"quick": ASKED[1:2], "normal": ASKED[:3], "thorough": ASKED}

# Parameters with ends of their own, and these.
ENDS = {"g": (-0.999, 0.999)}


def as_bsdf(phase: mi.PhaseFunction) -> mi.BSDF:
    """BSDF with the answers of a phase function, in the frame of the surface.

    Its ``eval`` and ``pdf`` are the two answers of ``eval_pdf``; light goes to both
    sides. Turned surfaces probe a phase function off the axes of the world.
    """
    flags = mi.BSDFFlags
    kinds = int(flags.GlossyReflection), int(flags.GlossyTransmission)
    lobes = sum(kinds) | int(flags.FrontSide) | int(flags.BackSide)

    class Scatterer(mi.BSDF):
        """Asks the phase function at a point of a medium."""

        phase_function = phase

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.m_flags = lobes | int(flags.Anisotropic)
            self.m_components = [self.m_flags] * max(1, phase.component_count())

        def _asked(self, ctx: Any, si: Any) -> tuple[Any, Any]:
            """Context and point of a medium."""
            context = mi.PhaseFunctionContext(None, ctx.mode)
            context.component = ctx.component
            mei = dr.zeros(mi.MediumInteraction3f)
            mei.wi, mei.p, mei.wavelengths = si.to_world(si.wi), si.p, si.wavelengths
            mei.sh_frame = mi.Frame3f(mei.wi)
            return context, mei

        def sample(
            self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True
        ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
            """Answer of the phase function, with the type of its side."""
            asked = *self._asked(ctx, si), sample1, sample2, active
            wo, weight, pdf = phase.sample(*asked)
            bs = dr.zeros(mi.BSDFSample3f, dr.width(si.wi, sample1, sample2))
            bs.wo, bs.pdf, bs.eta = si.to_local(mi.Vector3f(wo)), pdf, 1.0
            through = bs.wo.z * si.wi.z < 0
            bs.sampled_type = dr.select(through, mi.UInt32(kinds[1]), kinds[0])
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


def examine_phase_function(evidence: Evidence, plan: Effort, effort: str) -> None:
    """Run all checks of a phase function that :func:`as_bsdf` wraps, simplest first."""
    bsdf, seed = evidence.bsdf, evidence.seed
    for i, condition in enumerate(ASKED):
        samples = samples_of(bsdf, condition, plan.checked, (seed, 1, i))
        evidence.samples.append(samples)
        check_identities(evidence, samples)
        answers.check_lattice(evidence, Probe(bsdf, condition))
        _check_reciprocity(evidence, samples)
        if bsdf.component_count() > 1:
            components.check_samples(evidence, samples)
    sides = sides_of(bsdf)
    check_again(evidence, plan, sides)
    masks.check_bsdf(evidence)
    _excuse(evidence)
    _check_flags(evidence)
    parameters.check_samples(evidence, evidence.samples[1])
    ends.check_bsdf(evidence)
    ends.check_limits(evidence, ENDS)
    _check_maps(evidence, plan, MAPPED[effort])
    parameters.check_changes(evidence, plan, sides)
    cost.check_recorded(evidence, ASKED[1])


def _excuse(evidence: Evidence) -> None:
    """Turn breaches that all of Mitsuba's own phase functions have into remarks.

    They answer inactive rays, and draw azimuths from an axis of the world.
    """
    awake = [one for one in evidence.of("masks") if "ignores `active`" in one.mistake]
    if awake:
        evidence.breaches[:] = [one for one in evidence.breaches if one not in awake]
        text = "remark, no effect on images: inactive rays get a value, as of all of "
        text += "Mitsuba's own phase functions"
        evidence.remarks["masks"] = text  # which says all, of `pdf` too
    world = evidence.remarks.pop("answers", "")
    if world and not world.startswith("`sample`"):
        evidence.remark("answers", "it depends on axes of the world")


def _check_maps(
    evidence: Evidence, plan: Effort, conditions: tuple[Condition, ...]
) -> None:
    """Statistics of samples by patch, in both modes if they differ."""
    if evidence.in_radiance_mode:
        conditions += tuple(replace(one, mode="radiance") for one in conditions)
    for i, condition in enumerate(conditions):
        key = (evidence.seed, 2, i)
        maps = four_maps(evidence.bsdf, condition, plan.patches, plan.samples, key)
        if maps is not None:
            evidence.maps.append(maps)
            sampling.check_maps(evidence, maps)
            weights.check_maps(evidence, maps)
            _check_normalised(evidence, maps)
    weights.check_pooled(evidence)
    sampling.check_roulette(evidence)
    if len(evidence.maps) < len(conditions):
        _check_rings(evidence)


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


def _check_rings(evidence: Evidence) -> None:
    """Check light and directions in rings about the incident direction.

    By the test of a measurement before it follows rays through a medium, which works
    for any sharp lobe.
    """
    phase = evidence.bsdf.phase_function
    wavelengths = Probe(evidence.bsdf, ASKED[0]).interaction().wavelengths
    for name, asked, two in (
        ("weights", phase, ("`sample` scatters", "`eval`")),
        ("sampling", Densities(phase), ("directions are drawn", "`pdf`")),
    ):
        found = ask_phase_function(asked, wavelengths)
        worst = int(found.misplaced.argmax())
        text = f"{found.misplaced[worst]:.2g} of the light in other rings"
        evidence.remark(name, f"in rings about the light, of 4 directions: {text}")
        if found.excess > 1:
            evidence.breach(
                name,
                "sample",
                f"{text}, {found.excess:.3g} times the tolerance",
                f"{two[0]} otherwise than {two[1]} says",
                size=float(found.misplaced[worst]),
                off=float(min(found.misplaced[worst], 1.0)),
            )
        if name == "weights":
            total, bound = found.evaluated, found.tolerance
            off = np.abs(total[:, :N_RINGED].sum(axis=1) - 1)
            limit = bound[:, :N_RINGED].sum(axis=1)
            if (off > limit).any():
                k = int((off / limit).argmax())
                flux = float(total[k, :N_RINGED].sum())
                text = f"`eval` integrates to {flux:.4g}"
                mistake = f"{text}, where a phase function has 1"
                evidence.breach("energy", "eval", text, mistake, size=abs(flux - 1))


def _check_normalised(evidence: Evidence, maps: FourMaps) -> None:
    """Check that ``eval`` integrates to 1; absorption is the medium's."""
    flux = maps.smooth_flux
    off = np.abs(flux - 1)
    worst = int(off.argmax())
    bound = maps.smooth_bound[worst] + maps.eval_rounding
    if off[worst] > max(bound, SUM_ERROR):
        text = f"`eval` integrates to {flux[worst]:.5g}"
        evidence.breach(
            "energy",
            "eval",
            f"{text} at {maps.condition}",
            f"{text}, where a phase function has 1",
            maps.condition,
            size=float(off[worst]),
        )


def _check_reciprocity(evidence: Evidence, samples: Samples) -> None:
    """Check symmetry, with the projected area of microflakes (Jakob et al. 2010)."""
    usable = samples.usable & np.isfinite(samples.reverse).all(axis=1)
    if not usable.any():
        return
    areas = [
        _projected_area(evidence.bsdf, samples.condition, one)
        for one in (samples.wi, samples.wo)
    ]
    there, back = samples.eval * areas[0], samples.reverse * areas[1]
    slack = samples.eval_slack * areas[0] + samples.reverse_slack * areas[1]
    wrong = unequal(there, back, slack) & usable
    if beyond_rounding(wrong):
        function, what, kind = "eval", "`eval` is", Kind.SYMMETRY
        if _is_of_microflakes(evidence.bsdf):
            function, kind = "eval or projected_area", Kind.SYMMETRY_OF_MICROFLAKES
            what = "`eval` or `projected_area`: their product is"
        evidence.breach(
            "reciprocity",
            function,
            ratio_text(there, back, wrong, samples),
            f"{what} not symmetric in wi and wo",
            samples.condition,
            size=float(wrong.mean()),
            kind=kind,
        )


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
    area: Callable[..., Any] = phase.projected_area
    return numbers(area(mei, mi.Bool(True)), n).astype(float)[:, None]


def _check_flags(evidence: Evidence) -> None:
    """Check that a phase function declared as isotropic has one value everywhere."""
    phase, flags = evidence.bsdf.phase_function, mi.PhaseFunctionFlags
    declared = int(phase.flags())
    samples = evidence.samples[1]
    values = samples.eval[samples.usable]
    others = int(flags.Anisotropic) | int(flags.Microflake)
    if not len(values):
        return
    varies = np.ptp(values, axis=0).max() > 1e-3 * values.max()
    if declared & int(flags.Isotropic) and not declared & others and varies:
        evidence.breach(
            "flags",
            "flags",
            f"`eval` is {values.min():.4g} to {values.max():.4g} at "
            f"{samples.condition}",
            "`flags` declares Isotropic alone, but `eval` depends on the direction",
        )
    if not declared:
        evidence.breach(
            "flags", "flags", "flags are 0", "`flags` declares no kind of scattering"
        )
