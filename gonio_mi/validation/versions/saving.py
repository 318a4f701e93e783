"""Answers of one version of Mitsuba in a file; two such files compared.

A file is JSON: a list with an entry for each BSDF, whose arrays are an ``.npz`` in
base64. So the versions need not be installed at the same time or on one machine.
"""

from __future__ import annotations

import base64
import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

import numpy as np

from ...errors import FileFormatError, SettingError, checked_number
from ...files.writing import replacing
from ...instrument.specimen_text import SpecimenLike, specimen_name
from ...transport.variants import check_variant
from ..samples import SLACK, ULPS
from .asking import Answers, ask, interpreter
from .differing import Differences, alike, asked_of

FORMAT = "gonio-mi answers of a BSDF, 1"

# Samples of each view that are kept; values are known at half of them.
SAMPLES = 2**13

# What is known at the directions of the lattice, and at those of samples.
ROWS = ("eval", "pdf", "eval_slack", "pdf_slack", "wo")


def saved(
    specimen: SpecimenLike,
    python: str | PathLike[str],
    *,
    name: str | None = None,
    parameters: Mapping[str, Any] | None = None,
    plugins: Sequence[str] = (),
    seed: int = 0,
) -> dict[str, Any]:
    """What the Mitsuba of a virtual environment says of a BSDF, for JSON.

    Parameters as of :func:`~gonio_mi.validation.versions.diff`; `name` is what the
    entry is called.
    """
    check_variant()
    question = asked_of(specimen, parameters, plugins, seed)
    answers = ask(interpreter(python), question)
    content = io.BytesIO()
    small: dict[str, Any] = {}
    for key, x in answers.arrays.items():
        what = key.partition(".")[0]
        kept = x if what in (*ROWS, "index") else x[:SAMPLES]
        # single precision is what was answered
        small[key] = kept.astype(np.int32 if what in ("index", "type") else np.float32)
    np.savez_compressed(content, allow_pickle=False, **small)
    return {
        "format": FORMAT,
        "name": name or specimen_name(specimen, dict(question.parameters)),
        # what must be the same in two files
        "asked": {
            "variant": question.variant,
            "seed": question.seed,
            "conditions": [list(one) for one in question.conditions],
        },
        "facts": answers.facts,
        "arrays": base64.b64encode(content.getvalue()).decode(),
    }


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
    found = []
    for name, (asked, mine) in own.items():
        also, others = other[name]
        if asked != also:
            key = next(key for key in asked if asked[key] != also.get(key))
            raise SettingError(
                f"both files must ask {name} with the same {key}, got {asked[key]} and "
                f"{also.get(key)}"
            )
        places = [tuple(one) for one in asked["conditions"]]
        found.append(alike(name, places, *_aligned(mine, others), alpha))
    return found


def _read(path: str | PathLike[str]) -> dict[str, tuple[dict[str, Any], Answers]]:
    """Question and answers by name of the BSDF."""
    try:
        with open(path, "rb") as file:
            entries = json.load(file)
        if not entries:
            raise ValueError
        found = {}
        for entry in entries:
            if entry["format"] != FORMAT:
                raise ValueError
            content = io.BytesIO(base64.b64decode(entry["arrays"], validate=True))
            with np.load(content, allow_pickle=False) as arrays:
                answers = Answers(entry["facts"], dict(arrays))
            found[str(entry["name"])] = (dict(entry["asked"]), answers)
    except OSError as error:
        raise FileFormatError(f"{path} cannot be read: {error.strerror}") from None
    except (ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile):
        raise FileFormatError(
            f"{path} holds no answers of `gonio-mi diff --save`"
        ) from None
    return found


def _aligned(own: Answers, other: Answers) -> tuple[Answers, Answers]:
    """Both answers, at the directions that they have in common."""
    n = sum(name.startswith("wo.") for name in own.arrays)
    first, second = dict(own.arrays), dict(other.arrays)
    for i in range(n):
        rows, index = _common(own.at(i), other.at(i))
        for arrays, kept in zip((first, second), rows):
            for name in ROWS:
                arrays[f"{name}.{i}"] = arrays[f"{name}.{i}"][kept]
            arrays[f"index.{i}"] = index
    return Answers(own.facts, first), Answers(other.facts, second)


def _common(a: Mapping[str, Any], b: Mapping[str, Any]) -> tuple[list[Any], Any]:
    """Rows of the common directions in either, and numbers of their samples."""
    starts = [len(x["wo"]) - len(x["index"]) for x in (a, b)]
    index, *places = np.intersect1d(
        a["index"], b["index"], assume_unique=True, return_indices=True
    )
    at = [start + place for start, place in zip(starts, places)]
    off = np.abs(a["wo"][at[0]] - b["wo"][at[1]]).max(axis=1, initial=0)
    same = off <= SLACK * ULPS
    lattice = np.arange(min(starts))
    return [np.concatenate([lattice, x[same]]) for x in at], index[same]
