"""Whole commands of the program, start-up included, and what importing costs."""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from .table import print_table
from .timing import in_turns

ROUGH = "roughconductor:alpha=0.3,distribution=ggx"

# Each makes what those after it read.
COMMANDS = (
    "--help",
    f"measure {ROUGH} --theta-i 30 --rays 1e6 -o run.npz",
    "show run.npz",
    f"compare run.npz {ROUGH}",
    f"validate {ROUGH} --effort quick",
)
IMPORTS = ("import mitsuba, numpy", "import gonio_mi")


def main(argv: Sequence[str]) -> None:
    """Print what commands cost, of this checkout and beside another one."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmark commands",
        description="CPU and clock time of whole commands, medians in turns; Python's "
        "bytecode is cached, as users have it.",
    )
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument(
        "--against", type=Path, metavar="FOLDER", help="another checkout"
    )
    options = parser.parse_args(argv)
    roots = [Path.cwd()] if options.against is None else [options.against, Path.cwd()]
    python = [sys.executable, "-c"]
    program = str(Path(sys.executable).with_name("gonio-mi"))
    lines = {text: [*python, text] for text in IMPORTS}
    lines |= {text: [program, *text.split()] for text in COMMANDS}
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for text, words in lines.items():
            runs = {root: partial(_run, words, root, folder) for root in roots}
            for root, one in in_turns(runs, options.repeats).items():
                rows.append((text, root.name, f"{one.cpu:.2f}", f"{one.wall:.2f}"))
    print_table("Commands", ("command", "checkout", "CPU s", "s"), rows)


def _run(words: Sequence[str], root: Path, folder: str) -> None:
    """Run a command with the package of a checkout."""
    own = {"PYTHONPATH": str(root.resolve()), "PYTHONPYCACHEPREFIX": folder}
    environment = os.environ | own
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    subprocess.run(words, cwd=folder, env=environment, capture_output=True, check=True)
