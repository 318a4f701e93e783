"""Ask the Mitsuba of another environment, in a separate process, by scripts."""

import json
import os
import re
import subprocess
import tempfile
from collections.abc import Generator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ...errors import SettingError, SpecimenError, shown
from ...specimen.specimen_text import SpecimenLike, specimen_name
from ...variants import check_variant
from ..checks.answers import lattice
from ..conditions import Condition
from ..reproducers import source_of, sources
from ..samples import ULPS
from .table import encoded, told

WORKER = Path(__file__).with_name("worker.py")

FORMAT = "gonio-mi answers of a BSDF, 1"

# Polar angles of incidence in degrees, sides and transport modes.
VIEWS: list[list[Any]] = [
    [theta, side, mode]
    for side in ("front", "back")
    for theta, mode in zip((0.0, 40.0, 80.0, 40.0), (*3 * ["Importance"], "Radiance"))
]

# Displacements that tell how values answer to rounding.
STEPS = 3

# A script that asks a BSDF. With one thread, Mitsuba waits for ever for an EXR file.
SCRIPT = """\
import base64, io, json, os
from __main__ import load_plugin
import drjit as dr
import mitsuba as mi
import numpy as np


{functions}


question = dict(np.load("question.npz"))
os.chdir({folder!r})  # where names of files are meant
dr.set_thread_count(2)
mi.set_variant({variant!r})
for path in {plugins}:
    load_plugin(path)
{source}, parallel=False)
print(told(bsdf, {modes}, question))
"""


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


def answers_about(
    specimen: SpecimenLike,
    python: str,
    *,
    n: int,
    parameters: Mapping[str, Any] | None = None,
    plugins: Sequence[str] = (),
    seed: int = 0,
    given: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Answers about a BSDF from the Mitsuba of another Python, for JSON.

    Parameters
    ----------
    specimen, parameters, plugins, seed
        As of :func:`gonio_mi.validation.versions.diff`.
    python : str
    n : int
        Samples of each view.
    given : dict of ndarray, optional
        Directions ``wo.0``, ... at which functions are asked, and the numbers of their
        samples ``index.0``, ...: those of another version. Default: of its own samples.

    Returns
    -------
    dict
        Name, what was ``asked``, ``facts``, and ``arrays`` as :func:`.table.encoded`.

    Raises
    ------
    SettingError
        If that Python cannot run, or has no Mitsuba.
    SpecimenError
        If its Mitsuba cannot load the BSDF, or ends the process.
    """
    check_variant()
    source = source_of(specimen, parameters)
    if source is None:
        raise SpecimenError(
            "a BSDF for another version must be a file, or a dictionary of numbers, "
            f"texts, bitmaps and dictionaries, got {shown(specimen)}"
        )
    rng = np.random.default_rng(seed)
    question = {
        "wi": np.array([Condition(theta, 25.0, side).wi for theta, side, _ in VIEWS]),
        "lattice": lattice(),
        "steps": ULPS * rng.uniform(-1, 1, (STEPS, 3)),
        "u": rng.random((n, 3), dtype=np.float32),
    }
    script = SCRIPT.format(
        functions=sources(told),
        folder=os.getcwd(),
        variant=mi.variant(),
        plugins=[str(Path(path).resolve()) for path in plugins],
        source=source.removesuffix(".shapes()[0].bsdf()").removesuffix(")"),
        modes=[mode for *_, mode in VIEWS],
    )
    files = {"question.npz": encoded(question | dict(given or {}))}
    ((_, line, _),) = answers_of(python, [script], limits={}, files=files)
    if line.startswith("raised "):
        raise SpecimenError(f"{python} gave no answer: it {line}")
    asked = {"variant": mi.variant(), "seed": seed, "conditions": VIEWS}
    name = specimen_name(specimen, dict(parameters or {}))
    return {"format": FORMAT, "name": name, "asked": asked, **json.loads(line)}


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
    # it must not see the modules of this one
    hidden = ("PYTHONPATH", "PYTHONHOME")
    environment = {k: v for k, v in os.environ.items() if k not in hidden}
    left = list(scripts)
    while left:
        with tempfile.TemporaryDirectory() as folder:
            question = json.dumps({"scripts": left, **others})
            (Path(folder) / "question.json").write_text(question)
            with open(Path(folder) / "errors", "w+") as errors:
                try:
                    worker = subprocess.Popen(
                        [python, "-I", str(WORKER), folder],
                        stdout=subprocess.PIPE,
                        stderr=errors,
                        text=True,
                        env=environment,
                    )
                except OSError as error:
                    raise SettingError(
                        f"{python} cannot be run: {error.strerror}"
                    ) from None
                with worker:
                    try:
                        lines = map(json.loads, worker.stdout or ())
                        version = str(next(lines, ""))
                        for line, wrong in lines:
                            yield version, line, wrong
                            del left[0]
                        worker.wait()
                    finally:
                        worker.kill()
                errors.seek(0)
                said = errors.read()
        if not version:
            raise _no_answer(python, said, worker.returncode)
        if left:
            yield version, "raised an error that ended the process", False
            del left[0]


def _no_answer(python: str, said: str, code: int) -> SettingError | SpecimenError:
    """Error for a Python that said no version before it ended with an exit code."""
    missing = re.search(r"No module named '(mitsuba|drjit|numpy)", said)
    if missing:
        install = f"{python} -m pip install mitsuba numpy"
        return SettingError(f"{python} has no {missing[1]}: run {install}")
    last = said.strip().rpartition("\n")[2].strip() or f"it ended with {code}"
    return SpecimenError(f"{python} gave no answer: {last}")
