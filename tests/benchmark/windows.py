"""BSDF files of a blind and a screen, beside Radiance's genBSDF, at equal error.

``python -m tests.benchmark windows`` measures both specimens with both programs, in
one run: light of both sides, by what part it differs from a long measurement of other
seeds, the direct share, and the CPU time. It needs pyradiance.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from gonio_mi.array_types import Floats
from gonio_mi.collector.klems import Klems
from gonio_mi.exchange.exports import bsdf
from gonio_mi.exchange.formats import radiance

from .table import print_table
from .timing import cpu_seconds

REFLECTANCE = 0.6

# Cells to either side of the one that genBSDF looks at.
NEIGHBOURS = 24

# Rays of the reference, and of the first attempt, for each incident patch.
REFERENCE, FIRST = 2**17, 2**8

Matrices = Mapping[str, Floats]


def slats(tilt: float = 40.0, width: float = 0.9) -> list[Floats]:
    """Corners of the slat of a blind in a cell of 1 x 1, below z = 0."""
    sine, cosine = np.sin(np.radians(tilt)), np.cos(np.radians(tilt))
    y, z = width / 2 * sine, width / 2 * cosine
    corners = [(-0.5, -y, -z), (0.5, -y, -z), (0.5, y, z), (-0.5, y, z)]
    return [np.array(corners) - [0, 0, z]]


def screen(depth: float = 0.1) -> list[Floats]:
    """Corners of two crossed strips in a cell of 1 x 1, a quarter of which is open."""
    wide = np.array([(-0.5, -0.25), (0.5, -0.25), (0.5, 0.25), (-0.5, 0.25)])
    upper, lower = np.zeros((4, 1)), np.full((4, 1), -depth)
    return [np.hstack([wide, lower]), np.hstack([wide[:, ::-1], upper])]


SPECIMENS: dict[str, Callable[[], list[Floats]]] = {"blind": slats, "screen": screen}


def mesh_of(quads: Sequence[Floats]) -> dict[str, Any]:
    """Mitsuba scene of one cell."""
    matt = {"type": "diffuse", "reflectance": REFLECTANCE}
    scene: dict[str, Any] = {"type": "scene"}
    for number, corners in enumerate(quads):
        middle = corners.mean(axis=0)
        along, across = (corners[1] - corners[0]) / 2, (corners[3] - corners[0]) / 2
        matrix = np.eye(4)
        matrix[:3] = np.c_[along, across, np.cross(along, across), middle]
        scene[f"quad{number}"] = {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(matrix),
            "bsdf": {"type": "twosided", "bsdf": matt},
        }
    return scene


def polygons_of(quads: Sequence[Floats]) -> str:
    """Radiance scene of many cells: each quad is as long as all of them."""
    text = f"void plastic matt 0 0 5 {REFLECTANCE} {REFLECTANCE} {REFLECTANCE} 0 0\n"
    for number, corners in enumerate(quads):
        along = corners[1] - corners[0]
        axis = int(np.argmax(np.abs(along)))
        for step in range(-NEIGHBOURS, NEIGHBOURS + 1):
            moved = corners.copy()
            moved[:, axis] *= 2 * NEIGHBOURS + 1
            moved[:, 1 - axis] += step
            points = " ".join(f"{x:.9g}" for x in moved.ravel())
            name = f"q{number}_{step + NEIGHBOURS}"
            text += f"matt polygon {name} 0 0 12 {points}\n"
    return text


def ours(quads: Sequence[Floats], rays: int, seed: int) -> Matrices:
    """Light of all incident patches in all others, by block of the file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ours.xml"
        bsdf(mesh_of(quads), path, period=1, rays=rays, seed=seed)
        return _light(path.read_bytes())


def theirs(quads: Sequence[Floats], samples: int) -> Matrices:
    """The same by genBSDF with its defaults."""
    from pyradiance import genbsdf

    depth = min(corners[:, 2].min() for corners in quads)
    box = genbsdf.SamplingBox(-0.5, 0.5, -0.5, 0.5, float(depth), 0)
    with contextlib.redirect_stdout(io.StringIO()):  # remarks on the bounding box
        found = genbsdf.generate_bsdf(
            polygons_of(quads).encode(),
            nsamp=samples - 1,
            dim=box,
            nproc=len(os.sched_getaffinity(0)),
        )
        return _light(genbsdf.generate_xml(vis_results=found, basis="kf"))


def _light(file: bytes) -> Matrices:
    """Flux fractions of a file, exit patches times incident ones."""
    blocks: Any = radiance.read(io.BytesIO(file))
    projected = Klems().projected_solid_angles
    return {name: block * projected for (_, name), block in blocks.items()}


def misplaced(found: Matrices, truth: Matrices) -> float:
    """Part of the light of all patches that is elsewhere than in the truth."""
    weight = Klems().projected_solid_angles[:, 0]
    off = sum(np.abs(found[name] - truth[name]).sum(axis=0) for name in truth)
    return float(off @ weight / 2 / sum(truth[n].sum(axis=0) @ weight for n in truth))


def compared(name: str, samples: int) -> list[list[Any]]:
    """Rows of a table: program, size, part misplaced, T and R, direct, seconds."""
    quads = SPECIMENS[name]()
    truth = ours(quads, REFERENCE, 1)
    rows = [_row(name, "reference", REFERENCE, truth, truth, None)]
    before = cpu_seconds()
    other = theirs(quads, samples)
    seconds = cpu_seconds() - before
    rows.append(_row(name, "genBSDF", samples, other, truth, seconds))
    goal, rays = misplaced(other, truth), FIRST
    while True:
        before = cpu_seconds()
        found = ours(quads, rays, 0)
        seconds = cpu_seconds() - before
        if misplaced(found, truth) <= goal or rays >= REFERENCE:
            break
        rays *= 2
    rows.append(_row(name, "gonio-mi", rays, found, truth, seconds))
    return rows


def _row(
    name: str,
    program: str,
    size: int,
    found: Matrices,
    truth: Matrices,
    seconds: float | None,
) -> list[Any]:
    """Of hemispherical light, the sides apart, and of the normal patch."""
    weight = Klems().projected_solid_angles[:, 0] / np.pi
    totals = [found[block].sum(axis=0) @ weight for block in sorted(truth)]
    straight = found["Transmission Back"][0, 0]
    error = misplaced(found, truth) if found is not truth else None
    return [name, program, size, error, *totals, straight, seconds]


def main(argv: Sequence[str]) -> None:
    """Compare both specimens and print a table."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmark windows")
    parser.add_argument("--samples", type=int, default=100, help="of genBSDF (100)")
    parser.add_argument("--variant", default="llvm_ad_mono")
    options = parser.parse_args(argv)
    mi.set_variant(options.variant)
    head = ["specimen", "program", "rays or samples", "light misplaced"]
    head += ["R back", "R front", "T back", "T front", "normal, straight", "CPU s"]
    rows = [row for name in SPECIMENS for row in compared(name, options.samples)]
    print_table("Klems files", head, [[_text(x) for x in row] for row in rows])


def _text(value: Any) -> str:
    """Cell of the table."""
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
