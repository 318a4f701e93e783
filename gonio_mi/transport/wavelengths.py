"""The wavelengths of a measurement: up to four in each pass of spectral variants."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

__all__ = ["channel_names", "passes", "wavelength_lanes"]


def passes(nm: Any) -> list[Any]:
    """Wavelengths of each pass, at most four; one of None in other variants."""
    if not mi.is_spectral:
        return [None]
    return [nm[i : i + 4] for i in range(0, len(nm), 4)]


def wavelength_lanes(nm: tuple[float, ...] | None) -> mi.Spectrum:
    """Up to four wavelengths for Mitsuba, the last one repeated; none without `nm`."""
    if nm is None:
        return mi.Color0f()
    lanes = mi.Spectrum([*nm, *[nm[-1]] * (4 - len(nm))])
    dr.make_opaque(lanes)
    return lanes


def channel_names(nm: Any, channels: int) -> tuple[str, ...]:
    """Names of the channels of a tally: wavelengths, colours or luminance."""
    if mi.is_spectral:
        return tuple(f"{x:g}nm" for x in nm)
    return ("Y",) if channels == 1 else ("R", "G", "B")
