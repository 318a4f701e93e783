"""The first element is the answer without polarisation."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats
from ...errors import SettingError
from ...specimen.bsdf_trial import PluginFault
from ...variants import unpolarised
from ..arrays import answer_of, drawn, of_flux, rows
from ..evidence import BIAS, POLARISING, SAME, Evidence, Question
from ..judgements import by_sample
from ..mistakes import EVAL, SAMPLE, Claim, Function, Mistake
from ..mueller import in_mode
from ..probe import Probe
from ..samples import ELEMENT_ROUNDING, Samples, beyond_rounding, drawn_samples


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


@FIRST_ELEMENT.asks("bsdf")
def check_bsdf(evidence: Evidence) -> None:
    """Compare ``eval``, and shares of discrete lobes, with the other variant's.

    Of samples of either mode at once, for to change the variant takes long.
    """
    variant, name = unpolarised(mi.variant()), FIRST_ELEMENT.name
    load = evidence.load
    if load is None:
        text = "an object belongs to one variant: pass a dictionary or a file, which "
        evidence.undecided[name] = f"{text}{variant} can load, too"
        return
    try:
        with mi.variant_context(variant):
            bsdf = load()
            plain = [_ask(Probe(bsdf, x.condition), x) for x in evidence.samples]
    except (SettingError, PluginFault, ImportError, RuntimeError) as error:
        text = f"the plugin failed in {variant}, where it must be registered too"
        evidence.undecided[name] = f"{text}: {error}"
        return
    for samples, (value, alone) in zip(evidence.samples, plain):
        same_lobe = samples.discrete & (alone.type == samples.type)
        _compare(evidence, samples, EVAL, samples.eval, value, samples.smooth)
        _compare(evidence, samples, SAMPLE, samples.flux, alone.flux, same_lobe)
        if evidence.of(name):
            return  # the same in the other mode


def _ask(probe: Probe, samples: Samples) -> tuple[Floats, Samples]:
    """Values, and samples, without polarisation."""
    return probe.values(samples.wo), drawn_samples(probe, *samples.random)


def _compare(
    evidence: Evidence,
    samples: Samples,
    function: Function,
    light: Floats,
    plain: Floats,
    asked: Flags,
) -> None:
    """Check first elements against unpolarised answers, where `asked`."""
    size = np.maximum(np.abs(light), np.abs(plain))
    differs = (np.abs(light - plain) > ELEMENT_ROUNDING * size + 1e-9).any(axis=-1)
    wrong = np.asarray(differs & asked)
    if not beyond_rounding(wrong):
        return
    ratio = light[wrong].sum(-1) / np.maximum(plain[wrong].sum(-1), 1e-30)
    low, high = np.quantile(ratio, [0.05, 0.95])
    factor = f"{low:.4g}"
    if not np.isclose(low, high, rtol=1e-3):
        factor = f"{low:.4g} to {high:.4g}"
    off = float(min(1.0, np.abs(ratio - 1).mean()) * wrong.mean())
    guess = FirstElement.FACTOR(
        function, factor=factor, mode=in_mode(samples.condition)
    )
    text = f"it is {factor} times the unpolarised answer"
    what = of_flux if function is SAMPLE else answer_of(function)
    how = {"found": text, "off": off, "shown": Claim(first_element, by_sample, (what,))}
    evidence.breach(FIRST_ELEMENT, guess, samples, wrong, **how)
