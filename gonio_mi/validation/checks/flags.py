"""The flags that a plugin declares, against the observed behaviour."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mitsuba as mi
import numpy as np

from ...array_types import Floats
from ..conditions import Condition
from ..evidence import BIAS, Evidence
from ..kinds import Kind
from ..probe import Probe
from ..samples import Samples, beyond_rounding, samples_of, unequal
from . import sampling, weights
from .answers import LOBES

# Where nothing tells which of two is wrong.
EITHER = "flags or sample"


def check_bsdf(evidence: Evidence) -> None:
    """Check that sampled types and components are declared; some may go unused."""
    bsdf = evidence.bsdf
    flags, n = int(bsdf.flags()), bsdf.component_count()
    union = 0
    for i in range(n):
        union |= int(bsdf.flags(i))
    if union & ~flags:
        evidence.breach(
            "flags",
            "flags",
            f"{_names(union & ~flags)} of a component only",
            "`flags` of the whole lacks what a component declares",
        )
    seen = 0
    for samples in evidence.samples:
        if samples.given.any():
            seen |= int(np.bitwise_or.reduce(samples.type[samples.given]))
            if _check_declared(evidence, samples):
                return
    lobes = sum(int(getattr(mi.BSDFFlags, name)) for name in LOBES)
    missing = flags & lobes & ~seen
    if seen and missing:
        # costs time at most, and a texture may use it elsewhere
        evidence.remark("flags", f"{_names(missing)} declared and never sampled")


def _check_declared(evidence: Evidence, samples: Samples) -> bool:
    """Check that sampled types and components are declared; return if any is not."""
    bsdf = evidence.bsdf
    flags, n = int(bsdf.flags()), bsdf.component_count()
    types, components = samples.type[samples.given], samples.component[samples.given]
    kinds, last = int(np.bitwise_or.reduce(types)), int(components.max())
    if kinds & ~flags:
        names, smooth = _names(kinds & ~flags), int(mi.BSDFFlags.Smooth)
        # integrators sample the light only if a lobe is declared to be smooth
        unlit = kinds & smooth and not flags & smooth
        evidence.breach(
            "flags",
            "flags",
            f"{names} sampled at {samples.condition}",
            f"`flags` does not declare {names}, which `sample` draws",
            samples.condition,
            effect=BIAS if unlit else "",
        )
        return True
    if last >= n:
        mistake = f"`sample` names component {last}, where `flags` declares " + (
            f"{n} from 0 on: one of them is wrong" if n else "none"
        )
        if last < n + len(LOBES):  # else it is no component that was added
            mistake += "; m_components must be assigned, to append to it has no effect"
        statistic = f"component {last}, of {n} that are declared"
        evidence.breach("flags", EITHER, statistic, mistake, samples.condition)
        return True
    for i in set(components.tolist()):
        own = int(np.bitwise_or.reduce(types[components == i])) & ~int(bsdf.flags(i))
        if own:
            evidence.breach(
                "flags",
                EITHER,
                f"{_names(own)} as component {i}",
                f"`sample` gives component {i} a type that its `flags` lack: one of "
                "them is wrong",
                samples.condition,
                kind=Kind.TYPE_OF_A_COMPONENT,
            )
            return True
    return False


def check_sides(evidence: Evidence) -> None:
    """Check what flags declare on sides, rotation, differentials and texture.

    SpatiallyVarying gets a remark only, for none of Mitsuba's BSDFs declares it.
    """
    bsdf, flags, all_flags = evidence.bsdf, int(evidence.bsdf.flags()), mi.BSDFFlags
    base = Condition(50.0, 20.0)
    for side, flag in (("front", all_flags.FrontSide), ("back", all_flags.BackSide)):
        if flags & int(flag) or flags & int(all_flags.Transmission):
            continue
        condition = replace(base, side=side)
        samples = samples_of(bsdf, condition, 2**12, (evidence.seed, 31))
        lit = (np.nan_to_num(samples.weight, nan=1) > 0).any(axis=1)
        # a weight of 0 may come with no direction at all, of which none is asked
        asked = np.isfinite(samples.wo).all(axis=1)
        lit |= asked & (np.nan_to_num(samples.eval, nan=1) > 0).any(axis=1)
        dark = not samples.given.any()
        if dark and weights.check_unsampled_side(evidence, condition):
            sampling.check_unsampled_side(evidence, condition)
        if lit.any():
            function = "sample" if samples.given.any() else "eval"
            evidence.breach(
                "flags",
                function if np.isnan(samples.weight).any() else "flags",
                f"{100 * lit.mean():.3g} % of the samples scatter at {condition}",
                f"light from the {side} is scattered though `flags` does not "
                "declare it",
                condition,
                kind=Kind.UNDECLARED_SIDE,
            )
    if not any(samples.given.any() for samples in evidence.samples):
        return
    samples = samples_of(bsdf, base, 2**12, (evidence.seed, 32))
    turned = flags & int(all_flags.Anisotropic)
    for name, declared, change, kind in (
        ("Anisotropic", turned, _turn, Kind.ANISOTROPIC),
        (
            "NeedsDifferentials",
            bsdf.needs_differentials(),
            _differentiate,
            Kind.DIFFERENTIALS,
        ),
    ):
        share = 0.0 if declared else _changed(bsdf, samples, change)
        if share:
            evidence.breach(
                "flags",
                "flags",
                f"`eval` changes for {share:.3g} of them",
                f"`flags` does not declare {name}, but `eval` depends on it",
                base,
                kind=kind,
            )
    if not flags & int(all_flags.SpatiallyVarying) and _changed(bsdf, samples, _move):
        text = "`eval` depends on uv without SpatiallyVarying, as Mitsuba's own do"
        evidence.remark("flags", text)


def _changed(
    bsdf: mi.BSDF, samples: Samples, change: Callable[[Probe, Floats], Floats]
) -> float:
    """Fraction of samples for which `change` changes ``eval``; 0 if they are few."""
    probe = Probe(bsdf, samples.condition)
    value = probe.values(change(probe, samples.wo))
    differs = unequal(value, samples.eval, samples.eval_slack) & samples.smooth
    return float(differs.mean()) if beyond_rounding(differs) else 0.0


def _turn(probe: Probe, wo: Floats) -> Floats:
    """Turn both directions about the normal."""
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    probe.wi = mi.Vector3f((turn @ probe.condition.wi).tolist())
    return wo @ turn.T


def _move(probe: Probe, wo: Floats) -> Floats:
    """Move to another place of the texture."""
    probe.uv = mi.Point2f(0.15, 0.7)
    return wo


def _differentiate(probe: Probe, wo: Floats) -> Floats:
    """Give rays differentials."""
    probe.differentials = True
    return wo


def _names(flags: int) -> str:
    names = [name for name in LOBES if flags & int(getattr(mi.BSDFFlags, name))]
    return " and ".join(names) or f"flag {flags:#x}"
