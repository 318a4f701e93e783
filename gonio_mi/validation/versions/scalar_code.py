"""Whether scalar code answers as LLVM's, direction by direction: a script."""

import textwrap
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...single_precision import BSDF_ROUNDING as ROUNDING
from ..arrays import rows
from ..conditions import WAVELENGTHS_NM
from ..phase_functions import Scatterer
from ..reproducers import IMPORTS, sources


def answers(bsdf: Any, ctx: Any, si: Any, at: Any, to: Any, u: Any) -> Any:
    """All answers about directions and random numbers, of channels the sums."""
    si.wi, wo = (mi.warp.square_to_uniform_sphere(mi.Point2f(z)) for z in (at, to))
    si.sh_frame = mi.Frame3f([0, 0, 1])
    bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]), True)
    drawn = [dr.select(dr.any(weight != 0), z, 0) for z in (*bs.wo, bs.pdf)]
    found = bsdf.eval(ctx, si, wo, True), weight, bsdf.pdf(ctx, si, wo, True)
    axis = None if mi.variant().startswith("scalar") else 0
    sums = [np.sum(rows(x), axis) for x in found]
    return np.array([np.array(x) + np.zeros(np.size(u[0])) for x in (*sums, *drawn)])


def all_but_few(a: Any, b: Any) -> None:
    """One number in a hundred may be another: rounding may choose another lobe."""
    off = np.abs(a - b) / np.maximum(np.fmax(np.abs(a), np.abs(b)), 1e-6)
    k = np.unravel_index(np.argsort(off, axis=None)[-off.size // 100], off.shape)
    print(f"{b[k]:.6g} and {a[k]:.6g}: {off[k] / ROUNDING:.3g} roundings")


def in_two_variants(variant: str, source: str, of_volumes: bool) -> str:
    """Script that compares a scalar variant with LLVM's."""
    kind, interaction, given = "BSDF", "Surface", ""
    needed: list[Any] = [answers, all_but_few]
    if of_volumes:
        kind, interaction, given = "PhaseFunction", "Medium", "None"
        source += "\nbsdf = Scatterer(phase)"
        needed.append(Scatterer)
    lines = [
        f"{source}\nctx = mi.{kind}Context({given})",
        f"si = dr.zeros(mi.{interaction}Interaction3f)",
    ]
    if not of_volumes:
        lines.append("si.uv = mi.Point2f(0.35, 0.6)")
        lines.append("si.dp_du, si.dp_dv = [2, 0, 0], [0, 2, 0]")
    if mi.is_spectral:
        lines.append(f"si.wavelengths = mi.UnpolarizedSpectrum({list(WAVELENGTHS_NM)})")
    lines += [
        'each = [x] if "llvm" in variant else zip(*(z.T.tolist() for z in x))',
        "told.append(np.hstack([answers(bsdf, ctx, si, *one) for one in each]))",
    ]
    both = variant.replace("scalar", "llvm_ad"), variant
    return (
        f"{IMPORTS}\n{sources(*needed)}\n\n\n"
        "x, told = np.split(np.random.default_rng(0).random((7, 1000)), [2, 4]), []\n"
        f"for variant in {both}:\n    mi.set_variant(variant)\n"
        + textwrap.indent("\n".join(lines), "    ")
        + "\nall_but_few(*told)\n"
    )
