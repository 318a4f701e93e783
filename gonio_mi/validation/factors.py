"""Factors that explain a ratio of two answers: a cosine, a Jacobian, a probability."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import Flags, Floats
from .evidence import Evidence
from .samples import Samples, is_many, ratio_of

__all__ = [
    "FACTORS",
    "Ratio",
    "explain",
    "explain_neutrally",
    "factor",
    "has_known_factor",
    "inverse",
    "ratios_of",
]

# Likely factors that are forgotten, or there once too often, and how they read.
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
NUMBERS = {"pi": np.pi, "four": 4.0, "two": 2.0}

# Two answers that should be equal, the one above over the one below: which function
# is wrong if the ratio is, its answer, and the ratio in words.
#   guilty: (above, below), subject of "lacks a factor", ratio in words
BETWEEN = {
    "sampled_pdf": (
        ("sampled_pdf", "pdf"),
        "the pdf that `sample` returns",
        "the pdf that `sample` returns: pdf, over `pdf`,",
    ),
    "pdf": (("pdf", "sampled_pdf"), "`pdf`", "`pdf`, over the density of `sample`,"),
    "sample": (
        ("weight", "eval"),
        "`sample` weight",
        "`sample`: weight times pdf, over `eval`,",
    ),
    "eval": (("eval", "weight"), "`eval`", "`eval`: value, over weight times pdf,"),
}

# Largest distance from 1, for nine samples in ten, of a ratio that is explained; and of
# one whose factor is known from frequencies only.
TOLERANCE, COMPONENT_TOLERANCE = 2e-3, 0.02

_ANSWERS: dict[str, Callable[[Samples], Floats]] = {
    "weight": lambda samples: samples.weight * samples.pdf[:, None],
    "eval": lambda samples: samples.eval,
    "sampled_pdf": lambda samples: samples.sampled_pdf,
    "pdf": lambda samples: samples.pdf,
}


def factor(name: str, samples: Samples, mask: Flags) -> Floats:
    """Values of a factor for some samples."""
    wi, wo = samples.wi[mask], samples.wo[mask]
    half = wi + wo
    half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)

    def along() -> Floats:
        return np.maximum(np.abs(np.sum(wo * half, axis=1)), 1e-6)

    def of_component() -> Floats:
        drawn = np.bincount(samples.component[samples.smooth].astype(int))
        return (drawn / drawn.sum())[samples.component[mask].astype(int)]

    values: dict[str, Callable[[], Floats]] = {
        "cos_o": lambda: np.maximum(np.abs(wo[:, 2]), 1e-9),
        "cos_i": lambda: np.maximum(np.abs(wi[:, 2]), 1e-9),
        "sin_o": lambda: np.maximum(np.hypot(wo[:, 0], wo[:, 1]), 1e-9),
        "jacobian": lambda: 1 / (4 * along()),
        "dot": along,
        "cos_h": lambda: np.maximum(np.abs(half[:, 2]), 1e-9),
        "eta2": lambda: samples.eta[mask] ** 2,
        "component": of_component,
        "pdf": lambda: samples.pdf[mask],
    }
    return values[name]() if name in values else np.full(len(wo), NUMBERS[name])


@dataclass(frozen=True)
class Ratio:
    """A ratio that should be 1, of those samples that `mask` names."""

    values: Floats
    samples: Samples
    mask: Flags

    def factor(self, name: str) -> Floats:
        """Values of a factor for these samples."""
        return factor(name, self.samples, self.mask)

    @property
    def wrong(self) -> Flags:
        """Samples whose ratio is not 1, of all."""
        wrong = np.zeros(self.samples.n, dtype=bool)
        wrong[self.mask] = np.abs(self.values - 1) > TOLERANCE
        return wrong

    @property
    def off(self) -> float:
        """Mean distance from 1."""
        return float(np.abs(self.values - 1).mean())


@dataclass(frozen=True)
class _Found:
    """A factor that explains a ratio, its power, and a constant besides."""

    name: str
    power: int
    constant: float | None = None


def ratios_of(evidence: Evidence, guilty: str) -> list[Ratio]:
    """Ratios of a row of `BETWEEN`, for the samples of each condition."""
    (above, below), _, _ = BETWEEN[guilty]
    ratios = []
    for samples in (*evidence.whole, *evidence.sweeps):
        ok = samples.smooth & (samples.pdf > 0) & np.isfinite(samples.pdf)
        ok &= np.isfinite(samples.sampled_pdf) & (np.abs(samples.wo[:, 2]) > 1e-4)
        over, under = (
            _ANSWERS[name](samples).reshape(samples.n, -1) for name in (above, below)
        )
        for answer in (over, under):
            ok &= np.isfinite(answer).all(axis=1) & (answer > 0).any(axis=1)
        if ok.any():
            ratios.append(Ratio(ratio_of(over[ok], under[ok]), samples, ok))
    return ratios


def explain(ratios: Sequence[Ratio], guilty: str) -> str:
    """Sentence on a function by the ratios of a row of `BETWEEN`."""
    _, subject, words = BETWEEN[guilty]
    wrong = _wrong(ratios)
    if not wrong:
        return f"{subject} contradicts the other functions"
    found = _find(wrong)
    if found is None:
        return f"{words} {_in_numbers(wrong, ratios)}"
    has, lacks = "has {} too much", "lacks {}"
    if guilty == "sample" and found.name in ("component", "pdf"):
        # weight times pdf has a factor too much: it was never divided by it
        has, lacks = "lacks division by {}", "is divided once more by {}"
    verb = (has if found.power > 0 else lacks).format(FACTORS[found.name])
    if found.constant is None:
        return f"{subject} {verb}{_where(wrong, ratios)}"
    return f"{subject} {verb}, and has a factor {found.constant:.4g} besides"


def explain_neutrally(ratios: Sequence[Ratio]) -> str:
    """The same of weight and ``eval`` where nothing tells which of both is wrong."""
    what = BETWEEN["sample"][2].removeprefix("`sample`: ")
    wrong = _wrong(ratios)
    found = _find(wrong)
    if found is None:
        return f"{what} {_in_numbers(wrong, ratios)}"
    text, constant = FACTORS[found.name], found.constant
    if found.power < 0:
        text = f"{constant or 1:.4g} over {text}"
    elif constant is not None:
        text = f"{constant:.4g} times {text}"
    return f"{what} is {text}{_where(wrong, ratios)}"


def has_known_factor(ratios: Sequence[Ratio]) -> bool:
    """Whether a factor that varies with the directions explains ratios."""
    found = _find(_wrong(ratios)) if ratios else None
    return found is not None and found.name not in NUMBERS


def _wrong(ratios: Sequence[Ratio]) -> Sequence[Ratio]:
    """Ratios without those that are right, which tell nothing."""
    wrong = [one for one in ratios if not _is_one(one.values)]
    # or of a few samples only
    return wrong or [one for one in ratios if is_many(one.wrong)] or ratios


def _is_one(values: Floats, tolerance: float = TOLERANCE) -> bool:
    low, high = np.quantile(values, [0.05, 0.95])
    return low > 1 - tolerance and high < 1 + tolerance


def _find(ratios: Sequence[Ratio]) -> _Found | None:
    """Factor that explains ratios; None if none does."""
    for name, power, with_constant in _candidates():
        own = [ratio.factor(name) for ratio in ratios]
        rests = [ratio.values / x**power for ratio, x in zip(ratios, own)]
        if _is_trivial(name, own):
            continue
        near = COMPONENT_TOLERANCE if name == "component" else TOLERANCE
        if all(_is_one(rest, near) for rest in rests):
            return _Found(name, power)
        constant = float(np.median(rests[0]))
        if with_constant and all(_is_one(rest / constant) for rest in rests):
            return _Found(name, power, constant)
    return None


def _candidates() -> Iterator[tuple[str, int, bool]]:
    """Factors once too often or once too few, alone, then beside a constant."""
    for with_constant in (False, True):
        for name in FACTORS:
            if not (with_constant and name in (*NUMBERS, "component", "eta2")):
                yield name, 1, with_constant
                yield name, -1, with_constant


def _is_trivial(name: str, values: Sequence[Floats]) -> bool:
    """Whether a factor is 1 everywhere, or one number though it should vary."""
    constant = all(np.ptp(v) < 1e-6 for v in values)
    if constant and name not in (*NUMBERS, "eta2"):
        return True
    return all(np.abs(v - 1).max() < 1e-6 for v in values)


def _in_numbers(ratios: Sequence[Ratio], everything: Sequence[Ratio]) -> str:
    """How large ratios are, and where."""
    values = np.concatenate([ratio.values for ratio in ratios])
    wrong = np.abs(values - 1) > TOLERANCE
    values = values[wrong] if wrong.any() else values
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    place = _place(ratios, everything)
    if high - low < TOLERANCE * middle:
        return f"is {middle:.4g} {place or 'everywhere'}"
    text = f"is {low:.4g} to {high:.4g}, median {middle:.4g}"
    return f"{text}, {place}" if place else text


def _where(ratios: Sequence[Ratio], everything: Sequence[Ratio]) -> str:
    """Incident directions of which ratios are wrong; empty if of all.

    The place on the surface too, if it is right at others only.
    """
    n = len(everything)
    if len(ratios) == n:
        return ""
    worst = max(ratios, key=lambda ratio: ratio.off)
    first = worst.samples.condition
    more = f", and at {len(ratios) - 1} more of {n}" if len(ratios) > 1 else ""
    right = [one for one in everything if not any(one is other for other in ratios)]
    uvs = [{one.samples.condition.uv for one in some} for some in (ratios, right)]
    u, v = first.uv
    uv = f", uv ({u:g}, {v:g})" if not uvs[0] & uvs[1] else ""
    return f" at {first.place(worst.wrong)}{uv}{more}"


def _place(ratios: Sequence[Ratio], everything: Sequence[Ratio]) -> str:
    """Where ratios are wrong; empty if everywhere."""
    worst = max(ratios, key=lambda ratio: ratio.off)
    wo = worst.samples.wo[worst.mask]
    reflected = worst.samples.reflected[worst.mask]
    wrong = np.abs(worst.values - 1) > TOLERANCE
    words = [text] if (text := _where(ratios, everything).strip()) else []
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


def inverse(ratios: Sequence[Ratio]) -> list[Ratio]:
    """Ratios of the one below over the one above."""
    return [replace(ratio, values=1 / ratio.values) for ratio in ratios]
