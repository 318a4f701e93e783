"""What a record says of how it was made."""

from __future__ import annotations

import datetime
import platform
from functools import cache
from importlib.metadata import version
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..settings import INTEGRATOR, MeasurementSettings, declarations
from ..transport.bench import Bench
from ..transport.launch import transport_of
from ..transport.sampling import sampler_name
from ..transport.trial import class_of
from ..transport.wavelengths import passes
from .processor import processor

__all__ = ["described"]

# Settings that a record knows better: its batches, its channels, its precision.
KNOWN_OTHERWISE = {"batches", "wavelengths", "rel_err"}

# A parameter of a medium that has more, such as a grid, is told by its size.
MOST_NUMBERS = 4


@cache
def _own_version() -> str:
    """Version of the installed package, which is looked up in its files."""
    return version("gonio-mi")


def described(
    settings: MeasurementSettings, bench: Bench, seed: int, samples: bool
) -> dict[str, object]:
    """Settings of a measurement and what it found, in JSON's types.

    Every property of the integrator is among them, `points` and `rel_err` where the
    estimator has a use for them, `max_scatterings` where there are media.
    """
    own = {
        name: declared.text(getattr(settings, name))
        for name, declared in declarations(MeasurementSettings).items()
        if declared.plugin == INTEGRATOR and name not in KNOWN_OTHERWISE
    }
    if settings.estimator != "next_event":
        del own["points"]
    if bench.specimen.media:
        own["media"] = [_of_medium(medium) for medium in bench.specimen.media]
    else:
        del own["max_scatterings"]
    if settings.estimator == "quadrature":
        own["rel_err"] = settings.integral_err
    del own["trace"]  # told by the transport that was taken
    return own | {
        "specimen": bench.specimen.name,
        "surface": bench.specimen.description,
        **bench.digests,
        "transmission": bench.specimen.transmission,
        "emitter": bench.beam.emitter.class_name(),
        "side": "front" if bench.beam.side > 0 else "back",
        "transport": transport_of(bench, settings),
        "sampler": sampler_name(bench.sampler),
        "seed": seed,
        "rays": settings.rays if samples else 0,
        "passes": len(passes(settings.wavelengths)),
        "collector_radius": bench.collector.radius,
        "variant": mi.variant(),
        "versions": {
            "gonio_mi": _own_version(),
            "mitsuba": mi.__version__,
            "drjit": dr.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        "processors": [processor()],
        "created": datetime.datetime.now(datetime.timezone.utc).isoformat(
            "T", "seconds"
        ),
    }


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
