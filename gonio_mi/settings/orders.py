"""Scattering orders: by their number of surface events, which rays are collected."""

from __future__ import annotations

import re
from dataclasses import dataclass

from ..errors import SettingError, shown

__all__ = ["ALL_ORDERS", "UNLIMITED", "Order"]

# More events than any `max_depth` admits.
UNLIMITED = 2**31


@dataclass(frozen=True, slots=True)
class Order:
    """Numbers of surface events from `least` to `most`, both included."""

    least: int = 0
    most: int = UNLIMITED

    @classmethod
    def parse(cls, label: str, value: object) -> Order:
        """Orders of ``"all"``, ``2`` or ``"3+"``; ValueError for anything else."""
        if isinstance(value, cls):
            return value
        text = str(value)
        if text == "all":
            return ALL_ORDERS
        if not re.fullmatch(r"0|[1-9]\d{0,8}\+?", text):
            raise SettingError(
                f"{label} must be 'all', a number of surface events such as 2 (0 "
                f"for direct light), or '3+' for three or more, got {shown(value)}"
            )
        least = int(text.rstrip("+"))
        return cls(least, UNLIMITED if text.endswith("+") else least)

    def __str__(self) -> str:
        if self == ALL_ORDERS:
            return "all"
        return f"{self.least}+" if self.most == UNLIMITED else str(self.least)


ALL_ORDERS = Order()
