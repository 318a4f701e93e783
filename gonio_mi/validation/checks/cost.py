"""Repeated calls compile no kernel.

None is ever a failure. Compiling a kernel takes thousands of times as long as
running it on a small batch; a plugin causes that if it bakes a Python number that
changes into the kernel as a literal.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...transport.kernels import first_cause
from ..conditions import Condition
from ..evidence import COST, INTERFACE, SAME, Evidence, Question
from ..probe import Probe, uniform
from ..samples import samples_of

CALLS = Question("cost", __doc__, INTERFACE, volumes=SAME)

# Rays of a call, and turns in which a plugin and one of Mitsuba's own take it.
N_RAYS = 2**19
N_TURNS = 7

# Functions that integrators call in a loop, and rays of one that is recorded.
RECORDED = ("sample", "eval", "pdf")
N_RECORDED = 4

# How many times as long a plugin may take; its author knows of less.
MAX_RATIO = 10.0


def check_compiled(
    evidence: Evidence, condition: Condition, n: int, key: tuple[int, ...]
) -> None:
    """Check that repeated calls compile no kernel, unless the user records kernels.

    To read their history is to clear it.
    """
    if dr.flag(dr.JitFlag.KernelHistory):
        return
    for _ in range(2):
        # the second time, objects that are made once exist
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            samples_of(evidence.bsdf, condition, n, key)
            kernels = [k for k in dr.kernel_history() if "cache_hit" in k]
            dr.kernel_history_clear()
        n_new = sum(not k["cache_hit"] or bool(k["cache_disk"]) for k in kernels)
        if not n_new:
            return
    evidence.downgraded["cost"] = COST
    evidence.remark(
        "cost",
        f"adds cost: {n_new} of {len(kernels)} kernels are compiled anew whenever the "
        "same is asked; a number of Python that changes is a literal of the kernel, "
        "which dr.opaque makes a variable",
    )


def check_recorded(evidence: Evidence, condition: Condition) -> None:
    """Remark on functions that Mitsuba cannot record in a loop.

    Comes last, and not if answers are wrong: a plugin that keeps variables of the loop
    could not be called again.
    """
    if evidence.of("answers"):
        return
    probe = Probe(evidence.bsdf, condition)
    own = [name for name in RECORDED if not _is_recorded(probe, name)]
    if own:
        evidence.downgraded["cost"] = COST
        evidence.remark(
            "cost",
            f"adds cost: `{'`, `'.join(own)}` cannot be recorded (values are asked for "
            "by NumPy, `dr.none` or an `if`), so that `mi.render` raises unless "
            "dr.JitFlag.SymbolicLoops and SymbolicCalls are off",
        )


def _is_recorded(probe: Probe, function: str) -> bool:
    """Whether a loop of one turn that calls a function can be recorded."""

    def turn(i: mi.UInt32, wi: mi.Vector3f, u: mi.Point3f) -> tuple[Any, ...]:
        si, wo = probe.interaction(mi.Vector3f(wi)), mi.Vector3f(wi)
        si.uv = mi.Point2f(u.x, u.y)
        directions = (u.x, mi.Point2f(u.y, u.z)) if function == "sample" else (wo,)
        getattr(probe.bsdf, function)(probe.ctx, si, *directions, i < 1)
        return i + 1, wi, u

    sample1, sample2 = uniform(N_RECORDED, (73,))
    wi = mi.Vector3f(probe.wi) + dr.zeros(mi.Vector3f, N_RECORDED)
    state = mi.UInt32(0), wi, mi.Point3f(sample1, sample2.x, sample2.y)
    dr.make_opaque(state)
    try:
        dr.while_loop(state, lambda i, *_: i < 1, turn, mode="symbolic")
    except Exception as error:  # a plugin may raise anything
        # without a variable, which would keep the plugin alive
        return "*symbolic*" not in str(first_cause(error))
    return True


def check_time(evidence: Evidence, condition: Condition) -> None:
    """Remark on the time per ray, relative to the most similar BSDF of Mitsuba."""
    name, other = _closest(int(evidence.bsdf.flags()))
    if evidence.bsdf.class_name() == other.class_name():
        evidence.remark("cost", "it is what the times of others are compared with")
        return
    own, ratio = compared(_call(evidence.bsdf, condition), _call(other, condition))
    text = (
        f"`sample`, `eval` and `pdf` of a ray take {own / N_RAYS:.2g} ns, {ratio:.2g} "
        f"times as long as those of `{name}`"
    )
    if ratio > MAX_RATIO:
        evidence.downgraded["cost"] = COST
        text = f"adds cost: {text}"
    evidence.remark("cost", text)


def compared(
    first: Callable[[], None],
    second: Callable[[], None],
    clock: Callable[[], int] = time.perf_counter_ns,
) -> tuple[float, float]:
    """Median time of the first function in ns, and its ratio to the second's.

    They take turns, so that other work on the machine slows both, or few turns.
    """
    first()
    second()
    times = np.zeros((N_TURNS, 2))
    for turn in times:
        for i, call in enumerate((first, second)):
            start = clock()
            call()
            turn[i] = clock() - start
    return float(np.median(times[:, 0])), float(np.median(times[:, 0] / times[:, 1]))


def _call(bsdf: mi.BSDF, condition: Condition) -> Callable[[], None]:
    """Function that samples and then evaluates value and density of the samples."""
    probe = Probe(bsdf, condition)
    ctx, si = probe.ctx, probe.interaction()
    sample1, sample2 = uniform(N_RAYS, (71,))
    dr.make_opaque(sample1, sample2, si.wi)

    def call() -> None:
        """Sample and evaluate once."""
        # all in one kernel, as an integrator has it; each may change its copies
        copy = mi.SurfaceInteraction3f
        random = mi.Float(sample1), mi.Point2f(sample2)
        bs, weight = bsdf.sample(ctx, copy(si), *random, True)
        values = (
            f(ctx, copy(si), mi.Vector3f(bs.wo), True) for f in (bsdf.eval, bsdf.pdf)
        )
        dr.eval(weight, bs, *values)
        dr.sync_thread()

    return call


def _closest(flags: int) -> tuple[str, mi.BSDF]:
    """Name and instance of the BSDF of Mitsuba with the same kinds of lobes."""
    kind = mi.BSDFFlags

    def has(what: Any) -> bool:
        return bool(flags & int(what))

    if not has(kind.Smooth):
        name = "dielectric" if has(kind.Transmission) else "conductor"
    elif has(kind.Transmission):
        name = "roughdielectric"
    elif has(kind.GlossyReflection):
        name = "roughplastic" if has(kind.DiffuseReflection) else "roughconductor"
    else:
        name = "diffuse"
    rough = {"distribution": "ggx"} if name.startswith("rough") else {}
    return name, mi.load_dict({"type": name, **rough})
