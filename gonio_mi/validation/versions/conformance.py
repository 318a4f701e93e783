"""The conformance table: stock plugins under installed versions, by plain scripts.

Each property is asked by a script of at most 40 lines, most of them those that
:mod:`gonio_mi.validation.reproducers` writes for a failure, so that what is red comes
with its reproducer. The other version's environment needs nothing but Mitsuba and
NumPy.
"""

import base64
import html
import math
import os
import re
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from os import PathLike
from pathlib import Path
from queue import SimpleQueue
from threading import Event
from typing import Any

import mitsuba as mi

from ...annexes import ask
from ...campaigns.measure import measure
from ...errors import SettingError, SpecimenError
from ...progress import bar
from ...reports.page import folded, preformatted, save_page, table
from ..arrays import of_eval, of_weight
from ..checks.gradients import weight_slopes
from ..judgements import most_apart
from ..mistakes import Claim
from ..questions import OF_SURFACES as SURFACES, OF_VOLUMES as VOLUMES
from ..reproducers import ANYWHERE, by_lattices, script, source_of
from ..verdict import FAILS, Property, Verdict
from .asking import answers_of
from .scalar_code import in_two_variants
from .stock import bsdfs, phase_functions, word_of

# What is asked: property, angle of incidence, function, and what of the property.
QUESTIONS: tuple[tuple[str, int, str, tuple[Any, ...]], ...] = (
    ("answers", 60, "eval", (of_eval,)),
    ("answers", 60, "sample", (of_weight,)),
    *(("sampling", theta_i, "pdf", ()) for theta_i in (20, 60, 80)),
    *(("weights", theta_i, "sample", ()) for theta_i in (20, 60)),
    ("sampled_pdf", 60, "sample", ()),
    ("sampled_weight", 60, "sample", ()),
    ("reciprocity", 50, "eval", ()),
    ("adjoint", 50, "eval", ()),
    ("components", 50, "eval", ()),
    ("flags", 50, "flags", ()),
    ("masks", 50, "sample", (of_weight,)),
    ("ends", 50, "sample", (of_weight,)),
    ("parameters", 50, "sample", ()),
)

# How it is shown where a plugin that holds has no finding to be shown.
CLAIMS = {"parameters": Claim(weight_slopes, most_apart)}

# What is asked of surfaces only: no phase function of Mitsuba obeys a mask or has
# discrete lobes, and microflakes are reciprocal with their projected area.
OF_SURFACES = ("components", "flags", "masks", "parameters", "reciprocity")

# Not asked for reciprocity: shading normals are not reciprocal, nor is a table of
# measurements between its few angles of incidence.
NOT_RECIPROCAL = ("bumpmap", "normalmap", "measured")

# From how many standard errors, or roundings of a thousand operations, on two numbers
# are not equal: twice, with independent random numbers.
LIMITS = {"standard errors": 8.0, "roundings": 100.0}

# Materials measured here, which are the files of `measured`.
MEASURED: tuple[dict[str, Any], ...] = (
    {"alpha": 0.3},
    {"alpha": 0.3, "distribution": "ggx"},
    {"alpha": 0.6},
)

STYLE = """<style>
td { border-left: 1px solid var(--line); min-width: 15em; font-size: .85em; }
tr > td:first-child { position: sticky; left: 0; background: white; }
.right { background: #cec; } .wrong { background: #fbb; } .silent { background: #ddd; }
summary { cursor: pointer; overflow-wrap: anywhere; } .wrong pre { max-width: 60em; }
</style>"""


@dataclass(frozen=True)
class Question:
    """One script and its question.

    Attributes
    ----------
    plugin : str
    number : int
        Of the set of parameters, from 1.
    word : str
        The plugin and its parameters.
    name : str
        Property, function and direction of incidence.
    script : str
    """

    plugin: str
    number: int
    word: str
    name: str
    script: str


@dataclass(frozen=True)
class Answer:
    """Output of one script under one version.

    Attributes
    ----------
    question : Question
    version, variant : str
        Where it was asked.
    text : str
        Last line of the script; of an exception its type and message.
    wrong : bool
        Whether it is beyond `LIMITS`, twice.
    """

    question: Question
    version: str
    variant: str
    text: str
    wrong: bool

    @property
    def raised(self) -> bool:
        """Whether the script ended in an exception."""
        return self.text.startswith("raised ")

    @property
    def distance(self) -> float:
        """Distance of its two numbers over the limit; infinite for unequal counts."""
        found = re.search(r": (\S+) (standard errors|roundings)$", self.text)
        return float(found[1]) / LIMITS[found[2]] if found else math.inf


