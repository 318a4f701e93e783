"""What must be equal for every sample, for a BSDF has several functions to ask."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats
from ..collector.directions import direction
from .collecting import Drawn
from .equality import BSDF_ROUNDING, is_many, unequal
from .evidence import INTERFACE, NOISE, Evidence
from .probe import Probe, numbers, spectral

__all__ = [
    "check_answers",
    "check_directions",
    "check_everywhere",
    "check_identities",
    "check_memory",
]

# Standard errors beyond which a mean is not that of another.
BIASED = 5

# A ratio beyond that has a denominator of 0.
INFINITE = 1e20

# Directions at which answers are looked at beside those of samples.
EVERYWHERE = 2**12


def check_answers(evidence: Evidence, drawn: Drawn) -> None:
    """All values are finite and at least 0."""
    given = drawn.given
    smooth = given & ~drawn.delta
    values: dict[str, list[tuple[str, Floats, Flags | None]]] = {
        "sample": [
            ("weight", drawn.weight, None),
            ("pdf", drawn.sampled_pdf, given),
            ("direction", drawn.wo, given),
        ],
        "eval": [("value", drawn.eval, smooth), ("value", drawn.reverse, smooth)],
        "pdf": [("value", drawn.pdf, smooth)],
        "eval_pdf": [("value", x, smooth) for x in drawn.joint["eval_pdf"]],
        "eval_pdf_sample": [
            ("value", x, smooth) for x in drawn.joint["eval_pdf_sample"]
        ],
    }
    for function, answers in values.items():
        for what, value, where in answers:
            wrong: Any = ~np.isfinite(value)
            if what != "direction":
                wrong |= value < 0
            wrong = wrong if wrong.ndim == 1 else wrong.any(axis=1)
            if where is not None:
                wrong = wrong & where
            if wrong.any():
                example = np.ravel(value[wrong][0])
                example = example[~np.isfinite(example) | (example < 0)][0]
                evidence.breach(
                    "answers",
                    function,
                    f"{wrong.mean():.3g} of the samples at {drawn.condition}",
                    f"the {what} of `{function}` is {example:g} in places",
                    size=float(wrong.mean()),
                )


def check_everywhere(evidence: Evidence, probe: Probe) -> None:
    """The same for directions that no sample may have: a lattice on the sphere."""
    z = (np.arange(EVERYWHERE) + 0.5) / EVERYWHERE * 2 - 1
    phi = np.arange(EVERYWHERE) * np.pi * (5**0.5 - 1)
    wo = direction(np.arccos(z), phi)
    v = mi.Vector3f(np.ascontiguousarray(wo.T, dtype=np.float32))
    answers = (
        ("eval", spectral(probe.eval(v), EVERYWHERE)),
        ("pdf", numbers(probe.pdf(v), EVERYWHERE)[:, None]),
    )
    for function, value in answers:
        wrong = (~np.isfinite(value) | (value < 0)).any(axis=1)
        if wrong.any():
            i = int(wrong.argmax())
            example = value[i][~np.isfinite(value[i]) | (value[i] < 0)][0]
            theta, phi = np.degrees([np.arccos(z[i]), np.arctan2(wo[i, 1], wo[i, 0])])
            black = np.isfinite(value[wrong]).all() and not answers[0][1][wrong].any()
            evidence.breach(
                "answers",
                function,
                f"{wrong.mean():.3g} of all directions at {probe.condition}, such as "
                f"theta_o {theta:.0f}, phi_o {phi % 360:.0f}",
                f"the value of `{function}` is {example:g} in places",
                size=float(wrong.mean()),
                effect=INTERFACE if black else None,
            )


def check_directions(evidence: Evidence, drawn: Drawn) -> None:
    """Unit vectors, on the side and of the type that the record says."""
    given = drawn.given & np.isfinite(drawn.wo).all(axis=1)
    if not given.any():
        return
    length = np.linalg.norm(drawn.wo, axis=1)
    flags = mi.BSDFFlags
    reflects = (drawn.type & int(flags.Reflection)) != 0
    transmits = (drawn.type & int(flags.Transmission)) != 0
    # on the horizon no side is wrong
    beside = np.abs(drawn.wo[:, 2]) < BSDF_ROUNDING
    beside |= abs(drawn.condition.wi[2]) < BSDF_ROUNDING
    cases = [
        (np.abs(length - 1) > BSDF_ROUNDING, "directions are not of length 1", None),
        (
            reflects & ~transmits & ~drawn.reflected & ~beside,
            "a sample of a reflecting type leaves on the other side",
            None,
        ),
        (
            transmits & ~reflects & drawn.reflected & ~beside,
            "a sample of a transmitting type leaves on the side of incidence",
            None,
        ),
        (
            ~reflects & ~transmits,
            "sampled_type names neither reflection nor transmission",
            INTERFACE,
        ),
        (
            reflects & ~(np.abs(drawn.eta - 1) < BSDF_ROUNDING) & ~transmits,
            "eta is not 1 for a reflection",
            NOISE,  # Russian roulette is all that asks for it
        ),
        (~(drawn.eta > 0), "eta is not positive", None),
    ]
    for wrong, mistake, effect in cases:
        wrong = wrong & given
        if is_many(wrong, drawn.n):
            evidence.breach(
                "directions",
                "sample",
                f"{wrong.mean():.3g} of the samples at {drawn.condition}",
                f"`sample`: {mistake}",
                size=float(wrong.mean()),
                effect=effect,
            )


def check_memory(evidence: Evidence, first: Drawn, again: Drawn) -> None:
    """The same samples after all other calls: no answer depends on those before."""
    for function, before, after in (
        ("sample", first.weight, again.weight),
        ("sample", first.sampled_pdf, again.sampled_pdf),
        ("eval", first.eval, again.eval),
        ("pdf", first.pdf, again.pdf),
    ):
        usable: Any = np.isfinite(before) & np.isfinite(after)
        usable = usable if usable.ndim == 1 else usable.all(axis=1)
        wrong = unequal(before, after, 0.0) & usable
        if is_many(wrong, first.n):
            evidence.breach(
                "answers",
                function,
                f"{wrong.mean():.3g} of the samples at {first.condition}",
                f"`{function}` answers otherwise when it is asked again: it depends on "
                "the calls before",
                size=1.0,
            )
            return


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
        f"{dark.sum() / smooth.sum():.3g} of the samples with light at "
        f"{drawn.condition}",
        f"{functions} 0 where `sample` scatters light",
        size=1 + float(dark.mean()),
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
        wrong = unequal(value, drawn.eval, drawn.eval_slack) & usable
        if is_many(wrong, drawn.n):
            ratio = value.sum(axis=1) / np.maximum(drawn.eval.sum(axis=1), 1e-30)
            _unequal(
                evidence,
                function,
                function,
                drawn,
                wrong,
                ratio,
                "its value over `eval`",
                f"`{function}` answers otherwise than `eval`",
            )
        wrong = unequal(pdf, drawn.pdf, drawn.pdf_slack) & usable
        if is_many(wrong, drawn.n):
            ratio = pdf / np.maximum(drawn.pdf, 1e-30)
            _unequal(
                evidence,
                function,
                function,
                drawn,
                wrong,
                ratio,
                "its value over `pdf`",
                f"`{function}` answers otherwise than `pdf`",
            )
    own, given = drawn.joint, drawn.given
    wrong = (np.abs(own["wo"] - drawn.wo).max(axis=1) > BSDF_ROUNDING) & given
    wrong |= unequal(own["weight"], drawn.weight, 0.0)
    wrong |= unequal(own["pdf"], drawn.sampled_pdf, 0.0) & given
    if is_many(wrong, drawn.n):
        evidence.breach(
            "eval_pdf_sample",
            "eval_pdf_sample",
            f"{wrong.mean():.3g} of the samples at {drawn.condition}",
            "`eval_pdf_sample` draws other samples than `sample`",
            size=float(wrong.mean()),
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
        f"{what} is {spread} for {wrong.mean():.3g} of the samples at "
        f"{drawn.condition}",
        mistake,
        size=float(wrong.mean()),
        effect=effect,
    )
