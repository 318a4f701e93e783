"""The first element is the answer without polarisation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats, Integers
from ...errors import SettingError
from ...specimen.bsdf_trial import PluginFault
from ...variants import unpolarised
from ..arrays import answer_of, drawn, of_flux, rows
from ..evidence import BIAS, POLARISING, SAME, Evidence, Question
from ..judgements import by_sample
from ..mistakes import SAMPLE, Claim, Mistake
from ..mueller import Lobes, Matrices, MuellerProbe
from ..samples import beyond_rounding


def first_element(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> Any:
    """An answer without polarisation, the flux of `sample`."""
    bs, _ = drawn(bsdf, ctx, si, u)
    return rows(what(bsdf, ctx, si, bs.wo, u)).mean(axis=0)


FIRST_ELEMENT = Question(
    "first_element", __doc__, BIAS, POLARISING, rank=3, alone=True, matrices=SAME
)


class FirstElement(Mistake):
    """Mistakes in first elements."""

    FACTOR = """{who} reflects or transmits {factor} times what it does without
        polarisation{mode}: a factor of one of its two branches is missing"""


# Relative difference of two ways to compute one value, in single precision.
ROUNDING = 2e-3


def check_first_element(
    evidence: Evidence,
    load: Callable[[], mi.BSDF] | None,
    answers: Sequence[tuple[Matrices, Lobes]],
    random: Floats,
) -> None:
    """Compare ``eval``, and shares of discrete lobes, with the other variant's.

    For directions and random numbers of shape (n, 3), in each transport mode. `load`
    loads the plugin there; None if nobody knows how.
    """
    variant = unpolarised(mi.variant())
    if load is None:
        text = "an object belongs to one variant: pass a dictionary or a file, which "
        evidence.undecided["first_element"] = f"{text}{variant} can load, too"
        return
    try:
        with mi.variant_context(variant):
            bsdf = load()
            plain = [_ask(bsdf, *own, random) for own in answers]
    except (SettingError, PluginFault, ImportError, RuntimeError) as error:
        text = f"the plugin failed in {variant}, where it must be registered too"
        evidence.undecided["first_element"] = f"{text}: {error}"
        return
    for (values, lobes), (value, flux, types) in zip(answers, plain):
        same_lobe = lobes.delta & (lobes.type == types)
        _compare(evidence, values, value, values.finite)
        _compare(evidence, lobes.flux, flux, same_lobe)
        if evidence.of("first_element"):
            return  # the same in the other mode


def _compare(
    evidence: Evidence, matrices: Matrices, plain: Floats, asked: Flags
) -> None:
    """Check first elements against unpolarised answers, where `asked`."""
    light = matrices.light
    size = np.maximum(np.abs(light), np.abs(plain))
    differs = (np.abs(light - plain) > ROUNDING * size + 1e-9).any(axis=-1)
    wrong = np.asarray(differs & asked)
    if not beyond_rounding(wrong):
        return
    ratio = light[wrong].sum(-1) / np.maximum(plain[wrong].sum(-1), 1e-30)
    low, high = np.quantile(ratio, [0.05, 0.95])
    factor = f"{low:.4g}"
    if not np.isclose(low, high, rtol=1e-3):
        factor = f"{low:.4g} to {high:.4g}"
    off = float(min(1.0, np.abs(ratio - 1).mean()) * wrong.mean())
    fields = {"factor": factor, "mode": matrices.in_mode}
    guess = FirstElement.FACTOR(matrices.function, **fields)
    text = f"it is {factor} times the unpolarised answer"
    who = matrices.function
    what = of_flux if who is SAMPLE else answer_of(who)
    how = {"found": text, "off": off, "shown": Claim(first_element, by_sample, (what,))}
    evidence.breach(FIRST_ELEMENT, guess, matrices, wrong, **how)


def _ask(
    bsdf: mi.BSDF, values: Matrices, lobes: Lobes, random: Floats
) -> tuple[Floats, Floats, Integers]:
    """Values, and flux and types of samples, without polarisation."""
    probe = MuellerProbe(bsdf, values.asked.mode)
    drawn = probe.sample(lobes.weights.wi, random, values.uv)
    value = probe.eval(values.wi, values.wo, values.uv)
    return value.light, drawn.flux.light, drawn.type
