"""Command line of the benchmark."""

import argparse

import mitsuba as mi

from .counting import print_rates

__all__ = ["main"]


def main(argv=None):
    """Run the benchmark and print its tables."""
    parser = argparse.ArgumentParser(
        prog="python -m gonio_mi.benchmark",
        description="Compare the instrument with what a user would pick instead.",
    )
    parser.add_argument("--rays", type=float, default=2**24)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--variant", default="llvm_ad_mono")
    options = parser.parse_args(argv)
    mi.set_variant(options.variant)
    print_rates(int(options.rays), options.repeats)


if __name__ == "__main__":
    main()
