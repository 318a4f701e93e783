"""The examination of one BSDF: all checks in turn, ending in a verdict."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import SettingError, SpecimenError, checked_count, checked_number, shown
from ..kernels import launches_kernels
from ..progress import bar
from ..specimen.bsdf_trial import PluginFault
from ..specimen.loading import load_specimen, loaded
from ..specimen.specimen_text import SpecimenLike, specimen_name
from ..variants import is_parallel, is_polarised
from .checks import (
    adjoint,
    answers,
    components as components_check,
    continuity,
    cost,
    delta,
    directions,
    eval_pdf,
    gradients,
    parameters,
    reciprocity,
    sampling,
    weights,
)
from .checks.consistency import check_again, check_identities, check_memory
from .checks.flags import Declared
from .conditions import Condition, Effort, Sweep, sides_of
from .evidence import BIAS, MAX_P, NOISE, Evidence, Question
from .guilt.hypotheses import explain_reciprocity, likely_mistake
from .maps import in_radiance_mode
from .phase_functions import ASKED, MAPPED, as_bsdf, check_rings, check_symmetry
from .polarised import examine_polarised
from .probe import Probe, number_parameters
from .questions import OF_MATRICES, OF_SURFACES, OF_VOLUMES
from .reproducers import source_of
from .samples import Samples, samples_of, unequal
from .verdict import FAILS, Property, Verdict, properties_of

# Of a plugin that scatters nothing from the side that it declares.
OF_ANOTHER_SIDE = (
    "all light met the {0} of the surface, the only side that `flags` declares, which "
    "scatters none; light from the {1} is scattered: a sign of wi.z or `flags` is wrong"
)

# Polar angle of incidence, in degrees, from which on incidence is grazing.
GRAZING = 60

# Properties that maps of samples decide.
STATISTICAL = ("sampling", "weights", "energy")

# Steps of a progress bar, and the part of the samples one by one.
N_STEPS = 100
SAMPLES_STEPS = 0.4

# Polar angle of incidence, in degrees, up to which maps are drawn.
MAX_PICTURED = 89.5

# Factor of a grey parameter in each channel; none gains.
TINT = (1.0, 0.8, 0.6)

# Names of parameters that are a colour.
COLOURS = re.compile("reflectance|transmittance|colou?r|albedo|tint")


@launches_kernels(is_parallel)
def validate(
    specimen: SpecimenLike,
    *,
    effort: str = "normal",
    seed: int = 0,
    alpha: float = 1e-3,
    allow: str | Iterable[str] = (),
    strict: bool = False,
    progress: bool = False,
) -> Verdict:
    """Whether a BSDF is right, and if not, which of its functions is wrong.

    Or a phase function, which is asked like a BSDF over the whole sphere. In a variant
    of rgb, grey parameters of a dictionary get a colour. In a polarised variant Mueller
    matrices are judged; the unpolarised variant, which judges all else, is set for a
    moment if the specimen is a dictionary or a file.

    Parameters
    ----------
    specimen : dict, mi.BSDF, mi.PhaseFunction, mi.Scene, str or path
        As of :func:`gonio_mi.measure`; of a scene, the BSDF of its only shape.
    effort : {"quick", "normal", "thorough"}
        Seconds, some ten seconds, or minutes.
    seed : int
        Same seed, same verdict, except for times, which `quick` does not measure.
    alpha : float
        Probability that a right BSDF fails, shared by all statistical tests.
    allow : sequence of str
        Names of properties that the model knowingly lacks, such as ``"energy"``.
    strict : bool
        Whether anything that fails counts, and not only what biases images, by 1e-4 of
        the flux at least, or breaks integrators.

    progress : bool
        Whether to show a progress bar on standard error.

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
    bsdf, name, source, tints = _bsdf(specimen)
    questions = _questions(bsdf, name, allow)
    polarised = questions is OF_MATRICES
    evidence = Evidence(bsdf, seed, questions)
    if not isinstance(specimen, mi.Object):
        evidence.load = lambda: _bsdf(specimen)[0]
    try:
        if polarised:
            examine_polarised(evidence, plan, specimen)
        else:
            _examine(evidence, plan, name, progress)
    except PluginFault as fault:
        _stop(evidence, fault)
    properties = properties_of(evidence, alpha, allow)
    failed = _failed(properties)
    shares = {p.name: p.share for p in properties}
    guess = likely_mistake(evidence, failed, shares) if failed else None
    if failed and not (polarised or evidence.of_volumes):
        _add_maps_of_failure(evidence, plan)
    asked = [m.totals.n for m in evidence.maps] + [one.n for one in evidence.samples]
    settings = {"effort": effort, "seed": seed, "alpha": alpha, "allow": list(allow)}
    settings |= {"strict": bool(strict), "variant": mi.variant(), "tints": tints}
    settings |= {"n_tests": len(evidence.tests), "n_samples": sum(asked)}
    return Verdict(
        name,
        tuple(properties),
        str(guess.functions) if guess else None,
        str(guess) if guess else None,
        settings,
        tuple(evidence.maps),
        source,
        guess,
        evidence.note,
    )


