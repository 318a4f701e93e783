"""How often 95 % intervals hold: ``python tests/tools/study_of_quantities.py``.

Of each quantity, and of 1e3 to 1e6 rays, the part of 200 seeds whose interval has the
value of many more rays. ``--rays N ...``, ``--seeds N`` and ``--truth N`` choose
others. ``--cost`` prints instead the CPU seconds of a standard error of 1 %, beside a
map of 900 patches.
"""

import argparse
import time
from pathlib import Path

import gonio_mi as gonio

# isort: split
import mitsuba as mi

SCENES = Path(__file__).parents[2] / "scenes"
GLASS = {"type": "roughdielectric", "alpha": 0.1}
WHITE = {"type": "diffuse", "reflectance": 0.5}

# Names by specimen; those of the truth have so many rays.
STUDIES = {
    "rough glass": (
        GLASS,
        *("gloss20", "gloss60", "gloss85", "reflection_haze", "haze", "transmittance"),
        *("direct", "diffuse", "tis", "8/di", "8/de", "di/8", "de/8"),
    ),
    "white": (WHITE, "gloss20", "45/0", "0/45", "brf", "8/de", "di/8", "R_A"),
    "rough mirror": (
        {"type": "roughconductor", "alpha": 0.2},
        *("lobe_inner", "lobe_outer", "lobe_asymmetry"),
    ),
    "beads": (SCENES / "beads.xml", "R_A", "R_A:observation=2", "R_L:entrance=-30"),
    "threads": (SCENES / "crossed_threads.xml", "openness", "diffuse", "haze"),
}
TRUTH = 3 * 10**7


def stated(specimen, names, **settings):
    """Quantities by name; None for one that says it has no value."""
    try:
        return dict(zip(names, gonio.quantity(names, specimen, **settings)))
    except gonio.FileFormatError:
        raise
    except ValueError as error:
        if len(names) == 1:
            return {names[0]: None, "": str(error)}
        return {
            k: v for n in names for k, v in stated(specimen, [n], **settings).items()
        }


def seconds(run, *words, **settings):
    """CPU seconds of the second of two runs: the first one compiles kernels."""
    run(*words, **settings)
    began = time.process_time()
    run(*words, **settings)
    return time.process_time() - began


def print_costs(titles):
    """Print CPU seconds to a relative standard error of 1 %, by doubling the rays."""
    for title in titles:
        specimen, *names = STUDIES[title]
        spent = seconds(gonio.measure, specimen, 8, rel_err=0.01)
        print(f"{title}: map of 900 patches to 1 %, {spent:.2f} s", flush=True)
        for name in names:
            for power in range(10, 30):
                found = stated(specimen, [name], rays=2**power)[name]
                if found and found.std_err <= 0.01 * abs(found.value):
                    break
            spent = seconds(stated, specimen, [name], rays=2**power)
            print(f"{title} {name}: 2**{power} rays, {spent:.3f} s", flush=True)


def main():
    """Print a table of coverage."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rays", nargs="+", type=float, default=[1e3, 1e4, 1e5, 1e6])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--sampler", default="sobol")
    parser.add_argument("--only", nargs="+", default=list(STUDIES))
    parser.add_argument("--cost", action="store_true")
    parser.add_argument("--truth", type=float, default=TRUTH)
    options = parser.parse_args()
    mi.set_variant("llvm_ad_mono")
    if options.cost:
        print_costs(options.only)
        return
    for title in options.only:
        specimen, *names = STUDIES[title]
        truth = stated(specimen, names, rays=int(options.truth), seed=10**6)
        for rays in options.rays:
            began = time.process_time()
            runs = [
                stated(
                    specimen, names, rays=int(rays), seed=seed, sampler=options.sampler
                )
                for seed in range(options.seeds)
            ]
            spent = (time.process_time() - began) / len(runs)
            for name in names:
                found = [run[name] for run in runs if run[name] is not None]
                held = [
                    x.interval[0] <= truth[name].value <= x.interval[1] for x in found
                ]
                hits = sum(x.hits for x in found) / max(len(found), 1)
                part = sum(held) / max(len(held), 1)
                print(
                    f"{title:12} {name:18} {rays:8.0e} rays, {hits:9.1f} arrived, "
                    f"held {part:.3f} of {len(found)}, {spent:.2f} s for all",
                    flush=True,
                )


if __name__ == "__main__":
    main()
