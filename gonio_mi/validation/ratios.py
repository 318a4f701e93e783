"""What a ratio that should be 1 looks like: a cosine, a Jacobian, a probability."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ..array_types import Flags, Floats
from .collecting import Drawn
from .evidence import Evidence

__all__ = [
    "FACTORS",
    "Cases",
    "explain_neutrally",
    "explain_ratio",
    "factor",
    "ratios_of",
]

# What is likely forgotten, or there once too often, and how it reads.
FACTORS = {
    "cos_o": "the cosine of wo",
    "cos_i": "the cosine of wi",
    "sin_o": "the sine of theta_o",
    "pi": "a factor pi",
    "four": "a factor 4",
    "two": "a factor 2",
    "jacobian": "the Jacobian of the half vector, 1 / (4 wo.h)",
    "dot": "wo.h",
    "cos_h": "the cosine of the half vector",
    "eta2": "eta^2",
    "component": "the probability of the lobe",
    "pdf": "`pdf`",
}

# How near to 1 a ratio must be, for nine samples in ten, to be explained.
NEAR = 2e-3

# Ratios, the samples, and which of them the ratios are of.
Cases: TypeAlias = "list[tuple[Floats, Drawn, Flags]]"


def factor(name: str, drawn: Drawn, mask: Flags) -> Floats:
    """Values of a factor for some samples."""
    wi, wo = drawn.condition.wi, drawn.wo[mask]
    half = wi + wo
    half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
    if name == "cos_o":
        return np.maximum(np.abs(wo[:, 2]), 1e-9)
    if name == "cos_i":
        return np.full(len(wo), abs(wi[2]))
    if name == "sin_o":
        return np.maximum(np.hypot(wo[:, 0], wo[:, 1]), 1e-9)
    if name == "jacobian":
        return 1 / (4 * np.maximum(np.abs(np.sum(wo * half, axis=1)), 1e-6))
    if name == "dot":
        return np.maximum(np.abs(np.sum(wo * half, axis=1)), 1e-6)
    if name == "cos_h":
        return np.maximum(np.abs(half[:, 2]), 1e-9)
    if name == "eta2":
        return drawn.eta[mask] ** 2
    if name == "component":
        shares = np.bincount(drawn.component[drawn.smooth].astype(int))
        return (shares / shares.sum())[drawn.component[mask].astype(int)]
    if name == "pdf":
        return drawn.pdf[mask]
    return np.full(len(wo), {"pi": np.pi, "four": 4.0, "two": 2.0}[name])


@dataclass(frozen=True)
class _Found:
    """A factor that explains a ratio, its power, and a constant besides."""

    name: str
    power: int
    constant: float | None = None


def ratios_of(evidence: Evidence, what: str) -> Cases:
    """Ratios that should be 1, of each set of samples, with the samples they are of."""
    cases: Cases = []
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


def explain_ratio(cases: Cases, function: str, what: str) -> str:
    """Sentence on a ratio of two answers that should be 1.

    Parameters
    ----------
    cases : list of (ndarray, Drawn, mask)
        Ratios, the samples, and which of them the ratios are of.
    function : str
        Where the ratio's numerator comes from.
    what : str
        The ratio, in words.
    """
    wrong = _wrong(cases)
    if not wrong:
        return f"`{function}` contradicts the other functions"
    found = _find(wrong)
    if found is None:
        return f"`{function}`: {what} {_in_numbers(wrong, cases)}"
    text = _worded(function, found.name, found.power)
    if found.constant is None:
        return text + _where(wrong, cases)
    return f"{text}, and has a factor {found.constant:.4g} besides"


def explain_neutrally(cases: Cases, what: str) -> str:
    """The same where nothing tells whose fault it is."""
    wrong = _wrong(cases)
    found = _find(wrong)
    if found is None:
        return f"{what} {_in_numbers(wrong, cases)}"
    text, constant = FACTORS[found.name], found.constant
    if found.power < 0:
        text = f"{constant or 1:.4g} over {text}"
    elif constant is not None:
        text = f"{constant:.4g} times {text}"
    return f"{what} is {text}{_where(wrong, cases)}"


def _wrong(cases: Cases) -> Cases:
    """Cases without what is right, which tells nothing."""
    return [case for case in cases if not _is_near(case[0])] or cases


def _find(cases: Cases) -> _Found | None:
    """What explains a ratio; None if nothing that is known."""
    for name, power, constant in _candidates():
        near = 0.02 if name == "component" else NEAR  # known from frequencies only
        rests = [
            ratio / factor(name, drawn, mask) ** power for ratio, drawn, mask in cases
        ]
        if _is_constantly(1.0, name, rests, cases, near):
            return _Found(name, power)
        if constant and _is_constantly(float(np.median(rests[0])), name, rests, cases):
            return _Found(name, power, float(np.median(rests[0])))
    return None


def _in_numbers(cases: Cases, everything: Cases) -> str:
    """How large a ratio is in cases of all, and where."""
    ratios = np.concatenate([ratio for ratio, _, _ in cases])
    low, middle, high = np.quantile(ratios, [0.05, 0.5, 0.95])
    place = _place(cases, everything)
    if high - low < NEAR * middle:
        return f"is {middle:.4g} {place or 'everywhere'}"
    text = f"is {low:.4g} to {high:.4g}, median {middle:.4g}"
    return f"{text}, {place}" if place else text


def _where(cases: Cases, everything: Cases) -> str:
    """Incident directions of which ratios are wrong; empty if of all.

    The place on the surface too, if it is right at others only.
    """
    n = len(everything)
    if len(cases) == n:
        return ""
    first = max(cases, key=lambda case: np.abs(case[0] - 1).mean())[1]
    more = f", and at {len(cases) - 1} more of {n}" if len(cases) > 1 else ""
    wrong = {drawn.condition.uv for _, drawn, _ in cases}
    right = {
        drawn.condition.uv
        for ratio, drawn, _ in everything
        if not any(ratio is one for one, _, _ in cases)
    }
    u, v = first.condition.uv
    uv = f", uv ({u:g}, {v:g})" if not wrong & right else ""
    return f" at {first.condition}{uv}{more}"


def _place(cases: Cases, everything: Cases) -> str:
    """Where ratios are wrong; empty if everywhere."""
    ratio, drawn, mask = max(cases, key=lambda case: np.abs(case[0] - 1).mean())
    wo, reflected = drawn.wo[mask], drawn.reflected[mask]
    wrong = np.abs(ratio - 1) > NEAR
    words = [_where(cases, everything).strip()]
    words = words if words[0] else []
    if 0 < wrong.mean() < 0.95:
        for side, name in ((reflected, "lit side"), (~reflected, "other side")):
            if side[wrong].all() and not side.all():
                words.append(f"on the {name}")
        theta = np.degrees(np.arccos(np.clip(np.abs(wo[wrong, 2]), 0, 1)))
        low, high = np.quantile(theta, [0.05, 0.95])
        words.append(
            f"for {100 * wrong.mean():.3g} % of the samples, with theta_o {low:.0f} to "
            f"{high:.0f}"
        )
        for axis, name in ((0, "wo.x"), (1, "wo.y")):
            signs = np.sign(wo[wrong, axis])
            if abs(signs.sum()) == len(signs) and np.ptp(np.sign(wo[:, axis])) > 0:
                words.append(f"{name} {'> 0' if signs[0] > 0 else '< 0'}")
    return ", ".join(words)


def _candidates() -> Iterator[tuple[str, int, bool]]:
    """Factors once too often or once too few, alone, then beside a constant."""
    for constant in (False, True):
        for name in FACTORS:
            if not (constant and name in ("pi", "four", "two", "component", "eta2")):
                yield name, 1, constant
                yield name, -1, constant


def _is_constantly(
    value: float, name: str, rests: Sequence[Floats], cases: Cases, near: float = NEAR
) -> bool:
    """Whether a ratio is one value once a factor is taken out, which is not trivial."""
    values = [factor(name, drawn, mask) for _, drawn, mask in cases]
    if name not in ("pi", "four", "two", "eta2") and all(
        np.ptp(v) < 1e-6 for v in values
    ):
        return False
    if all(np.abs(v - 1).max() < 1e-6 for v in values):
        return False
    return all(_is_near(rest / value, near) for rest in rests)


def _worded(function: str, name: str, power: int) -> str:
    text = FACTORS[name]
    if function == "sample" and name in ("component", "pdf"):
        # weight times pdf has a factor too much: it was never divided by it
        verb = "lacks division by" if power > 0 else "is divided once more by"
        return f"`sample` weight {verb} {text}"
    if power < 0:
        return f"`{function}` lacks {text}"
    return f"`{function}` has {text} too much"


def _is_near(ratio: Floats, near: float = NEAR) -> bool:
    low, high = np.quantile(ratio, [0.05, 0.95])
    return low > 1 - near and high < 1 + near
