"""What every answer must be by itself: finite, at least 0, and the same each time."""

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
    "asked_after",
    "check_answers",
    "check_directions",
    "check_everywhere",
    "check_memory",
]

# Directions at which answers are looked at beside those of samples.
EVERYWHERE = 2**12

# What a type is, if all else agrees.
AGREED = "as `eval` has it: a type or a side is declared wrongly"


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
                    f"{100 * wrong.mean():.3g} % of the samples at {drawn.condition}",
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
    one_way = reflects & ~transmits & ~drawn.reflected & ~beside
    other_way = transmits & ~reflects & drawn.reflected & ~beside
    agreed = _agreed(drawn)
    through = "a sample of a reflecting type leaves on the other side"
    back = "a sample of a transmitting type leaves on the side of incidence"
    cases = [
        (np.abs(length - 1) > BSDF_ROUNDING, "directions are not of length 1", None),
        (one_way & ~agreed, through, None),
        (one_way & agreed, f"{through}, {AGREED}", INTERFACE),
        (other_way & ~agreed, back, None),
        (other_way & agreed, f"{back}, {AGREED}", INTERFACE),
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
                f"{100 * wrong.mean():.3g} % of the samples at {drawn.condition}",
                f"`sample`: {mistake}",
                size=float(wrong.mean()),
                effect=effect,
            )


def _agreed(drawn: Drawn) -> Flags:
    """Samples for which ``eval`` says what weight times pdf does, and not 0.

    Then their type is a name only: integrators ask it for discrete lobes.
    """
    product = drawn.weight * drawn.sampled_pdf[:, None]
    lit = (drawn.eval > 0).any(axis=1)
    return lit & ~unequal(product, drawn.eval, drawn.eval_slack)


def asked_after(probe: Probe, first: Drawn) -> tuple[Floats, Floats]:
    """``eval`` and ``pdf`` of samples, when others were drawn since."""
    wo = mi.Vector3f(np.ascontiguousarray(first.wo.T, dtype=np.float32))
    pdf = numbers(probe.pdf(wo), first.n).astype(float)
    return spectral(probe.eval(wo), first.n), pdf


def check_memory(
    evidence: Evidence,
    first: Drawn,
    after: tuple[Floats, Floats],
    again: Drawn,
) -> None:
    """The same samples after all other calls: no answer depends on those before.

    `after` is what :func:`asked_after` said in between.
    """
    for function, before, after_all in (
        ("eval", first.eval, after[0]),
        ("pdf", first.pdf, after[1]),
        ("sample", first.weight, again.weight),
        ("sample", first.sampled_pdf, again.sampled_pdf),
        ("eval", first.eval, again.eval),
        ("pdf", first.pdf, again.pdf),
    ):
        usable: Any = np.isfinite(before) & np.isfinite(after_all)
        usable = usable if usable.ndim == 1 else usable.all(axis=1)
        wrong = unequal(before, after_all, 0.0) & usable
        if is_many(wrong, first.n):
            evidence.breach(
                "answers",
                function,
                f"{100 * wrong.mean():.3g} % of the samples at {first.condition}",
                f"`{function}` answers otherwise when it is asked again: it depends on "
                "the calls before",
                size=1.0,
            )
            return
