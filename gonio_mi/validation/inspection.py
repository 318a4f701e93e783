"""The examination of one BSDF: all checks in turn, ending in a verdict."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import SettingError, SpecimenError, checked_count, checked_number, shown
from ..instrument.loading import check_variant, load_specimen, loaded, specimen_name
from ..transport.kernels import launches_kernels
from . import (
    answers,
    balance,
    components,
    cosines,
    cost,
    declarations,
    delta,
    ends,
    identities,
    jumps,
    parameters,
    symmetry,
)
from .collecting import Drawn, collect
from .conditions import Condition, Effort
from .diagnosis import diagnose
from .equality import unequal
from .evidence import INTERFACE, PROPERTIES, Evidence
from .maps import four_maps
from .probe import PluginFault, Probe
from .verdict import FAILS, Verdict, judge

__all__ = ["validate"]

# Polar angle of incidence, in degrees, below which nothing is grazing.
STEEP = 60


@launches_kernels()
def validate(
    specimen: Any,
    *,
    effort: str = "normal",
    seed: int = 0,
    alpha: float = 1e-3,
    allow: str | Iterable[str] = (),
    strict: bool = False,
) -> Verdict:
    """Whether a BSDF is right, and if not, which of its functions is wrong.

    In a variant of rgb, grey parameters of a dictionary get a colour.

    Parameters
    ----------
    specimen : dict, mi.BSDF, mi.Scene, str or path
        As of :func:`gonio_mi.measure`; of a scene, the BSDF of its only shape.
    effort : {"quick", "normal", "thorough"}
        Seconds, some ten seconds, or minutes.
    seed : int
        Same seed, same verdict, but for times: those are for `normal` and more.
    alpha : float
        Probability that a right BSDF fails, shared by all statistical tests.
    allow : sequence of str
        Names of properties that the model knowingly lacks, such as ``"energy"``.
    strict : bool
        Whether anything that fails counts, and not only what biases images or breaks
        integrators.

    Returns
    -------
    Verdict

    Raises
    ------
    SpecimenError
        If Mitsuba cannot load the specimen, or it is no BSDF.
    ValueError, TypeError
        If an argument is out of range.
    """
    plan = Effort.named(effort)
    seed = checked_count("seed", seed, 0)
    alpha = checked_number("alpha", alpha, 1e-12, 1, "a probability in [1e-12, 1)")
    allow = (allow,) if isinstance(allow, str) else tuple(allow)
    for name in allow:
        if name not in PROPERTIES:
            raise SettingError(
                f"allow must name some of {', '.join(PROPERTIES)}, got {shown(name)}"
            )
    bsdf, name = _bsdf(specimen)
    evidence = Evidence()
    try:
        _examine(evidence, bsdf, plan, seed)
    except PluginFault as fault:
        _stop(evidence, fault)
    properties = judge(evidence, alpha, allow)
    failed = {p.name: str(p.effect) for p in properties if p.status == FAILS}
    shares = {p.name: p.share for p in properties}
    function, mistake = None, None
    if failed:
        function, mistake = diagnose(evidence, failed, shares, bsdf)
    settings = {
        "effort": effort,
        "seed": seed,
        "alpha": alpha,
        "allow": list(allow),
        "strict": bool(strict),
        "variant": mi.variant(),
        "n_tests": len(evidence.tests),
        "n_samples": sum(m.totals.n for m in evidence.maps)
        + sum(d.n for d in evidence.drawn),
    }
    return Verdict(
        name, tuple(properties), function, mistake, settings, tuple(evidence.maps)
    )


def _bsdf(specimen: Any) -> tuple[mi.BSDF, str]:
    """BSDF of a specimen, and its name."""
    check_variant()
    name: str | None
    if isinstance(specimen, dict):
        name, grey = specimen_name(specimen), specimen
        specimen = loaded("the specimen", mi.load_dict, specimen)
        if isinstance(specimen, mi.BSDF):
            specimen = parameters.coloured(specimen, grey)
    else:
        name = str(specimen) if isinstance(specimen, (str, os.PathLike)) else None
    if not isinstance(specimen, mi.BSDF):
        scene = load_specimen(specimen)
        shapes = [s for s in scene.shapes() if not s.is_emitter()]
        if any(shape.is_medium_transition() for shape in shapes):
            raise SpecimenError(
                "validate judges BSDFs, got a shape with a medium: measure it, or "
                "validate the BSDF of its boundary alone"
            )
        if len(shapes) != 1:
            raise SpecimenError(
                "a scene to validate must have one shape, whose BSDF is meant, "
                f"got {len(shapes)}"
            )
        specimen = shapes[0].bsdf()
    return specimen, name or specimen.class_name()


def _examine(evidence: Evidence, bsdf: mi.BSDF, plan: Effort, seed: int) -> None:
    """All checks, from those that explain most."""
    flags = int(bsdf.flags())
    n = bsdf.component_count()
    lobes = range(n) if n > 1 else ()
    lower = int(mi.BSDFFlags.BackSide) | int(mi.BSDFFlags.Transmission)
    sides = ("front", "back") if flags & lower else ("front",)
    if not flags & (int(mi.BSDFFlags.FrontSide) | int(mi.BSDFFlags.Transmission)):
        sides = ("back",) if sides != ("front",) else sides
    conditions = list(plan.checks(sides, lobes))
    radiance = [replace(one, mode="radiance") for one in plan.radiance(sides)]
    for i, condition in enumerate([*conditions, *radiance]):
        _check_samples(evidence, bsdf, condition, plan, (seed, 1, i))
    first = conditions[0], plan.checked, (seed, 1, 0)
    after = answers.asked_after(Probe(bsdf, first[0]), evidence.drawn[0])
    again = cost.check_compiled(evidence, bsdf, *first)
    answers.check_memory(evidence, evidence.drawn[0], after, again)
    declarations.check_flags(evidence, bsdf)
    declarations.check_sides(evidence, bsdf, seed)
    for drawn in evidence.drawn[:: max(1, len(plan.angles) // 3)]:
        components.check_components(evidence, bsdf, drawn)
    declarations.check_masks(evidence, bsdf, seed)
    for drawn in evidence.drawn:
        if drawn.condition.component is None and drawn.condition.mode == "importance":
            jumps.check_normal(evidence, bsdf, drawn)
    for side in sides:
        jumps.check_cutoffs(evidence, bsdf, Condition(45.0, 25.0, side), (seed, 51))
    parameters.check_parameters(evidence, bsdf, _brightest(evidence))
    cosines.check_cosines(evidence, bsdf)
    ends.check_ends(evidence, bsdf)
    ends.check_roughness(evidence, bsdf)
    _check_maps(evidence, bsdf, plan, sides, lobes, seed)
    if plan is not Effort.named("quick"):
        # it takes a second
        cost.check_time(evidence, bsdf, Condition(40.0, 25.0, sides[0]))


def _check_samples(
    evidence: Evidence,
    bsdf: mi.BSDF,
    condition: Condition,
    plan: Effort,
    key: tuple[int, ...],
) -> None:
    drawn = collect(bsdf, condition, plan.checked, key)
    evidence.drawn.append(drawn)
    known = len(evidence.breaches)
    answers.check_answers(evidence, drawn)
    answers.check_everywhere(evidence, Probe(bsdf, condition))
    answers.check_directions(evidence, drawn)
    identities.check_identities(evidence, drawn)
    symmetry.check_symmetry(evidence, drawn, bsdf)
    delta.check_delta(evidence, drawn, bsdf, key)
    delta.check_null(evidence, drawn, Probe(bsdf, condition))
    if condition.component is not None:
        # no integrator asks for one component only
        evidence.breaches[known:] = [
            replace(breach, effect=INTERFACE) for breach in evidence.breaches[known:]
        ]


def _check_maps(
    evidence: Evidence,
    bsdf: mi.BSDF,
    plan: Effort,
    sides: Sequence[str],
    lobes: Sequence[int],
    seed: int,
) -> None:
    """Statistics of what is drawn."""
    patches = plan.patches
    conditions = list(plan.maps(sides, lobes))
    if any(_depends_on_mode(drawn) for drawn in evidence.drawn):
        conditions += [replace(one, mode="radiance") for one in plan.radiance(sides)]
    failed = 0
    for i, condition in enumerate(conditions):
        maps = four_maps(bsdf, condition, patches, plan.samples, (seed, 2, i))
        if maps is None:
            failed += 1
            continue
        evidence.maps.append(maps)
        balance.check_maps(evidence, maps)
        balance.check_energy(evidence, maps)
    balance.check_pooled(evidence)
    if failed:
        text = (
            f"the integrals of {failed} of {len(conditions)} incident directions did "
            "not converge: it would take more effort, or a smoother lobe"
        )
        for name in ("sampling", "weights", "energy"):
            if failed == len(conditions):
                evidence.undecided[name] = text
            else:
                evidence.remark(name, text)


def _brightest(evidence: Evidence) -> Drawn:
    """Samples of which most have a density, not at grazing incidence if possible."""
    whole = [one for one in evidence.drawn if one.condition.component is None]
    return max(
        whole,
        key=lambda drawn: (
            drawn.smooth.any() and drawn.condition.theta_i < STEEP,
            np.count_nonzero(drawn.smooth),
        ),
    )


def _depends_on_mode(drawn: Drawn) -> bool:
    return bool((unequal(drawn.eval, drawn.other_mode, 0) & drawn.smooth).any())


def _stop(evidence: Evidence, fault: PluginFault) -> None:
    """A fault is the last thing that is known."""
    evidence.breach(
        "answers", fault.function, str(fault), f"`{fault.function}` {fault.what}", 10.0
    )
    for name in PROPERTIES:
        evidence.undecided[name] = f"`{fault.function}` must answer first"
