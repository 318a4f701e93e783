"""The ratio of two answers that should be equal, and the factor that explains it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from ...array_types import Flags, Floats
from ..evidence import Evidence
from ..mistakes import EVAL, PDF, SAMPLE, Function, Guess, Mistake
from ..samples import Samples, beyond_rounding, ratio_of

# Likely factors that are forgotten, or there once too often, and how they read.
FACTORS = {
    "cos_o": "cos(theta_o)",
    "cos_i": "cos(theta_i)",
    "sin_o": "sin(theta_o)",
    "pi": "pi",
    "four": "4",
    "two": "2",
    "jacobian": "1 / (4 wo.h), the Jacobian of the half vector",
    "dot": "wo.h",
    "cos_h": "cos(theta_h) of the half vector",
    "eta2": "eta^2",
    "component": "P(lobe), the probability of the lobe",
    "pdf": "`pdf`",
    "masking": "G1(wo), Smith's masking of wo",
}
NUMBERS = {"pi": np.pi, "four": 4.0, "two": 2.0}


class Factor(Mistake):
    """What is wrong with one of two answers, by their ratio or a `factor` of it."""

    CONTRADICTS = "{subject} contradicts the other functions"
    RATIO = "{words} {ratio}"
    TOO_MUCH = "{subject} has an extra factor {factor}{where}"
    LACKS = "{subject} lacks the factor {factor}{where}"
    NOT_DIVIDED = "{subject} lacks division by {factor}{where}"
    DIVIDED_TWICE = "{subject} is divided once more by {factor}{where}"
    CONSTANT = """`eval` or the weight of `sample`: they differ by a constant factor,
        weight times pdf is {factor} times `eval`{where}"""
    EITHER = """`eval` or the weight of `sample`: weight times pdf, over `eval`,
        {ratio}{where}"""
    OTHER_SUMS = """{who}: the weights do not sum up to `eval`, where directions agree
        with `pdf`"""
    COLOURS = "`eval` or the weight of `sample`: {colours} are exchanged in one of them"
    OF_LOBE_ALONE = """{who} weight lacks division by the probability of the lobe: it is
        value over pdf of the picked lobe alone"""


@dataclass(frozen=True)
class Answer:
    """One of two answers about samples that should be equal.

    Attributes
    ----------
    function : Function
        That is guilty if this answer is wrong.
    name : str
        Of it, as an attribute of samples.
    subject, words : str
        It as the subject of "lacks a factor", and its ratio to the other.
    divisors : tuple of str
        Factors by which it may not have been divided.
    """

    function: Function
    name: str
    subject: str
    words: str
    divisors: tuple[str, ...] = ()


SAMPLED_PDF = Answer(
    SAMPLE,
    "sampled_pdf",
    "the pdf that `sample` returns",
    "the pdf that `sample` returns: pdf, over `pdf`,",
)
DENSITY = Answer(PDF, "pdf", "`pdf`", "`pdf`, over the density of `sample`,")
WEIGHT = Answer(
    SAMPLE,
    "flux_by_pdf",
    "`sample` weight",
    "`sample`: weight times pdf, over `eval`,",
    divisors=("component", "pdf"),
)
VALUE = Answer(EVAL, "eval", "`eval`", "`eval`: value, over weight times pdf,")

# Largest distance from 1, for nine samples in ten, of a ratio that is explained; and of
# one whose factor is known from frequencies only.
TOLERANCE, COMPONENT_TOLERANCE = 2e-3, 0.02

# Least square of a roughness whose masking is told from a constant.
MIN_ALPHA2 = 1e-3


def factor(name: str, samples: Samples, mask: Flags) -> Floats:
    """Values of a factor for some samples."""
    wi, wo = samples.wi[mask], samples.wo[mask]
    if name == "component":
        own = samples.component[mask].astype(int)
        return (np.bincount(own) / len(own))[own]
    half = wi + wo
    half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
    along = np.maximum(np.abs(np.sum(wo * half, axis=1)), 1e-6)
    values: dict[str, Any] = NUMBERS | {
        "cos_o": wo[:, 2],
        "cos_i": wi[:, 2],
        "sin_o": np.hypot(wo[:, 0], wo[:, 1]),
        "jacobian": 1 / (4 * along),
        "dot": along,
        "cos_h": half[:, 2],
        "eta2": samples.eta[mask] ** 2,
        "pdf": samples.pdf[mask],
    }
    return np.maximum(np.abs(values[name] * np.ones(len(wo))), 1e-9)


@dataclass(frozen=True, eq=False)
class Ratio:
    """A ratio that should be 1, of the samples that `mask` selects."""

    values: Floats
    samples: Samples
    mask: Flags

    @property
    def off(self) -> Flags:
        """Mask of the values that are not 1."""
        return np.abs(self.values - 1) > TOLERANCE

    @property
    def wrong(self) -> Flags:
        """Mask of all samples whose ratio is not 1."""
        wrong = np.zeros(self.samples.n, dtype=bool)
        wrong[self.mask] = self.off
        return wrong

    def uvs(self, mask: Flags | slice) -> set[tuple[float, ...]]:
        """Places on the surface of some samples, of a sweep or all in one."""
        uvs = self.samples.condition.uvs
        return set(map(tuple, uvs[mask])) if uvs.ndim > 1 else {tuple(uvs)}


class Found(NamedTuple):
    """A factor that explains a ratio, its power, and a constant besides."""

    name: str
    power: int
    constant: float = 1.0


@dataclass(frozen=True)
class Ratios:
    """Ratios of two answers, for the samples of each condition."""

    above: Answer
    below: Answer
    each: tuple[Ratio, ...]

    @classmethod
    def of(cls, evidence: Evidence, above: Answer, below: Answer) -> Ratios:
        """Ratios of all samples that have both answers."""
        ratios = []
        for samples in (*evidence.whole, *evidence.sweeps, *evidence.in_radiance_mode):
            ok = samples.smooth & (samples.pdf > 0) & np.isfinite(samples.pdf)
            ok &= np.isfinite(samples.sampled_pdf) & (np.abs(samples.wo[:, 2]) > 1e-4)
            over, under = (
                getattr(samples, one.name).reshape(samples.n, -1)
                for one in (above, below)
            )
            for answer in (over, under):
                ok &= np.isfinite(answer).all(axis=1) & (answer > 0).any(axis=1)
            if ok.any():
                ratios.append(Ratio(ratio_of(over[ok], under[ok]), samples, ok))
        return cls(above, below, tuple(ratios))

    def blame(self, functions: Function) -> Guess:
        """Mistake of one of both functions; of both, where nothing tells which."""
        if functions is self.below.function:
            each = tuple(replace(one, values=1 / one.values) for one in self.each)
            return Ratios(self.below, self.above, each).blame(functions)
        if functions is not self.above.function:
            return self._blame_either()
        names = {"subject": self.above.subject, "words": self.above.words}
        if not self.each:
            return Factor.CONTRADICTS(functions, **names)
        found = self.found
        if found is None:
            return Factor.RATIO(functions, ratio=self.in_numbers, **names)
        mistakes, where = (Factor.TOO_MUCH, Factor.LACKS), self.where
        if found.name in self.above.divisors:
            # a factor too much, by which it was never divided
            mistakes = Factor.NOT_DIVIDED, Factor.DIVIDED_TWICE
        if found.constant != 1:
            where = f", and an additional factor of {found.constant:.4g}"
        mistake, factor = mistakes[found.power < 0], FACTORS[found.name]
        return mistake(functions, factor=factor, where=where, **names)

    def _blame_either(self) -> Guess:
        """How they differ, where nothing tells which of both functions is wrong."""
        both = self.above.function | self.below.function
        found, middle = self.found, float(np.median(self.wrong[0].values))
        if all(is_one(one.values / middle) for one in self.wrong):
            text = f"{middle:.4g}"
            if found is not None:
                text = f"{'' if found.power > 0 else '1/'}{FACTORS[found.name]}"
            return Factor.CONSTANT(both, factor=text, where=self.where)
        if found is None:
            return Factor.EITHER(both, ratio=self.in_numbers, where="")
        text = FACTORS[found.name]
        if found.power < 0:
            text = f"{found.constant:.4g} over {text}"
        elif found.constant != 1:
            text = f"{found.constant:.4g} times {text}"
        return Factor.EITHER(both, ratio=f"is {text}", where=self.where)

    @cached_property
    def wrong(self) -> tuple[Ratio, ...]:
        """Those that are wrong; all of them if none stands out."""
        wrong = tuple(one for one in self.each if not is_one(one.values))
        # or of a few samples only
        few = tuple(one for one in self.each if beyond_rounding(one.wrong))
        return wrong or few or self.each

    @cached_property
    def found(self) -> Found | None:
        """Factor that explains those that are wrong; None if none does."""
        known = {
            name: [factor(name, one.samples, one.mask) for one in self.wrong]
            for name in FACTORS
            if name != "masking"
        }
        # a constant may come with factors that vary
        varying = [one for one in known if one not in (*NUMBERS, "component", "eta2")]
        alone = product([False], known, (1, -1))
        for with_constant, name, power in (*alone, *product([True], varying, (1, -1))):
            if _is_trivial(name, known[name]):
                continue
            both = zip(self.wrong, known[name])
            rests = [one.values / x**power for one, x in both]
            constant = float(np.median(rests[0])) if with_constant else 1.0
            near = COMPONENT_TOLERANCE if name == "component" else TOLERANCE
            if all(is_one(rest / constant, near) for rest in rests):
                return Found(name, power, constant)
        masking = (Found("masking", k) for k in (1, -1) if self._is_masking(k))
        return next(masking, None)

    @property
    def varies(self) -> bool:
        """Whether a factor that varies with the directions explains them."""
        found = self.found if self.each else None
        return found is not None and found.name not in NUMBERS

    def _is_masking(self, power: int) -> bool:
        """Whether GGX's G1(wo) to a power explains, of roughnesses that fit best."""
        wo = np.concatenate([one.samples.wo[one.mask] for one in self.wrong])
        g1 = np.concatenate([one.values for one in self.wrong]) ** power
        # (2 / G1 - 1)^2 - 1 is a sum of the squares of both roughnesses
        slopes = (wo[:, :2] / wo[:, 2:]) ** 2
        size = 1 + slopes.sum(axis=1)
        excess = ((2 / np.maximum(g1, 1e-9) - 1) ** 2 - 1) / size
        alpha2 = np.linalg.lstsq(slopes / size[:, None], excess, rcond=None)[0]
        fitted = 2 / (1 + np.sqrt(1 + slopes @ np.maximum(alpha2, 0)))
        return bool((alpha2 > MIN_ALPHA2).all() and is_one(g1 / fitted))

    @property
    def in_numbers(self) -> str:
        """Text on how large they are, and where."""
        values = np.concatenate([one.values for one in self.wrong])
        off = np.concatenate([one.off for one in self.wrong])
        values = values[off] if off.any() else values
        low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
        place = ", ".join(self._places())
        if high - low < TOLERANCE * middle:
            return f"is {middle:.4g} {place or 'everywhere'}"
        text = f"is {low:.4g} to {high:.4g}, median {middle:.4g}"
        return f"{text}, {place}" if place else text

    @property
    def where(self) -> str:
        """Text on the incident directions at which they are wrong; empty if at all.

        It names the place on the surface if only that one is wrong.
        """
        n, wrong = len(self.each), self.wrong
        if len(wrong) == n:
            return ""
        more = f", and at {len(wrong) - 1} more of {n}" if len(wrong) > 1 else ""
        right = [one for one in self.each if one not in wrong]
        wrong_uvs = {uv for one in wrong for uv in one.uvs(one.wrong)}
        right_uvs = {uv for one in right for uv in one.uvs(slice(None))}
        worst = self._worst
        first = worst.samples.condition
        u, v = first.uv
        told = first.uvs.ndim > 1 or wrong_uvs & right_uvs
        uv = "" if told else f", uv ({u:g}, {v:g})"
        return f" at {first.place(worst.wrong)}{uv}{more}"

    @property
    def _worst(self) -> Ratio:
        return max(self.wrong, key=lambda one: np.abs(one.values - 1).mean())

    def _places(self) -> Iterable[str]:
        """Texts on where they are wrong; none if everywhere."""
        worst, off = self._worst, self._worst.off
        wo = worst.samples.wo[worst.mask]
        if self.where:
            yield self.where.strip()
        if not 0 < off.mean() < 0.95:
            return
        reflected = worst.samples.reflected[worst.mask]
        for side, name in ((reflected, "illuminated side"), (~reflected, "other side")):
            if side[off].all() and not side.all():
                yield f"on the {name}"
        theta = np.degrees(np.arccos(np.clip(np.abs(wo[off, 2]), 0, 1)))
        low, high = np.quantile(theta, [0.05, 0.95])
        share = f"{100 * off.mean():.3g} % of the samples"
        yield f"for {share}, with theta_o {low:.0f} to {high:.0f}"
        for axis, name in ((0, "wo.x"), (1, "wo.y")):
            signs = np.sign(wo[off, axis])
            if abs(signs.sum()) == len(signs) and np.ptp(np.sign(wo[:, axis])) > 0:
                yield f"{name} {'> 0' if signs[0] > 0 else '< 0'}"


def is_one(values: Floats, tolerance: float = TOLERANCE) -> bool:
    """Whether nine ratios in ten are 1."""
    low, high = np.quantile(values, [0.05, 0.95])
    return low > 1 - tolerance and high < 1 + tolerance


def _is_trivial(name: str, values: Iterable[Floats]) -> bool:
    """Whether a factor is 1 everywhere, or constant though it should vary."""
    constant = all(np.ptp(v) < 1e-6 for v in values)
    if constant and name not in (*NUMBERS, "eta2"):
        return True
    return all(np.abs(v - 1).max() < 1e-6 for v in values)
