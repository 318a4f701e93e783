"""Ways to count the rays of a flat specimen: ours, and what is commonly used."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gonio_mi.array_types import Floats
from gonio_mi.campaigns.measure import measure
from gonio_mi.collector import EqualProjectedSolidAngle, EqualSolidAngle, Subdivision
from gonio_mi.collector.directions import direction
from gonio_mi.quadrature import integrate

from . import c_loop

PATCHES = EqualProjectedSolidAngle(30, 30)
THETA_I = 45.0  # degrees


@dataclass(frozen=True)
class Baseline:
    """A way to measure a map.

    Attributes
    ----------
    name : str
    flux : callable
        ``flux(size, seed)`` gives the flux fraction of each patch, float64, shaped like
        `subdivision`.
    subdivision : Subdivision
    size : str
        What the size counts, in the plural.
    first : int
        Smallest size worth trying.
    incident : int
        Incident directions that it measures at once.
    random : bool
        Whether another seed gives another map.
    """

    name: str
    flux: Callable[[int, int], Floats]
    subdivision: Subdivision = PATCHES
    size: str = "rays"
    first: int = 2**12
    incident: int = 1
    random: bool = True


def gonio_rays(
    specimen: Any,
    estimator: str,
    sampler: str,
    *,
    batches: int = 32,
    subdivision: Subdivision = PATCHES,
    **settings: Any,
) -> Baseline:
    """Our instrument, by rays; by default at one point, as the others do.

    `settings` are those of :func:`measure`.
    """
    given: dict[str, Any] = {"theta_i": THETA_I, "footprint": "point"} | settings

    def _flux(rays: int, seed: int) -> Floats:
        record: Any = measure(
            specimen,
            collector=subdivision,
            rays=rays,
            batches=batches,
            estimator=estimator,
            sampler=sampler,
            seed=seed,
            **given,
        )
        return record.brdf[..., 0] * subdivision.projected_solid_angles

    shown = "1 batch" if batches == 1 else f"{batches} batches"
    points = given.get("points", 1)
    if points > 1:
        shown = f"{points} points, {shown}"
    name = f"gonio-mi, {sampler}, {estimator}, {shown}"
    first = max(2**12 // points, batches)
    return Baseline(name, _flux, subdivision, first=first)


def samples(specimen: dict[str, Any], rays: int) -> Callable[[], None]:
    """Run of independent random numbers and Mitsuba's ``sample`` alone.

    Less than that is not to be had, whatever is done with the directions.
    """
    bsdf = mi.load_dict(specimen)
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(direction(np.radians(THETA_I), 0.0).tolist())
    dr.make_opaque(si.wi)

    def _run() -> None:
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(0, rays)
        bs, weight = bsdf.sample(
            mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d()
        )
        dr.eval(dr.sum(bs.wo.x + bs.wo.y + bs.wo.z + dr.sum(weight)))
        dr.sync_thread()

    return _run


def patch_integrals(specimen: dict[str, Any]) -> Baseline:
    """Our adaptive integral of ``eval``; its size is one over the tolerated error."""

    def _flux(size: int, seed: int) -> Floats:
        del seed
        bsdf = mi.load_dict(specimen)
        return integrate(bsdf, THETA_I, 0, PATCHES, integral_err=1 / size).flux[
            0, ..., 0
        ]

    return Baseline(
        "gonio-mi, integral of eval", _flux, size="1 / rel_err", first=1, random=False
    )


def chi2_rays(specimen: dict[str, Any]) -> Baseline:
    """The histogram that Mitsuba's chi-square test fills.

    It counts directions whatever their weight, which is the reflectance of nothing but
    white surfaces, on a grid of ``(phi, cos(theta))``: 30x30 patches of equal solid
    angle above, and as many below.
    """
    wi = direction(np.radians(THETA_I), 0.0).tolist()
    sample, pdf = mi.chi2.BSDFAdapter(specimen["type"], specimen, wi=wi)
    patches = EqualSolidAngle(30, 30)

    def _flux(rays: int, seed: int) -> Floats:
        test = mi.chi2.ChiSquareTest(
            domain=mi.chi2.SphericalDomain(),
            sample_func=sample,
            pdf_func=pdf,
            sample_dim=3,
            sample_count=rays,
            res=2 * patches.n_theta,
            seed=seed,
        )
        test.tabulate_histogram()
        # rows from the pole down, columns of azimuth from -180 degrees
        counts = test.histogram.numpy().reshape(2 * patches.n_theta, patches.n_phi)
        upper = counts[: patches.n_theta].astype(float)
        return np.roll(upper, -(patches.n_phi // 2), axis=1) / rays

    return Baseline("mi.chi2 histogram", _flux, patches)


def numpy_rays() -> Baseline:
    """A white Lambertian surface, in blocks of NumPy."""

    def _flux(rays: int, seed: int) -> Floats:
        generator = np.random.default_rng(seed)
        counts = np.zeros(PATCHES.n_patches, np.int64)
        for start in range(0, rays, 2**18):
            n = min(2**18, rays - start)
            sin2, turn = generator.random((2, n), dtype=np.float32)
            r, phi = np.sqrt(sin2), np.float32(2 * np.pi) * turn
            x, y = r * np.cos(phi), r * np.sin(phi)
            v = np.stack([x, y, np.sqrt(1 - sin2)], axis=-1)
            counts += np.bincount(PATCHES.patch(v), minlength=PATCHES.n_patches)
        return counts.reshape(PATCHES.shape) / rays

    return Baseline("NumPy", _flux)


@cache
def _numba_loop() -> Callable[[int, int, int, int], Any]:
    """Compiled loop that threads may share, or ImportError without numba."""
    import numba

    @numba.njit(nogil=True, fastmath=True)
    def _count(rays: int, seed: int, n_theta: int, n_phi: int) -> Any:
        # numba knows the legacy generator only, one in each thread
        np.random.seed(seed)  # noqa: NPY002
        own = np.zeros(n_theta * n_phi, np.uint32)
        for _ in range(rays):
            r = np.sqrt(np.random.random())  # noqa: NPY002
            phi = 2 * np.pi * np.random.random()  # noqa: NPY002
            x, y = r * np.cos(phi), r * np.sin(phi)
            ring = min(int((x * x + y * y) * n_theta), n_theta - 1)
            turn = np.arctan2(y, x) / (2 * np.pi)
            sector = min(int((turn + (turn < 0)) * n_phi), n_phi - 1)
            own[ring * n_phi + sector] += 1
        return own

    return _count


def numba_rays() -> Baseline:
    """A white Lambertian surface, in a parallel loop; ImportError without numba."""
    count, n_parts = _numba_loop(), 16

    def _flux(rays: int, seed: int) -> Floats:
        def _part(part: int) -> Any:
            n = rays * (part + 1) // n_parts - rays * part // n_parts
            return count(n, seed * n_parts + part, *PATCHES.shape)

        with ThreadPoolExecutor(dr.thread_count()) as pool:
            counts = sum(pool.map(_part, range(n_parts)), np.zeros(1, np.int64))
        return counts.reshape(PATCHES.shape) / rays

    return Baseline("numba, parallel loop", _flux)


def c_rays() -> Baseline:
    """A white Lambertian surface, in vectorised C; CompilerError without a compiler."""
    c_loop.library()

    def _flux(rays: int, seed: int) -> Floats:
        return c_loop.count_diffuse(rays, seed, PATCHES, dr.thread_count()) / rays

    return Baseline("C, vectorised by hand", _flux)


def without_renderer() -> tuple[list[Baseline], list[str]]:
    """What counts a white Lambertian surface without Mitsuba, as far as it is there.

    Returns
    -------
    found : list of Baseline
    absent : list of str
        One sentence for each that is left out.
    """
    found, absent = [], []
    for build in (numpy_rays, numba_rays, c_rays):
        try:
            found.append(build())
        except ImportError:
            absent.append("numba is left out: pip install '.[benchmark]'")
        except c_loop.CompilerError as error:
            absent.append(f"the C loop is left out: {error}")
    return found, absent
