"""Two versions of Mitsuba compared: what differs, and by how many errors."""

import base64
import io
import json
import math
import sys
import textwrap
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from os import PathLike
from typing import Any, TypeAlias

import numpy as np
from scipy import special

from ...array_types import Flags, Floats
from ...errors import FileFormatError, SettingError, checked_count, checked_number
from ...files.writing import replacing
from ...single_precision import BSDF_ROUNDING
from ...specimen.specimen_text import SpecimenLike
from ..samples import SLACK, ULPS, beyond_rounding
from .asking import FORMAT, answers_about, interpreter


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
    """Differences between two versions of Mitsuba for one BSDF.

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


# Samples of each view; and those that are kept in a file, where values are known at
# half of them.
SAMPLES, KEPT = 2**16, 2**13

# What a difference does to images and scenes.
MEANINGS = {
    "eval": "images change where this light is seen",
    "pdf": "weights of combined sampling change; images do not, if `sample` fits it",
    "sample": "noise changes; images do not, if the light is the same",
    "weights": "images change, unless `pdf` changed with them",
    "albedo": "images change: more or less light is scattered",
    "flags": "integrators treat it otherwise",
    "parameters": "scenes and scripts that name them, or rely on defaults",
}

# Whether a function differs, its size in units of the error, and by how much and where.
Finding: TypeAlias = tuple[bool, float, str]

# Of one view: differences in units of what rounding may leave, and the values compared.
Sized: TypeAlias = tuple[Floats, Floats, Floats]

# What is known at the directions of the lattice, and at those of samples.
ROWS = ("eval", "pdf", "eval_slack", "pdf_slack", "wo")

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
    seed = checked_count("seed", seed, 0)
    alpha = checked_number("alpha", alpha, 1e-12, 1, "a probability in [1e-12, 1)")
    there = interpreter(against)
    asked: dict[str, Any] = {"parameters": parameters, "plugins": plugins, "seed": seed}
    own = answers_about(specimen, sys.executable, n=SAMPLES, **asked)
    arrays = decoded(own["arrays"])
    given = {k: x for k, x in arrays.items() if k.startswith(("wo.", "index."))}
    other = answers_about(specimen, there, n=SAMPLES, given=given, **asked)
    return _compared(own, other, alpha)


def saved(
    specimen: SpecimenLike,
    python: str | PathLike[str],
    *,
    name: str | None = None,
    **asked: Any,
) -> dict[str, Any]:
    """Answers about a BSDF from the Mitsuba of a virtual environment, for JSON.

    Parameters as of :func:`diff`; `name` is what the entry is called.
    """
    entry = answers_about(specimen, interpreter(python), n=KEPT, **asked)
    return entry | ({"name": name} if name else {})


def save_answers(
    path: str | PathLike[str], entries: Sequence[Mapping[str, Any]]
) -> None:
    """Write entries of :func:`saved` to a file."""
    with replacing(path) as file:
        file.write(json.dumps(list(entries), indent=1).encode())


def diff_saved(
    first: str | PathLike[str], second: str | PathLike[str], *, alpha: float = 1e-3
) -> list[Differences]:
    """Compare what two files of :func:`save_answers` say, BSDF by BSDF.

    Values are compared at the directions that both have: a lattice on the sphere, and
    the samples that are the same in both.

    Raises
    ------
    FileFormatError
        If a file is none of these.
    SettingError
        If they hold other BSDFs, or were asked otherwise.
    """
    alpha = checked_number("alpha", alpha, 1e-12, 1, "a probability in [1e-12, 1)")
    own, other = _read(first), _read(second)
    if own.keys() != other.keys():
        only = sorted(own.keys() ^ other.keys())
        raise SettingError(f"both files must hold the same BSDFs, got {only[0]} in one")
    return [_compared(entry, other[name], alpha) for name, entry in own.items()]


def _read(path: str | PathLike[str]) -> dict[str, dict[str, Any]]:
    """Entries of a file by name of the BSDF."""
    try:
        with open(path, "rb") as file:
            entries = {str(entry["name"]): entry for entry in json.load(file)}
        for entry in entries.values():
            decoded(entry["arrays"])
            dict(entry["asked"]), dict(entry["facts"])
        if {entry["format"] for entry in entries.values()} != {FORMAT}:
            raise ValueError
    except OSError as error:
        raise FileFormatError(f"{path} cannot be read: {error.strerror}") from None
    except (ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile):
        raise FileFormatError(
            f"{path} holds no answers of `gonio-mi diff --save`"
        ) from None
    return entries


def decoded(text: str) -> dict[str, Any]:
    """Arrays of :func:`.table.encoded`, in double precision or whole numbers."""
    content = io.BytesIO(base64.b64decode(text, validate=True))
    with np.load(content, allow_pickle=False) as arrays:
        kinds = {k: float if x.dtype.kind == "f" else int for k, x in arrays.items()}
        return {k: arrays[k].astype(kind) for k, kind in kinds.items()}


def _compared(
    own: Mapping[str, Any], other: Mapping[str, Any], alpha: float
) -> Differences:
    """Differences of two versions' answers, at the directions that both have."""
    name, asked = own["name"], own["asked"]
    for key, value in asked.items():
        if value != other["asked"].get(key):
            raise SettingError(
                f"both files must ask {name} with the same {key}, got {value} and "
                f"{other['asked'].get(key)}"
            )
    facts, arrays = zip(*((x["facts"], decoded(x["arrays"])) for x in (own, other)))
    places, pairs = [], []
    for i, (theta, side, mode) in enumerate(asked["conditions"]):
        places.append(f"theta_i {theta:g}, {side}, {mode.lower()} mode")
        pair = [
            {key[: -len(f".{i}")]: x for key, x in one.items() if key.endswith(f".{i}")}
            for one in arrays
        ]
        pairs.append(_at_common_directions(*pair))
    found = {
        "eval": _worst(places, [_values("eval", *pair) for pair in pairs], ""),
        "pdf": _worst(places, [_values("pdf", *pair) for pair in pairs], ""),
        "sample": _sample(places, pairs),
        "weights": _worst(
            places, [_weights(*pair) for pair in pairs], "of the same sample "
        ),
        "albedo": _albedo(places, pairs, alpha),
        "flags": _flags(*facts),
        "parameters": _parameters(*facts),
    }
    parts = tuple(Difference(key, *x, MEANINGS[key]) for key, x in found.items())
    return Differences(name, (facts[0]["mitsuba"], facts[1]["mitsuba"]), parts)