def _failed(properties: Sequence[Property]) -> dict[str, str]:
    """Effects of what fails; what is next to nothing explains nothing that counts."""
    found = [p for p in properties if p.status == FAILS]
    counts = any(p.counts for p in found)
    return {p.name: str(p.effect) for p in found if not (p.minor and counts)}


def _questions(bsdf: mi.BSDF, name: str, allow: Sequence[str]) -> tuple[Question, ...]:
    """Questions about the BSDF or phase function; raises for an unknown `allow`."""
    questions = OF_MATRICES if is_polarised(mi.variant()) else OF_SURFACES
    if hasattr(bsdf, "phase_function"):
        if questions is OF_MATRICES:
            raise SpecimenError(
                f"validate judges phase functions in unpolarised variants, got {name} "
                f"in {mi.variant()}"
            )
        questions = OF_VOLUMES
    names = [one.name for one in questions]
    for one in allow:
        if one not in names:
            known = ", ".join(names)
            raise SettingError(f"allow must name some of {known}, got {shown(one)}")
    return questions


def _bsdf(
    specimen: SpecimenLike,
) -> tuple[mi.BSDF, str, str | None, dict[str, list[float]]]:
    """BSDF of a specimen, its name, a statement that loads it or None, and tints."""
    name: str | None
    source, tints = source_of(specimen), {}
    if isinstance(specimen, dict):
        name, grey = specimen_name(specimen), specimen
        specimen = loaded("the specimen", mi.load_dict, specimen)
        if isinstance(specimen, mi.BSDF):
            specimen, tinted = coloured(specimen, grey)
            source = source_of(tinted)
            tints = {k: x["value"] for k, x in tinted.items() if x is not grey.get(k)}
        elif isinstance(specimen, mi.PhaseFunction):
            source = source_of(grey, volumes=True)
    else:
        name = str(specimen) if isinstance(specimen, (str, os.PathLike)) else None
    if isinstance(specimen, mi.PhaseFunction):
        specimen = as_bsdf(specimen)
    if not isinstance(specimen, mi.BSDF):
        scene = load_specimen(specimen)
        shapes = [s for s in scene.shapes() if not s.is_emitter()]
        if any(shape.is_medium_transition() for shape in shapes):
            raise SpecimenError(
                "validate judges BSDFs, got a shape with a medium: measure it, or "
                "validate the BSDF of its boundary, and its phase function, alone"
            )
        if len(shapes) != 1:
            raise SpecimenError(
                f"a scene to validate must have one shape, got {len(shapes)}: a BSDF "
                "alone must be the root of its file, <bsdf ...> in place of <scene ...>"
            )
        specimen = shapes[0].bsdf()
    return specimen, name or specimen.class_name(), source, tints


def _examine(
    evidence: Evidence,
    plan: Effort,
    name: str,
    progress: bool,
) -> None:
    """Run all checks with a progress bar."""
    with bar(progress, total=N_STEPS, desc=f"validate {name}", unit="step") as report:
        for step in _steps(evidence, plan):
            if report is not None:
                report(step)


