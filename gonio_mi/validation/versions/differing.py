"""Two versions of Mitsuba compared: what differs, and by how many errors."""

from __future__ import annotations

import math
import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from os import PathLike
from typing import Any

import mitsuba as mi
import numpy as np
from scipy import special

from ...array_types import Flags, Floats
from ...errors import checked_count, checked_number
from ...instrument.specimen_text import SpecimenLike, specimen_name
from ...single_precision import BSDF_ROUNDING
from ...transport.variants import check_variant
from ..samples import SLACK, ULPS, is_many
from .asking import Answers, Question, ask, interpreter


@dataclass(frozen=True)
class Difference:
    """One function, as two versions have it.

    Attributes
    ----------
    function : str
        ``eval``, ``pdf``, ``sample``, ``weights``, ``albedo``, ``flags`` or
        ``parameters``.
    differs : bool
        By more than errors explain.
    size : float
        In units of the error: for ``eval``, ``pdf`` and ``weights`` the most that
        rounding may leave, for ``albedo`` standard errors; 0 without a number.
    text : str
        By how much, and where.
    meaning : str
        What it does to images and scenes, if it differs.
    """

    function: str
    differs: bool
    size: float
    text: str
    meaning: str

    def __str__(self) -> str:
        word = "differs" if self.differs else "same"
        line = f"{word:<9}{self.function:<11} {self.text}"
        if self.differs:
            line += f"\n{'':<21}{self.meaning}"
        return line


@dataclass(frozen=True)
class Differences:
    """What two versions of Mitsuba say of one BSDF.

    Attributes
    ----------
    name : str
        Of the BSDF.
    versions : tuple of str
        Of Mitsuba: here, and there.
    parts : tuple of Difference
    """

    name: str
    versions: tuple[str, str]
    parts: tuple[Difference, ...]

    @property
    def same(self) -> bool:
        """Whether nothing differs."""
        return not any(part.differs for part in self.parts)

    def __getitem__(self, function: str) -> Difference:
        return {part.function: part for part in self.parts}[function]

    def __str__(self) -> str:
        found = [part.function for part in self.parts if part.differs]
        said = f"differs in {', '.join(found)}" if found else "the same"
        title = f"{self.name}: Mitsuba {' and '.join(self.versions)}: {said}"
        parts = "\n".join(map(str, self.parts))
        return f"{title}\n{textwrap.indent(parts, '  ')}"

    def to_dict(self) -> dict[str, Any]:
        """For JSON: name, versions, ``same``, and the parts with their attributes.

        A size is None where one version has no finite number.
        """
        return {
            "name": self.name,
            "versions": list(self.versions),
            "same": self.same,
            "parts": [
                asdict(part)
                | {
                    "size": part.size if math.isfinite(part.size) else None,
                    "meaning": part.meaning if part.differs else None,
                }
                for part in self.parts
            ],
        }


# Polar angles of incidence in degrees and transport modes, on either side.
VIEWS = (
    *((theta, "Importance") for theta in (0.0, 40.0, 80.0)),
    (40.0, "Radiance"),
)

# Directions nearer than that are the same sample, for rounding may tilt a facet.
SAME = 2.0**-10

# A value below that has no use as a denominator.
SMALLEST = 1e-30


def diff(
    specimen: SpecimenLike,
    against: str | PathLike[str],
    *,
    parameters: Mapping[str, Any] | None = None,
    plugins: Sequence[str] = (),
    seed: int = 0,
    alpha: float = 1e-3,
) -> Differences:
    """Compare what two installed versions of Mitsuba say of a BSDF.

    Both are asked, each in a process of its own, about the same directions and with the
    same random numbers, in the variant that is set here. Own plugins are loaded by both
    from their files; those of this package are not known there.

    Parameters
    ----------
    specimen : dict, str or path
        A dictionary of a BSDF, or a scene file with one shape, whose BSDF is meant.
    against : str or path
        The other virtual environment, or its Python. It needs Mitsuba and NumPy.
    parameters : dict, optional
        Values for the ``$name`` parameters of the scene file.
    plugins : sequence of str
        Python files that register plugins.
    seed : int
        Of the random numbers.
    alpha : float
        Probability that equal albedos are said to differ.

    Returns
    -------
    Differences

    Raises
    ------
    SettingError
        If `against` is no environment that can run, or has no Mitsuba.
    SpecimenError
        If one of the two cannot load the BSDF.
    """
    check_variant()
    seed = checked_count("seed", seed, 0)
    alpha = checked_number("alpha", alpha, 1e-12, 1, "a probability in [1e-12, 1)")
    question = asked_of(specimen, parameters, plugins, seed)
    there = interpreter(against)
    own = ask(sys.executable, question)
    wo = {name: x for name, x in own.arrays.items() if name.startswith("wo.")}
    other = ask(there, question, wo)
    name = specimen_name(specimen, dict(question.parameters))
    return alike(name, question.conditions, own, other, alpha)


