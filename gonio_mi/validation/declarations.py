"""What a plugin declares about itself, against what it does; and its masks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Floats
from .collecting import Drawn, collect
from .conditions import Condition
from .equality import is_many, unequal
from .evidence import BIAS, Evidence
from .probe import Probe, numbers, spectral

__all__ = ["LOBES", "check_flags", "check_masks", "check_sides"]

# Where nothing tells which of two is wrong.
EITHER = "flags or sample"

# What a lobe can be: names as in mi.BSDFFlags.
LOBES = (
    "Null",
    "DiffuseReflection",
    "DiffuseTransmission",
    "GlossyReflection",
    "GlossyTransmission",
    "DeltaReflection",
    "DeltaTransmission",
)


def check_flags(evidence: Evidence, bsdf: mi.BSDF) -> None:
    """Sampled types and components are declared; what is declared may be unused."""
    flags, n = int(bsdf.flags()), bsdf.component_count()
    union = 0
    for i in range(n):
        union |= int(bsdf.flags(i))
    if union & ~flags:
        _breach(
            evidence,
            "flags",
            f"{_names(union & ~flags)} of a component only",
            "`flags` of the whole lacks what a component declares",
        )
    seen = 0
    for drawn in evidence.drawn:
        if drawn.given.any():
            kinds, breach = _undeclared(bsdf, drawn)
            seen |= kinds
            if breach:
                _breach(evidence, *breach)
                return
    lobes = sum(int(getattr(mi.BSDFFlags, name)) for name in LOBES)
    missing = flags & lobes & ~seen
    if seen and missing:
        # costs time at most, and a texture may use it elsewhere
        evidence.remark("flags", f"{_names(missing)} declared and never sampled")


def _undeclared(bsdf: mi.BSDF, drawn: Drawn) -> tuple[int, tuple[Any, ...] | None]:
    """Types of all samples, and the breach of those that are not declared, or None."""
    flags, n = int(bsdf.flags()), bsdf.component_count()
    types, components = drawn.type[drawn.given], drawn.component[drawn.given]
    kinds = int(np.bitwise_or.reduce(types))
    if kinds & ~flags:
        names = _names(kinds & ~flags)
        smooth = int(mi.BSDFFlags.Smooth)
        # integrators sample the light only if a lobe is declared to be smooth
        unlit = kinds & smooth and not flags & smooth
        return kinds, (
            "flags",
            f"{names} sampled at {drawn.condition}",
            f"`flags` does not declare {names}, which `sample` draws",
            BIAS if unlit else None,
        )
    if components.max() >= n:
        last = int(components.max())
        # a larger number is no component that was added
        trap = "; m_components must be assigned, to append to it has no effect"
        trap *= last < n + len(LOBES)
        return kinds, (
            EITHER,
            f"component {last}, of {n} that are declared",
            f"`sample` names component {last}, where `flags` declares "
            + (f"{n} from 0 on: one of them is wrong" if n else "none")
            + trap,
        )
    for i in set(components.tolist()):
        own = int(np.bitwise_or.reduce(types[components == i])) & ~int(bsdf.flags(i))
        if own:
            return kinds, (
                EITHER,
                f"{_names(own)} as component {i}",
                f"`sample` gives component {i} a type that its `flags` lack: one of "
                "them is wrong",
            )
    return kinds, None


def check_sides(evidence: Evidence, bsdf: mi.BSDF, seed: int) -> None:
    """Both sides, rotation, differentials and places as declared.

    SpatiallyVarying is a remark: none of Mitsuba's BSDFs declares it.
    """
    flags = int(bsdf.flags())
    all_flags = mi.BSDFFlags
    base = Condition(50.0, 20.0)
    for side, flag in (("front", all_flags.FrontSide), ("back", all_flags.BackSide)):
        if not flags & int(flag) and not flags & int(all_flags.Transmission):
            drawn = collect(bsdf, replace(base, side=side), 2**12, (seed, 31))
            lit = (np.nan_to_num(drawn.weight, nan=1) > 0).any(axis=1)
            # a weight of 0 may come with no direction at all, of which none is asked
            asked = np.isfinite(drawn.wo).all(axis=1)
            lit |= asked & (np.nan_to_num(drawn.eval, nan=1) > 0).any(axis=1)
            if lit.any():
                function = "eval" if not drawn.given.any() else "sample"
                _breach(
                    evidence,
                    function if np.isnan(drawn.weight).any() else "flags",
                    f"{100 * lit.mean():.3g} % of the samples scatter at "
                    f"{replace(base, side=side)}",
                    f"`flags` does not declare {flag.name}, whose light is scattered",
                )
    if not _has_light(evidence):
        return
    drawn = collect(bsdf, base, 2**12, (seed, 32))
    for name, declared, change in (
        ("Anisotropic", flags & int(all_flags.Anisotropic), _turn),
        ("NeedsDifferentials", bsdf.needs_differentials(), _differentiate),
    ):
        changed = 0.0 if declared else _changed(bsdf, drawn, change)
        if changed:
            _breach(
                evidence,
                "flags",
                f"`eval` changes for {changed:.3g} of them",
                f"`flags` does not declare {name}, but `eval` depends on it",
            )
    if not flags & int(all_flags.SpatiallyVarying) and _changed(bsdf, drawn, _move):
        text = "`eval` depends on uv without SpatiallyVarying, as Mitsuba's own do"
        evidence.remark("flags", text)


def _changed(
    bsdf: mi.BSDF, drawn: Drawn, change: Callable[[Probe, Floats], Floats]
) -> float:
    """Share of samples for which `change` changes ``eval``; 0 for a few."""
    probe = Probe(bsdf, drawn.condition)
    wo = change(probe, drawn.wo)
    value = spectral(probe.eval(mi.Vector3f(wo.T)), drawn.n)
    differs = unequal(value, drawn.eval, drawn.eval_slack) & drawn.smooth
    return float(differs.mean()) if is_many(differs, drawn.n) else 0.0


def _turn(probe: Probe, wo: Floats) -> Floats:
    """Both directions, turned about the normal."""
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    probe.wi = mi.Vector3f((turn @ probe.condition.wi).tolist())
    return wo @ turn.T


def _move(probe: Probe, wo: Floats) -> Floats:
    """Another place of the texture."""
    probe.uv = mi.Point2f(0.15, 0.7)
    return wo


def _differentiate(probe: Probe, wo: Floats) -> Floats:
    """Rays with differentials."""
    plain = probe.interaction

    def _interaction(wi: mi.Vector3f | None = None) -> mi.SurfaceInteraction3f:
        si = plain(wi)
        si.duv_dx, si.duv_dy = mi.Vector2f(0.3, 0.1), mi.Vector2f(-0.1, 0.2)
        return si

    probe.interaction = _interaction  # type: ignore[method-assign]
    return wo


def check_masks(evidence: Evidence, bsdf: mi.BSDF, seed: int) -> None:
    """Every other ray is inactive: it gets no light, the others what they got.

    The density of an inactive ray is of no use to anyone, and a remark only.
    """
    condition, n = Condition(40.0, 25.0), 2**10
    drawn = collect(bsdf, condition, n, (seed, 41))
    probe = Probe(bsdf, condition)
    active = np.arange(n) % 2 == 0
    mask = mi.Bool(active)
    wo = mi.Vector3f(drawn.wo.T)
    sample1 = mi.Float(drawn.sample1)
    sample2 = mi.Point2f(drawn.sample2.T)
    joint = probe.eval_pdf(wo, mask)
    one = probe.sample(sample1, sample2, mask)
    answers = [
        ("sample", one.weight, drawn.weight),
        ("eval", probe.eval(wo, mask), drawn.eval),
        ("pdf", probe.pdf(wo, mask), drawn.pdf),
        ("eval_pdf", joint[0], drawn.joint["eval_pdf"][0]),
        ("eval_pdf", joint[1], drawn.joint["eval_pdf"][1]),
    ]
    densities = numbers(answers[2][1], n)
    if densities[~active].any():
        evidence.remark("masks", "`pdf` gives inactive rays a value, which nobody uses")
    for function, masked, plain in answers:
        flat = np.ndim(plain) == 1
        masked = numbers(masked, n) if flat else spectral(masked, n)
        usable = active & np.isfinite(plain if flat else plain.sum(axis=1))
        changed = unequal(masked.astype(float), plain, 0.0) & usable
        light = np.zeros(n) if flat else np.abs(masked).sum(axis=1)
        awake = ~active & (light != 0)
        for wrong, what in (
            (awake, "ignores `active`: inactive rays get a value"),
            (changed, "answers active rays differently when others are not"),
        ):
            if wrong.any():
                evidence.breach(
                    "masks",
                    function,
                    f"{wrong.sum()} of {n // 2} rays at {condition}",
                    f"`{function}` {what}",
                    size=float(wrong.mean()),
                )


def _has_light(evidence: Evidence) -> bool:
    return any(drawn.given.any() for drawn in evidence.drawn)


def _names(flags: int) -> str:
    names = [name for name in LOBES if flags & int(getattr(mi.BSDFFlags, name))]
    return " and ".join(names) or f"flag {flags:#x}"


def _breach(
    evidence: Evidence,
    function: str,
    statistic: str,
    mistake: str,
    effect: str | None = None,
) -> None:
    evidence.breach("flags", function, statistic, mistake, effect=effect)
