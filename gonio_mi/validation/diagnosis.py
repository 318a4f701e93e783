"""From failed properties to the one function that explains them, and its mistake."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats
from .collecting import Drawn
from .components import explain_lobes
from .density import explain_density
from .evidence import EFFECTS, INTERFACE, MODEL, Evidence
from .probe import Probe, numbers, spectral
from .ratios import Cases, explain_ratio

__all__ = ["diagnose"]

# Part of the samples that explains nothing else.
RARE = 0.01

# What is looked at first explains what comes later.
ORDER = (
    "answers",
    "directions",
    "delta",
    "sampling",
    "sampled_pdf",
    "sampled_weight",
    "weights",
    "eval_pdf",
    "eval_pdf_sample",
    "energy",
    "continuity",
    "reciprocity",
    "adjoint",
    "flags",
    "masks",
    "components",
    "ends",
    "parameters",
)


def diagnose(
    evidence: Evidence, failed: Mapping[str, str], bsdf: mi.BSDF
) -> tuple[str, str]:
    """Likely guilty function and mistake.

    Parameters
    ----------
    evidence : Evidence
    failed : dict
        Effect by name of property.
    bsdf : mi.BSDF
        To be asked for its single lobes.

    Returns
    -------
    function, mistake : str
    """
    worst = min(failed.values(), key=EFFECTS.index)
    names = [name for name in ORDER if failed.get(name) == worst]
    # what few samples do comes after what all do, as a law that a model may choose
    later = [
        n for n in names if _is_rare(evidence, n) or (n, worst) == ("delta", MODEL)
    ]
    for name in [n for n in names if n not in later] + later:
        if name in ("sampling", "sampled_pdf", "sampled_weight", "weights"):
            found = _of_densities(evidence, failed, bsdf)
        elif name == "energy":
            found = _of_energy(evidence)
        else:
            found = _worst(evidence, name)
        if found is not None:
            return found
    return "sample", "`sample` or `eval` is wrong"


def _is_rare(evidence: Evidence, name: str) -> bool:
    """Whether only some single samples are wrong."""
    own = [b for b in evidence.breaches if b.property == name]
    return name in ("answers", "directions") and max(b.size for b in own) < RARE


def _worst(evidence: Evidence, name: str) -> tuple[str, str] | None:
    """What the worst breach of a property says."""
    own = [b for b in evidence.breaches if b.property == name]
    if not own:
        if name == "delta":
            return (
                "sample",
                "`sample`: the pdf of a discrete lobe is not its probability",
            )
        return None
    worst = max(own, key=lambda b: b.size)
    if name == "eval_pdf_sample":
        # what is wrong with eval_pdf too is its mistake
        joint = [b for b in evidence.breaches if b.property == "eval_pdf"]
        worst = joint[0] if joint else worst
    return worst.function, worst.mistake


def _of_energy(evidence: Evidence) -> tuple[str, str]:
    """Which of ``eval`` and the weights gain light; both are the model's."""
    totals = [m.smooth_flux.max() + m.totals.delta_mean.max() for m in evidence.maps]
    discrete = any(m.totals.delta_mean.max() > 1 + 1e-4 for m in evidence.maps)
    most = max(totals, default=1.0)
    function = "sample" if discrete else "eval"
    return function, f"`{function}` gains light: {most:.4g} of it leaves"


def _of_densities(
    evidence: Evidence, failed: Mapping[str, str], bsdf: mi.BSDF
) -> tuple[str, str] | None:
    """Which of ``sample``, ``pdf`` and ``eval`` contradicts the two others."""
    whole = _worst(evidence, "weights")
    if whole and "weights" in failed:
        # one of them is 0 where another is not
        return whole
    excess = _worst(evidence, "sampling")
    if excess and failed.get("sampling") == INTERFACE:
        return excess
    if "sampling" not in failed:
        if "sampled_pdf" in failed:
            return _of_sampled_pdf(evidence)
        return _of_weights(evidence, failed, bsdf)
    whole_only = [d for d in evidence.drawn if d.condition.component is None]
    lobes = explain_lobes(whole_only[0], bsdf)
    beyond = [b for b in evidence.breaches if b.property == "sampled_pdf"]
    if beyond and "sampled_weight" not in failed and "weights" not in failed:
        if lobes:
            return "pdf", f"`pdf` {lobes}"
        text = explain_ratio(_all(evidence, "pdf"), "pdf", "the density of `sample`")
        return "pdf", text
    return ("pdf", f"`pdf` {lobes}") if lobes else explain_density(evidence, failed)


def _of_sampled_pdf(evidence: Evidence) -> tuple[str, str]:
    text = explain_ratio(_all(evidence, "sampled_pdf"), "sample", "pdf, over `pdf`,")
    return "sample", text.replace("`sample`", "the pdf that `sample` returns", 1)


