"""Factors that explain a ratio of two answers: a cosine, a Jacobian, a probability.

And whether the weight of ``sample`` or ``eval`` is wrong, if anything tells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats
from ..conditions import Sweep
from ..evidence import Evidence
from ..mistakes import EVAL, PDF, SAMPLE, Function, Guess, Mistake
from ..probe import Probe, is_delta, numbers, spectral, uniform
from ..samples import Samples, beyond_rounding, ratio_of, unequal

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
class Between:
    """Two answers that should be equal, of whose ratio one function is guilty.

    Attributes
    ----------
    guilty : Function
    above, below : str
        The answers, as attributes of samples.
    subject, words : str
        That function's answer as the subject of "lacks a factor", and the ratio.
    """

    guilty: Function
    above: str
    below: str
    subject: str
    words: str


OF_SAMPLED_PDF = Between(
    SAMPLE,
    "sampled_pdf",
    "pdf",
    "the pdf that `sample` returns",
    "the pdf that `sample` returns: pdf, over `pdf`,",
)
OF_PDF = Between(
    PDF, "pdf", "sampled_pdf", "`pdf`", "`pdf`, over the density of `sample`,"
)
OF_WEIGHT = Between(
    SAMPLE,
    "flux_by_pdf",
    "eval",
    "`sample` weight",
    "`sample`: weight times pdf, over `eval`,",
)
OF_EVAL = Between(
    EVAL, "eval", "flux_by_pdf", "`eval`", "`eval`: value, over weight times pdf,"
)

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


@dataclass(frozen=True)
class Ratio:
    """A ratio that should be 1, of the samples that `mask` selects."""

    values: Floats
    samples: Samples
    mask: Flags

    @property
    def wrong(self) -> Flags:
        """Mask of all samples whose ratio is not 1."""
        wrong = np.zeros(self.samples.n, dtype=bool)
        wrong[self.mask] = np.abs(self.values - 1) > TOLERANCE
        return wrong

    @property
    def off(self) -> float:
        """Mean distance from 1."""
        return float(np.abs(self.values - 1).mean())


class _Found(NamedTuple):
    """A factor that explains a ratio, its power, and a constant besides."""

    name: str
    power: int
    constant: float = 1.0


def ratios_of(evidence: Evidence, two: Between) -> list[Ratio]:
    """Ratios of two answers, for the samples of each condition."""
    ratios = []
    for samples in (*evidence.whole, *evidence.sweeps, *evidence.in_radiance_mode):
        ok = samples.smooth & (samples.pdf > 0) & np.isfinite(samples.pdf)
        ok &= np.isfinite(samples.sampled_pdf) & (np.abs(samples.wo[:, 2]) > 1e-4)
        over = getattr(samples, two.above).reshape(samples.n, -1)
        under = getattr(samples, two.below).reshape(samples.n, -1)
        for answer in (over, under):
            ok &= np.isfinite(answer).all(axis=1) & (answer > 0).any(axis=1)
        if ok.any():
            ratios.append(Ratio(ratio_of(over[ok], under[ok]), samples, ok))
    return ratios


def explain(ratios: Sequence[Ratio], two: Between) -> Guess:
    """Mistake of the function that is guilty of ratios of two answers."""
    names, wrong = {"subject": two.subject, "words": two.words}, _wrong(ratios)
    if not wrong:
        return Factor.CONTRADICTS(two.guilty, **names)
    found = _find(wrong)
    if found is None:
        return Factor.RATIO(two.guilty, ratio=_in_numbers(wrong, ratios), **names)
    mistakes = Factor.TOO_MUCH, Factor.LACKS
    if two is OF_WEIGHT and found.name in ("component", "pdf"):
        # weight times pdf has a factor too much: it was never divided by it
        mistakes = Factor.NOT_DIVIDED, Factor.DIVIDED_TWICE
    where = _where(wrong, ratios)
    if found.constant != 1:
        where = f", and an additional factor of {found.constant:.4g}"
    mistake, factor = mistakes[found.power < 0], FACTORS[found.name]
    return mistake(two.guilty, factor=factor, where=where, **names)


def _explain_neutrally(ratios: Sequence[Ratio]) -> Guess:
    """Ratio of weight and ``eval`` where nothing tells which of them is wrong."""
    wrong = _wrong(ratios)
    found, where = _find(wrong), _where(wrong, ratios)
    middle = float(np.median(wrong[0].values))
    if all(_is_one(one.values / middle) for one in wrong):
        text = f"{middle:.4g}"
        if found is not None:
            text = f"{'' if found.power > 0 else '1/'}{FACTORS[found.name]}"
        return Factor.CONSTANT(EVAL | SAMPLE, factor=text, where=where)
    if found is None:
        text = _in_numbers(wrong, ratios)
        return Factor.EITHER(EVAL | SAMPLE, ratio=text, where="")
    text = FACTORS[found.name]
    if found.power < 0:
        text = f"{found.constant:.4g} over {text}"
    elif found.constant != 1:
        text = f"{found.constant:.4g} times {text}"
    return Factor.EITHER(EVAL | SAMPLE, ratio=f"is {text}", where=where)


def has_known_factor(ratios: Sequence[Ratio]) -> bool:
    """Whether a factor that varies with the directions explains ratios."""
    found = _find(_wrong(ratios)) if ratios else None
    return found is not None and found.name not in NUMBERS


def _wrong(ratios: Sequence[Ratio]) -> Sequence[Ratio]:
    """Ratios that are wrong; all of them if none stands out."""
    wrong = [one for one in ratios if not _is_one(one.values)]
    # or of a few samples only
    return wrong or [one for one in ratios if beyond_rounding(one.wrong)] or ratios


def _is_one(values: Floats, tolerance: float = TOLERANCE) -> bool:
    low, high = np.quantile(values, [0.05, 0.95])
    return low > 1 - tolerance and high < 1 + tolerance


def _find(ratios: Sequence[Ratio]) -> _Found | None:
    """Factor that explains ratios; None if none does."""
    known = {
        name: [factor(name, one.samples, one.mask) for one in ratios]
        for name in FACTORS
        if name != "masking"
    }
    # a constant may come with factors that vary
    varying = [one for one in known if one not in (*NUMBERS, "component", "eta2")]
    alone = product([False], known, (1, -1))
    for with_constant, name, power in (*alone, *product([True], varying, (1, -1))):
        if _is_trivial(name, known[name]):
            continue
        rests = [ratio.values / x**power for ratio, x in zip(ratios, known[name])]
        constant = float(np.median(rests[0])) if with_constant else 1.0
        near = COMPONENT_TOLERANCE if name == "component" else TOLERANCE
        if all(_is_one(rest / constant, near) for rest in rests):
            return _Found(name, power, constant)
    masking = next((k for k in (1, -1) if _is_masking(ratios, k)), None)
    return None if masking is None else _Found("masking", masking)


def _is_masking(ratios: Sequence[Ratio], power: int) -> bool:
    """Whether a power of GGX's G1(wo) explains ratios, of roughnesses that fit best."""
    wo = np.concatenate([one.samples.wo[one.mask] for one in ratios])
    g1 = np.concatenate([one.values for one in ratios]) ** power
    # (2 / G1 - 1)^2 - 1 is a sum of the squares of both roughnesses
    slopes = (wo[:, :2] / wo[:, 2:]) ** 2
    size = 1 + slopes.sum(axis=1)
    excess = ((2 / np.maximum(g1, 1e-9) - 1) ** 2 - 1) / size
    alpha2 = np.linalg.lstsq(slopes / size[:, None], excess, rcond=None)[0]
    fitted = 2 / (1 + np.sqrt(1 + slopes @ np.maximum(alpha2, 0)))
    return bool((alpha2 > MIN_ALPHA2).all() and _is_one(g1 / fitted))


