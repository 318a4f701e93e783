"""What a file of another tool has lost of a record."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..array_types import Floats
from ..results.record import Record

__all__ = ["Loss", "fractions_of", "losses"]


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
        Part of the light that is in another patch than in the record.
    noise : float
        Part that the record's own standard errors would misplace on average.
    """

    theta_i: float
    phi_i: float
    quantity: str
    recorded: float
    std_err: float
    written: float
    misplaced: float
    noise: float

    def __str__(self) -> str:
        return (
            f"theta_i {self.theta_i:.4g}, phi_i {self.phi_i:.4g}: {self.quantity} "
            f"{self.recorded:.5f} +- {self.std_err:.1g}, in the file "
            f"{self.written:.5f}; {self.misplaced:.2%} of the light is in other "
            f"patches (the record's own noise: {self.noise:.2%})"
        )


def fractions_of(record: Record) -> Floats:
    """Flux fractions with the incident direction as first axis, also of one."""
    return record.flux_fraction if record.stacked else record.flux_fraction[None]


def losses(record: Record, written: Floats) -> list[Loss]:
    """Compare flux fractions of the file with those of the record.

    Parameters
    ----------
    record : Record
    written : ndarray, shape (n_incident, n_hemispheres, n_theta, n_phi, channels)
        Of the hemispheres that the file holds.

    Returns
    -------
    list of Loss
    """
    recorded = fractions_of(record)
    projected = record.subdivision.projected_solid_angles[..., None]
    every = []
    for index, hemisphere in np.ndindex(written.shape[:2]):
        one = record[index]
        name = ("dhr", "dht")[hemisphere]
        errors: Any = (one.brdf_std_err, one.btdf_std_err)[hemisphere]
        total = recorded[index, hemisphere].sum()
        difference = np.abs(written[index, hemisphere] - recorded[index, hemisphere])
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
                float(written[index, hemisphere].sum() / n),
                float(difference.sum() / 2 / total) if total else 0.0,
                float(noise / 2 / total) if total else 0.0,
            )
        )
    return every
