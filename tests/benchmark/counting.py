"""Raw speed: all count the same rays into 900 patches."""

from collections.abc import Callable
from functools import partial
from typing import Any

from .baselines import Baseline, chi2_rays, gonio_rays, samples, without_renderer
from .table import print_table
from .timing import in_turns, speeds

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
    found: dict[tuple[str, str], Baseline] = {}
    for name, specimen in SPECIMENS.items():
        ways = [
            gonio_rays(specimen, estimator, sampler, batches=1)
            for sampler in ("independent", "sobol")
            for estimator in ("analog", "weighted")
        ]
        for way in [*ways, chi2_rays(specimen)]:
            found[name, way.name.removesuffix(", 1 batch")] = way
    others, absent = without_renderer()
    found |= {("diffuse", way.name): way for way in others}
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