def _is_trivial(name: str, values: Sequence[Floats]) -> bool:
    """Whether a factor is 1 everywhere, or constant though it should vary."""
    constant = all(np.ptp(v) < 1e-6 for v in values)
    if constant and name not in (*NUMBERS, "eta2"):
        return True
    return all(np.abs(v - 1).max() < 1e-6 for v in values)


def _in_numbers(ratios: Sequence[Ratio], everything: Sequence[Ratio]) -> str:
    """Text on how large ratios are, and where."""
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
    """Text on the incident directions at which ratios are wrong; empty if at all.

    It names the place on the surface if only that one is wrong.
    """
    n = len(everything)
    if len(ratios) == n:
        return ""
    worst = max(ratios, key=lambda ratio: ratio.off)
    first = worst.samples.condition
    more = f", and at {len(ratios) - 1} more of {n}" if len(ratios) > 1 else ""
    right = [one for one in everything if not any(one is other for other in ratios)]
    wrong_uvs = {uv for one in ratios for uv in _uvs(one, one.wrong)}
    right_uvs = {uv for one in right for uv in _uvs(one, slice(None))}
    u, v = first.uv
    told = first.uvs.ndim > 1 or wrong_uvs & right_uvs
    uv = "" if told else f", uv ({u:g}, {v:g})"
    return f" at {first.place(worst.wrong)}{uv}{more}"