def _steps(evidence: Evidence, plan: Effort) -> Iterator[float]:
    """Run all checks, those that explain most first; yield steps of `N_STEPS`."""
    bsdf, seed, volumes = evidence.bsdf, evidence.seed, evidence.of_volumes
    n = bsdf.component_count()
    components, sides = range(n) if n > 1 else (), sides_of(bsdf)
    conditions = ASKED if volumes else _conditions(bsdf, plan, sides, components)
    for i, condition in enumerate(conditions):
        _check_samples(evidence, condition, plan.checked, (seed, 1, i))
        yield N_STEPS * SAMPLES_STEPS / len(conditions)
    check_again(evidence, plan, sides)
    evidence.ask("bsdf")
    every = 1 if volumes else max(1, len(plan.angles) // 3)
    for samples in evidence.samples[::every] if components or not volumes else ():
        components_check.check_samples(evidence, samples)
    if not volumes:
        _check_surface(evidence, sides)
    evidence.ask("parameters")
    yield from _check_maps(evidence, plan, sides, components)
    usual, brightest = ASKED[1], evidence.samples[1]
    if not volumes:
        usual, brightest = Condition(40.0, 25.0, sides[0]), _brightest(evidence)
    parameters.check_changes(evidence, plan, sides)
    gradients.check_samples(evidence, plan, brightest)
    if plan is not Effort.named("quick") and not volumes:
        cost.check_time(evidence, usual)  # it takes a second
    check_memory(evidence)
    parameters.check_instances(evidence)
    cost.check_recorded(evidence, usual)


def _conditions(
    bsdf: mi.BSDF, plan: Effort, sides: Sequence[str], components: Sequence[int]
) -> Sequence[Condition]:
    """Conditions under which samples of a BSDF are checked one by one."""
    conditions = list(plan.checks(sides, components))
    if bsdf.needs_differentials():
        conditions += [replace(conditions[1], differentials=True)]
    return conditions + [replace(x, mode="radiance") for x in plan.radiance(sides)]


def _check_surface(evidence: Evidence, sides: Sequence[str]) -> None:
    """Check what phase functions have not: a normal, a horizon, cosines."""
    for samples in evidence.whole:
        if samples.condition.mode == "importance":
            continuity.check_normal(evidence, samples)
    for side in sides:
        continuity.check_cutoffs(evidence, Condition(45.0, 25.0, side))
    answers.check_albedo(evidence)
    explain_reciprocity(evidence)


def _check_samples(
    evidence: Evidence, condition: Condition, n: int, key: tuple[int, ...]
) -> None:
    """Check samples of one condition."""
    samples = samples_of(evidence.bsdf, condition, n, key)
    evidence.samples.append(samples)
    check_identities(evidence, samples)
    probe = Probe(evidence.bsdf, condition)
    lattice = answers.check_lattice(evidence, probe)
    if evidence.of_volumes:
        check_symmetry(evidence, samples)
        return
    eval_pdf.check_lattice(evidence, probe, *lattice)
    if condition.component is None:
        weights.check_unsampled(evidence, samples, *lattice)
    ways = reciprocity.ways_of(samples)
    if ways is not None:
        ways = reciprocity.dispersed(directions.check_eta(evidence, ways))
        reciprocity.check_ways(evidence, ways)
        adjoint.check_ways(evidence, ways)
    for lobe in delta.lobes_of(evidence, samples):
        returns = reciprocity.check_lobe(evidence, lobe, key)
        adjoint.check_lobe(evidence, lobe, key, returns)
    delta.check_null(evidence, samples)


def _check_maps(
    evidence: Evidence, plan: Effort, sides: Sequence[str], components: Sequence[int]
) -> Iterator[float]:
    """Check samples by patch; yield steps of progress."""
    if evidence.noisy:
        # means of samples were compared
        _leave_undecided(evidence, "`eval` draws random numbers: it has no integral")
        evidence.downgraded |= dict.fromkeys(STATISTICAL, NOISE)
        return
    volumes = evidence.of_volumes
    conditions = list(MAPPED[plan] if volumes else plan.maps(sides, components))
    if evidence.bsdf.needs_differentials():
        conditions += [replace(conditions[0], differentials=True)]
    if volumes:
        in_radiance = conditions if evidence.in_radiance_mode else []
    else:
        other_mode = any(_depends_on_mode(evidence, one) for one in evidence.whole)
        in_radiance = list(plan.radiance(sides)) if other_mode else []
    conditions += [replace(one, mode="radiance") for one in in_radiance]
    failed = 0
    for i, condition in enumerate(conditions):
        failed += evidence.add_maps(plan, condition, 2, i) is None
        yield N_STEPS * (1 - SAMPLES_STEPS) / len(conditions)
    if not (volumes or in_radiance):
        # the same integrals, other samples: their keys follow those of all conditions
        first = {maps.condition.side: maps for maps in reversed(evidence.maps)}
        for maps in [first[side] for side in sides if side in first]:
            key = (evidence.seed, 2, len(evidence.maps) + failed)
            evidence.maps.append(in_radiance_mode(evidence.bsdf, maps, key))
    for maps in evidence.maps:
        evidence.ask("maps", maps)
    if not volumes:
        _look_between(evidence, plan, sides)
    sampling.check_pooled(evidence)
    sampling.check_roulette(evidence)
    if not volumes:
        _note_undecided(evidence, failed, len(conditions), sides[0])
    elif failed:
        check_rings(evidence)


def _note_undecided(evidence: Evidence, failed: int, n: int, side: str) -> None:
    """Note what is not known without light, or where of `n` integrals some `failed`."""
    lit = any(samples.given.any() for samples in evidence.samples)
    lit = lit or any(m.smooth_flux.any() for m in evidence.maps)
    if not (lit or failed):
        dark = (
            b.guess for b in evidence.of("flags") if b.guess.mistake is Declared.SIDE
        )
        text = "no light was scattered, so that nothing was compared"
        if other := next(dark, None):
            text = OF_ANOTHER_SIDE.format(side, other.fields["side"])
        _leave_undecided(evidence, text)
    if failed:
        text = (
            f"the integrals of {failed} of {n} incident directions did "
            "not converge: it would take more effort, or a smoother lobe"
        )
        if failed == n:
            _leave_undecided(evidence, text)
        for name in STATISTICAL:
            evidence.remark(name, text)


def _leave_undecided(evidence: Evidence, text: str) -> None:
    """Note why nothing that maps of samples decide is decided."""
    evidence.undecided |= dict.fromkeys(STATISTICAL, text)


def _look_between(evidence: Evidence, plan: Effort, sides: Sequence[str]) -> None:
    """Add maps at other angles if what is wrong is little at those that were asked.

    It may be more in between, as for Beckmann facets of Mitsuba's: of the flux, 4e-5 at
    80 and 89 degrees and 7e-4 at 75.
    """
    wrong = [test for test in evidence.tests if test.p < MAX_P and test.of_flux]
    if not wrong or not all(test.minor for test in wrong):
        return
    for i, condition in enumerate(plan.between(sides)):
        if maps := evidence.add_maps(plan, condition, 3, i):
            evidence.ask("maps", maps)


def _add_maps_of_failure(evidence: Evidence, plan: Effort) -> None:
    """Put maps at the direction of the worst bias before all others."""
    strong = [test for test in evidence.tests if test.p < MAX_P]
    own = [
        one
        for one in (*evidence.breaches, *strong)
        if one.effect == BIAS and one.share and one.condition is not None
        if one.condition.theta_i < MAX_PICTURED
        if not isinstance(one.condition, Sweep)  # which no map has
    ]
    if not own or not evidence.maps:
        return
    condition = max(own, key=lambda one: one.share or 0.0).condition
    maps = next((one for one in evidence.maps if one.condition == condition), None)
    if maps is None and condition is not None:
        with contextlib.suppress(PluginFault):
            maps = evidence.add_maps(plan, condition, 2, 99)
    if maps is not None:
        evidence.maps.sort(key=lambda one: one is not maps)


def _brightest(evidence: Evidence) -> Samples:
    """Samples with the most densities, not at grazing incidence if possible."""
    return max(
        evidence.whole,
        key=lambda samples: (
            samples.smooth.any() and samples.condition.theta_i < GRAZING,
            np.count_nonzero(samples.smooth),
        ),
    )


def _depends_on_mode(evidence: Evidence, samples: Samples) -> bool:
    """Whether ``eval`` or ``pdf`` depends on the transport mode."""
    wo = answers.lattice()
    there, here = (
        Probe(evidence.bsdf, replace(samples.condition, mode=mode)).densities(wo)
        for mode in ("importance", "radiance")
    )
    differs = unequal(samples.eval, samples.other_mode, 0) & samples.smooth
    return bool(differs.any() or unequal(there, here, 0).any())


def _stop(evidence: Evidence, fault: PluginFault) -> None:
    """Record a fault of the plugin, after which nothing else can be judged."""
    evidence.breach_of_fault(evidence.questions[0], fault, size=10.0)
    names, text = (q.name for q in evidence.questions), "must answer first"
    evidence.undecided |= dict.fromkeys(names, f"`{fault.function}` {text}")


# ------------------------------------------------------------------- the BSDF in colour


def coloured(bsdf: mi.BSDF, specimen: dict[str, Any]) -> tuple[mi.BSDF, dict[str, Any]]:
    """BSDF of a dictionary with its grey parameters tinted, and that dictionary.

    In rgb variants only. `bsdf` is the BSDF of `specimen`; both are returned if there
    is nothing to tint.
    """
    tints = _tints(bsdf) if mi.is_rgb else {}
    if not tints:
        return bsdf, specimen
    try:
        tinted = specimen | tints
        return loaded("the tinted BSDF", mi.load_dict, tinted), tinted
    except Exception:
        return bsdf, specimen  # what such a parameter may be is up to the plugin


def _tints(bsdf: mi.BSDF) -> dict[str, Any]:
    """Tinted colours by name, for a dictionary; none without ``traverse``."""
    try:
        _, params = number_parameters(bsdf)
    except PluginFault:
        return {}  # `answers` says so
    tints = {}
    for key, value in params.items():
        name = key.removesuffix(".value")
        # a texture may be grey; what a plugin keeps as one number stays one
        colour = mi.Color3f if key == name else (mi.Float, mi.Color3f)
        if not COLOURS.search(name) or not isinstance(value, colour):
            continue
        value = np.ravel(value)
        if "." not in name and np.ptp(value) == 0 and 0 < value[0] <= 1:
            tint = [round(float(value[0]) * share, 6) for share in TINT]
            tints[name] = {"type": "rgb", "value": tint}
    return tints
