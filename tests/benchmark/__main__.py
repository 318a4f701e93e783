"""Command line of the benchmark."""

import argparse
import sys
from collections.abc import Sequence

import mitsuba as mi

from . import (
    commands,
    growth,
    materials,
    pictures,
    reference_cases,
    round_trips,
    stock,
    windows,
)
from .automatic import print_auto_costs, print_auto_coverage
from .batch_designs import print_ratios
from .counting import print_rates
from .coverage import CASES, print_coverage
from .diffuse_facets import facet_contests
from .equal_error import print_contests, print_costs
from .micro_geometry import print_speeds
from .stacks import print_integrals, print_stacks
from .tolerances import print_campaigns
from .turbid_layer import layer_contests, print_layer_speeds

# Tables of their own, each with its own options.
TABLES = {
    "commands": commands.main,
    "growth": growth.main,
    "materials": materials.main,
    "pictures": pictures.main,
    "reference_cases": reference_cases.main,
    "round_trips": round_trips.main,
    "stock": stock.main,
    "windows": windows.main,
}

# Parts of the benchmark that are options without a value.
PARTS = {
    "counting": "raw speed only",
    "equal-error": "equal error only",
    "geometry": "paths on a rough mirror, and equal error on diffuse facets, instead",
    "media": "rays through a medium, and equal error beside volpath, instead",
    "integrals": "a stack of them and each, instead",
    "stacks": "what a direction costs among 1 to 1000, and their memory, instead",
    "error": "sobol against independent rays, instead",
    "coverage": "of intervals of 95 %%, instead",
    "auto": "the estimator auto beside others, and its coverage, instead",
}


def main(argv: Sequence[str]) -> None:
    """Compare with others, or run one part of the benchmark, and print tables."""
    if argv and argv[0] in TABLES:
        TABLES[argv[0]](argv[1:])
        return
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmark",
        description="Compare the instrument with what a user would pick instead: raw "
        "speed, and the cost of a map of equal error. Ratios of medians in turns. "
        f"Other tables: {', '.join(TABLES)}, each as the first word.",
    )
    part = parser.add_mutually_exclusive_group()
    for name, what in PARTS.items():
        part.add_argument(f"--{name}", action="store_true", help=what)
    what = "what campaigns of this tolerance cost, beside grids; hours below 0.01"
    part.add_argument("--tolerance", type=float, metavar="X", help=what)
    add = parser.add_argument
    what = "specimens of --tolerance, --auto (no coverage) or --coverage"
    add("--only", nargs="+", default=(), help=what)
    add("--theta-max", type=float, default=80.0, help="of --tolerance")
    what = "--tolerance without grids beside it"
    add("--no-grids", action="store_true", help=what)
    what = (
        "for raw speed 1.7e7, for --error 1e8, for --geometry 4.2e6, for --media "
        "2.1e6, for --stacks 16384, and the most for --coverage 1e6, if not given"
    )
    add("--rays", type=float, help=what)
    add("--repeats", type=int, default=7)
    add("--seeds", type=int, default=6, help="for --error (6)")
    add("--target", type=float, default=0.01, help="RMS error to reach (0.01)")
    what = "CPU seconds of one run, beyond which costs are extrapolated (10)"
    add("--limit", type=float, default=10.0, help=what)
    add("--variant", default="llvm_ad_mono")
    options = parser.parse_args(argv)
    mi.set_variant(options.variant)
    _run(options)


def _run(options: argparse.Namespace) -> None:
    """Print what was asked for."""
    cost = options.target, options.repeats, options.limit
    if options.error:
        print_ratios(int(options.rays or 1e8), options.seeds, options.repeats)
    elif options.geometry:
        print_speeds(int(options.rays or 2**22), options.repeats)
        print_contests(*facet_contests(), *cost)
    elif options.integrals:
        print_integrals(options.repeats)
    elif options.stacks:
        print_stacks(int(options.rays or 2**14), options.repeats)
    elif options.tolerance:
        asked = options.tolerance, options.only, options.theta_max
        print_campaigns(*asked, not options.no_grids)
    elif options.media:
        print_layer_speeds(int(options.rays or 2**21), options.repeats)
        print_contests(*layer_contests(), *cost)
    elif options.coverage:
        print_coverage(int(options.rays or 1e6), options.only or tuple(CASES))
    elif options.auto:
        for wish in ("rel_err", "noise"):
            print_auto_costs(wish, *cost, options.only)
        if not options.only:
            print_auto_coverage()
    else:
        if not options.equal_error:
            print_rates(int(options.rays or 2**24), options.repeats)
        if not options.counting:
            print_costs(*cost)


if __name__ == "__main__":
    main(sys.argv[1:])