def questions(variant: str) -> Iterator[Question]:
    """All that is asked in a variant, which must be set.

    Scalar variants are asked whether they answer as those of LLVM.
    """
    surfaces = [*bsdfs(), *([] if mi.is_monochromatic else [_measured()])]
    for volumes, plugins in ((False, surfaces), (True, phase_functions())):
        for one, k in ((one, k) for ones in plugins for k, one in enumerate(ones, 1)):
            word, source = word_of(one), str(source_of(one, volumes=volumes))
            if variant.startswith("scalar"):
                text = in_two_variants(variant, source, volumes)
                asked = [("scalar and LLVM code", text)]
            else:
                settings = {"variant": variant}
                verdict = Verdict(word, (), None, None, settings, source=source)
                asked = list(_of_properties(verdict, one["type"], volumes))
            for name, text in asked:
                yield Question(one["type"], k, word, name, text)


def _of_properties(
    verdict: Verdict, plugin: str, volumes: bool
) -> Iterator[tuple[str, str]]:
    """Names and scripts of all questions about one plugin."""
    asked = {one.name: one.shown for one in (VOLUMES if volumes else SURFACES)}
    left_out = {*OF_SURFACES} if volumes else set()
    left_out |= {"reciprocity", "adjoint"} if plugin in NOT_RECIPROCAL else set()
    left_out |= {"parameters"} if mi.is_polarized else set()  # of numbers, not matrices
    for name, theta_i, function, given in QUESTIONS:
        claim = CLAIMS.get(name, asked.get(name))
        if name in left_out or claim is None:
            continue
        found = Property(
            name,
            FAILS,
            "",
            function=function,
            condition=replace(ANYWHERE, theta_i=theta_i),
            shown=replace(claim, given=given or claim.given),
            of_volumes=volumes,
        )
        write = by_lattices if name in ("sampling", "weights") else script
        of = "" if name == function else f" of {function}"
        yield f"{name}{of} at theta_i {theta_i}", write(verdict, found)


def _measured() -> list[dict[str, Any]]:
    """Parameters of `measured`, of files that :func:`_materials` writes."""
    kind = "rgb" if mi.is_rgb else "spectral"
    names = [f"material_{kind}_{i + 1}.bsdf" for i in range(len(MEASURED))]
    return [{"type": "measured", "filename": name} for name in names]


def _materials() -> dict[str, str]:
    """Files of `measured` by name, as text of base 64: metals measured here."""
    files = {}
    with tempfile.TemporaryDirectory() as folder:
        of_colours: dict[str, Any] = {"wavelengths": [400.0, 500.0, 600.0, 700.0]}
        for variant, channels in (
            ("llvm_ad_rgb", dict[str, Any]()),
            ("llvm_ad_spectral", of_colours),
        ):
            mi.set_variant(variant)
            for metal, one in zip(MEASURED, _measured()):
                record = measure(
                    {"type": "roughconductor"} | metal,
                    theta_i=range(0, 90, 15),
                    collector="projected:10x20",
                    rays=2**16,
                    **channels,
                )
                path = Path(folder) / one["filename"]
                ask("exchange", "export")(record, path)
                files[path.name] = base64.b64encode(path.read_bytes()).decode()
    return files


def ask_versions(
    pythons: Sequence[str], variants: Sequence[str], progress: bool = False
) -> Iterator[Answer]:
    """Answers of each Python's Mitsuba to all questions, in each variant, as they come.

    As many environments are asked at once as there are cores.

    Raises
    ------
    SettingError
        If one of them has no Mitsuba.
    """
    files, asked = _materials(), {}
    for variant in variants:
        mi.set_variant(variant)
        asked[variant] = list(questions(variant))
    answers: SimpleQueue[Answer | Exception | None] = SimpleQueue()
    stopped = Event()

    def ask(variant: str, python: str) -> None:
        """Put the answers of one environment, then None, into the queue."""
        texts = [one.script for one in asked[variant]]
        told = answers_of(python, texts, limits=LIMITS, files=files)
        try:
            for one, (version, line, wrong) in zip(asked[variant], told):
                answers.put(Answer(one, version, variant, line, wrong))
                if stopped.is_set():
                    break
        except (SettingError, SpecimenError) as error:
            answers.put(error)
        finally:
            told.close()
            answers.put(None)

    left = len(pythons) * len(variants)
    total = len(pythons) * sum(map(len, asked.values()))
    with (
        bar(progress, total=total, desc="conformance", unit="question") as report,
        ThreadPoolExecutor(os.cpu_count()) as pool,
    ):
        for python, variant in product(pythons, variants):
            pool.submit(ask, variant, python)
        try:
            while left:
                one = answers.get()
                if isinstance(one, Exception):
                    raise one
                if one is None:
                    left -= 1
                    continue
                if report is not None:
                    report(1)
                yield one
        finally:
            stopped.set()
            pool.shutdown(wait=False, cancel_futures=True)


