"""Last lines of scripts, in the Mitsuba of whichever Python runs this file.

``python worker.py FOLDER`` reads ``question.json`` there and prints a line of JSON for
each script, as soon as it has ended, see :mod:`gonio_mi.validation.versions.asking`. It
needs nothing but Mitsuba.
"""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import re
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi


def main(folder: str) -> None:
    """Run the scripts of the question in `folder`."""
    # lines are for us, whatever Mitsuba prints for people
    with os.fdopen(os.dup(1), "w", buffering=1) as lines:
        os.dup2(2, 1)
        os.chdir(folder)
        for told in all_said(**json.loads(Path("question.json").read_text())):
            print(json.dumps(told), file=lines)


def all_said(
    scripts: list[str], limits: dict[str, float], files: dict[str, str]
) -> Iterator[Any]:
    """Yield the version, then the last line of each script and whether it is wrong.

    A wrong script runs again with other random numbers, and counts if it is wrong
    again. `files`, as text in base 64, are put where the scripts run.
    """
    warnings.simplefilter("ignore")
    dr.set_thread_count(1)  # two processes share the cores
    for name, content in files.items():
        Path(name).write_bytes(base64.b64decode(content))
    yield mi.__version__
    for text in scripts:
        line, wrong = said(text, limits)
        if wrong:
            # other random numbers
            line, wrong = said(text.replace("default_rng(0)", "default_rng(1)"), limits)
        yield line, wrong


def said(text: str, limits: dict[str, float]) -> tuple[str, bool]:
    """Last line that a script prints, and whether its numbers are beyond a limit."""
    printed = io.StringIO()
    scope: dict[str, Any] = {"__name__": "script"}
    try:
        with contextlib.redirect_stdout(printed):
            exec(compile(text, "script", "exec"), scope)
    except Exception as error:
        # a plugin that this version does not know, or that fails, is no finding
        told = " ".join(str(error).split())[-300:]
        return f"raised {type(error).__name__}: {told}", False
    finally:
        scope.clear()  # functions refer to it: its arrays would stay
    line = printed.getvalue().strip().rpartition("\n")[2]
    found = re.search(r": (\S+) (standard errors|roundings)$", line[-100:])
    far = found is not None and float(found[1]) > limits[found[2]]
    return line, far or line.endswith("must be equal: False")


def load_plugin(path: str) -> None:
    """Run a Python file that registers a plugin, with what it imports beside it."""
    sys.path.insert(0, str(Path(path).parent))
    scope = {"__name__": Path(path).stem, "__file__": path}
    exec(compile(Path(path).read_bytes(), path, "exec"), scope)


if __name__ == "__main__":
    main(sys.argv[1])