def _uvs(ratio: Ratio, mask: Flags | slice) -> set[tuple[float, ...]]:
    """Places on the surface of some samples, of a sweep or all in one."""
    uvs = ratio.samples.condition.uvs
    return set(map(tuple, uvs[mask])) if uvs.ndim > 1 else {tuple(uvs)}


def _place(ratios: Sequence[Ratio], everything: Sequence[Ratio]) -> str:
    """Text on where ratios are wrong; empty if everywhere."""
    worst = max(ratios, key=lambda ratio: ratio.off)
    wo = worst.samples.wo[worst.mask]
    reflected = worst.samples.reflected[worst.mask]
    wrong = np.abs(worst.values - 1) > TOLERANCE
    words = [text] if (text := _where(ratios, everything).strip()) else []
    if 0 < wrong.mean() < 0.95:
        for side, name in ((reflected, "illuminated side"), (~reflected, "other side")):
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


# --------------------------------------------------- the weight of `sample`, and `eval`

# Weight times pdf is one account of the BSDF, ``eval`` another. Where they differ, each
# may be wrong, unless one of them gains flux that the other does not, or is reciprocal
# where the other is not, or depends on the lobe that was picked.

# Pairs of directions that are exchanged, samples of the way back, the cosine of the
# angle within which such a sample is near to that way, and how many there must be.
N_PAIRS = 24
N_BACK = 2**16
MIN_COSINE = np.cos(np.radians(3.0))
MIN_NEARBY = 12

# Logarithms of ratios that are as good as 0, and such that are not; the fraction of the
# pairs that must be the one for a reciprocal account, the other for one that is not.
MAX_LOG_SAME, MIN_LOG_OTHER = 0.03, 0.1
MIN_SAME, MIN_OTHER = 0.9, 0.15


def explain_weights(evidence: Evidence) -> Guess:
    """Function and mistake, where weight times pdf is not ``eval``.

    Directions are drawn with the density of ``pdf``, or that could not be decided.
    """
    whole = evidence.of("sampled_weight")
    if whole and all(b.condition and b.condition.component is not None for b in whole):
        # only single components disagree
        worst = max(evidence.of("components") or whole, key=lambda b: b.size)
        return worst.guess
    ratios = ratios_of(evidence, OF_WEIGHT)
    if not ratios:
        return Factor.OTHER_SUMS(SAMPLE)
    if colours := _exchanged_colours(ratios):
        return Factor.COLOURS(EVAL | SAMPLE, colours=colours)
    if _is_of_lobe_alone(evidence):
        return Factor.OF_LOBE_ALONE(SAMPLE)
    guilty = _by_energy(evidence)
    if not guilty and not int(evidence.bsdf.flags()) & int(mi.BSDFFlags.NonSymmetric):
        guilty = _by_reciprocity(evidence.bsdf, ratios)
    if guilty is EVAL:
        inverse = [replace(one, values=1 / one.values) for one in ratios]
        return explain(inverse, OF_EVAL)
    return explain(ratios, OF_WEIGHT) if guilty else _explain_neutrally(ratios)


# Colours that may be exchanged, by the order of channels that takes it back.
COLOURS = {
    "red and blue": [2, 1, 0],
    "red and green": [1, 0, 2],
    "green and blue": [0, 2, 1],
}


def _exchanged_colours(ratios: Sequence[Ratio]) -> str:
    """Names of two colours that weights and ``eval`` exchange; empty if none."""
    samples, ok = ratios[0].samples, ratios[0].mask

    def differ(order: list[int]) -> bool:
        value, slack = samples.eval[:, order], samples.eval_slack[:, order]
        return beyond_rounding(unequal(samples.flux_by_pdf, value, slack) & ok)

    if samples.eval.shape[1] != 3 or not differ([0, 1, 2]):
        return ""
    return next((words for words, one in COLOURS.items() if not differ(one)), "")


def _by_energy(evidence: Evidence) -> Function | None:
    """Whichever of both gains light; None if neither or both do."""
    whole = [m for m in evidence.maps if m.condition.component is None]
    whole = [m for m in whole if m.condition.mode == "importance"]
    flux = max((m.smooth_flux.max() for m in whole), default=0.0)
    mean = max((m.totals.mean.max() for m in whole), default=0.0)
    discrete = max((m.totals.delta_mean.max() for m in whole), default=0.0)
    if flux + discrete > 1.001 > mean:
        return EVAL
    return SAMPLE if mean > 1.001 > flux + discrete else None


