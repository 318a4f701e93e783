"""The conformance table: stock plugins under installed versions, by plain scripts.

Each property is asked by the script that :mod:`gonio_mi.validation.reproducer` writes
for a failure of it, so that what is red comes with its reproducer. The other version's
environment needs nothing but Mitsuba and NumPy.
"""

from __future__ import annotations

import html
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any

import mitsuba as mi
import numpy as np

from ..reports.page import preformatted, save_page
from ..validation.evidence import PHASE, PROPERTIES
from ..validation.reproducer import ANYWHERE, script, source_of
from ..validation.verdict import FAILS, Property, Verdict
from .asking import answer_of

# What is asked: property, angle of incidence, function, and which of its answers.
QUESTIONS = (
    ("answers", 60, "eval", "value"),
    ("answers", 60, "sample", "weight"),
    *(("sampling", theta_i, "pdf", "") for theta_i in (20, 60, 80)),
    *(("weights", theta_i, "sample", "") for theta_i in (20, 60)),
    ("sampled_pdf", 60, "sample", ""),
    ("sampled_weight", 60, "sample", ""),
    ("reciprocity", 50, "eval", ""),
    ("adjoint", 50, "eval", ""),
    ("components", 50, "eval", ""),
    ("flags", 50, "flags", ""),
    ("masks", 50, "sample", ""),
    ("ends", 50, "sample", "weight"),
)

# What is asked of surfaces only: no phase function of Mitsuba heeds a mask, and
# microflakes are reciprocal with their projected area.
OF_SURFACES = ("components", "flags", "masks", "reciprocity")

# Not asked of these, which are known for it: shading normals are not reciprocal.
TILTED = ("bumpmap", "normalmap")

# From how many standard errors, or roundings of a thousand operations, on two numbers
# are not equal: twice, with independent random numbers.
LIMITS = {"standard errors": 8.0, "roundings": 100.0}


@dataclass(frozen=True)
class Answer:
    """What one script says under one version.

    Attributes
    ----------
    case, name, variant, version : str
        Plugin in one word, property, and where it was asked.
    text : str
        Last line of the script; of an exception its type and message.
    wrong : bool
        Whether it is beyond `LIMITS`, twice.
    script : str
    """

    case: str
    name: str
    variant: str
    version: str
    text: str
    wrong: bool
    script: str


def bsdfs() -> Iterator[list[dict[str, Any]]]:
    """Mitsuba's own BSDFs, with three sets of parameters each where there are as many.

    Not `measured` and `measured_polarized`, which need files. Those of polarised light
    alone are there where the variant is polarised.
    """
    ggx = {"distribution": "ggx"}
    checkers: Any = {"type": "checkerboard", "color0": 0.2, "color1": 0.7}
    sets: dict[str, list[dict[str, Any]]] = {
        "diffuse": [{"reflectance": x} for x in (0.6, checkers, 1.0)],
        "conductor": [{"material": x} for x in ("none", "Al", "Au")],
        "roughconductor": [
            {"alpha": 0.1},
            {"alpha": 0.3} | ggx,
            {"alpha_u": 0.1, "alpha_v": 0.4} | ggx,
            {"alpha": 0.3, "sample_visible": False} | ggx,
        ],
        "dielectric": [{"int_ior": x} for x in (1.33, 1.5, 2.4)],
        "thindielectric": [{"int_ior": x} for x in (1.33, 1.5, 2.4)],
        "roughdielectric": [
            {"alpha": 0.3},
            {"alpha": 0.2} | ggx,
            {"alpha": 0.3, "sample_visible": False} | ggx,
        ],
        "plastic": [{}, {"nonlinear": True}, {"int_ior": 1.9}],
        "roughplastic": [{"alpha": 0.1}, {"alpha": 0.3} | ggx, {"alpha": 0.6}],
        "pplastic": [{"alpha": x} for x in (0.1, 0.3, 0.6)],
        "principled": [
            {},
            {"metallic": 1.0, "anisotropic": 0.8, "roughness": 0.3},
            {"clearcoat": 1.0, "sheen": 0.5, "flatness": 0.5},
            {"spec_trans": 0.7, "eta": 1.5, "roughness": 0.4},
        ],
        "principledthin": [
            {},
            {"spec_trans": 0.5, "diff_trans": 1.0, "roughness": 0.4},
            {"diff_trans": 2.0},
        ],
        "hair": [{"sigma_a": x} for x in (0.0, 0.2, 2.0)],
        "null": [{}],
    }
    sets |= _composed()
    if mi.is_polarized:
        sets |= {
            "polarizer": [{"theta": x} for x in (0.0, 20.0, 90.0)],
            "retarder": [{"theta": x} for x in (0.0, 20.0, 90.0)],
            "circular": [{}, {"left_handed": True}],
        }
    for name, ones in sets.items():
        yield [{"type": name} | one for one in ones]


