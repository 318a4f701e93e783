"""The table of answers by which two versions are compared, as another Python makes it.

It runs the source of :func:`told` and of what that names, with NumPy and Mitsuba alone:
so vectors are made component by component, as all versions have them.
"""

import base64
import io
import json
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..arrays import drawn, of_eval, of_pdf, rows


def told(bsdf: Any, modes: Any, question: Any) -> str:
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
    arrays = {}
    for i, mode in enumerate(modes):
        ctx = mi.BSDFContext(getattr(mi.TransportMode, mode))
        for name, value in table(bsdf, ctx, question, i).items():
            # single precision is what was answered
            kind = np.int32 if name in ("index", "type") else np.float32
            arrays[f"{name}.{i}"] = value.astype(kind)
    facts = {
        "mitsuba": mi.__version__,
        "drjit": dr.__version__,
        "flags": int(bsdf.flags()),
        "components": [int(bsdf.flags(i)) for i in range(bsdf.component_count())],
        "parameters": first_numbers(mi.traverse(bsdf)),
    }
    return json.dumps({"facts": facts, "arrays": encoded(arrays)})


def encoded(arrays: Any) -> str:
    """File of arrays as text."""
    content = io.BytesIO()
    np.savez_compressed(content, allow_pickle=False, **arrays)
    return base64.b64encode(content.getvalue()).decode()


def first_numbers(params: Any) -> Any:
    """First 64 numbers of each parameter that ``traverse`` shows, by name."""
    found: Any = {}
    for name in params.keys():  # noqa: SIM118 (Mitsuba's own type)
        try:
            numbers = np.ravel(np.array(params[name], dtype=float))
            found[name] = [float(x) for x in numbers[:64]]
        except (TypeError, ValueError, RuntimeError):
            found[name] = None  # it holds no numbers
    return found


def table(bsdf: Any, ctx: Any, question: Any, i: int) -> Any:
    """Samples at the incident direction of number `i`, and values at directions.

    By default those are a lattice, and directions of samples, of numbers ``index``.
    Slacks are the largest changes of values as either direction is displaced.
    """
    u, wi = question["u"], question["wi"][i]
    bs, weight = drawn(bsdf, ctx, place(np.broadcast_to(wi, u.shape)), vector(u))
    direction = columns(bs.wo, u)
    if f"wo.{i}" in question:
        wo, index = question[f"wo.{i}"], question[f"index.{i}"]
    else:
        few = direction[: len(question["lattice"])]
        usable = np.isfinite(few).all(axis=1) & (np.abs(few).sum(axis=1) > 0.5)
        wo = np.concatenate([question["lattice"], few[usable]]).astype(np.float32)
        index = np.flatnonzero(usable)
    wi = np.broadcast_to(wi, wo.shape)
    moved = [way for x in question["steps"] for way in ((wi + x, wo), (wi, wo + x))]
    found = {"wo": wo, "index": index}
    for name, what in (("eval", of_eval), ("pdf", of_pdf)):
        here, *others = (
            columns(what(bsdf, ctx, place(a), vector(b)), b)
            for a, b in ((wi, wo), *moved)
        )
        found[name] = here
        found[f"{name}_slack"] = np.fmax.reduce([np.abs(x - here) for x in others])
    return found | {
        "pdf": found["pdf"][:, 0],
        "pdf_slack": found["pdf_slack"][:, 0],
        "direction": direction,
        "weight": columns(weight, u),
        "sampled_pdf": columns(bs.pdf, u)[:, 0],
        "type": columns(bs.sampled_type, u)[:, 0],
    }


def vector(three: Any) -> Any:
    """Dr.Jit vector of an array of shape ``(n, 3)``."""
    parts = np.ascontiguousarray(three.T, dtype=np.float32)
    return mi.Vector3f(*(mi.Float(part) for part in parts))


def columns(answer: Any, asked: Any) -> Any:
    """Array of shape ``(n, k)`` of what was `asked` about n directions."""
    found = rows(answer).T
    return np.broadcast_to(found, (len(asked), found.shape[1]))


def place(wi: Any) -> Any:
    """Points of a flat surface in z = 0, of 2 x 2 scene units, lit from `wi`."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.t, si.uv, si.n = 1.0, mi.Point2f(0.4, 0.7), mi.Normal3f(0, 0, 1)
    axes = [mi.Vector3f(*row) for row in np.eye(3).tolist()]
    si.sh_frame = mi.Frame3f(*axes)
    si.dp_du, si.dp_dv = 2 * axes[0], 2 * axes[1]
    if "spectral" in mi.variant():
        si.wavelengths = mi.Spectrum([450.0, 520.0, 580.0, 650.0])
    si.wi = vector(wi)
    return si
