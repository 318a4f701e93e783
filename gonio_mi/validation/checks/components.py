"""The components of a BSDF, each alone, against the whole."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...array_types import Flags, Floats
from ..evidence import Evidence
from ..probe import Probe, spectral
from ..samples import Samples, is_many, unequal

__all__ = ["alone", "check_samples"]


@dataclass(frozen=True)
class Alone:
    """Answers about samples of the whole, of each component asked alone.

    Attributes
    ----------
    eval : ndarray, shape (n_components, n, channels)
    pdf : ndarray, shape (n_components, n)
    wo : ndarray, shape (n_components, n, 3)
        Directions that ``sample`` draws of them from the same random numbers.
    """

    eval: Floats
    pdf: Floats
    wo: Floats


def alone(evidence: Evidence, samples: Samples) -> Alone:
    """Ask each component about the directions of samples of the whole."""
    random, answers = samples.random, []
    for i in range(evidence.bsdf.component_count()):
        probe = Probe(evidence.bsdf, replace(samples.condition, component=i))
        value, density = probe.values(samples.wo), probe.densities(samples.wo)
        wo = spectral(probe.sample(*random)[0].wo, samples.n)
        answers.append((value, density, wo))
    return Alone(*map(np.array, zip(*answers)))


def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Values of the components add up to the whole; an undeclared one is dark.

    The density of the whole is at most the sum of those of the components, for each is
    picked with a probability of at most 1, whatever that depends on.
    """
    if samples.condition.component is not None or not evidence.bsdf.component_count():
        return
    each = alone(evidence, samples)
    total, density = each.eval.sum(axis=0), each.pdf.sum(axis=0)
    usable = samples.smooth & np.isfinite(total).all(axis=1) & np.isfinite(density)
    deaf = _deaf(samples, each, usable)
    wrong = unequal(total, samples.eval, samples.eval_slack) & usable
    if is_many(wrong):
        whole = samples.eval[wrong].sum(axis=1)
        ratio = total[wrong].sum(axis=1) / np.maximum(whole, 1e-30)
        evidence.breach(
            "components",
            "eval",
            f"their sum is {np.median(ratio):.4g} times the whole for "
            f"{samples.fraction(wrong)}",
            deaf
            or "`eval` does not heed ctx.component, or the components are not a sum",
            size=1 + float(wrong.mean()),
        )
    more = unequal(samples.pdf, density, samples.pdf_slack) & (samples.pdf > density)
    more &= usable
    if is_many(more):
        ratio = samples.pdf[more] / np.maximum(density[more], 1e-30)
        evidence.breach(
            "components",
            "pdf",
            f"`pdf` is up to {min(ratio.max(), 1e6):.4g} times the sum of those of "
            f"the components for {samples.fraction(more)}",
            "`pdf` of the whole is more than those of its components together",
            size=float(more.mean()),
        )


def _deaf(samples: Samples, each: Alone, usable: Flags) -> str:
    """Sentence on the functions that ignore ctx.component; empty if there are none.

    One component alone would be the whole, heeded or not.
    """
    if len(each.pdf) < 2:
        return ""
    own = {
        "eval": [unequal(v, samples.eval, samples.eval_slack) for v in each.eval],
        "pdf": [unequal(v, samples.pdf, samples.pdf_slack) for v in each.pdf],
        "sample": [unequal(v, samples.wo, 0.0) for v in each.wo],
    }
    *others, last = [
        f"`{name}`"
        for name, differs in own.items()
        if not any(is_many(one & usable) for one in differs)
    ] or [""]
    if others:
        return f"{', '.join(others)} and {last} do not heed ctx.component"
    return last and f"{last} does not heed ctx.component"
