"""Rays per second, and error per ray: ``python -m gonio_mi.benchmark``.

First every method does the same work, counting the directions that a flat BSDF sends
into 900 patches, in turns, several times over; ratios of the medians are printed. Then
the samplers are compared by the error of the map that the same rays give.
"""

import argparse
import time
from statistics import median

import drjit as dr
import mitsuba as mi
import numpy as np

from . import goniophotometer
from .quadrature import integrate
from .subdivision import EqualProjectedSolidAngle

__all__ = ["main"]

SPECIMENS = {
    "diffuse": {"type": "diffuse", "reflectance": 1.0},
    "roughconductor": {"type": "roughconductor", "alpha": 0.2, "distribution": "ggx"},
}
THETA_I = 45.0

ACCURACY_SPECIMENS = {
    "diffuse": {"type": "diffuse"},
    "roughconductor 0.2": {"type": "roughconductor", "alpha": 0.2},
    "roughplastic 0.2": {"type": "roughplastic", "alpha": 0.2},
    "principled": {"type": "principled", "roughness": 0.3, "specular": 0.5},
    "roughdielectric 0.3": {"type": "roughdielectric", "alpha": 0.3},
}


def gonio_rays(specimen, estimator, sampler):
    """Return a function that measures `n` rays."""

    def run(n):
        goniophotometer.measure(
            specimen,
            THETA_I,
            rays=n,
            batches=1,
            estimator=estimator,
            sampler=sampler,
            footprint="point",  # as the others, which know no position
        )

    return run


def chi2_rays(specimen):
    """Return a function that fills Mitsuba's own chi-square histogram with `n` rays."""
    wi = [float(np.sin(np.radians(THETA_I))), 0.0, float(np.cos(np.radians(THETA_I)))]
    settings = {key: value for key, value in specimen.items() if key != "type"}
    xml = "".join(
        f'<{"string" if isinstance(v, str) else "float"} name="{k}" value="{v}"/>'
        for k, v in settings.items()
    )
    sample, pdf = mi.chi2.BSDFAdapter(specimen["type"], xml, wi=wi)

    def run(n):
        test = mi.chi2.ChiSquareTest(
            domain=mi.chi2.SphericalDomain(),
            sample_func=sample,
            pdf_func=pdf,
            sample_dim=3,
            sample_count=n,
            res=30,
        )
        test.tabulate_histogram()
        dr.sync_thread()

    return run


def numba_rays():
    """Return a function that counts `n` cosine-distributed rays in a parallel loop."""
    import numba

    @numba.njit(parallel=True, fastmath=True)
    def count(n, n_theta, n_phi, n_threads):
        counts = np.zeros((n_threads, n_theta * n_phi), np.uint32)
        for thread in numba.prange(n_threads):
            own = np.zeros(n_theta * n_phi, np.uint32)
            for _ in range(n // n_threads):
                # numba knows the legacy generator only
                r = np.sqrt(np.random.random())  # noqa: NPY002
                phi = 2 * np.pi * np.random.random()  # noqa: NPY002
                x, y = r * np.cos(phi), r * np.sin(phi)
                ring = min(int((x * x + y * y) * n_theta), n_theta - 1)
                turn = np.arctan2(y, x) / (2 * np.pi)
                sector = min(int((turn + (turn < 0)) * n_phi), n_phi - 1)
                own[ring * n_phi + sector] += 1
            counts[thread] = own
        return counts.sum(axis=0)

    grid = EqualProjectedSolidAngle(30, 30)

    def run(n):
        count(n, grid.n_theta, grid.n_phi, numba.get_num_threads())

    return run


def numpy_rays():
    """Return a function that counts `n` cosine-distributed rays in blocks of NumPy."""
    generator = np.random.default_rng(0)
    grid = EqualProjectedSolidAngle(30, 30)

    def run(n):
        counts = np.zeros(grid.n_patches, np.int64)
        for start in range(0, n, 2**18):
            sin2, turn = generator.random((2, min(2**18, n - start)), dtype=np.float32)
            r, phi = np.sqrt(sin2), np.float32(2 * np.pi) * turn
            x, y = r * np.cos(phi), r * np.sin(phi)
            v = np.stack([x, y, np.sqrt(1 - sin2)], axis=-1)
            counts += np.bincount(grid.patch(v), minlength=grid.n_patches)

    return run


def rates(methods, rays, repeats):
    """Median rays per second of each method, all of them run in turns."""
    for run in methods.values():
        run(rays)
    seconds = {name: [] for name in methods}
    for _ in range(repeats):
        for name, run in methods.items():
            start = time.perf_counter()
            run(rays)
            seconds[name].append(time.perf_counter() - start)
    return {name: rays / median(times) for name, times in seconds.items()}


def print_accuracy(rays, seeds=4):
    """Print the RMS error of 30x30 maps by either sampler, against an integral."""
    grid = EqualProjectedSolidAngle(30, 30)
    print(f"RMS error of BRDF and BTDF, {rays:g} rays, 32 batches, {seeds} seeds")
    print("                        independent   sobol    as many independent rays as")
    for name, specimen in ACCURACY_SPECIMENS.items():
        exact = integrate(mi.load_dict(specimen), THETA_I, 0, grid).values
        errors = []
        for sampler in ("independent", "sobol"):
            squares = []
            for seed in range(seeds):
                record = goniophotometer.measure(
                    specimen,
                    THETA_I,
                    collector=grid,
                    rays=rays,
                    sampler=sampler,
                    seed=seed,
                    hemispheres="both",
                )
                map_ = np.stack([record.brdf, record.btdf])
                squares.append(np.mean((map_ - exact) ** 2))
            errors.append(np.sqrt(np.mean(squares)))
        ratio = (errors[0] / errors[1]) ** 2
        print(f"  {name:20s}  {errors[0]:.2e}   {errors[1]:.2e}   x {ratio:.0f}")


def main(argv=None):
    """Run the benchmark and print a table."""
    parser = argparse.ArgumentParser(
        prog="python -m gonio_mi.benchmark", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--rays", type=float, default=2**24)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--variant", default="llvm_ad_mono")
    options = parser.parse_args(argv)
    mi.set_variant(options.variant)

    for name, specimen in SPECIMENS.items():
        methods = {
            f"gonio-mi {estimator}, {sampler}": gonio_rays(specimen, estimator, sampler)
            for sampler in ("independent", "sobol")
            for estimator in ("analog", "weighted")
        }
        methods["mi.chi2 histogram"] = chi2_rays(specimen)
        if name == "diffuse":
            methods["NumPy"] = numpy_rays()
            try:
                methods["numba, parallel"] = numba_rays()
            except ImportError:
                print("numba is left out: pip install 'gonio-mi[benchmark]'")
        results = rates(methods, int(options.rays), options.repeats)
        first = next(iter(results.values()))
        print(
            f"{name}: {options.rays:g} rays, medians of {options.repeats} runs in turns"
        )
        for method, rate in results.items():
            print(f"  {method:32s} {rate / 1e6:8.1f} Mray/s   1 : {first / rate:.2f}")
    print_accuracy(int(options.rays))


if __name__ == "__main__":
    main()
