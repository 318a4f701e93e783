"""``gonio-mi plan``: estimate how many rays a measurement needs.

Estimate how many rays a measurement needs: by the bounds of Krishnaswamy et al. (2004)
on the absolute error of the flux, and for a relative error of all patches at once.

examples:
  gonio-mi plan
  gonio-mi plan --collector projected:100x100 --rel-err 0.005
  gonio-mi measure principled --theta-i 30 --rays 1e5 -o pilot.npz
  gonio-mi plan pilot.npz --level 0.99

Without a pilot, a white Lambertian specimen is assumed, which illuminates every patch.
The numbers are for independent rays; the sampler sobol needs fewer.
"""

from argparse import ArgumentParser, Namespace
from dataclasses import asdict

from .arguments import DONE, add_json, add_number, add_text, tell, tell_json
from .file_kinds import record_of


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    text = "A first record of the specimen at one incident direction."
    add_text(parser, "pilot", "PILOT", text, nargs="?")
    patches = "projected:30x30"
    text = f"Patches, without a pilot. Default: {patches}."
    add_text(parser, "--collector", "KIND:NTxNP", text, default=patches)
    text = "Absolute error of a flux fraction, for the bounds."
    add_number(parser, "--epsilon", "E", text, 0.005)
    add_number(parser, "--delta", "D", "Probability of exceeding --epsilon.", 0.01)
    text = "Relative error of every patch of at least --floor times the mean BRDF."
    add_number(parser, "--rel-err", "X", text, 0.01)
    text = "Probability that no such patch exceeds --rel-err."
    add_number(parser, "--level", "P", text, 0.95)
    text = "Fraction of the mean BRDF below which patches are left out."
    add_number(parser, "--floor", "F", text, 0.1)
    add_json(parser)


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    from ..results.planning import plan  # SciPy's statistics are slow to import

    pilot = None if options.pilot is None else record_of(options.pilot)
    names = ("collector", "epsilon", "delta", "rel_err", "level", "floor")
    planned = plan(pilot, **{name: getattr(options, name) for name in names})
    if options.json:
        tell_json(asdict(planned))
    else:
        tell(planned)
    return DONE
