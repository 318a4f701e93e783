"""The components of a BSDF, each alone, against the whole."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats
from .collecting import Drawn
from .equality import is_many, unequal
from .evidence import Evidence
from .probe import Probe, numbers, spectral

__all__ = ["check_components", "explain_lobes"]


@dataclass(frozen=True)
class Alone:
    """What the components say of samples of the whole, each asked alone.

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


def alone(bsdf: mi.BSDF, drawn: Drawn) -> Alone:
    """Ask each component about the directions of samples of the whole."""
    wo = mi.Vector3f(np.ascontiguousarray(drawn.wo.T))
    random = mi.Float(drawn.sample1), mi.Point2f(drawn.sample2.T)
    values, densities, directions = [], [], []
    for i in range(bsdf.component_count()):
        probe = Probe(bsdf, replace(drawn.condition, component=i))
        values.append(spectral(probe.eval(wo), drawn.n))
        densities.append(numbers(probe.pdf(wo), drawn.n).astype(float))
        directions.append(spectral(probe.sample(*random).bs.wo, drawn.n))
    return Alone(np.array(values), np.array(densities), np.array(directions))


def check_components(evidence: Evidence, bsdf: mi.BSDF, drawn: Drawn) -> None:
    """Values of the components add up to the whole; an undeclared one is dark.

    The density of the whole is at most the sum of those of the components, for each is
    picked with a probability of at most 1, whatever that depends on.
    """
    if drawn.condition.component is not None or not bsdf.component_count():
        return
    each = alone(bsdf, drawn)
    total, density = each.eval.sum(axis=0), each.pdf.sum(axis=0)
    usable = drawn.smooth & np.isfinite(total).all(axis=1) & np.isfinite(density)
    deaf = _deaf(drawn, each, usable)
    wrong = unequal(total, drawn.eval, drawn.eval_slack) & usable
    if is_many(wrong, drawn.n):
        ratio = total[wrong].sum(axis=1) / np.maximum(
            drawn.eval[wrong].sum(axis=1), 1e-30
        )
        evidence.breach(
            "components",
            "eval",
            f"their sum is {np.median(ratio):.4g} times the whole for "
            f"{100 * wrong.mean():.3g} % of the samples at {drawn.condition}",
            deaf
            or "`eval` does not heed ctx.component, or the components are not a sum",
            size=1 + float(wrong.mean()),
        )
    more = unequal(drawn.pdf, density, drawn.pdf_slack) & (drawn.pdf > density)
    more &= usable
    if is_many(more, drawn.n):
        ratio = drawn.pdf[more] / np.maximum(density[more], 1e-30)
        evidence.breach(
            "components",
            "pdf",
            f"`pdf` is up to {min(ratio.max(), 1e6):.4g} times the sum of those of "
            f"the components for {100 * more.mean():.3g} % of the samples at "
            f"{drawn.condition}",
            "`pdf` of the whole is more than those of its components together",
            size=float(more.mean()),
        )


def _deaf(drawn: Drawn, each: Alone, usable: Flags) -> str:
    """Sentence on the functions that ignore ctx.component; empty if there are none.

    One component alone would be the whole, heeded or not.
    """
    if len(each.pdf) < 2:
        return ""
    own = {
        "eval": [unequal(v, drawn.eval, drawn.eval_slack) for v in each.eval],
        "pdf": [unequal(v, drawn.pdf, drawn.pdf_slack) for v in each.pdf],
        "sample": [unequal(v, drawn.wo, 0.0) for v in each.wo],
    }
    names = [
        f"`{name}`"
        for name, differs in own.items()
        if not any(is_many(one & usable, drawn.n) for one in differs)
    ]
    if not names:
        return ""
    if len(names) == 1:
        return f"{names[0]} does not heed ctx.component"
    return f"{', '.join(names[:-1])} and {names[-1]} do not heed ctx.component"


def explain_lobes(drawn: Drawn, bsdf: mi.BSDF) -> str:
    """What ``pdf`` of the whole is of those of its components; empty if a mixture.

    Parameters
    ----------
    drawn : Drawn
        Samples of the whole.
    """
    if bsdf.component_count() < 2 or not drawn.smooth.any():
        return ""
    each = alone(bsdf, drawn)

    def is_it(density: Floats) -> bool:
        differs = unequal(density, drawn.pdf, drawn.pdf_slack) & drawn.smooth
        return not is_many(differs, drawn.n)

    own = [i for i, density in enumerate(each.pdf) if is_it(density)]
    if len(own) == 1:
        return f"is that of component {own[0]} alone"
    if not own and is_it(each.pdf.sum(axis=0)):
        return "is the sum of its components', without the probability of each"
    return ""
