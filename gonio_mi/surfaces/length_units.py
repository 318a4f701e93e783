"""Units of length as files of instruments write them."""

from ..errors import SettingError, shown

__all__ = ["UNITS", "metres"]

# The micro sign and the Greek letter are two characters.
UNITS = {
    "m": 1.0,
    "cm": 1e-2,
    "mm": 1e-3,
    "um": 1e-6,
    "µm": 1e-6,
    "μm": 1e-6,
    "nm": 1e-9,
    "Å": 1e-10,
    "pm": 1e-12,
    "in": 0.0254,
}


def metres(unit: str) -> float:
    """Metres of one unit; ValueError for what is none."""
    if unit not in UNITS:
        raise SettingError(f"unit must be one of {', '.join(UNITS)}, got {shown(unit)}")
    return UNITS[unit]
