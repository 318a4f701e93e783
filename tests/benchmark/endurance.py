"""Memory and time per ray, as the rays grow: neither may."""

from gonio_mi.campaigns.measure import measure

from .baselines import PATCHES, THETA_I
from .table import print_table
from .timing import cpu_seconds, peak_memory

__all__ = ["print_growth"]

SPECIMEN = {"type": "diffuse", "reflectance": 1.0}


def print_growth(most: int) -> None:
    """Print peak memory and time per ray from 1e7 rays to `most`, by factors of ten."""
    rows = []
    for sampler in ("sobol", "independent"):
        _measure(sampler, 10**6)
        rays = 10**7
        while rays <= most:
            start = cpu_seconds()
            _measure(sampler, rays)
            rows.append(
                (
                    sampler,
                    f"{rays:.0e}",
                    f"{1e9 * (cpu_seconds() - start) / rays:.2f}",
                    f"{peak_memory() / 2**20:.1f}",
                )
            )
            rays *= 10
    print_table(
        "Growth: diffuse, 900 patches; the peak is that of the process so far",
        ("sampler", "rays", "core-ns per ray", "peak MiB"),
        rows,
    )


def _measure(sampler: str, rays: int) -> None:
    measure(SPECIMEN, THETA_I, collector=PATCHES, rays=rays, sampler=sampler)
