"""False alarms of `validate` and its p-values, over many seeds: a study, not a test.

::

    export PYTHONPATH=tests:tests/references
    python tests/tools/study_of_alarms.py LOG.jsonl --seeds 200

judges the right BSDFs of right_bsdfs.py, broken_bsdfs.py and short_bsdfs.py at the
alpha of users, 1e-3, and adds one line for each verdict to the log; what is there
already is not done again. It ends with the number of verdicts, the alarms (whatever
fails of a property that is not KNOWN to), and, of each kind of statistical test, how
its p-values lie: with less than a thousandth, and the probability of so large a
deviation from a uniform law (Kolmogorov and Smirnov), of either sign and of too small
values alone.
"""

import argparse
import json
import sys
import zlib
from collections import defaultdict
from pathlib import Path

import gonio_mi  # noqa: F401 (first: it finds the LLVM for Dr.Jit)

# isort: split
import broken_bsdfs
import mitsuba as mi
import numpy as np
import right_bsdfs
import short_bsdfs
from scipy import stats

from gonio_mi.validation import maps, validate, verdict
from gonio_mi.validation.integrals import integrals

# The module, whose name the package gives to its function.
EXAMINATION = sys.modules["gonio_mi.validation.examination"]

# What a statistic is, by its first words.
VIEWS = {
    "z of the sum": "total",
    "mean z ": "mean",
    "mean z^2": "spread",
    "worst z": "worst",
    "z of all sums": "pooled",
    "a discrete lobe": "probability",
}
BLOCK = 20


def cases():
    """Right BSDFs by name."""
    heavy = {name: {"type": "heavy", "case": name} for name in right_bsdfs.HEAVY}
    own = {f"own {name}": {"type": name} for name in broken_bsdfs.RIGHT}
    names = (*right_bsdfs.PUBLISHED, *short_bsdfs.RIGHT)
    unusual = {f"unusual {name}": {"type": name} for name in names}
    return right_bsdfs.RIGHT | heavy | right_bsdfs.textured() | own | unusual


class Remembered:
    """Integrals, which do not depend on the seed, but for how far they are refined."""

    def __init__(self):
        self.known = {}

    def __call__(self, probe, subdivision, totals, limits):
        """Integrals as of :func:`gonio_mi.validation.integrals.integrals`."""
        key = probe.condition, totals.n, limits.tobytes()
        if key not in self.known:
            self.known[key] = integrals(probe, subdivision, totals, limits)
        return self.known[key]


def judged(name, bsdf, effort, seed):
    """Line of the log on one verdict."""
    tests = []

    def properties_of(evidence, *others):
        tests.extend(evidence.tests)
        return verdict.properties_of(evidence, *others)

    EXAMINATION.properties_of = properties_of
    # directions of the same random numbers have the same p-values in many plugins
    own = seed + (zlib.crc32(name.encode()) << 16)
    found = validate(bsdf, effort=effort, seed=own, strict=True)
    return {
        "name": name,
        "seed": seed,
        "effort": effort,
        "variant": mi.variant(),
        "failures": {one.name: [one.effect, one.statistic] for one in found.failures},
        "undecided": [p.name for p in found.properties if p.status == "undecided"],
        "tests": [(one.name, _view(one.statistic), one.p) for one in tests],
    }


def _view(statistic):
    return next((v for k, v in VIEWS.items() if statistic.startswith(k)), "bound")


def report(lines):
    """Print the counts of verdicts and alarms, and how p-values lie."""
    n, tests = len(lines), sum(len(line["tests"]) for line in lines)
    names = {line["name"] for line in lines}
    print(f"{n} verdicts on {len(names)} BSDFs, {tests} statistical tests")
    alarms = 0
    for line in lines:
        known = right_bsdfs.KNOWN.get(line["name"], set())
        for name, (effect, text) in line["failures"].items():
            if name not in known:
                alarms += 1
                print(f"ALARM {line['name']}, seed {line['seed']}: {name}, {effect}")
                print(f"      {text}")
    print(f"{alarms} alarms, where alpha allows {n * 1e-3:.3g}")
    kinds = defaultdict(list)
    for line in lines:
        for name, view, p in line["tests"]:
            # what few tests have fails for all seeds
            if name not in right_bsdfs.KNOWN.get(line["name"], set()):
                kinds[name, view].append(p)
    for (name, view), p in sorted(kinds.items()):
        both, small = (
            stats.kstest(p, "uniform", alternative=side).pvalue
            for side in ("two-sided", "greater")
        )
        below = [np.mean(np.array(p) < level) for level in (0.001, 0.01, 0.1)]
        print(
            f"{name:9} {view:12} {len(p):6} p-values, least {min(p):.2g}; below 0.001, "
            f"0.01, 0.1: {below[0]:.5f} {below[1]:.4f} {below[2]:.3f}; "
            f"uniform {both:.2g}, not too small {small:.2g}"
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", type=Path)
    parser.add_argument("--seeds", type=int, default=0)
    parser.add_argument("--effort", default="quick")
    parser.add_argument("--variant", default="llvm_ad_mono")
    parser.add_argument("--only", nargs="*", help="names of BSDFs")
    options = parser.parse_args()
    options.log.touch()
    lines = [json.loads(line) for line in options.log.read_text().splitlines()]
    done = {(line["name"], line["effort"], line["seed"]) for line in lines}
    mi.set_variant(options.variant)
    right_bsdfs.register()
    broken_bsdfs.register()
    short_bsdfs.register()
    chosen = cases()
    with options.log.open("a") as log:
        for begin in range(0, options.seeds, BLOCK):
            for name in options.only or chosen:
                seeds = range(begin, min(begin + BLOCK, options.seeds))
                todo = [
                    seed for seed in seeds if (name, options.effort, seed) not in done
                ]
                if not todo:
                    continue
                maps.integrals = Remembered()
                for seed in todo:
                    line = judged(name, chosen[name], options.effort, seed)
                    lines.append(line)
                    log.write(json.dumps(line) + "\n")
                    log.flush()
    report(lines)


if __name__ == "__main__":
    main()