def _of_weights(
    evidence: Evidence, failed: Mapping[str, str], bsdf: mi.BSDF
) -> tuple[str, str] | None:
    """``sample`` or ``eval``: whichever lacks a property on its own."""
    cases = _all(evidence, "sampled_weight")
    whole = [b for b in evidence.breaches if b.property == "sampled_weight"]
    if whole and all("component" in b.statistic for b in whole):
        # only single components disagree
        return _worst(evidence, "components") or _worst(evidence, "sampled_weight")
    if not cases:
        return "sample", (
            "`sample`: the weights do not sum up to `eval`, where directions agree "
            "with `pdf`"
        )
    flux = max((m.smooth_flux.max() for m in evidence.maps), default=0.0)
    mean = max((m.totals.mean.max() for m in evidence.maps), default=0.0)
    guilty = "sample"
    gains = "energy" in failed and flux > 1.001 > mean
    if gains or ("reciprocity" in failed and _weights_are_reciprocal(evidence)):
        guilty = "eval"
    elif "answers" in failed:
        found: Any = _worst(evidence, "answers")
        guilty = found[0]
    elif _is_constant(cases) and not mean > 1.001 and flux > 0:
        # a weight that lacks a probability gains light, or differs between lobes
        guilty = "eval"
    both = guilty != "eval" or not (
        gains or "reciprocity" in failed or "answers" in failed
    )
    both = both and _is_constant(cases)
    if guilty == "eval":
        cases = [(1 / ratio, drawn, mask) for ratio, drawn, mask in cases]
        text = explain_ratio(cases, "eval", "value, over weight times pdf,")
        return "eval", text.replace("`eval`", "`eval` or `sample`", int(both))
    if _is_of_lobe_alone(evidence, bsdf):
        return "sample", (
            "`sample` weight lacks division by the probability of the lobe: it is "
            "value over pdf of the picked lobe alone"
        )
    text = explain_ratio(cases, "sample", "weight times pdf, over `eval`,")
    # a constant may be wrong in either
    return "sample", text.replace("`sample`", "`sample` or `eval`", int(both))


def _is_of_lobe_alone(evidence: Evidence, bsdf: mi.BSDF) -> bool:
    """Whether weights are those of a single component, as if there were no other."""
    n = bsdf.component_count()
    drawn = evidence.drawn[0]
    if n < 2 or drawn.condition.component is not None:
        return False
    wo = mi.Vector3f(drawn.wo.T)
    ratios = []
    for i in range(n):
        own = drawn.smooth & (drawn.component == i)
        if own.any():
            probe = Probe(bsdf, replace(drawn.condition, component=i))
            value = spectral(probe.eval(wo), drawn.n)[own].sum(axis=1)
            pdf = numbers(probe.pdf(wo), drawn.n)[own]
            weight = drawn.weight[own].sum(axis=1)
            ratios.append(weight * pdf / np.maximum(value, 1e-30))
    if len(ratios) < 2:
        return False
    low, high = np.quantile(np.concatenate(ratios), [0.02, 0.98])
    return low > 0.998 and high < 1.002


def _weights_are_reciprocal(evidence: Evidence) -> bool:
    """Whether the ratio of `eval` to the weights has what `eval` lacks of reciprocity.

    A model that is not reciprocal fails in weights and ``eval`` alike.
    """
    own = [b for b in evidence.breaches if b.property == "reciprocity"]
    return any(b.function == "eval" for b in own)


def _is_constant(cases: Cases) -> bool:
    ratios = np.concatenate([ratio for ratio, _, _ in cases])
    low, high = np.quantile(ratios, [0.02, 0.98])
    return high - low < 1e-3 * abs(high)


def _all(evidence: Evidence, what: str) -> list[tuple[Floats, Drawn, Flags]]:
    """Ratios that should be 1, of each set of samples, with the samples they are of."""
    cases = []
    for drawn in evidence.drawn:
        if drawn.condition.component is not None:
            continue
        ok = drawn.smooth & (drawn.pdf > 0) & np.isfinite(drawn.pdf)
        ok &= np.isfinite(drawn.sampled_pdf) & (np.abs(drawn.wo[:, 2]) > 1e-4)
        if what == "sampled_weight":
            over = drawn.weight.sum(axis=1) * drawn.pdf
            under = drawn.eval.sum(axis=1)
        elif what == "sampled_pdf":
            over, under = drawn.sampled_pdf, drawn.pdf
        else:
            over, under = drawn.pdf, drawn.sampled_pdf
        ok &= np.isfinite(under) & (under > 0) & (over > 0)
        if ok.any():
            cases.append((over[ok] / under[ok], drawn, ok))
    return cases
