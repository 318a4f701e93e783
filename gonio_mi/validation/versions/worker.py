"""Answers of a BSDF, or of scripts, in the Mitsuba of whichever Python runs this file.

``python worker.py FOLDER`` reads ``question.json`` and ``question.npz`` there and
writes ``answer.json`` and ``answer.npz``, see :mod:`.asking`; of scripts
 it prints a line of JSON each, as soon as it has ended. It needs nothing but
NumPy and Mitsuba, and is meant to run with versions that the rest of the package knows
nothing of: vectors are made and read component by component.
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

import numpy as np

# Numbers of a parameter that are kept.
MOST_NUMBERS = 64


def main(folder: str) -> None:
    """Answer the question in `folder`, or write in one line why that is impossible."""
    here = Path(folder).resolve()
    question = json.loads((here / "question.json").read_text())
    if "scripts" in question:
        # lines are for us, whatever Mitsuba prints for people
        with os.fdopen(os.dup(1), "w", buffering=1) as lines:
            os.dup2(2, 1)
            os.chdir(here)
            for told in all_said(**question):
                print(json.dumps(told), file=lines)
        return
    with np.load(here / "question.npz") as content:
        arrays = dict(content)
    try:
        facts, answers = answered(question, arrays)
    except Exception as error:
        # a plugin, or another version of Mitsuba, may raise anything
        text = " ".join(str(error).split())[-300:]
        facts, answers = {"error": f"{type(error).__name__}: {text}"}, {}
    np.savez(here / "answer.npz", **answers)
    (here / "answer.json").write_text(json.dumps(facts))


def answered(
    question: dict[str, Any], arrays: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Facts about the BSDF, and arrays of its answers."""
    import drjit
    import mitsuba as mi

    mi.set_variant(question["variant"])
    for path in question["plugins"]:
        sys.path.insert(0, str(Path(path).resolve().parent))
        scope = {"__name__": Path(path).stem, "__file__": path}
        exec(compile(Path(path).read_bytes(), path, "exec"), scope)
    bsdf = loaded(mi, question)
    answers: dict[str, Any] = {}
    for i, mode in enumerate(question["modes"]):
        asked = Asked(mi, drjit, bsdf, arrays["wi"][i], mode)
        given = arrays.get(f"wo.{i}")
        for name, value in asked.all(arrays, given).items():
            answers[f"{name}.{i}"] = value
    facts = {
        "mitsuba": mi.__version__,
        "drjit": drjit.__version__,
        "flags": int(bsdf.flags()),
        "components": [int(bsdf.flags(i)) for i in range(bsdf.component_count())],
        "parameters": parameters(mi, bsdf),
    }
    return facts, answers


def all_said(
    scripts: list[str], limits: dict[str, float], files: dict[str, str]
) -> Iterator[Any]:
    """Yield the version, then the last line of each script and whether it is wrong.

    A wrong script runs again with other random numbers, and counts if it is wrong
    again. `files`, as text in base 64, are put where the scripts run.
    """
    import drjit as dr
    import mitsuba as mi

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
        told = " ".join(str(error).split())[:200]
        return f"raised {type(error).__name__}: {told}", False
    finally:
        scope.clear()  # functions refer to it: its arrays would stay
    line = printed.getvalue().strip().rpartition("\n")[2]
    found = re.search(r": (\S+) (standard errors|roundings)$", line)
    far = found is not None and float(found[1]) > limits[found[2]]
    return line, far or line.endswith("must be equal: False")


def loaded(mi: Any, question: dict[str, Any]) -> Any:
    """BSDF of the question: of a dictionary, or of the only shape of a scene file."""
    import drjit as dr

    if dr.thread_count() == 1:  # Mitsuba waits for ever for an EXR file then
        dr.set_thread_count(2)
    if question["file"] is None:
        return mi.load_dict(built(mi, question["specimen"]), parallel=False)
    scene = mi.load_file(question["file"], parallel=False, **question["parameters"])
    shapes = [shape for shape in scene.shapes() if not shape.is_emitter()]
    if len(shapes) != 1:
        raise ValueError(f"the scene must have one shape, got {len(shapes)}")
    return shapes[0].bsdf()


def built(mi: Any, node: Any) -> Any:
    """Dictionary in which arrays are bitmaps again."""
    if not isinstance(node, dict):
        return node
    if "pixels" in node:
        return mi.Bitmap(np.array(node["pixels"], dtype=np.float32))
    return {key: built(mi, value) for key, value in node.items()}


