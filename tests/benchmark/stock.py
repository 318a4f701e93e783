"""The table of Mitsuba's own BSDFs: ``python -m tests.benchmark stock [NAME]``."""

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi

from gonio_mi.campaigns.measure import measure
from gonio_mi.exchange.exports.exporting import export
from gonio_mi.validation.examination import validate
from gonio_mi.validation.verdict import Verdict
from gonio_mi.validation.versions.stock import cases


def coloured() -> Iterator[tuple[str, dict[str, Any]]]:
    """Cases that need a variant of rgb, which must be set.

    The file of `measured` is a record of a metal that was measured here.
    """
    yield "hair", {"type": "hair"}
    metal = {"type": "roughconductor", "alpha": 0.3} | {"distribution": "ggx"}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "metal.bsdf"
        record = measure(
            metal, theta_i=range(0, 90, 15), collector="projected:20x40", rays=2**19
        )
        export(record, path)
        yield "measured", {"type": "measured", "filename": str(path)}


def _table(names: Sequence[str]) -> Iterator[tuple[str, Verdict]]:
    """Name and verdict of each case whose name begins with one of `names`, or all."""
    for variant, cases_of in (("llvm_ad_mono", cases), ("llvm_ad_rgb", coloured)):
        mi.set_variant(variant)
        for name, specimen in cases_of():
            if not names or name.startswith(tuple(names)):
                yield name, validate(specimen)


def main(names: Sequence[str]) -> None:
    """Print the table in Markdown."""
    print("| BSDF | verdict | what was found |\n|---|---|---|")
    for name, verdict in _table(names):
        found = [
            f"{one.effect}: {one.name}, {one.statistic}" for one in verdict.failures
        ]
        word = "passes" if verdict.passed else "fails"
        print(f"| {name} | {word} | {'<br>'.join(found)} |", flush=True)
