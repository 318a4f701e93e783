"""Ask the Mitsuba of another environment about a BSDF, in a separate process."""

from __future__ import annotations

import json
import os
import re
import subprocess
import tempfile
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, TextIO

import mitsuba as mi
import numpy as np

from ...errors import SettingError, SpecimenError, shown
from ...instrument.specimen_text import with_real_indices
from ..checks.answers import lattice
from ..conditions import Condition
from ..samples import ULPS

WORKER = Path(__file__).with_name("worker.py")

# Samples of each incident direction.
SAMPLES = 2**16

# Displacements that tell how values answer to rounding.
STEPS = 3


@dataclass(frozen=True)
class Question:
    """A BSDF, and the conditions under which it is asked.

    Attributes
    ----------
    specimen : dict or str
        Of :func:`gonio_mi.measure`: a dictionary, or a scene file with one shape.
    parameters : dict
        Values for the ``$name`` parameters of the scene file.
    variant : str
    plugins : tuple of str
        Python files that register plugins.
    conditions : tuple of (float, str, str)
        Polar angle of incidence in degrees, ``front`` or ``back``, transport mode.
    seed : int
    """

    specimen: Any
    parameters: Mapping[str, Any]
    variant: str
    plugins: tuple[str, ...]
    conditions: tuple[tuple[float, str, str], ...]
    seed: int

    def to_json(self) -> dict[str, Any]:
        """Content of the worker's JSON file: all but arrays."""
        file = None if isinstance(self.specimen, dict) else str(self.specimen)
        return {
            "file": file,
            "specimen": None if file else _plain(with_real_indices(self.specimen)),
            "parameters": {key: str(x) for key, x in self.parameters.items()},
            "variant": self.variant,
            "plugins": [str(Path(path).resolve()) for path in self.plugins],
            "modes": [mode for _, _, mode in self.conditions],
        }

    def arrays(self) -> dict[str, Any]:
        """Directions, displacements and random numbers, the same for all versions."""
        rng = np.random.default_rng(self.seed)
        wi = [Condition(theta, 25.0, side).wi for theta, side, _ in self.conditions]
        return {
            "wi": np.array(wi),
            "lattice": lattice(),
            "steps": ULPS * rng.uniform(-1, 1, (STEPS, 3)),
            "u": rng.random((SAMPLES, 3), dtype=np.float32),
        }


@dataclass(frozen=True)
class Answers:
    """Answers of one version.

    Attributes
    ----------
    facts : dict
        Versions of Mitsuba and Dr.Jit, flags, components and parameters.
    arrays : dict of ndarray
        By name and number of the condition, such as ``eval.0``.
    """

    facts: dict[str, Any]
    arrays: dict[str, Any]

    def at(self, condition: int) -> dict[str, Any]:
        """Arrays of the condition of that number, by function."""
        parts = [(*name.split("."), array) for name, array in self.arrays.items()]
        return {name: array for name, i, array in parts if int(i) == condition}


def interpreter(venv: str | PathLike[str]) -> str:
    """Path of a virtual environment's Python; `venv` may be that Python itself.

    Raises
    ------
    SettingError
        If there is none.
    """
    path = Path(venv)
    for found in (path, path / "bin/python", path / "Scripts/python.exe"):
        if found.is_file() and os.access(found, os.X_OK):
            return str(found.absolute())
    raise SettingError(
        "against must be a virtual environment, or its Python, got "
        f"{shown(str(venv))}, which has no bin/python"
    )


def ask(
    python: str, question: Question, wo: Mapping[str, Any] | None = None
) -> Answers:
    """Answers of the Mitsuba that a Python finds.

    Parameters
    ----------
    python : str
    question : Question
    wo : dict of ndarray, optional
        Directions ``wo.0``, ``wo.1``, ... at which functions are asked, those of the
        :class:`Answers` of another version; its own samples by default.

    Raises
    ------
    SettingError
        If that Python cannot run, or has no Mitsuba.
    SpecimenError
        If its Mitsuba cannot load the BSDF, or ends the process.
    """
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        (here / "question.json").write_text(json.dumps(question.to_json()))
        np.savez(here / "question.npz", **question.arrays(), **(wo or {}))
        with _worker(python, folder) as worker:
            said = worker.communicate()
        try:
            facts = json.loads((here / "answer.json").read_text())
            with np.load(here / "answer.npz") as content:
                answers = dict(content)
        except (OSError, ValueError):
            facts = {"error": _last(*said, worker.returncode)}
    if "error" in facts:
        _check_modules(python, str(facts))
        raise SpecimenError(f"{python} gave no answer: {facts['error']}")
    return Answers(facts, answers)


def answers_of(
    python: str, scripts: Sequence[str], **others: Any
) -> Generator[tuple[str, str, bool], None, None]:
    """Version, last line, and whether it is wrong, for one script after the other.

    If a script ends the process, its line says so, and a new process runs the rest.

    Parameters
    ----------
    python : str
    scripts : sequence of str
    **others
        As of :func:`gonio_mi.validation.versions.worker.all_said`.

    Raises
    ------
    SettingError
        If that Python cannot run, or has no Mitsuba.
    """
    left = list(scripts)
    while left:
        with tempfile.TemporaryDirectory() as folder:
            question = json.dumps({"scripts": left, **others})
            (Path(folder) / "question.json").write_text(question)
            with (
                open(Path(folder) / "errors", "w+") as errors,
                _worker(python, folder, stderr=errors) as worker,
            ):
                try:
                    lines = map(json.loads, worker.stdout or ())
                    version = str(next(lines, ""))
                    for line, wrong in lines:
                        yield version, line, wrong
                        del left[0]
                finally:
                    worker.kill()
                errors.seek(0)
                said = errors.read()
        if not version:
            _check_modules(python, said)
            raise SpecimenError(f"{python} gave no answer: {_last(said, '', 1)}")
        if left:
            yield version, "raised an error that ended the process", False
            del left[0]


def _worker(
    python: str, folder: str, stderr: int | TextIO = subprocess.PIPE
) -> subprocess.Popen[str]:
    """The worker in another environment, which must not see the modules of this one."""
    hidden = ("PYTHONPATH", "PYTHONHOME")
    environment = {k: v for k, v in os.environ.items() if k not in hidden}
    command = [python, "-I", str(WORKER), folder]
    try:
        return subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=stderr, text=True, env=environment
        )
    except OSError as error:
        raise SettingError(f"{python} cannot be run: {error.strerror}") from None


def _check_modules(python: str, said: str) -> None:
    """Raise SettingError if the output says that a needed module is missing."""
    missing = re.search(r"No module named '(mitsuba|drjit|numpy)", said)
    if missing:
        raise SettingError(
            f"{python} has no {missing[1]}: run {python} -m pip install mitsuba numpy"
        )


def _last(out: str, err: str, code: int) -> str:
    """Last line that a process printed, or its exit code."""
    said = [line.strip() for line in (err + out).split("\n") if line.strip()]
    return said[-1] if said else f"it ended with {code}"


def _plain(node: Any) -> Any:
    """Dictionary for JSON, in which bitmaps are arrays of their pixels."""
    if isinstance(node, dict):
        return {key: _plain(value) for key, value in node.items()}
    if isinstance(node, mi.Bitmap):
        return {"pixels": np.array(node).tolist()}
    if node is None or isinstance(node, (bool, int, float, str, list)):
        return node
    raise SpecimenError(
        "a BSDF for another version must be a dictionary of numbers, texts, bitmaps "
        f"and dictionaries, got {type(node).__name__} in it"
    )