def _at_common_directions(
    a: Mapping[str, Any], b: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Both answers, without the values at directions that only one of them has."""
    starts = [len(x["wo"]) - len(x["index"]) for x in (a, b)]
    index, *places = np.intersect1d(
        a["index"], b["index"], assume_unique=True, return_indices=True
    )
    at = [start + place for start, place in zip(starts, places)]
    off = np.abs(a["wo"][at[0]] - b["wo"][at[1]]).max(axis=1, initial=0)
    same = off <= SLACK * ULPS
    first, second = (
        {**x, "index": index[same]}
        | {name: x[name][np.r_[: min(starts), rows[same]]] for name in ROWS}
        for x, rows in zip((a, b), at)
    )
    return first, second


def _sizes(a: Floats, b: Floats, slack: Floats | float) -> Floats:
    """Differences in units of what rounding may leave; 0 where both are NaN."""
    unit = BSDF_ROUNDING * np.fmax(np.abs(a), np.abs(b)) + SLACK * slack
    off = np.abs(a - b)
    size = np.where(off > 0, off / np.maximum(unit, SMALLEST), 0.0)
    size = np.where(np.isfinite(a) & np.isfinite(b), size, np.inf)
    size = np.where(np.isnan(a) & np.isnan(b), 0.0, size)
    return size if size.ndim == 1 else size.max(axis=1)


def _worst(places: Sequence[str], views: Sequence[Sized], what: str) -> Finding:
    """Finding at the place where most values differ, if any do beyond rounding."""
    shares = [float((sizes > 1).mean()) if len(sizes) else 0.0 for sizes, *_ in views]
    n_many = sum(bool(beyond_rounding(sizes > 1)) for sizes, *_ in views)
    if not n_many:
        known = [float(np.quantile(sizes, 0.999)) for sizes, *_ in views if len(sizes)]
        most = max(known, default=0.0)
        return False, most, f"to rounding: up to {most:.2g} of what it may leave"
    i = int(np.argmax(shares))
    sizes, *values = views[i]
    # finite values that are furthest apart: large relative differences in the tails of
    # a lobe are of no interest
    seen = np.isfinite(sizes) & (sizes > 1)
    with np.errstate(invalid="ignore"):
        apart = np.abs(values[0] - values[1]).reshape(len(sizes), -1).max(axis=1)
    k = np.argmax(np.where(seen, apart, -1) if seen.any() else sizes)
    a, b = (np.ravel(x[k]).mean() for x in values)
    size = float(sizes[np.argmax(np.where(np.isfinite(sizes), sizes, -1))])
    text = (
        f"{what}up to {a:.5g} and {b:.5g}; by up to {size:.3g} times what rounding "
        f"leaves, {shares[i]:.2g} of all at {places[i]}"
    )
    return True, size, text + (n_many > 1) * f", and at {n_many - 1} more views"


def _values(function: str, a: Mapping[str, Any], b: Mapping[str, Any]) -> Sized:
    """``eval`` or ``pdf`` at the same directions."""
    slack = np.nan_to_num(np.fmax(a[f"{function}_slack"], b[f"{function}_slack"]))
    return _sizes(a[function], b[function], slack), a[function], b[function]


def _given(a: Mapping[str, Any], b: Mapping[str, Any]) -> tuple[Flags, Flags]:
    """Masks of samples that did not fail, in either version."""
    first, second = ((x["weight"] != 0).any(axis=1) for x in (a, b))
    return first, second


def _moved(a: Mapping[str, Any], b: Mapping[str, Any]) -> Flags:
    """Mask of samples that change direction or type, or fail in one version only."""
    first, second = _given(a, b)
    off = np.abs(a["direction"] - b["direction"]).max(axis=1) > SAME
    return (first != second) | (first & second & (off | (a["type"] != b["type"])))


def _sample(places: Sequence[str], pairs: Sequence[tuple[Any, Any]]) -> Finding:
    """Directions for the same random numbers."""
    moved = [_moved(a, b) for a, b in pairs]
    if not any(map(beyond_rounding, moved)):
        return False, 0.0, "the same directions for the same numbers"
    shares = [float(one.mean()) for one in moved]
    i = int(np.argmax(shares))
    share = f"{shares[i]:.2g} of the same random numbers"
    return True, 0.0, f"other directions for {share} at {places[i]}"


def _weights(a: Mapping[str, Any], b: Mapping[str, Any]) -> Sized:
    """Weights and densities of samples that have the same direction.

    Only where all functions were asked about that direction, so that their slack for
    rounding is known.
    """
    index = a["index"].astype(int)
    start = len(a["wo"]) - len(index)  # after the lattice
    slack, value_slack = (a[f"{name}_slack"][start:] for name in ("pdf", "eval"))
    density, value = (np.abs(a[name][start:]) for name in ("pdf", "eval"))
    tilt = np.abs(a["direction"] - b["direction"])[index].max(axis=1, initial=0)
    both = np.logical_and(*_given(a, b)) & ~_moved(a, b)
    both = both[index] & (tilt <= SLACK * ULPS)
    weights = [x["weight"][index][both] for x in (a, b)]
    densities = [x["sampled_pdf"][index][both] for x in (a, b)]
    # a weight is badly conditioned where a density or a value is
    relative = (slack / np.fmax(density, SMALLEST))[:, None]
    relative = relative + value_slack / np.fmax(value, SMALLEST)
    own, others = weights
    of_weights = _sizes(own, others, relative[both] * np.abs(own))
    of_densities = _sizes(densities[0], densities[1], slack[both])
    shown = weights if of_weights.sum() >= of_densities.sum() else densities
    return np.fmax(of_weights, of_densities), shown[0], shown[1]


def _albedo(
    places: Sequence[str], pairs: Sequence[tuple[Any, Any]], alpha: float
) -> Finding:
    """Means of weights, with the standard error of their difference."""
    scores, texts = [], []
    for pair in pairs:
        x, y = (np.nan_to_num(one["weight"].mean(axis=1)) for one in pair)
        root, off = np.sqrt(len(x)), x - y
        error = np.hypot(off.std() / root, BSDF_ROUNDING * max(x.mean(), y.mean()))
        scores.append(off.mean() / error if error > 0 else 0.0)
        texts.append(
            f"{x.mean():.5g} +- {x.std() / root:.1g} and "
            f"{y.mean():.5g} +- {y.std() / root:.1g}"
        )
    i = int(np.argmax(np.abs(scores)))
    differs = bool(2 * special.ndtr(-abs(scores[i])) < alpha / len(scores))
    text = f"{texts[i]} at {places[i]}: {scores[i]:+.2g} standard errors"
    return differs, float(abs(scores[i])), text


def _flags(a: Mapping[str, Any], b: Mapping[str, Any]) -> Finding:
    """Flags of the whole, and of each component."""
    said = [f"{one['flags']:#x}, {len(one['components'])} components" for one in (a, b)]
    differs = any(a[key] != b[key] for key in ("flags", "components"))
    return differs, 0.0, " and ".join(said) if differs else said[0]


def _parameters(a: Mapping[str, Any], b: Mapping[str, Any]) -> Finding:
    """Names that ``traverse`` shows, and their values."""
    first, second = a["parameters"], b["parameters"]
    words = [
        f"{', '.join(sorted(names))} in {version} only"
        for names, version in (
            (first.keys() - second.keys(), a["mitsuba"]),
            (second.keys() - first.keys(), b["mitsuba"]),
        )
        if names
    ]
    common = sorted(first.keys() & second.keys())
    changed = [name for name in common if not _equal(first[name], second[name])]
    if changed:
        words.append(f"other values of {', '.join(changed)}")
    same = f"{len(first)} of the same names and values"
    return bool(words), 0.0, "; ".join(words) or same


def _equal(x: Sequence[float] | None, y: Sequence[float] | None) -> bool:
    if x is None or y is None:
        return x is y
    return len(x) == len(y) and bool(np.allclose(x, y, rtol=BSDF_ROUNDING, atol=0))
