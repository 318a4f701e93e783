"""What a record says of the campaign that chose its incident directions."""

import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np

from .statistics import binomial_interval

__all__ = ["LOOKS", "campaign_is_sound", "campaign_text"]

NUMBERS = ("tolerance", "theta_max", "within", "measured", "rays")

# A campaign looks at new directions at most so often, and ends when few are missed: the
# confidence in their share holds for all looks together (Bonferroni).
LOOKS, CONFIDENCE = 10, 0.95

# Equal parts of a whole turn that a specimen may be turned by: no more than degrees.
MOST_TURNS = 360

# Of each unseen direction: both angles, light, its standard error, dhr and dht.
COLUMNS = 6


def campaign_is_sound(found: Any) -> bool:
    """Whether a record's setting ``campaign`` can be what a campaign writes."""
    if not isinstance(found, Mapping) or not isinstance(found.get("isotropic"), bool):
        return False
    numbers: list[Any] = [found.get(name) for name in NUMBERS]
    unseen = found.get("unseen")
    rows = unseen if isinstance(unseen, (list, tuple)) else [None]
    for row in rows:
        numbers += (
            row if isinstance(row, (list, tuple)) and len(row) == COLUMNS else [""]
        )
    plain = all(type(x) in (int, float) and -1e15 < x < 1e15 for x in numbers)
    return plain and len(rows) > 0 and _is_symmetry(found.get("symmetry"))


def _is_symmetry(found: Any) -> bool:
    """Whether it can be a symmetry; older records say nothing of it."""
    if found is None:
        return True
    if not isinstance(found, Mapping):
        return False
    turns, mirror, copies = (found.get(name) for name in ("turns", "mirror", "copies"))
    if type(turns) is not int or not 1 <= turns <= MOST_TURNS:
        return False
    numbers: list[Any] = [0 if mirror is None else mirror]
    for one in copies if isinstance(copies, (list, tuple)) else [None]:
        numbers += one if isinstance(one, (list, tuple)) and len(one) == 2 else [""]
    return all(type(x) in (int, float) and -1e15 < x < 1e15 for x in numbers)


def campaign_text(found: Mapping[str, Any], used: int, width: int) -> str:
    """Tolerance, and the errors at directions that only test the material.

    `used`: measured incident directions that the record holds.
    """
    unseen = np.array(found["unseen"], dtype=float)
    light, reflected = unseen[:, 2], np.abs(unseen[:, 4:]).max(axis=1)
    worst = int(np.argmax(np.maximum(light, reflected)))
    theta, phi = unseen[worst, :2]
    within = np.clip(round(found["within"] * len(unseen)), 0, len(unseen))
    chance = (1 - CONFIDENCE) / LOOKS
    share, _ = binomial_interval(within, len(unseen), 1 - 2 * chance)
    kind = "isotropic" if found["isotropic"] else "anisotropic"
    text = (
        f"tolerance {found['tolerance']:.3g} up to theta_i {found['theta_max']:g}, "
        f"{kind} by measurement{_symmetry_text(found.get('symmetry'))}. "
        f"{found['measured']} incident directions were measured: {used} of them are "
        f"this record, {len(unseen)} at random only test it, the rest only served the "
        f"choice. Of the {len(unseen)} tests, {within:.0f} are within the tolerance "
        f"(of all directions at least {share:.0%}, with a confidence of "
        f"{CONFIDENCE:.0%}): of the light, {np.mean(light):.2g} is elsewhere than "
        f"predicted on average and {light[worst]:.2g} +- {unseen[worst, 3]:.1g} "
        f"(std_err) at the worst, theta_i {theta:.1f}, phi_i {phi:.1f}; dhr and dht "
        f"are off by up to {reflected.max():.2g}."
    )
    indent = " " * 10
    return textwrap.fill(
        text, width, initial_indent="material".ljust(10), subsequent_indent=indent
    )


def _symmetry_text(found: Mapping[str, Any] | None) -> str:
    """How a specimen may be turned and mirrored, and what was copied for it."""
    if not found or not found["copies"]:
        return ""
    ways = []
    if found["turns"] > 1:
        ways.append(f"turned by {360 / found['turns']:g} degrees")
    if found["mirror"] is not None:
        ways.append(f"mirrored at the azimuth {found['mirror']:g}")
    return (
        f" and the same if {' or '.join(ways)} ({len(found['copies'])} of its "
        "directions are copies, with the noise of what they copy)"
    )
