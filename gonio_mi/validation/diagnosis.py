"""From failed properties to the one function that explains them, and its mistake."""

from __future__ import annotations

from collections.abc import Mapping

import mitsuba as mi

from .components import explain_lobes
from .density import explain_density
from .evidence import EFFECTS, INTERFACE, MODEL, Evidence
from .ratios import explain_ratio, ratios_of
from .weight_or_value import explain_weights

__all__ = ["diagnose"]

# Part of the samples that explains nothing else.
RARE = 0.01

# Part of the share of the largest failure below which another is no symptom of it, but
# a smaller one beside it, and explains nothing.
MINOR = 0.2

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
    evidence: Evidence,
    failed: Mapping[str, str],
    shares: Mapping[str, float | None],
    bsdf: mi.BSDF,
) -> tuple[str, str]:
    """Likely guilty function and mistake.

    Parameters
    ----------
    evidence : Evidence
    failed, shares : dict
        Effect by name of property, and how much of the light it is about.
    bsdf : mi.BSDF
        To be asked for its single lobes.

    Returns
    -------
    function, mistake : str
    """
    worst = min(failed.values(), key=EFFECTS.index)
    own = {name: shares[name] for name in failed if failed[name] == worst}
    largest = max((x for x in own.values() if x is not None), default=0.0)
    minor = {n for n, x in own.items() if x is not None and x < MINOR * largest}
    failed = {name: effect for name, effect in failed.items() if name not in minor}
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
        return explain_weights(evidence, failed, bsdf)
    whole_only = [d for d in evidence.drawn if d.condition.component is None]
    lobes = explain_lobes(whole_only[0], bsdf)
    beyond = [b for b in evidence.breaches if b.property == "sampled_pdf"]
    if beyond and "sampled_weight" not in failed and "weights" not in failed:
        if lobes:
            return "pdf", f"`pdf` {lobes}"
        text = explain_ratio(
            ratios_of(evidence, "pdf"), "pdf", "the density of `sample`"
        )
        return "pdf", text
    if lobes:
        return "pdf", f"`pdf` {lobes}"
    return explain_density(evidence, failed, bsdf)


def _of_sampled_pdf(evidence: Evidence) -> tuple[str, str]:
    text = explain_ratio(
        ratios_of(evidence, "sampled_pdf"), "sample", "pdf, over `pdf`,"
    )
    return "sample", text.replace("`sample`", "the pdf that `sample` returns", 1)
