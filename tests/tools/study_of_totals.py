"""How often intervals of totals of few hits hold, for the table of the handbook.

    export PYTHONPATH=tests:tests/references
    python tests/tools/study_of_totals.py 300

The number is that of the seeds; it takes some minutes.
"""

import sys

import gonio_mi as gonio

# isort: split
import mitsuba as mi
import numpy as np
from core.results.test_coverage import FEW_HITS, few_hits

HITS = (3, 8, 24, 50, 100)


def held(name, hits, seeds):
    """Share of the seeds whose interval held, and mean width over the truth."""
    specimen, of, truth, how = few_hits(name, hits)
    specimen, found = mi.load_dict(specimen), []
    for seed in range(1000, 1000 + seeds):
        (low,), (high,) = gonio.measure(specimen, 30, seed=seed, **how).interval(of=of)
        found.append((low <= truth <= high, (high - low) / truth))
    return np.mean(found, axis=0)


def main(seeds=300):
    """Print a row for each case."""
    mi.set_variant("llvm_ad_mono")
    for name in FEW_HITS:
        cells = [held(name, hits, seeds) for hits in HITS]
        print(name, *(f"{part:.3f} ({width:.2f})" for part, width in cells), sep=" | ")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
