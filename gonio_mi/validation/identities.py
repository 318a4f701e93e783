"""What must be equal for every sample, for a BSDF has several functions to ask."""

from __future__ import annotations

import numpy as np

from ..array_types import Flags, Floats
from .collecting import Drawn
from .equality import BSDF_ROUNDING, is_many, unequal
from .evidence import INTERFACE, Evidence

__all__ = ["check_identities"]

# Standard errors beyond which a mean is not that of another.
BIASED = 5

# A ratio beyond that has a denominator of 0.
INFINITE = 1e20


def check_identities(evidence: Evidence, drawn: Drawn) -> None:
    """Densities and values of all functions agree, sample by sample."""
    smooth = drawn.smooth & np.isfinite(drawn.eval).all(axis=1)
    smooth &= np.isfinite(drawn.pdf) & np.isfinite(drawn.sampled_pdf)
    if smooth.any():
        _check_sampled(evidence, drawn, smooth)
    _check_joint(evidence, drawn)


def _check_dark(evidence: Evidence, drawn: Drawn, smooth: Flags) -> None:
    """``eval`` and ``pdf`` are not 0 where ``sample`` scatters light."""
    dark = smooth & (drawn.eval == 0).all(axis=1)
    if not is_many(dark, drawn.n):
        return
    both = dark & (drawn.pdf == 0)
    functions = "`eval` and `pdf` are" if is_many(both, drawn.n) else "`eval` is"
    evidence.breach(
        "weights",
        "eval",
        f"{100 * dark.sum() / smooth.sum():.3g} % of the samples with light at "
        f"{drawn.condition}",
        f"{functions} 0 where `sample` scatters light",
        size=1 + float(dark.mean()),
        off=float(dark.mean()),
        theta_i=drawn.condition.theta_i,
    )


def _check_sampled(evidence: Evidence, drawn: Drawn, smooth: Flags) -> None:
    _check_dark(evidence, drawn, smooth)
    smooth = smooth & (drawn.eval != 0).any(axis=1)
    slack = drawn.pdf_slack
    density = unequal(drawn.sampled_pdf, drawn.pdf, slack) & smooth
    if is_many(density, drawn.n):
        _unequal(
            evidence,
            "sampled_pdf",
            "sample",
            drawn,
            density,
            drawn.sampled_pdf / np.maximum(drawn.pdf, 1e-30),
            "its pdf over `pdf`",
            "`sample` returns another pdf than `pdf`",
        )
    products = [drawn.weight * p[:, None] for p in (drawn.sampled_pdf, drawn.pdf)]
    # where a density is badly conditioned, so is the product
    relative = slack / np.maximum(drawn.pdf, 1e-30)
    wrong = [
        unequal(x, drawn.eval, drawn.eval_slack + np.abs(x) * relative[:, None])
        & smooth
        for x in products
    ]
    if all(is_many(one, drawn.n) for one in wrong):
        ratio = products[1].sum(axis=1) / np.maximum(drawn.eval.sum(axis=1), 1e-30)
        _unequal(
            evidence,
            "sampled_weight",
            "sample",
            drawn,
            wrong[1],
            ratio,
            "weight times pdf over `eval`",
            "the weight of `sample` is not `eval` over pdf",
            effect=None if _is_biased(drawn, smooth) else INTERFACE,
        )


def _is_biased(drawn: Drawn, smooth: Flags) -> bool:
    """Whether weights have another mean than ``eval`` over ``pdf``, beyond chance."""
    usable = smooth & (drawn.pdf > 0)
    ratio = drawn.eval[usable].mean(axis=1) / drawn.pdf[usable]
    off = drawn.weight[usable].mean(axis=1) - ratio
    if len(off) < 2:
        return True
    return abs(off.mean()) > BIASED * off.std() / np.sqrt(len(off))


def _check_joint(evidence: Evidence, drawn: Drawn) -> None:
    """``eval_pdf`` and ``eval_pdf_sample`` against the separate calls."""
    usable = np.isfinite(drawn.wo).all(axis=1) & ~drawn.delta
    usable &= np.abs(np.linalg.norm(drawn.wo, axis=1) - 1) < BSDF_ROUNDING
    for function in ("eval_pdf", "eval_pdf_sample"):
        value, pdf = drawn.joint[function]
        for alone, joint, due, slack in (
            ("eval", value, drawn.eval, drawn.eval_slack),
            ("pdf", pdf[:, None], drawn.pdf[:, None], drawn.pdf_slack[:, None]),
        ):
            wrong = unequal(joint, due, slack) & usable
            if is_many(wrong, drawn.n):
                _unequal(
                    evidence,
                    function,
                    function,
                    drawn,
                    wrong,
                    joint.sum(axis=1) / np.maximum(due.sum(axis=1), 1e-30),
                    f"its value over `{alone}`",
                    f"`{function}` answers otherwise than `{alone}`",
                )
    own, given = drawn.joint, drawn.given
    wrong = (np.abs(own["wo"] - drawn.wo).max(axis=1) > BSDF_ROUNDING) & given
    wrong |= unequal(own["weight"], drawn.weight, 0.0)
    wrong |= unequal(own["pdf"], drawn.sampled_pdf, 0.0) & given
    if is_many(wrong, drawn.n):
        evidence.breach(
            "eval_pdf_sample",
            "eval_pdf_sample",
            f"{100 * wrong.mean():.3g} % of the samples at {drawn.condition}",
            "`eval_pdf_sample` draws other samples than `sample`",
            size=float(wrong.mean()),
            off=float(wrong.mean()),
            theta_i=drawn.condition.theta_i,
        )


def _unequal(
    evidence: Evidence,
    name: str,
    function: str,
    drawn: Drawn,
    wrong: Flags,
    ratio: Floats,
    what: str,
    mistake: str | None = None,
    effect: str | None = None,
) -> None:
    """Add a breach that tells by how much values differ."""
    mistake = mistake or f"`{function}`: {what} should be 1"
    usable = wrong & (np.abs(ratio) < INFINITE)
    spread = "infinite"
    if usable.any():
        low, middle, high = np.quantile(ratio[usable], [0.05, 0.5, 0.95])
        spread = f"{low:.4g} to {high:.4g}, median {middle:.4g}"
    evidence.breach(
        name,
        function,
        f"{what} is {spread} for {100 * wrong.mean():.3g} % of the samples at "
        f"{drawn.condition}",
        mistake,
        size=float(wrong.mean()),
        effect=effect,
        off=float(np.mean(np.where(usable, np.minimum(np.abs(ratio - 1), 1), wrong))),
        theta_i=drawn.condition.theta_i,
    )