def save_table(answers: Iterable[Answer], path: str | PathLike[str]) -> None:
    """Write a page: a row for each plugin, a column for each version."""
    answers = list(answers)
    versions = list(dict.fromkeys(one.version for one in answers))
    plugins = list(dict.fromkeys(one.question.plugin for one in answers))
    variants = dict.fromkeys(one.variant for one in answers)
    wrong = sum(one.wrong for one in answers)
    told = " or ".join(f"{limit:g} {unit}" for unit, limit in LIMITS.items())
    title = "Conformance of Mitsuba's own plugins"
    text = (
        f"<p>{len(answers)} answers, {wrong} of them wrong, of the variants "
        f"{', '.join(variants)}.</p>"
        "<p><b>Red:</b> two numbers that should be equal are farther apart than "
        f"{told}, or counts that must be equal are not, with two independent sets of "
        "random numbers. Each line is a property, with the worst of its numbers, then "
        "the sets of parameters and the variants in which it is wrong. <b>A click on a "
        "line</b> shows all numbers and a script for the worst, which prints them: it "
        "needs Mitsuba of that version and NumPy, nothing else. One rounding is that "
        "of a thousand operations in single precision, 6.1e-5.</p>"
        "<p><b>Green:</b> all that answered agrees. <b>Grey:</b> most questions got no "
        "answer, but an error; some plugins exist in some variants only.</p>"
    )
    head = ["plugin, sets of parameters", *(f"Mitsuba {one}" for one in versions)]
    rows = [[f"<b>{one}</b>" for one in head]]
    for plugin in plugins:
        own = [one for one in answers if one.question.plugin == plugin]
        sets = dict.fromkeys((one.question.number, one.question.word) for one in own)
        named = "".join(f"<br>{k}: {html.escape(word)}" for k, word in sorted(sets))
        cells = [_cell([one for one in own if one.version == v]) for v in versions]
        rows.append([f"<b>{plugin}</b><small>{named}</small>", *cells])
    page = f"<div style='overflow-x: auto'>{table(rows)}</div>"
    save_page(path, title, [STYLE, f"<h1>{title}</h1>", text, page])


def _cell(answers: Sequence[Answer]) -> str:
    """Cell of one plugin under one version: what is wrong, with its scripts."""
    silent = [one for one in answers if one.raised]
    found: dict[str, list[Answer]] = {}
    for one in answers:
        if one.wrong:
            found.setdefault(one.question.name, []).append(one)
    n = len(answers) - len(silent) - sum(map(len, found.values()))
    parts = [f"{n} agree"] if n else []
    parts += [_finding(name, ones) for name, ones in found.items()]
    if silent:
        told = "\n".join(dict.fromkeys(f"{_where([x])}: {x.text}" for x in silent))
        parts.append(folded(f"{len(silent)} without an answer", preformatted(told)))
    kind = "wrong" if found else "right" if n > len(silent) else "silent"
    return f'<td class="{kind}">{"".join(f"<div>{part}</div>" for part in parts)}</td>'


def _finding(name: str, ones: Sequence[Answer]) -> str:
    """What is wrong with one property: the worst, where, and its script."""
    worst = max(ones, key=lambda one: one.distance)
    lines = "\n".join(f"{_where([one])}: {one.text}" for one in ones)
    heading = f"{name}: {worst.text} ({_where(ones)})"
    return folded(heading, preformatted(f"{lines}\n\n{worst.question.script}"))


def _where(ones: Sequence[Answer]) -> str:
    """Sets of parameters and variants of answers."""
    numbers = sorted({one.question.number for one in ones})
    variants = dict.fromkeys(one.variant.replace("llvm_ad_", "") for one in ones)
    sets = f"set{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"
    return f"{sets}; {', '.join(variants)}"