def _by_reciprocity(bsdf: mi.BSDF, ratios: Sequence[Ratio]) -> Function | None:
    """Whichever of both is not reciprocal while the other is; None if none is.

    Not for plugins that declare NonSymmetric, whose right function may be the one that
    is not reciprocal.

    Weights are known only for samples. So light is sent back along some samples, and
    the directions that come near to the incident one are compared.
    """
    usable = [
        one
        for one in ratios
        if one.samples.condition.mode == "importance"
        if not isinstance(one.samples.condition, Sweep)
    ]
    # neither steep nor grazing, where all is symmetric or nothing is met
    usable.sort(key=lambda one: abs(one.samples.condition.theta_i - 45))
    pairs: list[tuple[float, float, float]] = []
    for ratio in usable[:4]:
        own, index = ratio.samples, np.flatnonzero(ratio.mask)
        # of sums over channels, as those of the way back
        logs = np.log(own.flux_by_pdf[index].sum(axis=1) / own.eval[index].sum(axis=1))
        wrong = own.reflected[index] & (np.abs(logs) > MAX_LOG_SAME)
        for k in np.flatnonzero(wrong)[:N_PAIRS]:
            back = _way_back(bsdf, own, int(index[k]))
            if back is not None:
                of_eval, log_ratio, unsure = back
                pairs.append((of_eval, of_eval + float(logs[k]) - log_ratio, unsure))
        if len(pairs) >= N_PAIRS:
            break
    if len(pairs) < N_PAIRS // 2:
        return None
    by_eval, by_weights, slack = np.abs(np.array(pairs)).T
    either = (SAMPLE, by_eval, by_weights), (EVAL, by_weights, by_eval)
    for guilty, right, wrong in either:
        same = np.mean(right < MAX_LOG_SAME + slack)
        other = np.mean(wrong > MIN_LOG_OTHER + slack)
        if same > MIN_SAME and other > MIN_OTHER:
            return guilty
    return None


def _way_back(
    bsdf: mi.BSDF, samples: Samples, k: int
) -> tuple[float, float, float] | None:
    """Logarithms for a sample: f there over f back, the ratio of weights back, slack.

    That ratio is a linear function of the direction near by; what is left is slack.
    """
    wi, wo = samples.condition.wi, samples.wo[k]
    there = samples.eval[k].sum() / abs(wo[2])
    back = samples.reverse[k].sum() / abs(wi[2])
    if not (there > 0 and back > 0 and abs(wo[2]) > 0.1):
        return None
    probe = Probe(bsdf, samples.condition.lit_from(wo))
    bs, sampled = probe.sample(*uniform(N_BACK, (k, 61)))
    towards, weight = spectral(bs.wo, N_BACK), spectral(sampled, N_BACK).sum(axis=1)
    value = probe.values(towards).sum(axis=1)
    over = weight * probe.densities(towards)
    near = (towards @ wi > MIN_COSINE) & ~numbers(is_delta(bs), N_BACK)
    near &= (value > 0) & (over > 0)
    if np.count_nonzero(near) < MIN_NEARBY:
        return None
    logs = np.log(over[near] / value[near])
    off = np.column_stack([np.ones(len(logs)), (towards[near] - wi)[:, :2]])
    plane = np.linalg.lstsq(off, logs, rcond=None)[0]
    slack = 2 * np.sqrt(np.mean((logs - off @ plane) ** 2))
    return float(np.log(there / back)), float(plane[0]), float(slack)


def _is_of_lobe_alone(evidence: Evidence) -> bool:
    """Whether each weight is that of the picked component as if it were alone."""
    n, samples = evidence.bsdf.component_count(), evidence.samples[0]
    if n < 2 or samples.condition.component is not None:
        return False
    ratios = []
    for i in range(n):
        own = samples.smooth & (samples.component == i)
        if own.any():
            probe = Probe(evidence.bsdf, replace(samples.condition, component=i))
            value = probe.values(samples.wo)[own].sum(axis=1)
            over = samples.weight[own].sum(axis=1) * probe.densities(samples.wo)[own]
            ratios.append(over / np.maximum(value, 1e-30))
    if len(ratios) < 2:
        return False
    low, high = np.quantile(np.concatenate(ratios), [0.02, 0.98])
    return low > 0.998 and high < 1.002
