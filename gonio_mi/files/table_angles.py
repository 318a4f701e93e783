"""Angles of plain tables: their unit, what azimuths count from, and signs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..array_types import Floats
from .table_names import ANGLES, Column

# What azimuths of exit count from.
AZIMUTHS = ("specimen", "source", "mirror")

DEGREES = {"deg": 1.0, "": 1.0, "rad": float(np.degrees(1.0))}

# Angles that are at most this large may be radians if no unit is specified, unless all
# are whole numbers, up to a rounding.
MAX_RADIANS: dict[str, tuple[tuple[str, ...], float]] = {
    "polar angles": (("theta_i", "theta_o"), np.pi),
    "azimuths": (("phi_i", "phi_o", "delta_phi"), 2 * np.pi),
}
ANGLE_ROUNDING = 1e-3


@dataclass
class TableAngles:
    """Angles of the columns of a table, as they are written.

    Attributes
    ----------
    arrays : dict of ndarray, shape (n,)
        By role.
    picked : mapping of Column
        The columns that they were read from; those of a number for all rows have none.
    azimuth : str, optional
        One of :data:`AZIMUTHS`, if the user says it.
    in_degrees : bool
        Whether a column without a unit is certainly in degrees.
    notes, questions : list of str
        To which what is understood and what is not is added.
    """

    arrays: dict[str, Floats]
    picked: Mapping[str, Column]
    azimuth: str | None
    in_degrees: bool
    notes: list[str]
    questions: list[str]

    def convert(self) -> None:
        """Convert angles to degrees, or ask for those that may be in either unit."""
        unclear = []
        for kind, (roles, most) in MAX_RADIANS.items():
            bare = [r for r in roles if r in self.picked and not self.picked[r].unit]
            angles = np.concatenate([self.arrays[r] for r in bare] or [np.zeros(1)])
            angles = np.abs(angles)
            whole = (np.abs(angles - np.round(angles)) < ANGLE_ROUNDING).all()
            if not (whole or self.in_degrees) and angles.max() <= most:
                unclear.append((kind, bare[0], angles.max()))
        if unclear:
            kind, role, _ = unclear[0]
            kind = "angles" if len(unclear) > 1 else kind
            largest = max(most for *_, most in unclear)
            self.questions.append(
                f"{kind} up to {largest:.4g} may be degrees or radians: say --columns "
                f"{role}='{self.picked[role].name.strip()}:rad' (or :deg), and so of "
                "each"
            )
        for role in ANGLES:
            if role in self.picked:
                self.arrays[role] = self.arrays[role] * DEGREES[self.picked[role].unit]

    def directions(self) -> dict[str, Any]:
        """Polar angles, and azimuths of the specimen, in degrees."""
        arrays, azimuth = self.arrays, self.azimuth
        theta_i, theta_o = arrays["theta_i"], arrays["theta_o"]
        zero = np.zeros(len(theta_i))
        phi_i = arrays.get("phi_i", zero)
        signed = bool((theta_o < 0).any() or (theta_i < 0).any())
        absolute = "phi_o" in arrays and "phi_i" in arrays and "delta_phi" not in arrays
        if absolute and signed and azimuth != "specimen":
            # azimuths that are all the same tell no side
            phis = np.concatenate([phi_i, arrays["phi_o"]])
            absolute = bool((phis != phis[0]).any())
        if absolute and azimuth in (None, "specimen"):
            phi_o = arrays["phi_o"]
        else:
            needed = (theta_o != 0).any() and (theta_i != 0).any()
            if needed and azimuth in (None, "specimen"):
                what = "angles" if signed else "azimuths"
                self.questions.append(azimuth_question(what))
            relative = arrays.get("delta_phi")
            if relative is None:
                relative = arrays.get("phi_o", zero) - phi_i
            phi_o = phi_i + relative + (180 if azimuth == "mirror" else 0)
            self.notes.append(
                f"azimuths count from {azimuth or 'nothing that matters'}"
                + (", signed polar angles are on both sides" if signed else "")
            )
        if signed:
            # without azimuths the side of the source may have the minus sign
            if absolute or (theta_i > 0).any():
                phi_i = np.where(theta_i < 0, phi_i + 180.0, phi_i)
            phi_o = np.where(theta_o < 0, phi_o + 180.0, phi_o)
            theta_i, theta_o = np.abs(theta_i), np.abs(theta_o)
            if absolute and azimuth is None:
                self.notes.append(
                    "negative polar angles are positive ones half a turn on"
                )
        return {"theta_i": theta_i, "phi_i": phi_i, "theta_o": theta_o, "phi_o": phi_o}

    def count_from_lit_side(self, columns: dict[str, Any]) -> None:
        """Count polar angles of transmission from the normal of the lit face."""
        if (columns["theta_o"] <= 90).all():
            columns["theta_o"] = 180 - columns["theta_o"]
            self.notes.append(
                "theta_o of transmission counts from the normal of the other face"
            )


def azimuth_question(what: str) -> str:
    """Question about the zero of azimuths, or of signed angles."""
    return (
        f"its {what} are relative to incidence: say --azimuth source or mirror, whose "
        "side is 0 (or positive), or --columns phi_i=0 if azimuths are the specimen's"
    )
