"""Outcome of a campaign: its choice of directions, and the error of its material.

A mapping in files and in ``record.settings``, elsewhere a :class:`CampaignOutcome`.
"""

from __future__ import annotations

import textwrap
from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np

from ..errors import SettingError, shown
from .statistics import binomial_interval

# A campaign looks at new directions at most so often, and ends when few are missed: the
# confidence in their share holds for all looks together (Bonferroni).
MAX_LOOKS, CONFIDENCE = 10, 0.95

# Equal parts of a whole turn that a specimen may be turned by: no more than degrees.
MAX_TURNS = 360

# Numbers of a mapping are smaller, and a row of it holds so many.
MAX_NUMBER, N_NUMBERS = 1e15, 6


@dataclass(frozen=True)
class PredictionError:
    """What a prediction gets wrong at one incident direction.

    All but the angles are fractions of the flux that leaves there, of all channels
    together.

    Attributes
    ----------
    theta_i, phi_i : float
        In degrees.
    total_variation : float
        Total variation distance of both distributions over the patches, half the sum
        of the absolute differences of their flux fractions: what is in another patch
        than predicted.
    std_err : float
        Of `total_variation`, by what the measurement is wrong.
    dhr, dht : float
        Predicted less measured reflectance, and transmittance.
    relative : float, optional
        Largest relative error of a patch whose BSDF is at least a tenth of its mean, as
        a picture shows it, beyond three standard errors; no part of the flux.
    relative_weight : float
        How many of `error` this is, where a campaign was asked for it.
    """

    theta_i: float
    phi_i: float
    total_variation: float
    std_err: float
    dhr: float
    dht: float
    relative: float | None = None
    relative_weight: float = 0.0

    @property
    def error(self) -> float:
        """The largest of all three, without sign, and of the weighted relative one."""
        seen = self.relative_weight * (self.relative or 0.0)
        return max(self.total_variation, abs(self.dhr), abs(self.dht), seen)

    def exceeds(self, tolerance: float) -> bool:
        """Whether the error is above the tolerance, beyond two standard errors."""
        return self.error - 2 * self.std_err > tolerance


