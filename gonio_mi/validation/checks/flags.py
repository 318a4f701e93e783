"""Flags declare the observed behaviour."""

from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from ...array_types import Floats
from ..arrays import Sides, drawn, lit, lit_from, smooth, value
from ..conditions import Condition
from ..evidence import BIAS, INTERFACE, SAME, Evidence, Question
from ..judgements import by_sample, equal, same
from ..mistakes import EVAL, FLAGS, SAMPLE, Claim, Mistake
from ..probe import Probe
from ..samples import Samples, beyond_rounding, samples_of, unequal
from . import sampling, weights
from .answers import LOBES


def declared(bsdf: Any, ctx: Any, si: Any, u: Any) -> tuple[int, int]:
    """Types and components that are sampled are declared."""
    bs, weight = drawn(bsdf, ctx, si, u)
    types = int(np.bitwise_or.reduce(np.array(bs.sampled_type) * lit(weight)))
    last = int(np.max(np.array(bs.sampled_component) * lit(weight)))
    if types & ~int(bsdf.flags()) == 0 and last >= bsdf.component_count():
        return last + 1, bsdf.component_count()
    return types, types & int(bsdf.flags())


def types_of_components(bsdf: Any, ctx: Any, si: Any, u: Any) -> tuple[int, int]:
    """Types that are sampled as a component are those that it declares."""
    bs, weight = drawn(bsdf, ctx, si, u)
    for i in range(bsdf.component_count()):
        own = lit(weight) & (np.array(bs.sampled_component) == i)
        types = int(np.bitwise_or.reduce(np.array(bs.sampled_type) * own))
        if types & ~int(bsdf.flags(i)):
            return types, types & int(bsdf.flags(i))
    return 0, 0


def unlit(bsdf: Any, ctx: Any, si: Any, u: Any) -> tuple[float, int]:
    """Nothing is scattered from a side that is not declared."""
    bs, _ = drawn(bsdf, ctx, si, u)
    return float(np.mean(value(bsdf, ctx, si, bs.wo) > 0)), 0


def turned(bsdf: Any, ctx: Any, si: Any, u: Any) -> Sides:
    """An isotropic surface may turn about its normal."""
    bs, weight = drawn(bsdf, ctx, si, u)
    turn = mi.Matrix3f([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    there = value(bsdf, ctx, lit_from(si, turn @ si.wi), turn @ bs.wo)
    return value(bsdf, ctx, si, bs.wo), there, smooth(bs, weight)


def differentials(bsdf: Any, ctx: Any, si: Any, u: Any) -> Sides:
    """Without NeedsDifferentials nothing depends on them."""
    bs, weight = drawn(bsdf, ctx, si, u)
    there = type(si)(si)
    there.duv_dx, there.duv_dy = mi.Vector2f(0.3, 0.1), mi.Vector2f(-0.1, 0.2)
    others = value(bsdf, ctx, there, bs.wo)
    return value(bsdf, ctx, si, bs.wo), others, smooth(bs, weight)


def isotropic(bsdf: Any, ctx: Any, si: Any, u: Any) -> tuple[float, float]:
    """A phase function that is isotropic alone has one value."""
    bs, _ = drawn(bsdf, ctx, si, u)
    values = value(bsdf, ctx, si, bs.wo)
    return values.min(), values.max()


DECLARED = Question(
    "flags",
    __doc__,
    INTERFACE,
    "path, direct, volpath, prb: no light is sampled without a smooth lobe",
    volumes=SAME,
    rank=2,
    shown=Claim(declared, same),
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
            text, at = f"{_names(own)} as component {i}", samples.condition
            shown = Claim(types_of_components, same)
            evidence.breach(DECLARED, guess, at, statistic=text, shown=shown)
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
            how = {"found": text, "shown": Claim(unlit, same)}
            evidence.breach(DECLARED, guess, condition, **how)
    if not any(samples.given.any() for samples in evidence.samples):
        return
    samples = samples_of(bsdf, base, 2**12, (evidence.seed, 32))
    for name, known, stated in (
        ("Anisotropic", flags & int(all_flags.Anisotropic), turned),
        ("NeedsDifferentials", bsdf.needs_differentials(), differentials),
    ):
        share = 0.0
        if not known:
            share = _changed(evidence, samples, samples.hold(stated)[1])
        if share:
            text = f"`eval` changes for {share:.3g} of them"
            guess = Declared.DEPENDENCE(FLAGS, name=name)
            shown = Claim(stated, by_sample)
            evidence.breach(DECLARED, guess, base, statistic=text, shown=shown)
    there = Probe(bsdf, replace(base, uv=(0.15, 0.7))).values(samples.wo)
    varies = flags & int(all_flags.SpatiallyVarying)
    if not varies and _changed(evidence, samples, there):
        text = "`eval` depends on uv without SpatiallyVarying, as Mitsuba's own do"
        evidence.remark("flags", text)


def _changed(evidence: Evidence, samples: Samples, value: Floats) -> float:
    """Fraction of samples whose ``eval`` is not this value; 0 if they are few."""
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
        shown = Claim(isotropic, equal)
        guess = Declared.NOT_ISOTROPIC(FLAGS)
        evidence.breach(DECLARED, guess, found=text, shown=shown)
    if not declared:
        evidence.breach(DECLARED, Declared.NOTHING(FLAGS), found="flags are 0")
