"""The numbers of a record, and sentences on what makes them doubtful."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

import numpy as np

from .gradients import Slope, slopes_of
from .planning import patch_values, precision, relative_errors
from .record import Record
from .tally import Ledger, grouped, holds_integrals

LEVEL = 0.95
N_WORST = 5

# A smaller share of rays beside the patches is rounding: `diffuse` alone sends 2 in 1e7
# along the horizon.
MAX_STRAY = 1e-6

# How light gets to the other side of a specimen whose BSDFs declare no transmission: by
# what a few thousand straight rays found.
PASSED = {
    "none": "leaked to the other side, where straight rays find no gap and no BSDF "
    "declares transmission: the geometry is not closed",
    "gaps": "went to the other side through gaps of the geometry, as they should "
    "between threads or fibres but not in a closed surface",
}

# What `missed` rays ask for.
MISSED = (
    "missed the specimen; they are not part of the incident flux: if it stands for a "
    "larger surface with openings, give a period (--period box), which counts them as "
    "transmitted"
)

# And where the footprint is not the outline of a solid.
AT_EDGES = "; if these are its edges, take a smaller footprint (--footprint)"

# And what rays over an edge do that may be none.
OVER_THE_EDGE = (
    "left over the edge of the specimen and count by their direction; if it stands for "
    "a larger surface, give a period (--period box) or take a smaller footprint"
)


@dataclass(frozen=True)
class Total:
    """A hemisphere's total in one channel, with the limits of its interval."""

    channel: str
    value: float | None
    std_err: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True)
class DirectionSummary:
    """Numbers of one incident direction.

    Attributes
    ----------
    theta_i, phi_i : float or None
        In degrees.
    dhr, dht, direct : list of Total
        For each channel. None without a lower hemisphere; `direct` but for periodic
        specimens whose direct light is collected.
    ledger : dict of int
        Rows of the ledger, ``emitted``, and of these ``over_the_edge``.
    n_patches, n_without_hit, n_pooled, n_lobe : int
        Patches in all, those known by an upper limit only, those that are judged by
        the hits of all, and those that reach a tenth of the mean.
    rel_err_lobe : float or None
        Largest relative standard error of the latter.
    gradients : list of Slope
        Of the totals.
    """

    theta_i: float | None
    phi_i: float | None
    dhr: list[Total]
    dht: list[Total] | None
    direct: list[Total] | None
    ledger: dict[str, int]
    n_patches: int
    n_without_hit: int
    n_pooled: int
    n_lobe: int
    rel_err_lobe: float | None
    gradients: list[Slope]

    @property
    def totals(self) -> list[tuple[str, Total]]:
        """All totals with the names of their quantities."""
        every = {"dhr": self.dhr, "dht": self.dht, "direct": self.direct}
        return [(name, one) for name, totals in every.items() for one in totals or []]

    def exceeds_error(self, row: str) -> bool:
        """Whether a row of the ledger is above the totals' statistical error."""
        totals = self.dhr + (self.dht or [])
        limits = [one.low for one in totals], [one.high for one in totals]
        error = _largest_error(*limits)
        return self.ledger[row] > error * self.ledger["emitted"]


@dataclass(frozen=True)
class PatchSummary:
    """A patch, angles in degrees, and its BRDF or BTDF; no hits of an integral.

    All directions outside of apertures are one patch, without angles.
    """

    theta_i: float | None
    phi_i: float | None
    of: str
    channel: str
    theta_o: float | None
    phi_o: float | None
    value: float
    std_err: float
    rel_err: float
    hits: int | None


@dataclass(frozen=True)
class Summary:
    """The numbers of a record; None for what is not known.

    Attributes
    ----------
    record : Record
    directions : list of DirectionSummary
    worst_patches : list of PatchSummary
        Of the largest relative standard error among those that reach a tenth of the
        mean.
    warnings : list of str
        Sentences on what makes the record doubtful, or its bits hard to repeat.
    back : Summary, optional
        Of the record's back.
    """

    record: Record
    directions: list[DirectionSummary]
    worst_patches: list[PatchSummary]
    warnings: list[str]
    back: Summary | None = None

    @property
    def integrals(self) -> bool:
        """Whether integrals stand for rays, but for those of delta components."""
        return holds_integrals(self.record.tallies)

    @property
    def ledger(self) -> dict[str, int]:
        """Rows of the ledger over all incident directions, as of one."""
        return _ledger(self.record)

    def as_mapping(self) -> dict[str, Any]:
        """The numbers in JSON's types, with ``settings``, and the intervals' ``level``.

        The settings have the collector, hemispheres and channels beside the record's.
        """
        record = self.record
        settings = {key: _known(value) for key, value in record.settings.items()}
        settings["collector"] = str(record.subdivision)
        settings["hemispheres"] = "both" if record.has_lower else "upper"
        settings["channels"] = list(record.channels)
        back = {} if self.back is None else {"back": self.back.as_mapping()}
        return {
            "integrals": self.integrals,
            "settings": settings,
            "level": LEVEL,
            "directions": [
                asdict(one) | _matrices(record[i])
                for i, one in enumerate(self.directions)
            ],
            "ledger": self.ledger,
            "worst_patches": [asdict(one) for one in self.worst_patches],
            "warnings": self.warnings,
            **back,
        }


