"""Last lines of scripts, in the Mitsuba of whichever Python runs this file.

``python worker.py FOLDER`` reads ``question.json`` there and prints a line of JSON for
each script, as soon as it has ended, see :mod:`gonio_mi.validation.versions.asking`. It
needs nothing but NumPy and Mitsuba, and is meant to run with versions that the rest of
the package knows nothing of: vectors are made and read component by component.
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
import numpy as np

# Numbers of a parameter that are kept.
MOST_NUMBERS = 64


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


# ------------------------------------- what scripts of `gonio-mi diff` take from here


def load_plugin(path: str) -> None:
    """Run a Python file that registers a plugin, with what it imports beside it."""
    sys.path.insert(0, str(Path(path).parent))
    scope = {"__name__": Path(path).stem, "__file__": path}
    exec(compile(Path(path).read_bytes(), path, "exec"), scope)


def answers(bsdf: Any, modes: list[str], question: dict[str, Any]) -> str:
    """JSON of facts about a BSDF, and of its answers in transport modes.

    Of a scene, the BSDF of its only shape is meant.
    """
    if isinstance(bsdf, mi.Scene):
        shapes = [shape for shape in bsdf.shapes() if not shape.is_emitter()]
        if len(shapes) != 1:
            raise ValueError(
                f"the scene must have one shape, got {len(shapes)}: a BSDF alone must "
                "be the root of its file, <bsdf ...> in place of <scene ...>"
            )
        bsdf = shapes[0].bsdf()
    arrays: dict[str, Any] = {}
    for i, mode in enumerate(modes):
        ctx = mi.BSDFContext(getattr(mi.TransportMode, mode))
        for name, value in answers_in(bsdf, ctx, question, i).items():
            # single precision is what was answered
            kind = np.int32 if name in ("index", "type") else np.float32
            arrays[f"{name}.{i}"] = value.astype(kind)
    facts = {
        "mitsuba": mi.__version__,
        "drjit": dr.__version__,
        "flags": int(bsdf.flags()),
        "components": [int(bsdf.flags(i)) for i in range(bsdf.component_count())],
        "parameters": parameters(bsdf),
    }
    return json.dumps({"facts": facts, "arrays": encoded(arrays)})


def encoded(arrays: dict[str, Any]) -> str:
    """File of arrays as text."""
    content = io.BytesIO()
    np.savez_compressed(content, allow_pickle=False, **arrays)
    return base64.b64encode(content.getvalue()).decode()


def parameters(bsdf: Any) -> dict[str, Any]:
    """First numbers of each parameter that ``traverse`` shows, by name."""
    found: dict[str, Any] = {}
    params = mi.traverse(bsdf)
    for name in params.keys():  # noqa: SIM118 (Mitsuba's own type)
        try:
            numbers = np.ravel(np.array(params[name], dtype=float))
            found[name] = [float(x) for x in numbers[:MOST_NUMBERS]]
        except (TypeError, ValueError, RuntimeError):
            found[name] = None  # it holds no numbers
    return found


def answers_in(bsdf: Any, ctx: Any, question: dict[str, Any], i: int) -> dict[str, Any]:
    """Samples at the incident direction of number `i`, and values at directions.

    By default those are a lattice, and directions of samples, of numbers ``index``.
    Slacks are the largest changes of values as either direction is displaced.
    """
    u, wi = question["u"], question["wi"][i]
    si, n = interaction(np.broadcast_to(wi, u.shape)), len(u)
    sample1, x, y = (mi.Float(np.ascontiguousarray(column)) for column in u.T)
    bs, weight = bsdf.sample(ctx, si, sample1, mi.Point2f(x, y), mi.Bool(True))
    direction = columns(bs.wo, n)
    if f"wo.{i}" in question:
        wo, index = question[f"wo.{i}"], question[f"index.{i}"]
    else:
        few = direction[: len(question["lattice"])]
        usable = np.isfinite(few).all(axis=1) & (np.abs(few).sum(axis=1) > 0.5)
        wo = np.concatenate([question["lattice"], few[usable]]).astype(np.float32)
        index = np.flatnonzero(usable)
    wi = np.broadcast_to(wi, wo.shape)
    value, pdf = eval_pdf(bsdf, ctx, wi, wo)
    slack, pdf_slack = 0 * value, 0 * pdf
    for step in question["steps"]:
        for moved in ((wi + step, wo), (wi, wo + step)):
            other, other_pdf = eval_pdf(bsdf, ctx, *moved)
            slack = np.fmax(slack, np.abs(other - value))
            pdf_slack = np.fmax(pdf_slack, np.abs(other_pdf - pdf))
    return {
        "direction": direction,
        "weight": columns(weight, n),
        "sampled_pdf": column(bs.pdf, n),
        "type": column(bs.sampled_type, n),
        "wo": wo,
        "index": index,
        "eval": value,
        "pdf": pdf,
        "eval_slack": slack,
        "pdf_slack": pdf_slack,
    }


def eval_pdf(bsdf: Any, ctx: Any, wi: Any, wo: Any) -> Any:
    """Values of ``eval``, shape ``(n, channels)``, and of ``pdf``, ``(n,)``."""
    asked = ctx, interaction(wi), vector(wo), mi.Bool(True)
    n = len(wo)
    return columns(bsdf.eval(*asked), n), column(bsdf.pdf(*asked), n)


def vector(rows: Any) -> Any:
    """Dr.Jit vector of an array of shape ``(n, 3)``."""
    parts = np.ascontiguousarray(rows.T, dtype=np.float32)
    return mi.Vector3f(*(mi.Float(part) for part in parts))


def interaction(wi: Any) -> Any:
    """Point of a flat surface in z = 0, of 2 x 2 scene units, lit from `wi`."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.t, si.uv, si.n = 1.0, mi.Point2f(0.4, 0.7), mi.Normal3f(0, 0, 1)
    axes = [mi.Vector3f(*row) for row in np.eye(3).tolist()]
    si.sh_frame = mi.Frame3f(*axes)
    si.dp_du, si.dp_dv = 2 * axes[0], 2 * axes[1]
    if "spectral" in mi.variant():
        si.wavelengths = mi.Spectrum([450.0, 520.0, 580.0, 650.0])
    si.wi = vector(wi)
    return si


def column(value: Any, n: int) -> Any:
    """Array of shape ``(n,)`` of a scalar quantity."""
    return np.broadcast_to(np.ravel(np.array(value)), n).astype(float)


def columns(value: Any, n: int) -> Any:
    """Array of shape ``(n, k)`` of a vector or spectrum."""
    return np.stack([column(value[i], n) for i in range(len(value))], axis=1)


if __name__ == "__main__":
    main(sys.argv[1])
