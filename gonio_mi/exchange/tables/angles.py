"""Angles of plain tables: their unit, what azimuths count from, and signs."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...array_types import Floats
from .names import ANGLES, FACTOR_OF, Column

# What azimuths of exit count from.
AZIMUTHS = ("specimen", "source", "mirror")

# Angles that are at most this large may be radians if no unit is specified, unless all
# are whole numbers, up to a rounding.
MAX_RADIANS: dict[str, tuple[tuple[str, ...], float]] = {
    "polar angles": (("theta_i", "theta_o"), np.pi),
    "azimuths": (("phi_i", "phi_o", "delta_phi"), 2 * np.pi),
}
ANGLE_ROUNDING = 1e-3


def unit_questions(
    arrays: Mapping[str, Floats], picked: Mapping[str, Column]
) -> list[str]:
    """Questions on angles that may be in degrees or radians, if there are such.

    Parameters
    ----------
    arrays : mapping of ndarray, shape (n,)
        Numbers of the table as they are written, by role.
    picked : mapping of Column
        The columns that they were read from; those of a number for all rows have none.
    """
    questions = []
    for kind, (roles, most) in MAX_RADIANS.items():
        bare = [role for role in roles if role in picked and not picked[role].unit]
        angles = np.abs(np.concatenate([[0.0], *(arrays[role] for role in bare)]))
        whole = (np.abs(angles - np.round(angles)) < ANGLE_ROUNDING).all()
        if not whole and angles.max() <= most:
            questions.append(
                f"{kind} up to {angles.max():.4g} may be degrees or radians: say "
                f"--columns {bare[0]}='{picked[bare[0]].name.strip()}:rad' (or :deg), "
                "and so of each"
            )
    return questions


def in_degrees(
    arrays: Mapping[str, Floats], picked: Mapping[str, Column]
) -> dict[str, Floats]:
    """Angles of the columns in degrees, by role; see :func:`unit_questions`."""
    angles = [role for role in ANGLES if role in picked]
    return {role: arrays[role] * FACTOR_OF[picked[role].unit] for role in angles}


def directions(
    arrays: Mapping[str, Floats], azimuth: str | None
) -> tuple[dict[str, Any], list[str], list[str]]:
    """Polar angles, and azimuths of the specimen, in degrees; notes and questions.

    Parameters
    ----------
    arrays : mapping of ndarray, shape (n,)
        Angles of the table in degrees, by role.
    azimuth : str, optional
        One of :data:`AZIMUTHS`, if the user says it.
    """
    theta_i, theta_o = arrays["theta_i"], arrays["theta_o"]
    zero = np.zeros(len(theta_i))
    phi_i = arrays.get("phi_i", zero)
    notes, questions = [], []
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
            questions.append(azimuth_question("angles" if signed else "azimuths"))
        relative = arrays.get("delta_phi")
        if relative is None:
            relative = arrays.get("phi_o", zero) - phi_i
        phi_o = phi_i + relative + (180 if azimuth == "mirror" else 0)
        both = ", signed polar angles are on both sides" if signed else ""
        notes.append(f"azimuths count from {azimuth or 'nothing that matters'}{both}")
    if signed:
        # without azimuths the side of the source may have the minus sign
        if absolute or (theta_i > 0).any():
            phi_i = np.where(theta_i < 0, phi_i + 180.0, phi_i)
        phi_o = np.where(theta_o < 0, phi_o + 180.0, phi_o)
        theta_i, theta_o = np.abs(theta_i), np.abs(theta_o)
        if absolute and azimuth is None:
            notes.append("negative polar angles are positive ones half a turn on")
    found = {"theta_i": theta_i, "phi_i": phi_i, "theta_o": theta_o, "phi_o": phi_o}
    return found, notes, questions


def azimuth_question(what: str) -> str:
    """Question about the zero of azimuths, or of signed angles."""
    return (
        f"its {what} are relative to incidence: say --azimuth source or mirror, whose "
        "side is 0 (or positive), or --columns phi_i=0 if azimuths are the specimen's"
    )