def _composed() -> dict[str, list[dict[str, Any]]]:
    """Parameters of those that hold other BSDFs."""
    diffuse, glossy = {"type": "diffuse"}, {"type": "roughconductor", "alpha": 0.2}
    heights = np.linspace(0, 0.3, 16, dtype=np.float32).reshape(4, 4, 1)
    normals = np.tile(np.array([0.55, 0.5, 0.99], np.float32), (2, 2, 1))
    bumps, slopes = (
        {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": True}
        for values in (heights, normals)
    )
    nested = (diffuse, glossy, {"type": "plastic"})
    return {
        "mask": [{"opacity": x, "nested": diffuse} for x in (0.2, 0.5, 0.9)],
        "twosided": [
            {"nested": glossy},
            {"nested": {"type": "plastic"}},
            {"front": diffuse, "back": glossy},
        ],
        "blendbsdf": [
            {"weight": 0.3, "first": diffuse, "second": glossy},
            {"weight": 0.7, "first": diffuse, "second": {"type": "plastic"}},
            {"weight": 0.25, "first": diffuse, "second": {"type": "conductor"}},
        ],
        "bumpmap": [{"heights": bumps, "nested": one} for one in nested],
        "normalmap": [{"normalmap": slopes, "nested": one} for one in nested],
    }


def cases() -> Iterator[tuple[str, dict[str, Any]]]:
    """Name, as on the command line if it can, and dictionary of each BSDF."""
    for ones in bsdfs():
        for one in ones:
            nested = [x["type"] for x in one.values() if isinstance(x, dict)]
            plain = {k: x for k, x in one.items() if not isinstance(x, dict)}
            given = [f"{k}={x}" for k, x in plain.items() if k != "type"]
            text = ":".join([one["type"], *filter(None, [",".join(given)])])
            yield " of ".join([text, *filter(None, [" and ".join(nested)])]), one


def phase_functions() -> Iterator[list[dict[str, Any]]]:
    """Mitsuba's own phase functions, likewise."""
    lobes = [{"g": x} for x in (-0.5, 0.5, 0.9)]
    values = ("0.5, 1.0, 1.5", "1.0, 0.2, 1.0", "0.1, 0.1, 3.0")
    flakes = ((1, 1, 1, 0, 0, 0), (0.05, 1, 1, 0, 0, 0), (0.1, 1, 0.3, 0.1, 0, 0))
    first = {"type": "isotropic"}
    sets: dict[str, list[dict[str, Any]]] = {
        "isotropic": [{}],
        "hg": lobes,
        "rayleigh": [{}],
        "tabphase": [{"values": one} for one in values],
        "sggx": [
            {
                "S": {
                    "type": "gridvolume",
                    "filter_type": "nearest",
                    "grid": mi.VolumeGrid(
                        np.array(one, np.float32).reshape(1, 1, 1, 6)
                    ),
                }
            }
            for one in flakes
        ],
        "blendphase": [
            {"weight": x, "first": first, "second": {"type": "hg", "g": 0.6}}
            for x in (0.2, 0.5, 0.8)
        ],
    }
    for name, ones in sets.items():
        yield [{"type": name} | one for one in ones]


def questions(variant: str) -> Iterator[tuple[str, str, str]]:
    """Case, property and script of all that is asked in a variant."""
    for volumes, plugins in ((False, bsdfs()), (True, phase_functions())):
        known = PHASE if volumes else PROPERTIES
        for ones in plugins:
            for i, one in enumerate(ones):
                source = source_of(one, volumes=volumes)
                case = f"{one['type']}, parameters {i + 1}"
                for name, theta_i, function, about in QUESTIONS:
                    tilted = one["type"] in TILTED and name in (
                        "reciprocity",
                        "adjoint",
                    )
                    if name not in known or (volumes and name in OF_SURFACES) or tilted:
                        continue
                    place = replace(ANYWHERE, theta_i=theta_i)
                    found = Property(
                        name,
                        FAILS,
                        "",
                        function=function,
                        condition=place,
                        about=about,
                        of_volumes=volumes,
                    )
                    settings = {"variant": variant}
                    verdict = Verdict(case, (), None, None, settings, source=source)
                    yield case, f"{name} at {place}", script(verdict, found)


def ask_versions(pythons: Sequence[str], variants: Sequence[str]) -> list[Answer]:
    """Answers of each Python's Mitsuba to all questions, in each variant.

    Raises
    ------
    SettingError
        If one of them has no Mitsuba.
    SpecimenError
        If one of them ends its process.
    """
    answers = []
    for variant in variants:
        mi.set_variant(variant)
        asked = list(questions(variant))
        texts = [text for _, _, text in asked]
        for python in pythons:
            asked_all = {"scripts": texts, "limits": LIMITS}
            told, _ = answer_of(python, asked_all, {})
            answers += [
                Answer(case, name, variant, told["version"], line, wrong, text)
                for (case, name, text), (line, wrong) in zip(asked, told["answers"])
            ]
    return answers


def save_table(answers: Iterable[Answer], path: str | PathLike[str]) -> None:
    """Write a page: a row for each set of parameters, a column for each version."""
    answers = list(answers)
    columns = list(dict.fromkeys((one.version, one.variant) for one in answers))
    rows = list(dict.fromkeys(one.case for one in answers))
    head = "".join(f"<th>Mitsuba {v}<br><small>{w}</small></th>" for v, w in columns)
    lines = [f"<tr><th>plugin</th>{head}</tr>"]
    for case in rows:
        cells = "".join(
            _cell([a for a in answers if (a.case, a.version, a.variant) == (case, *c)])
            for c in columns
        )
        lines.append(f"<tr><td>{html.escape(case)}</td>{cells}</tr>")
    told = ", ".join(f"{limit:g} {unit}" for unit, limit in LIMITS.items())
    text = (
        "<p>Red: two numbers that should be equal are farther apart than "
        f"{told.replace(', ', ' or ')}, or counts that must be equal are not, with two "
        "independent sets of random numbers. A click shows the script, which needs "
        "Mitsuba and NumPy only. "
        "Grey: the version does not answer.</p>"
    )
    title = "Conformance of Mitsuba's own plugins"
    table = f"<div style='overflow-x: auto'><table>{''.join(lines)}</table></div>"
    save_page(path, title, [f"<h1>{title}</h1>", text, table])


def _cell(answers: Sequence[Answer]) -> str:
    """Cell of one plugin under one version: what is wrong, with its scripts."""
    wrong = [one for one in answers if one.wrong]
    failed = [one for one in answers if "raised" in one.text]
    if len(failed) == len(answers):
        return '<td style="background: #ddd">no answer</td>'
    if not wrong:
        text = f"{len(answers) - len(failed)} agree"
        text += f", {len(failed)} without an answer" if failed else ""
        return f'<td style="background: #cec">{text}</td>'
    folded = "".join(
        f"<details><summary>{html.escape(one.name)}: {html.escape(one.text)}</summary>"
        f"{preformatted(one.script)}</details>"
        for one in wrong
    )
    return f'<td style="background: #fbb">{folded}</td>'
