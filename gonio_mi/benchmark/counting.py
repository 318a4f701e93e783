"""Raw speed: all count the same rays into 900 patches."""

from collections.abc import Callable
from functools import partial
from typing import Any

from .baselines import (
    Baseline,
    c_rays,
    chi2_rays,
    gonio_rays,
    numba_rays,
    numpy_rays,
    samples,
)
from .c_loop import CompilerError
from .table import print_table
from .timing import in_turns, speeds

__all__ = ["SPECIMENS", "print_rates", "baselines"]

SPECIMENS: dict[str, dict[str, Any]] = {
    "diffuse": {"type": "diffuse", "reflectance": 1.0},
    "rough conductor": {"type": "roughconductor", "alpha": 0.2, "distribution": "ggx"},
}


def baselines() -> tuple[dict[tuple[str, str], Baseline], list[str]]:
    """All that can run here, as ``{(specimen, name): Baseline}``, ours first.

    Returns
    -------
    baselines : dict
    absent : list of str
        One sentence for each that is left out.
    """
    found, absent = {}, []
    for name, specimen in SPECIMENS.items():
        ways = [
            gonio_rays(specimen, estimator, sampler, batches=1)
            for sampler in ("independent", "sobol")
            for estimator in ("analog", "weighted")
        ]
        for way in [*ways, chi2_rays(specimen)]:
            found[name, way.name.removesuffix(", 1 batch")] = way
    for build in (numpy_rays, numba_rays, c_rays):
        try:
            way = build()
        except ImportError:
            absent.append("numba is left out: pip install 'gonio-mi[benchmark]'")
        except CompilerError as error:
            absent.append(f"the C loop is left out: {error}")
        else:
            found["diffuse", way.name] = way
    return found, absent


def print_rates(rays: int, repeats: int) -> None:
    """Print speeds, relative to counting independent rays off the diffuse specimen."""
    found, absent = baselines()
    runs: dict[tuple[str, str], Callable[[], Any]] = {
        key: partial(baseline.flux, rays, 0) for key, baseline in found.items()
    }
    for name, specimen in SPECIMENS.items():
        runs[name, "Mitsuba's sample, nothing counted"] = samples(specimen, rays)
    times = in_turns(runs, repeats)
    print_table(
        f"Counting: {rays:g} rays into 900 patches, medians of {repeats} runs in turns",
        ("specimen", "method", "core-ns per ray", "Mray/s", "speed"),
        speeds(times, rays),
    )
    for sentence in absent:
        print(sentence)
