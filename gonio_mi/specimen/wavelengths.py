"""The wavelengths of a measurement: passes, channels, and whether data cover them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..errors import SpecimenError
from .scene_objects import class_of, traversed


def passes(nm: Any) -> list[Any]:
    """Wavelengths of each pass, at most four; one of None in other variants."""
    if not mi.is_spectral:
        return [None]
    return [nm[i : i + 4] for i in range(0, len(nm), 4)]


def wavelength_lanes(nm: tuple[float, ...] | None) -> mi.UnpolarizedSpectrum:
    """Up to four wavelengths for Mitsuba, the last one repeated; none without `nm`."""
    if nm is None:
        return mi.Color0f()
    lanes = mi.UnpolarizedSpectrum([*nm, *[nm[-1]] * (4 - len(nm))])
    dr.make_opaque(lanes)
    return lanes


def lanes_of(nm: Any) -> list[mi.UnpolarizedSpectrum]:
    """Wavelengths of each pass, as Mitsuba takes them."""
    return [wavelength_lanes(part) for part in passes(nm)]


def channel_names(nm: Any, channels: int) -> tuple[str, ...]:
    """Names of the channels of a tally: wavelengths, colours or luminance."""
    if mi.is_spectral:
        return tuple(f"{x:g}nm" for x in nm)
    return ("Y",) if channels == 1 else ("R", "G", "B")


def check_files_cover(
    files: Iterable[tuple[str, float, float]], nm: Sequence[float]
) -> None:
    """Raise :class:`SpecimenError` if a measured file has no data at a wavelength.

    Mitsuba would extrapolate with the data at the end of its range.

    Parameters
    ----------
    files : sequence of (str, float, float)
        As of :class:`~gonio_mi.specimen.specimen.Specimen`.
    nm : sequence of float
        Wavelengths of the measurement.
    """
    for name, low, high in files:
        _check_within(name, low, high, nm)


def _check_within(name: str, low: float, high: float, nm: Iterable[float]) -> None:
    """Raise SpecimenError for a wavelength out of range, in single precision."""
    for x in nm:
        if not low <= np.float32(x) <= high:
            raise SpecimenError(
                f"{name} covers the wavelengths from {low:g} to {high:g} nm, "
                f"got {x:g} nm"
            )


# Points of a texture and wavelengths within its range where it is looked at.
N_POINTS = 16
N_WAVELENGTHS = 16


def check_covered(things: Iterable[Any], nm: Sequence[float]) -> None:
    """Raise :class:`SpecimenError` where a spectrum of `things` ends before `nm`.

    A spectrum that is the same at all wavelengths has no end. Any other one holds in
    the ``wavelength_range()`` that it declares, ends included; what Mitsuba gives
    beyond is 0, or what the formula behind a colour happens to say there. A texture
    written in Python that declares no range ends where it turns to 0 beyond Mitsuba's
    own, 360 to 830 nm. A BSDF written in Python may have a ``wavelength_range()`` too.

    Parameters
    ----------
    things : iterable of mi.BSDF or mi.Emitter
    nm : sequence of float
        Wavelengths that are asked for.
    """
    for thing in {id(thing): thing for thing in things}.values():
        scene = traversed(thing)
        # of one texture in another, such as a checkerboard's, the inner one has data
        outer = {id(parent) for parent, _ in scene.hierarchy.values()}
        for part in scene.hierarchy:
            leaf = isinstance(part, mi.Texture) and id(part) not in outer
            if leaf or isinstance(part, mi.BSDF):
                low, high = _range(part)
                beyond = [x for x in nm if not low <= np.float32(x) <= high]
                if beyond and (not leaf or _ends(part, low, high, beyond)):
                    _check_within(_label(thing, scene, part), low, high, beyond)


def _range(part: Any) -> tuple[Any, Any]:
    """Range in nm that a texture or BSDF declares, in single precision."""
    if not hasattr(part, "wavelength_range"):
        return 0.0, np.inf
    low, high = (np.float32(end) for end in np.ravel(part.wavelength_range()))
    return float(low), float(high)


def _ends(texture: Any, low: float, high: float, beyond: Sequence[float]) -> bool:
    """Whether `texture` has other values within its range than `beyond` it."""
    within = np.linspace(low, high, N_WAVELENGTHS, endpoint=False)[1:]
    try:
        inside, outside = (_values(texture, nm) for nm in (within.tolist(), beyond))
    except RuntimeError:  # it is no spectrum: a map of normals, say
        return False
    if np.all(inside == inside[:1]) and np.all(outside == inside[:1]):
        return False
    own = type(texture).wavelength_range is not mi.Texture.wavelength_range
    declared = type(texture) is mi.Texture or own
    return declared or bool(np.all(outside == 0, axis=1).any())


def _values(texture: Any, nm: Iterable[float]) -> NDArray[np.float64]:
    """Values of a texture, with axes of wavelengths and of points all over it."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, N_POINTS)
    si = dr.zeros(mi.SurfaceInteraction3f, N_POINTS)
    si.uv = sampler.next_2d()
    values = []
    for x in nm:
        si.wavelengths = mi.UnpolarizedSpectrum(float(x))
        values.append(np.array(texture.eval(si))[0] + np.zeros(N_POINTS))
    return np.array(values)


def _label(thing: Any, scene: Any, part: Any) -> str:
    """Class of `thing` and, by Mitsuba's key, which of its parameters `part` is."""
    if part is thing:
        return class_of(thing)
    keys = (key for key, node in scene.properties.items() if node[2] is part)
    name = next(keys, "").rpartition(".")[0] or class_of(part)
    return f"{class_of(thing)}.{name}"