def asked_of(
    specimen: SpecimenLike,
    parameters: Mapping[str, Any] | None,
    plugins: Sequence[str],
    seed: int,
) -> Question:
    """Question about a BSDF, in the variant that is set."""
    conditions = tuple(
        (theta, side, mode) for side in ("front", "back") for theta, mode in VIEWS
    )
    return Question(
        specimen, parameters or {}, mi.variant(), tuple(plugins), conditions, seed
    )


def alike(
    name: str,
    conditions: Sequence[tuple[float, str, str]],
    own: Answers,
    other: Answers,
    alpha: float,
) -> Differences:
    """Differences of answers that were given at the same directions."""
    versions = own.facts["mitsuba"], other.facts["mitsuba"]
    return Differences(name, versions, tuple(_parts(conditions, own, other, alpha)))


def _parts(
    conditions: Sequence[tuple[float, str, str]],
    own: Answers,
    other: Answers,
    alpha: float,
) -> Iterator[Difference]:
    places = [
        f"theta_i {theta:g}, {side}, {mode.lower()} mode"
        for theta, side, mode in conditions
    ]
    pairs = [(own.at(i), other.at(i)) for i in range(len(conditions))]
    means = "images change where this light is seen"
    yield _values("eval", means, places, pairs)
    means = "weights of combined sampling change; images do not, if `sample` fits it"
    yield _values("pdf", means, places, pairs)
    yield _sample(places, pairs)
    yield _weights(places, pairs)
    yield _albedo(places, pairs, alpha)
    yield _flags(own.facts, other.facts)
    yield _parameters(own.facts, other.facts)


def _sizes(a: Floats, b: Floats, slack: Floats | float) -> Floats:
    """Differences in units of what rounding may leave; 0 where both are NaN."""
    unit = BSDF_ROUNDING * np.fmax(np.abs(a), np.abs(b)) + SLACK * slack
    off = np.abs(a - b)
    size = np.where(off > 0, off / np.maximum(unit, SMALLEST), 0.0)
    size = np.where(np.isfinite(a) & np.isfinite(b), size, np.inf)
    size = np.where(np.isnan(a) & np.isnan(b), 0.0, size)
    return size if size.ndim == 1 else size.max(axis=1)


def _worst(
    function: str,
    means: str,
    places: Sequence[str],
    sizes: Sequence[Floats],
    examples: Sequence[tuple[Floats, Floats]],
    what: str,
) -> Difference:
    """Difference at the place where most values differ, if any do beyond rounding."""
    shares = [float((size > 1).mean()) if len(size) else 0.0 for size in sizes]
    many = [is_many(size > 1) for size in sizes]
    if not any(many):
        most = max((float(np.quantile(s, 0.999)) for s in sizes if len(s)), default=0.0)
        text = f"to rounding: up to {most:.2g} of what it may leave"
        return Difference(function, False, most, text, means)
    i = int(np.argmax(shares))
    k = _most_seen(sizes[i], *examples[i])
    a, b = (np.ravel(x[k]).mean() for x in examples[i])
    size = float(sizes[i][np.argmax(np.where(np.isfinite(sizes[i]), sizes[i], -1))])
    text = (
        f"{what}{a:.5g} and {b:.5g}; by up to {size:.3g} times what rounding leaves, "
        f"{shares[i]:.2g} of all at {places[i]}"
    )
    if sum(many) > 1:
        text += f", and at {sum(many) - 1} more views"
    return Difference(function, True, size, text, means)


def _most_seen(sizes: Floats, a: Floats, b: Floats) -> int:
    """Index of finite values beyond rounding that are furthest apart.

    Large relative differences in the tails of a lobe are of no interest.
    """
    seen = np.isfinite(sizes) & (sizes > 1)
    if not seen.any():
        return int(np.argmax(sizes))
    with np.errstate(invalid="ignore"):
        apart = np.abs(a - b).reshape(len(sizes), -1).max(axis=1)
    return int(np.argmax(np.where(seen, apart, -1)))


def _values(
    function: str, means: str, places: Sequence[str], pairs: Sequence[tuple[Any, Any]]
) -> Difference:
    """``eval`` or ``pdf`` at the same directions."""
    sizes, examples = [], []
    for a, b in pairs:
        slack = np.fmax(a[f"{function}_slack"], b[f"{function}_slack"])
        sizes.append(_sizes(a[function], b[function], np.nan_to_num(slack)))
        examples.append((a[function], b[function]))
    return _worst(function, means, places, sizes, examples, "up to ")


def _given(a: Mapping[str, Any], b: Mapping[str, Any]) -> tuple[Flags, Flags]:
    """Masks of samples that did not fail, in either version."""
    first, second = ((x["weight"] != 0).any(axis=1) for x in (a, b))
    return first, second


def _moved(a: Mapping[str, Any], b: Mapping[str, Any]) -> Flags:
    """Mask of samples that change direction or type, or fail in one version only."""
    first, second = _given(a, b)
    off = np.abs(a["direction"] - b["direction"]).max(axis=1) > SAME
    return (first != second) | (first & second & (off | (a["type"] != b["type"])))