def _matrices(single: Record) -> dict[str, Any]:
    """Mueller matrices of the totals with their standard errors, if there are some."""
    names = ("dhr_mueller", "dht_mueller")
    values = {
        f"{name}{ending}": getattr(single, f"{name}{ending}")
        for name in names
        for ending in ("", "_std_err")
    }
    return {
        key: [[[_known(x) for x in row] for row in one] for one in value.tolist()]
        for key, value in values.items()
        if value is not None
    }


def summarize(record: Record) -> Summary:
    """Return the numbers of `record`, and what makes them doubtful."""
    looks = list(record)
    directions = [_direction(look) for look in looks]
    patches = [patch for look in looks for patch in _worst_patches(look)]
    patches.sort(key=lambda patch: -patch.rel_err)
    warnings = _warnings(record, directions)
    back = None if record.back is None else summarize(record.back)
    return Summary(record, directions, patches[:N_WORST], warnings, back)


def _direction(look: Record) -> DirectionSummary:
    """Numbers of one incident direction."""
    worst, n_lobe = precision(look)
    # direct light was collected, however little there was
    has_direct = look.asked.period != "none" and look.asked.order.least == 0
    return DirectionSummary(
        theta_i=_known(float(look.theta_i[0])),
        phi_i=_known(float(look.phi_i[0])),
        dhr=_totals(look, "dhr"),
        dht=_totals(look, "dht") if look.has_lower else None,
        direct=_totals(look, "direct") if has_direct else None,
        ledger=_ledger(look),
        n_patches=look.counts.size,
        n_without_hit=int(np.sum(look.without_hit)),
        n_pooled=int(np.sum(look.pooled)),
        n_lobe=n_lobe,
        rel_err_lobe=_known(worst),
        gradients=slopes_of(look, LEVEL),
    )


def _ledger(record: Record) -> dict[str, int]:
    return vars(record.ledger) | {"emitted": record.ledger.emitted}


def _totals(look: Record, quantity: str) -> list[Total]:
    """One hemisphere's total, per channel."""
    low, high = look.interval(LEVEL, of=quantity)
    std_err = getattr(look, f"{quantity}_std_err")
    columns = zip(look.channels, getattr(look, quantity), std_err, low, high)
    return [
        Total(channel, *(_known(float(one)) for one in values))
        for channel, *values in columns
    ]


def _largest_error(low: Any, high: Any) -> float:
    """Half of the widest interval, at least `MAX_STRAY`; limits may be None or NaN."""
    errors = (np.array(high, dtype=float) - np.array(low, dtype=float)) / 2
    return float(np.max(errors, initial=MAX_STRAY, where=np.isfinite(errors)))


def _worst_patches(look: Record) -> list[PatchSummary]:
    """Patches worth reporting with the largest relative standard error."""
    quantities = ("brdf", "btdf") if look.has_lower else ("brdf",)
    value = patch_values(look, "brdf", "btdf")
    std_err = patch_values(look, "brdf_std_err", "btdf_std_err")
    relative = relative_errors(look)
    relative[np.isinf(relative)] = np.nan  # not known, which sorts last
    order = np.argsort(-relative, axis=None, kind="stable")[:N_WORST]
    worst = []
    for index in zip(*np.unravel_index(order, value.shape)):
        if not np.isfinite(relative[index]):
            break
        hemisphere, i, j, channel = index
        hits = int(look.counts[hemisphere, i, j])
        theta_o, phi_o = (np.degrees(a[i, j]) for a in look.subdivision.middles)
        worst.append(
            PatchSummary(
                theta_i=_known(float(look.theta_i[0])),
                phi_i=_known(float(look.phi_i[0])),
                of=quantities[hemisphere],
                channel=look.channels[channel],
                theta_o=_known(float(180 - theta_o if hemisphere else theta_o)),
                phi_o=_known(float(phi_o)),
                value=float(value[index]),
                std_err=float(std_err[index]),
                rel_err=float(relative[index]),
                hits=None if holds_integrals(look.tallies) and not hits else hits,
            )
        )
    return worst


