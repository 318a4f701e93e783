"""Flags declare the observed behaviour."""

from dataclasses import replace

import mitsuba as mi
import numpy as np

from ...array_types import Floats
from ..conditions import Condition
from ..evidence import BIAS, INTERFACE, SAME, Evidence, Question
from ..mistakes import EVAL, FLAGS, SAMPLE, Kind, Mistake
from ..probe import Probe
from ..samples import Samples, beyond_rounding, samples_of, unequal
from . import sampling, weights
from .answers import LOBES

DECLARED = Question(
    "flags",
    __doc__,
    INTERFACE,
    "path, direct, volpath, prb: no light is sampled without a smooth lobe",
    volumes=SAME,
    rank=2,
)


class Declared(Mistake):
    """Mistakes in what is declared."""

    OF_A_COMPONENT = "{who} of the whole lacks what a component declares"
    TYPE = "{who} does not declare {names}, which `sample` draws"
    COMPONENT = """`sample` names component {last}, where `flags` declares {known}: one
        of them is wrong{hint}"""
    TYPE_OF_COMPONENT = """`sample` gives component {component} a type that its `flags`
        lack: one of them is wrong"""
    SIDE = "light from the {side} is scattered though `flags` does not declare it"
    DEPENDENCE = "{who} does not declare {name}, but `eval` depends on it"
    NOT_ISOTROPIC = """{who} declares Isotropic alone, but `eval` depends on the
        direction"""
    NOTHING = "{who} declares no kind of scattering"


# A turn about the normal.
TURN = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])


@DECLARED.asks("bsdf")
def check_bsdf(evidence: Evidence) -> None:
    """Check that sampled types and components are declared; some may go unused."""
    if evidence.of_volumes:
        _check_isotropic(evidence)
        return
    bsdf = evidence.bsdf
    flags, n = int(bsdf.flags()), bsdf.component_count()
    union = int(np.bitwise_or.reduce([0, *(int(bsdf.flags(i)) for i in range(n))]))
    if union & ~flags:
        text = f"{_names(union & ~flags)} of a component only"
        evidence.breach(DECLARED, Declared.OF_A_COMPONENT(FLAGS), found=text)
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
        guess, text = Declared.TYPE(FLAGS, names=names), f"{names} sampled"
        how = {"found": text, "effect": BIAS if unlit else ""}
        evidence.breach(DECLARED, guess, samples.condition, **how)
        return True
    if last >= n:
        hint = ""
        if last < n + len(LOBES):  # else it is no component that was added
            hint = "; m_components must be assigned, to append to it has no effect"
        fields = {"last": last, "known": f"{n} from 0 on" if n else "none"}
        guess = Declared.COMPONENT(FLAGS | SAMPLE, hint=hint, **fields)
        text = f"component {last}, of {n} that are declared"
        evidence.breach(DECLARED, guess, samples.condition, statistic=text)
        return True
    for i in set(components.tolist()):
        own = int(np.bitwise_or.reduce(types[components == i])) & ~int(bsdf.flags(i))
        if own:
            guess = Declared.TYPE_OF_COMPONENT(FLAGS | SAMPLE, component=i)
            text, kind = f"{_names(own)} as component {i}", Kind.TYPE_OF_A_COMPONENT
            at = samples.condition
            evidence.breach(DECLARED, guess, at, statistic=text, kind=kind)
            return True
    return False


@DECLARED.asks("bsdf")
def check_sides(evidence: Evidence) -> None:
    """Check what flags declare on sides, rotation, differentials and texture.

    SpatiallyVarying gets a remark only, for none of Mitsuba's BSDFs declares it.
    """
    if evidence.of_volumes:
        return
    bsdf, flags, all_flags = evidence.bsdf, int(evidence.bsdf.flags()), mi.BSDFFlags
    base = Condition(50.0, 20.0)
    for side, flag in (("front", all_flags.FrontSide), ("back", all_flags.BackSide)):
        if flags & int(flag) or flags & int(all_flags.Transmission):
            continue
        condition = replace(base, side=side)
        samples = samples_of(bsdf, condition, 2**12, (evidence.seed, 31), False)
        lit = (np.nan_to_num(samples.weight, nan=1) > 0).any(axis=1)
        # a weight of 0 may come with no direction at all, of which none is asked
        asked = np.isfinite(samples.wo).all(axis=1)
        lit |= asked & (np.nan_to_num(samples.eval, nan=1) > 0).any(axis=1)
        dark = not samples.given.any()
        if dark and weights.check_unsampled_side(evidence, condition):
            sampling.check_unsampled_side(evidence, condition)
        if lit.any():
            function = SAMPLE if samples.given.any() else EVAL
            function = function if np.isnan(samples.weight).any() else FLAGS
            text = f"{100 * lit.mean():.3g} % of the samples scatter"
            guess = Declared.SIDE(function, side=side)
            how = {"found": text, "kind": Kind.UNDECLARED_SIDE}
            evidence.breach(DECLARED, guess, condition, **how)
    if not any(samples.given.any() for samples in evidence.samples):
        return
    samples = samples_of(bsdf, base, 2**12, (evidence.seed, 32))
    turned = flags & int(all_flags.Anisotropic), base.lit_from(TURN @ base.wi)
    given = bsdf.needs_differentials(), replace(base, differentials=True)
    for name, (declared, condition), wo, kind in (
        ("Anisotropic", turned, samples.wo @ TURN.T, Kind.ANISOTROPIC),
        ("NeedsDifferentials", given, samples.wo, Kind.DIFFERENTIALS),
    ):
        share = 0.0 if declared else _changed(evidence, samples, condition, wo)
        if share:
            text = f"`eval` changes for {share:.3g} of them"
            guess = Declared.DEPENDENCE(FLAGS, name=name)
            evidence.breach(DECLARED, guess, base, statistic=text, kind=kind)
    there = replace(base, uv=(0.15, 0.7)), samples.wo
    varies = flags & int(all_flags.SpatiallyVarying)
    if not varies and _changed(evidence, samples, *there):
        text = "`eval` depends on uv without SpatiallyVarying, as Mitsuba's own do"
        evidence.remark("flags", text)


def _changed(
    evidence: Evidence, samples: Samples, condition: Condition, wo: Floats
) -> float:
    """Fraction of samples whose ``eval`` is another one there; 0 if they are few."""
    value = Probe(evidence.bsdf, condition).values(wo)
    if evidence.by_chance(value, samples.eval, samples.wo):
        return 0.0
    differs = unequal(value, samples.eval, samples.eval_slack) & samples.smooth
    return float(differs.mean()) if beyond_rounding(differs) else 0.0


def _names(flags: int) -> str:
    names = [name for name in LOBES if flags & int(getattr(mi.BSDFFlags, name))]
    return " and ".join(names) or f"flag {flags:#x}"


def _check_isotropic(evidence: Evidence) -> None:
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
        text = f"`eval` is {values.min():.4g} to {values.max():.4g} at "
        text += str(samples.condition)
        evidence.breach(DECLARED, Declared.NOT_ISOTROPIC(FLAGS), found=text)
    if not declared:
        evidence.breach(DECLARED, Declared.NOTHING(FLAGS), found="flags are 0")