def _sample(places: Sequence[str], pairs: Sequence[tuple[Any, Any]]) -> Difference:
    """Directions for the same random numbers."""
    moved = [_moved(a, b) for a, b in pairs]
    shares = [float(one.mean()) for one in moved]
    i = int(np.argmax(shares))
    if not any(is_many(one) for one in moved):
        text = "the same directions for the same numbers"
        return Difference("sample", False, 0.0, text, "")
    share = f"{shares[i]:.2g} of the same random numbers"
    text = f"other directions for {share} at {places[i]}"
    means = "noise changes; images do not, if the light is the same"
    return Difference("sample", True, 0.0, text, means)


def _weights(places: Sequence[str], pairs: Sequence[tuple[Any, Any]]) -> Difference:
    """Weights and densities of samples that have the same direction.

    Only where all functions were asked about that direction, so that their slack for
    rounding is known.
    """
    sizes, examples = [], []
    for a, b in pairs:
        index = a["index"].astype(int)
        start = len(a["wo"]) - len(index)  # after the lattice
        slacks = [a[f"{name}_slack"][start:] for name in ("pdf", "eval")]
        values = [np.abs(a[name][start:]) for name in ("pdf", "eval")]
        tilt = np.abs(a["direction"] - b["direction"])[index].max(axis=1, initial=0)
        both = np.logical_and(*_given(a, b)) & ~_moved(a, b)
        both = both[index] & (tilt <= SLACK * ULPS)
        own, other = (
            {name: x[name][index][both] for name in ("weight", "sampled_pdf")}
            for x in (a, b)
        )
        # a weight is badly conditioned where a density or a value is
        relative = (slacks[0] / np.fmax(values[0], SMALLEST))[:, None]
        relative = relative + slacks[1] / np.fmax(values[1], SMALLEST)
        weight = _sizes(
            own["weight"], other["weight"], relative[both] * np.abs(own["weight"])
        )
        density = _sizes(own["sampled_pdf"], other["sampled_pdf"], slacks[0][both])
        name = "weight" if weight.sum() >= density.sum() else "sampled_pdf"
        sizes.append(np.fmax(weight, density))
        examples.append((own[name], other[name]))
    means = "images change, unless `pdf` changed with them"
    what = "of the same sample up to "
    return _worst("weights", means, places, sizes, examples, what)


def _albedo(
    places: Sequence[str], pairs: Sequence[tuple[Any, Any]], alpha: float
) -> Difference:
    """Means of weights, with the standard error of their difference."""
    scores, texts = [], []
    for a, b in pairs:
        x, y = (np.nan_to_num(one["weight"].mean(axis=1)) for one in (a, b))
        n, off = len(x), x - y
        rounding = BSDF_ROUNDING * max(x.mean(), y.mean())
        error = np.hypot(off.std() / np.sqrt(n), rounding)
        scores.append(off.mean() / error if error > 0 else 0.0)
        errors = [one.std() / np.sqrt(n) for one in (x, y)]
        texts.append(
            f"{x.mean():.5g} +- {errors[0]:.1g} and {y.mean():.5g} +- {errors[1]:.1g}"
        )
    i = int(np.argmax(np.abs(scores)))
    level = alpha / len(scores)
    differs = bool(2 * special.ndtr(-abs(scores[i])) < level)
    text = f"{texts[i]} at {places[i]}: {scores[i]:+.2g} standard errors"
    means = "images change: more or less light is scattered"
    return Difference("albedo", differs, float(abs(scores[i])), text, means)


def _flags(a: Mapping[str, Any], b: Mapping[str, Any]) -> Difference:
    """Flags of the whole, and of each component."""
    said = [f"{one['flags']:#x}, {len(one['components'])} components" for one in (a, b)]
    keys = ("flags", "components")
    if all(a[key] == b[key] for key in keys):
        return Difference("flags", False, 0.0, said[0], "")
    text = f"{said[0]} and {said[1]}"
    return Difference("flags", True, 0.0, text, "integrators treat it otherwise")


def _parameters(a: Mapping[str, Any], b: Mapping[str, Any]) -> Difference:
    """Names that ``traverse`` shows, and their values."""
    first, second = a["parameters"], b["parameters"]
    words = []
    for names, version in (
        (sorted(first.keys() - second.keys()), a["mitsuba"]),
        (sorted(second.keys() - first.keys()), b["mitsuba"]),
    ):
        if names:
            words.append(f"{', '.join(names)} in {version} only")
    changed = [
        name
        for name in first.keys() & second.keys()
        if not _equal(first[name], second[name])
    ]
    if changed:
        words.append(f"other values of {', '.join(sorted(changed))}")
    text = "; ".join(words) or f"{len(first)} of the same names and values"
    means = "scenes and scripts that name them, or rely on defaults"
    return Difference("parameters", bool(words), 0.0, text, means)


def _equal(x: Sequence[float] | None, y: Sequence[float] | None) -> bool:
    if x is None or y is None:
        return x is y
    return len(x) == len(y) and bool(np.allclose(x, y, rtol=BSDF_ROUNDING, atol=0))
