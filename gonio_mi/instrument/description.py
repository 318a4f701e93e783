"""What a record says of how it was made."""

from __future__ import annotations

import ctypes
import datetime
import platform
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import llvm
from ..results.provenance import Provenance
from ..settings import MeasurementSettings
from ..transport.bench import Bench
from ..transport.launch import transport_of
from ..transport.sampling import sampler_name
from ..transport.scene_objects import class_of

__all__ = ["described", "processor", "target"]

# A parameter of a medium that has more, such as a grid, is told by its size.
MOST_NUMBERS = 4


@cache
def _own_version() -> str:
    """Version of the installed package, which is looked up in its files."""
    return version("gonio-mi")


def described(bench: Bench) -> tuple[MeasurementSettings, Provenance]:
    """What was asked for of a measurement, and how it came about."""
    settings, specimen = bench.settings, bench.specimen
    goals: dict[str, Any] = {}
    digests: dict[str, Any] = bench.digests
    if settings.estimator.integrates:
        goals = {"rel_err": settings.integral_err, "noise": None}
    side = "front" if bench.beam.side > 0 else "back"
    provenance = Provenance(
        specimen=specimen.name,
        surface=specimen.description,
        media=tuple(map(_of_medium, specimen.media)),
        defects=tuple(specimen.defects),
        **digests,
        transmission=specimen.transmission,
        emitter=bench.beam.emitter.class_name(),
        transport=transport_of(bench),
        sampler=sampler_name(bench.sampler),
        seeds=(settings.seed,),
        rays=settings.rays if bench.samples else 0,
        passes=len(bench.passes),
        variant=mi.variant(),
        versions={
            "gonio_mi": _own_version(),
            "mitsuba": mi.__version__,
            "drjit": dr.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        processors=(processor(),),
        created=datetime.datetime.now(datetime.timezone.utc).isoformat("T", "seconds"),
    )
    return replace(settings, side=side, **goals), provenance


def _of_medium(medium: Any) -> str:
    """One line on a medium: its classes and numbers; of large arrays, their size.

    What is no number, of a plugin of somebody's own, is left out.
    """
    numbers = {}
    for name, value in mi.traverse(medium):
        try:
            flat = np.ravel(np.array(value, dtype=float))
        except (TypeError, ValueError):
            continue
        name = name.removesuffix(".value").removesuffix(".value")
        few = "/".join(f"{number:g}" for number in flat)
        if mi.is_spectral and flat.size == 3:
            few = "of a colour"  # the numbers are coefficients of its spectrum
        numbers[name] = few if flat.size <= MOST_NUMBERS else f"{flat.size} numbers"
    phase = class_of(medium.phase_function())
    told = ", ".join(f"{name} {value}" for name, value in numbers.items())
    return f"{class_of(medium)} with {phase}: {told}"


def processor() -> str:
    """Text on the processor that kernels of the variant are compiled for.

    On those of other names, widths of vectors or versions of LLVM the same rays may
    round otherwise.
    """
    if not mi.variant().startswith("llvm"):
        return str(mi.variant()).split("_")[0]
    name, width = target()
    vectors = f"vectors of {width}" if width else "vectors of unknown width"
    return f"{name}, {vectors}, LLVM {llvm.dotted(dr.detail.llvm_version())}"


def target() -> tuple[str, int | None]:
    """Name of the LLVM backend's processor, and how many numbers its vectors hold.

    Dr.Jit tells no Python function of it; where its library is another one, the name
    is the machine's and the width None.
    """
    try:
        core = ctypes.CDLL(str(Path(dr.__file__).parent / "libdrjit-core.so"))
        name, width = core._Z19jit_llvm_target_cpuv, core._Z21jit_llvm_vector_widthv
    except (OSError, AttributeError):
        return platform.machine(), None
    name.restype, width.restype = ctypes.c_char_p, ctypes.c_uint32
    text = name()
    return (text.decode() if text else platform.machine()), int(width()) or None
