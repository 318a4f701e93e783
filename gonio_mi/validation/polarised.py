"""The examination of a BSDF in a polarised variant: of Mueller matrices.

What the first elements do by themselves, such as the density of samples, the
unpolarised variant judges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..collector.stokes import UPRIGHT
from ..specimen.loading import loaded
from .checks import answers, ends, energy, frames
from .checks.consistency import check_sweep
from .conditions import PLACES, Condition, Effort, Given, Sweep, sides_of
from .evidence import Evidence
from .mueller import is_depolarised, per_light, samples_at
from .probe import Probe, uniform
from .samples import Samples, drawn_samples, samples_of

# Plugins that tilt the frame of a nested BSDF.
TILTING = ("normalmap", "bumpmap")


def examine_polarised(evidence: Evidence, plan: Effort, specimen: Any) -> None:
    """Run all checks of matrices.

    Parameters
    ----------
    evidence : Evidence
    plan : Effort
    specimen : object
        As of :func:`gonio_mi.validate`.
    """
    bsdf, sides, key = evidence.bsdf, sides_of(evidence.bsdf), (evidence.seed, 77)
    sweep = Sweep(side=sides[0], both=len(sides) > 1, n=plan.lanes)
    for asked in (sweep, replace(sweep, mode="radiance")):
        samples = samples_of(bsdf, asked, sweep.n, key)
        evidence.samples.append(samples)
        # where importance mode contradicts itself, nothing is due in radiance mode
        if not any(map(evidence.of, answers.AGREEMENTS)):
            evidence.ask("samples", samples)
        evidence.ask("matrices", samples)
    evidence.ask("bsdf")
    ends.check_straight(evidence, answers.ANSWERS)
    samples = evidence.samples[0]
    _remark_on_light(evidence, samples)
    frames.check_turned(evidence, samples, *_axes(specimen))
    frames.check_jumps(evidence, samples)
    if not evidence.of("frames"):
        frames.check_world(evidence, samples)
    if not any(map(evidence.of, answers.AGREEMENTS)):
        check_sweep(evidence, plan, sides)
    _check_energy(evidence, list(plan.checks(sides, ())), sweep.n // 2, key)


def _check_energy(
    evidence: Evidence, conditions: Sequence[Condition], n: int, key: tuple[int, ...]
) -> None:
    """Check the flux of `n` samples of each incident direction, drawn together."""
    wi, uv = (
        np.repeat([getattr(one, name) for one in conditions], n, axis=0)
        for name in ("wi", "uv")
    )
    probe = Probe(evidence.bsdf, Given(lit_by=wi, at=uv))
    samples = drawn_samples(probe, *uniform(len(wi), key))
    for i, condition in enumerate(conditions):
        own = samples.select(np.s_[i * n : (i + 1) * n])
        energy.check_gain(evidence, replace(own, condition=condition))


def _remark_on_light(evidence: Evidence, samples: Samples) -> None:
    """Note where no light is scattered, or none keeps its polarisation."""
    usable = ("eval", samples.usable), ("weight", samples.given)
    answered = [samples.full(name)[mask] for name, mask in usable]
    if sum(map(len, answered)) == 0:
        text = "no light was scattered, so that nothing was compared"
        names = (question.name for question in evidence.questions[1:])
        evidence.undecided |= dict.fromkeys(names, text)
    elif all(is_depolarised(per_light(raw)) for raw in answered):
        evidence.note = (
            "but it depolarises all light: there is no polarisation to be judged"
        )
        text = "all matrices have the first element only: light leaves unpolarised"
        if (samples.discrete & ~samples.null).any():
            text += ", by discrete lobes too, where a smooth surface polarises it"
        evidence.remark("realisable", text)


def _axes(specimen: Any) -> tuple[Floats, Floats | None]:
    """Normal of the scattering surface, and axes of a nested BSDF that is tilted.

    At the first place. A mirror instead of the nested BSDF shows where its normal is.
    """
    if not (isinstance(specimen, dict) and specimen.get("type") in TILTING):
        return UPRIGHT, None
    mirrored = dict(specimen)
    for key, value in specimen.items():
        part = value
        if isinstance(value, dict):
            part = loaded("the nested BSDF", mi.load_dict, value)
        if isinstance(part, mi.BSDF):
            mirrored[key] = {"type": "conductor"}
    tilted = loaded("the specimen", mi.load_dict, mirrored)
    lobes = samples_at(tilted, UPRIGHT[None], np.full((1, 3), 0.5), np.array(PLACES[0]))
    if not lobes.given.any():
        return UPRIGHT, None
    normal = UPRIGHT + lobes.wo[0]
    normal /= np.linalg.norm(normal)
    s = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    s /= np.linalg.norm(s)
    return normal, np.column_stack([s, np.cross(normal, s), normal])