def _known(value: Any) -> Any:
    """None in place of NaN and infinity, which JSON does not have."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


# ---------------------------------------------------------------------------- warnings


def _warnings(record: Record, directions: Sequence[DirectionSummary]) -> list[str]:
    """Sentences on what makes a record doubtful, or its bits hard to repeat."""
    ledger, provenance = record.ledger, record.provenance
    sentences = list(provenance.defects)
    called = "sample()"
    if record.asked.sends_points:
        called += " or eval()"
    if ledger.invalid:
        sentences.append(
            f"{_share(ledger.invalid, ledger)} are invalid: the BSDF's {called} "
            "returned a weight that is negative, NaN or above 32768 (along a path "
            "2**30), or no unit direction; their flux is in no patch"
        )
    if ledger.astray:
        sentences.append(
            f"{_share(ledger.astray, ledger)} went astray: a shape with a medium is "
            "open or overlaps another; their flux is in no patch"
        )

    def exceeds(row: str) -> bool:
        return any(direction.exceeds_error(row) for direction in directions)

    sentences += _lost_light(record, exceeds)
    rows = {}
    if not provenance.media:  # else it passed a layer, as it should
        rows["direct"] = (
            "passed openings of the periodic cell straight on and are transmitted, as "
            "they should between threads or slats but not in a closed surface"
        )
    transmission = provenance.transmission
    if ledger.direct and transmission == "none":
        transmission = "gaps"  # which the few thousand rays did not find
    if transmission in PASSED and not provenance.edges:
        rows["transmitted"] = PASSED[transmission]
    sentences += _excessive_rows(ledger, exceeds, rows)
    several = provenance.each_processor
    if len(several) > 1:
        sentences.append(
            "its parts were measured on unlike processors, or with other vectors or "
            f"LLVM ({'; '.join(several)}): the statistics hold, but no single one "
            "of them repeats these bits"
        )
    return sentences


def lost_light(record: Record) -> list[str]:
    """Sentences on light that is in no patch, missed the specimen, or left its edges.

    Beside that which a BSDF or a medium has lost by a mistake.
    """
    ledger = record.ledger
    stray = ledger.sideways + ledger.missed + ledger.over_the_edge
    if not ledger.truncated and stray <= MAX_STRAY * ledger.emitted:
        return []  # without looking for the statistical error

    @cache
    def error(number: int) -> float:
        """Statistical error of a direction, which takes longer than a few rays."""
        light = record.estimates[number]
        totals = (light.total(i) for i in range(record.n_hemispheres))
        low, high = zip(*(total.interval(LEVEL) for total in totals))
        return _largest_error(low, high)

    def exceeds(row: str) -> bool:
        """Whether a row is above the statistical error in any direction."""
        return any(
            getattr(own, row) > error(number) * own.emitted
            for number, own in enumerate(tally.ledger for tally in record.tallies)
            if getattr(own, row) > MAX_STRAY * own.emitted
        )

    return _lost_light(record, exceeds)


def _lost_light(record: Record, exceeds: Callable[[str], bool]) -> list[str]:
    ledger, sentences = record.ledger, []
    if ledger.truncated:
        media = record.provenance.media
        limits = "max_depth or max_scatterings" if media else "max_depth"
        sentences.append(
            f"{_share(ledger.truncated, ledger)} were truncated by {limits}; their "
            "flux is in no patch"
        )
    edges = record.provenance.edges
    outlined = edges == "closed" and record.asked.footprint == "full"
    missed = MISSED if outlined else MISSED + AT_EDGES
    rows = {"sideways": "left sideways, into no patch", "missed": missed}
    if edges == "open":
        rows["over_the_edge"] = OVER_THE_EDGE
    return sentences + _excessive_rows(ledger, exceeds, rows)


def _excessive_rows(
    ledger: Ledger, exceeds: Callable[[str], bool], rows: dict[str, str]
) -> list[str]:
    """Sentences on those of the `rows` that exceed the statistical error."""
    return [
        f"{_share(getattr(ledger, row), ledger)} {sentence}: more than the "
        "statistical error"
        for row, sentence in rows.items()
        if exceeds(row)
    ]


def _share(n: int, ledger: Ledger) -> str:
    return f"{grouped(n)} of {grouped(ledger.emitted)} rays"
