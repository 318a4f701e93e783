"""Limits of a quantity by the patches in which the material itself was measured.

A material of patch means does not tell where in a patch its light is. What a window
receives of a patch that it covers in part is known as well as the patches around bound
the variation within it.
"""

from types import SimpleNamespace
from typing import Any

import mitsuba as mi
import numpy as np

from ...array_types import Floats, Integers
from ...collector import Receptors, Subdivision
from ...collector.directions import angles, direction
from ...collector.receptors import Window
from ...errors import SettingError
from ...quadrature.evaluator import IncidentLight
from ...results.record import Record
from ...specimen.specimen import Specimen
from ...specimen.wavelengths import passes, wavelength_lanes
from ...transport.surface_events import flux_context
from ..comparison.patch_variation import variation_within
from .definitions import Definition

# Points per side of a window, at first and at most, and for each patch in it; those of
# a patch that tell whether a window cuts it.
MIN_POINTS, MAX_POINTS, POINTS_PER_PATCH, N_POINTS = 64, 1024, 32, 8

# Part of the light in a window that may be in patches that resolve no lobe.
MISSED = 0.02

# Part of an upper limit above which what is not known leaves a value unknown.
MAX_UNKNOWN = 0.5


class PatchLimits:
    """What the patches of a flat specimen's material leave open.

    Parameters
    ----------
    specimen : Specimen
    """

    def __init__(self, specimen: Specimen) -> None:
        self.plane, self.patches = specimen.plane, specimen.measured_patches

    def unresolved(self, own: Definition, estimate: Floats, record: Record) -> float:
        """By how much a quantity may be wrong for what the patches leave open.

        Parameters
        ----------
        own : Definition
        estimate : ndarray, shape (4,)
            Value, standard error and limits, without its `minus`.
        record : Record
            Of the specimen, with the light of the quantity.

        Raises
        ------
        SettingError
            If this is more than half of the upper limit, or of a lobe's light.
        """
        patches = self.patches[int(record.asked.side == "back")]
        if patches is None or own.diffuse:
            return 0.0
        unknown, most = 0.0, float(estimate[3])
        for theta, phi, *size in windows_of(own):
            window = (theta, (phi + float(record.phi_i[0])) % 360, *size)
            number, rest, light = self._cut(patches, window, own.lower, record)
            if own.curve:
                unknown, most = float(rest.sum()), light
            else:
                scale = own.scale
                if own.over is not None:
                    scale /= record.flux_fraction[int(own.lower)].sum()
                unknown += float(scale * rest.sum())
            if unknown > MAX_UNKNOWN * most:
                raise too_wide(own.title, patches, int(number[rest.argmax()]), window)
        return 0.0 if own.curve else unknown

    def _cut(
        self, patches: Subdivision, window: Window, lower: bool, record: Record
    ) -> tuple[Integers, Floats, float]:
        """Patches that a window covers in part, and what of their light is unknown.

        That is infinite where they resolve no lobe. With the light in all the window.
        """
        number, part = covered(patches, window)
        areas = patches.projected_solid_angles.ravel()[number]
        inside = Receptors((window,)).patch(patches.points(N_POINTS, number)) == 0
        rest = np.where(inside.all(axis=1), 0.0, np.minimum(part, np.abs(areas - part)))

        def readings(numbers: Integers) -> Any:
            value = self._brdf(patches, numbers, lower, record)
            return SimpleNamespace(value=value, error=np.zeros(len(numbers)))

        means = readings(number).value
        variation, known = variation_within(patches, number, readings)
        light = float(part @ means)
        open_ = np.where(rest * means > MISSED * light, np.inf, rest * means)
        open_[known] = rest[known] * variation.bound
        return number, open_, light

    def _brdf(
        self, patches: Subdivision, numbers: Integers, lower: bool, record: Record
    ) -> Floats:
        """BRDF or BTDF in the middles of patches, mean of the channels."""
        incident = float(record.theta_i[0]), float(record.phi_i[0])
        nm = passes(record.asked.wavelengths)[0]
        interaction = mi.SurfaceInteraction3f(self.plane.interaction)
        interaction.wavelengths = wavelength_lanes(nm)
        light = IncidentLight.of([incident], record.asked.side, interaction)
        theta, phi = angles(patches.points(1, numbers)[:, 0])
        wo = light.towards(theta, phi, np.full(len(theta), lower))
        value = self.plane.bsdf.eval(flux_context(), light.first, wo)
        columns = [np.broadcast_to(v.numpy(), len(theta)) for v in value]
        return np.asarray(np.mean(columns, axis=0) / np.cos(theta))


def windows_of(own: Definition) -> list[Window]:
    """Windows whose light tells; of a curve the patch about the mirror direction.

    Not those of which it is a part.
    """
    if own.over and own.over == own.receptors:
        return [*own.without]
    if own.patches is None:
        return [*own.receptors, *own.without]
    mirror = direction(np.radians(own.theta_i), np.pi)
    low, high, left, right = own.patches.cells[own.patches.patch(mirror)]
    across = (right - left) * np.sin((low + high) / 2)
    size = np.degrees([high - low, across])
    return [(own.theta_i, 180.0, *size.tolist())]


def covered(patches: Subdivision, window: Window) -> tuple[Integers, Floats]:
    """Patches that a window meets, and the projected solid angle in each, in sr."""
    n = MIN_POINTS
    while True:
        wo, weight = Receptors((window,)).filled(n)
        number, index = np.unique(patches.patch(wo), return_inverse=True)
        wanted = POINTS_PER_PATCH * np.sqrt(len(number))
        if n >= min(wanted, MAX_POINTS):
            return number, np.bincount(index.ravel(), weight).astype(float)
        n = int(min(wanted, MAX_POINTS)) + 1


def too_wide(
    title: str, patches: Subdivision, number: int, window: Window
) -> SettingError:
    """Error for a patch that does not resolve the light in a window."""
    low, high, left, right = np.degrees(patches.cells[number])
    middle = np.radians((low + high) / 2)
    around = low == 0 and right - left > 359
    size = (
        (2 * high,) if around else (high - low, (right - left) * float(np.sin(middle)))
    )
    receptor, patch = (" x ".join(f"{a:.3g}" for a in b) for b in (window[2:], size))
    return SettingError(
        f"{title} needs a material whose patches resolve the light about its receptor "
        f"of {receptor} degrees, got patches of {patch} degrees at theta_o "
        f"{window[0]:g}: measure the specimen itself, or the material in finer patches"
    )