def parameters(mi: Any, bsdf: Any) -> dict[str, Any]:
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


class Asked:
    """The functions of a BSDF for one incident direction, on NumPy arrays."""

    def __init__(self, mi: Any, dr: Any, bsdf: Any, wi: Any, mode: str) -> None:
        self.mi, self.dr, self.bsdf, self.wi = mi, dr, bsdf, wi
        self.ctx = mi.BSDFContext(getattr(mi.TransportMode, mode))

    def all(self, arrays: dict[str, Any], wo: Any) -> dict[str, Any]:
        """Samples, and values at `wo`, by default a lattice and directions of samples.

        Slacks are the largest changes of values as either direction is displaced.
        """
        answers = self.sample(arrays["u"])
        if wo is None:
            few = answers["direction"][: len(arrays["lattice"])]
            usable = np.isfinite(few).all(axis=1) & (np.abs(few).sum(axis=1) > 0.5)
            wo = np.concatenate([arrays["lattice"], few[usable]]).astype(np.float32)
            answers["index"] = np.flatnonzero(usable)
        answers["wo"] = wo
        wi = np.broadcast_to(self.wi, wo.shape)
        value, pdf = self.eval_pdf(wi, wo)
        slack, pdf_slack = 0 * value, 0 * pdf
        for step in arrays["steps"]:
            for moved in ((wi + step, wo), (wi, wo + step)):
                other, other_pdf = self.eval_pdf(*moved)
                slack = np.fmax(slack, np.abs(other - value))
                pdf_slack = np.fmax(pdf_slack, np.abs(other_pdf - pdf))
        answers.update(eval=value, pdf=pdf, eval_slack=slack, pdf_slack=pdf_slack)
        return answers

    def eval_pdf(self, wi: Any, wo: Any) -> Any:
        """Values of ``eval``, shape ``(n, channels)``, and of ``pdf``, ``(n,)``."""
        si, wo, n = self.interaction(wi), self.vector(wo), len(wo)
        asked = self.ctx, si, wo, self.mi.Bool(True)
        return columns(self.bsdf.eval(*asked), n), column(self.bsdf.pdf(*asked), n)

    def sample(self, u: Any) -> dict[str, Any]:
        """Answers of ``sample`` for random numbers of shape ``(n, 3)``."""
        n, mi = len(u), self.mi
        sample1, x, y = (mi.Float(np.ascontiguousarray(u[:, i])) for i in range(3))
        wi = np.broadcast_to(self.wi, (n, 3))
        si, sample2, every = self.interaction(wi), mi.Point2f(x, y), mi.Bool(True)
        bs, weight = self.bsdf.sample(self.ctx, si, sample1, sample2, every)
        return {
            "direction": columns(bs.wo, n),
            "weight": columns(weight, n),
            "sampled_pdf": column(bs.pdf, n),
            "type": column(bs.sampled_type, n),
            "eta": column(bs.eta, n),
        }

    def vector(self, rows: Any) -> Any:
        """Dr.Jit vector of an array of shape ``(n, 3)``."""
        parts = np.ascontiguousarray(rows.T, dtype=np.float32)
        return self.mi.Vector3f(*(self.mi.Float(part) for part in parts))

    def interaction(self, wi: Any) -> Any:
        """Point of a flat surface in z = 0, of 2 x 2 scene units, lit from `wi`."""
        mi = self.mi
        si = self.dr.zeros(mi.SurfaceInteraction3f, len(wi))
        si.t, si.uv, si.n = 1.0, mi.Point2f(0.4, 0.7), mi.Normal3f(0, 0, 1)
        axes = [mi.Vector3f(*row) for row in np.eye(3).tolist()]
        si.sh_frame = mi.Frame3f(*axes)
        si.dp_du, si.dp_dv = 2 * axes[0], 2 * axes[1]
        if "spectral" in mi.variant():
            si.wavelengths = mi.Spectrum([450.0, 520.0, 580.0, 650.0])
        si.wi = self.vector(wi)
        return si


def column(value: Any, n: int) -> Any:
    """Array of shape ``(n,)`` of a scalar quantity."""
    return np.broadcast_to(np.ravel(np.array(value)), n).astype(float)


def columns(value: Any, n: int) -> Any:
    """Array of shape ``(n, k)`` of a vector or spectrum."""
    return np.stack([column(value[i], n) for i in range(len(value))], axis=1)


if __name__ == "__main__":
    main(sys.argv[1])