@dataclass(frozen=True)
class CampaignOutcome:
    """What a campaign of a tolerance found.

    Attributes
    ----------
    tolerance : float
        Largest error that was asked for, of a :class:`PredictionError`.
    theta_max : float
        In degrees, up to where the material shall be right.
    isotropic : bool
        Whether one azimuth of incidence is enough.
    turns : int
        Equal parts of a whole turn, by each of which the specimen may be turned.
    mirror : float, optional
        Azimuth of a mirror plane in degrees.
    copies : tuple of (float, float)
        Incident directions in degrees that copy others by this symmetry.
    measured, rays : int
        Incident directions that were measured in all, and rays that were sent.
    within : float
        Fraction of the test directions whose errors are within the tolerance.
    unseen : tuple of PredictionError
        At the random directions that only test the material.
    """

    tolerance: float
    theta_max: float
    isotropic: bool
    turns: int
    mirror: float | None
    copies: tuple[tuple[float, float], ...]
    measured: int
    rays: int
    within: float
    unseen: tuple[PredictionError, ...]

    @classmethod
    def from_mapping(cls, found: Any) -> CampaignOutcome:
        """What :meth:`as_mapping` wrote.

        Raises
        ------
        ValueError
            For anything that no campaign writes.
        """
        try:
            symmetry = found.get("symmetry", {"turns": 1, "mirror": None, "copies": []})
            mirror = symmetry["mirror"]
            numbers = ("tolerance", "theta_max", "measured", "rays", "within")
            weight = _number(found.get("relative_weight", 0))
            relative = found.get("relative") or [None] * len(found["unseen"])
            relative = [None if one is None else _number(one) for one in relative]
            outcome = cls(
                **{name: _number(found[name]) for name in numbers},
                isotropic=found["isotropic"],
                turns=symmetry["turns"],
                mirror=None if mirror is None else _number(mirror),
                copies=tuple((_number(a), _number(b)) for a, b in symmetry["copies"]),
                unseen=tuple(
                    replace(
                        PredictionError(*map(_number, row[:N_NUMBERS])),
                        relative=one,
                        relative_weight=weight,
                    )
                    for row, one in zip(found["unseen"], relative, strict=True)
                ),
            )
            if not (
                [type(outcome.isotropic), type(outcome.turns)] == [bool, int]
                and 1 <= outcome.turns <= MAX_TURNS
                and outcome.unseen
            ):
                raise ValueError
        except (AttributeError, KeyError, TypeError, ValueError):
            raise SettingError(
                f"campaign must be what a campaign writes, got {shown(found)}"
            ) from None
        return outcome

    def as_mapping(self) -> dict[str, Any]:
        """The outcome in JSON's types."""
        seen: dict[str, Any] = {}
        if any(one.relative is not None for one in self.unseen):
            seen["relative"] = [one.relative for one in self.unseen]
        if self.unseen[0].relative_weight:
            seen["relative_weight"] = self.unseen[0].relative_weight
        return {
            "tolerance": self.tolerance,
            "theta_max": self.theta_max,
            "isotropic": self.isotropic,
            "symmetry": {
                "turns": self.turns,
                "mirror": self.mirror,
                "copies": [list(one) for one in self.copies],
            },
            "measured": self.measured,
            "rays": self.rays,
            "within": self.within,
            "unseen": [list(astuple(one)[:N_NUMBERS]) for one in self.unseen],
            **seen,
        }

    def text(self, n_used: int, width: int) -> str:
        """Tolerance, and the errors at directions that only test the material.

        `n_used`: measured incident directions that the record holds.
        """
        distances = [one.total_variation for one in self.unseen]
        reflected = [max(abs(one.dhr), abs(one.dht)) for one in self.unseen]
        worst = max(self.unseen, key=lambda one: one.error)
        n_unseen = len(self.unseen)
        within = np.clip(round(self.within * n_unseen), 0, n_unseen)
        chance = (1 - CONFIDENCE) / MAX_LOOKS
        fraction, _ = binomial_interval(within, n_unseen, 1 - 2 * chance)
        kind = "isotropic" if self.isotropic else "anisotropic"
        known = "std_err" if self.rays else "error of its integrals"
        text = (
            f"tolerance {self.tolerance:.3g} up to theta_i {self.theta_max:g}, "
            f"{kind} by measurement{self._symmetry_text()}. "
            f"{self.measured} incident directions were measured: {n_used} of them are "
            f"this record, {n_unseen} at random only test it, the rest only served the "
            f"choice. Of the {n_unseen} tests, {within:.0f} are within the tolerance "
            f"(of all directions at least {fraction:.0%}, with a confidence of "
            f"{CONFIDENCE:.0%} for up to {MAX_LOOKS} rounds of tests): of the flux, "
            f"{np.mean(distances):.2g} is in other patches than predicted (total "
            "variation distance) on average and "
            f"{worst.total_variation:.2g} +- {worst.std_err:.1g} ({known}) at the "
            f"worst, theta_i {worst.theta_i:.1f}, phi_i {worst.phi_i:.1f}; dhr and dht "
            f"are off by up to {max(reflected):.2g}.{self._seen_text()}"
        )
        return textwrap.fill(
            text, width, initial_indent=f"{'material':<10}", subsequent_indent=" " * 10
        )

    def _seen_text(self) -> str:
        """Sentence on the largest relative error, empty if unknown."""
        known = [one for one in self.unseen if one.relative is not None]
        if not known:
            return ""
        worst = max(known, key=lambda one: one.relative or 0.0)
        asked = worst.relative_weight
        limit = f" ({self.tolerance / asked:.3g} was asked for)" if asked else ""
        return (
            f" Where the BSDF is above a tenth of its mean, a patch is off by up to "
            f"{worst.relative:.2g} of its value{limit}, theta_i {worst.theta_i:.1f}, "
            f"phi_i {worst.phi_i:.1f}."
        )

    def _symmetry_text(self) -> str:
        """How a specimen may be turned and mirrored, and what was copied for it."""
        if not self.copies:
            return ""
        ways = []
        if self.turns > 1:
            ways.append(f"turned by {360 / self.turns:g} degrees")
        if self.mirror is not None:
            ways.append(f"mirrored at the azimuth {self.mirror:g}")
        return (
            f" and the same if {' or '.join(ways)} ({len(self.copies)} of its "
            "directions are copies, with the noise of what they copy)"
        )


def _number(value: Any) -> Any:
    """The value if it is a number as JSON has it, else ValueError."""
    if type(value) not in (int, float) or not -MAX_NUMBER < value < MAX_NUMBER:
        raise ValueError
    return value
