"""Files that a record is written to, by name, and what each has lost of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ...array_types import Floats
from ...results.record import Record, fractions_of
from ...single_precision import ROUNDING
from ..formats.reading import written_as

WORDS = {"dhr": "reflected", "dht": "transmitted"}

# Fraction of the largest reflectance or transmittance below which directions are left
# out: where so little flux goes says nothing about the file.
MIN_FLUX = 0.01


@dataclass(frozen=True)
class Loss:
    """What a file says of one incident direction and hemisphere of a record.

    Attributes
    ----------
    theta_i, phi_i : float
        In degrees.
    quantity : {"dhr", "dht"}
    recorded, std_err, written : float
        Reflectance or transmittance (mean of the channels) of the record, its standard
        error, and that of the file.
    misplaced : float
        Fraction of the flux in other patches than in the record, in [0, 1]: the total
        variation distance of the two.
    noise : float
        Fraction that the record's own standard errors would misplace on average.
    side : {"front", "back"}
        The lit face.
    """

    theta_i: float
    phi_i: float
    quantity: str
    recorded: float
    std_err: float
    written: float
    misplaced: float
    noise: float
    side: str = "front"

    def __str__(self) -> str:
        return (
            f"theta_i {self.theta_i:.4g}, phi_i {self.phi_i:.4g}, {self.side}: "
            f"{self.quantity} {self.recorded:.5f} +- {self.std_err:.1g} (std_err), in "
            f"the file {self.written:.5f}; {self.misplaced:.2%} of the flux is in "
            f"other patches (the record's own noise: {self.noise:.2%})"
        )


def losses(
    record: Record, written: Floats, recorded: Floats | None = None
) -> list[Loss]:
    """Compare flux fractions of the file with those of the record.

    Parameters
    ----------
    record : Record
    written : ndarray, shape (n_incident, n_hemispheres, ..., channels)
        Of the hemispheres that the file holds, in any patches.
    recorded : ndarray, optional
        What the record says of the same patches; its own if they are those.

    Returns
    -------
    list of Loss
    """
    recorded = fractions_of(record) if recorded is None else recorded
    projected = record.subdivision.projected_solid_angles[..., None]
    every = []
    for index, hemisphere in np.ndindex(written.shape[:2]):
        one = record[index]
        name = ("dhr", "dht")[hemisphere]
        errors: Any = (one.brdf_std_err, one.btdf_std_err)[hemisphere]
        ours, theirs = recorded[index, hemisphere], written[index, hemisphere]
        total = ours.sum()
        most = max(total, theirs.sum())
        # mean of the absolute value of a normal deviate
        noise = np.sqrt(2 / np.pi) * np.nansum(errors * projected)
        n = len(record.channels)
        every.append(
            Loss(
                float(one.theta_i[0]),
                float(one.phi_i[0]),
                name,
                float(total / n),
                float(np.mean(getattr(one, f"{name}_std_err"))),
                float(theirs.sum() / n),
                float(np.abs(theirs - ours).sum() / 2 / most) if most else 0.0,
                float(noise / 2 / total) if total else 0.0,
                record.asked.side,
            )
        )
    return every


def in_words(every: Sequence[Loss]) -> list[str]:
    """One line for each lit face and hemisphere: the loss, and where it is largest.

    That is of the record's own incident directions; between them a file, which may be
    of patches, can be further off. Where less than 1 % of the most light is, as behind
    total reflection, patches are left out, and the line says so; totals are of all.
    """
    lines = []
    for side, quantity in dict.fromkeys((one.side, one.quantity) for one in every):
        some = [one for one in every if (one.side, one.quantity) == (side, quantity)]
        least = MIN_FLUX * max(one.recorded for one in some)
        bright = [one for one in some if one.recorded >= least]
        worst = max(bright, key=lambda one: one.misplaced)
        off = max(some, key=lambda one: abs(one.written - one.recorded))
        mean = sum(one.misplaced for one in bright) / len(bright)
        left_out = len(some) - len(bright)
        line = f"{side}, {WORDS[quantity]}: {mean:.1%} of the flux is in "
        line += "neighbouring patches"
        if len(bright) == 1 or round(worst.misplaced, 3):
            line += f", at worst {worst.misplaced:.1%} for" if len(bright) > 1 else ","
            line += f" incidence at {_place(worst)}"
        error = abs(off.written - off.recorded)
        line += f"; total off by {error:.2g}"
        if error > ROUNDING and len(some) > 1:
            line += (
                f" at {_place(off)}, the most of {len(some)} incident directions "
                "of the record"
            )
        if left_out:
            line += f"; {left_out} faint directions left out"
        lines.append(line)
    return lines


def _place(one: Loss) -> str:
    return f"theta_i {one.theta_i:.3g}, phi_i {one.phi_i:.3g}"


def part_names(
    record: Record, path: str | PathLike[str]
) -> dict[tuple[int, int], Path]:
    """Files by hemisphere (0 for reflection) and number of the channel.

    Where there are several, what each holds is put before the ending of the path:
    ``run.brdf450nm.csv``.
    """
    path, n = Path(path), len(written_as(path)[1])
    stem, ending = path.name[:-n], path.name[-n:]
    channels = record.channels if len(record.channels) > 1 else ("",)
    parts = {
        (hemisphere, number): f"{stem}.{quantity}{channel}{ending}"
        for hemisphere, quantity in enumerate(("brdf", "btdf")[: record.n_hemispheres])
        for number, channel in enumerate(channels)
    }
    if len(parts) == 1:
        return {(0, 0): path}
    return {key: path.with_name(name) for key, name in parts.items()}


def written_files(record: Record, path: str | PathLike[str]) -> list[Path]:
    """All files that an export to a path writes."""
    if written_as(path)[0].in_parts:
        return list(part_names(record, path).values())
    return [Path(path)]
