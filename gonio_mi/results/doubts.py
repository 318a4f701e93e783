"""Sentences on what makes a result doubtful, or its bits hard to repeat."""

from typing import Any

import numpy as np

from .record import Record
from .tally import Ledger

__all__ = ["doubts", "exceeds_error", "grouped"]

# A smaller share of rays beside the patches is rounding: `diffuse` alone sends 2 in 1e7
# along the horizon.
STRAY = 1e-6

# How light gets to the other side of a specimen whose BSDFs declare no transmission: by
# what a few thousand straight rays found.
PASSED = {
    "none": "leaked to the other side, where straight rays find no gap and no BSDF "
    "declares transmission: the geometry is not closed",
    "gaps": "went to the other side through gaps of the geometry or around its edges, "
    "as they should between threads or fibres but not in a closed surface",
}

# What `missed` rays ask for.
MISSED = (
    "missed the specimen; they are not part of the incident flux: if it stands for a "
    "larger surface with openings, give a period, which counts them as transmitted; if "
    "these are its edges, take a smaller footprint"
)


def doubts(record: Record, directions: list[dict[str, Any]]) -> list[str]:
    """Sentences on a record, of which `directions` are the numbers.

    See :func:`~gonio_mi.results.summary.summarize`.
    """
    ledger, sentences = record.ledger, list(record.provenance.defects)
    media = record.provenance.media
    called = "sample()"
    if record.asked.estimator.deposits:
        called += " or eval()"
    if ledger.invalid:
        sentences.append(
            f"{_share(ledger.invalid, ledger)} are invalid: the BSDF's {called} "
            "returned a weight that is negative, infinite or NaN, or no unit "
            "direction; their flux is in no patch"
        )
    if ledger.truncated:
        limits = "max_depth or max_scatterings" if media else "max_depth"
        sentences.append(
            f"{_share(ledger.truncated, ledger)} were truncated by {limits}; their "
            "flux is in no patch"
        )
    if ledger.astray:
        sentences.append(
            f"{_share(ledger.astray, ledger)} went astray: a shape with a medium is "
            "open or overlaps another; their flux is in no patch"
        )
    rows = {
        "sideways": "left sideways, over the edge of the specimen, into no patch",
        "missed": MISSED,
        "direct": "passed openings of the periodic cell straight on and are "
        "transmitted, as they should between threads or slats but not in a closed "
        "surface",
    }
    if media:
        del rows["direct"]  # it passed a layer, as it should
    transmission = record.provenance.transmission
    if ledger.direct and transmission == "none":
        transmission = "gaps"  # which the few thousand rays did not find
    passed = PASSED.get(str(transmission))
    if passed:
        rows["transmitted"] = passed
    for row, sentence in rows.items():
        if any(exceeds_error(direction, row) for direction in directions):
            sentences.append(
                f"{_share(getattr(ledger, row), ledger)} {sentence}: more than the "
                "statistical error"
            )
    several = record.provenance.each_processor
    if len(several) > 1:
        sentences.append(
            "its parts were measured on unlike processors, or with other vectors or "
            f"LLVM ({'; '.join(several)}): the statistics hold, but no single one "
            "of them repeats these bits"
        )
    return sentences


def exceeds_error(direction: dict[str, Any], row: str) -> bool:
    """Whether a row of the ledger is larger than the totals' statistical error.

    `direction` is one of those of :func:`~gonio_mi.results.summary.summarize`.
    """
    totals = direction["dhr"] + (direction["dht"] or [])
    # half the interval; NaN, where it is not known, is skipped by fmax
    half = np.array([(total["high"] - total["low"]) / 2 for total in totals])
    error = np.fmax.reduce(half, initial=STRAY)
    return direction["ledger"][row] > error * direction["ledger"]["emitted"]


def _share(n: int, ledger: Ledger) -> str:
    return f"{grouped(n)} of {grouped(ledger.emitted)} rays"


def grouped(n: int) -> str:
    """Whole number with its digits in groups of three."""
    return f"{n:,}".replace(",", " ")
