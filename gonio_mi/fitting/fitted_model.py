"""BSDFs with parameters that are to be found: which, from where, within what."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..errors import SettingError, did_you_mean, shown
from ..instrument.loading import loaded

__all__ = ["FittedModel", "LoadedModel", "Parameter"]

# What is free unless it is said. Nothing is said for the user: the same words are the
# same BSDF in a fit as in a measurement.
FREE: dict[str, tuple[str, ...]] = {
    "diffuse": ("reflectance",),
    "roughconductor": ("alpha", "specular_reflectance"),
    "roughdielectric": ("alpha", "int_ior"),
    "roughplastic": ("alpha", "int_ior", "diffuse_reflectance"),
    "principled": ("base_color", "roughness", "metallic", "specular"),
}

# Where the search for a parameter begins, and its limits. Roughness decides where the
# light is: it is begun with from several places.
ROUGHNESS = ((0.05, 0.15, 0.4), 1e-3, 1.0)
FRACTION = ((0.5,), 0.0, 1.0)
INDEX = ((1.5,), 1.01, 4.0)
KNOWN: dict[str, tuple[tuple[float, ...], float, float]] = {
    **dict.fromkeys(("alpha", "alpha_u", "alpha_v"), ROUGHNESS),
    "roughness": ((0.2, 0.4, 0.7), 0.05, 1.0),
    **dict.fromkeys(("int_ior", "ext_ior"), INDEX),
    "eta": ((1.5,), 0.01, 10.0),
    "k": ((3.0,), 0.0, 20.0),
    # a fit may have to pass 1, which no surface does, to be unbiased; Mitsuba's colours
    # cannot
    **dict.fromkeys(("specular_reflectance", "reflectance"), ((0.8,), 0.0, 1.5)),
    **dict.fromkeys(("diffuse_reflectance", "specular_transmittance"), FRACTION),
    **dict.fromkeys(("base_color", "metallic", "specular", "anisotropic"), FRACTION),
    **dict.fromkeys(("spec_tint", "sheen", "sheen_tint", "clearcoat"), FRACTION),
    **dict.fromkeys(("clearcoat_gloss", "flatness", "spec_trans"), FRACTION),
}
RGB = ("R", "G", "B")
COLOURS = ("reflectance", "base_color", "transmittance")

# Loaded BSDFs that are kept: where the search is, and beside it along some parameters.
KEPT = 4


@dataclass(frozen=True)
class Parameter:
    """A number to be found.

    Attributes
    ----------
    name : str
        As the BSDF has it; of a colour, with a channel behind a dot.
    starts : tuple of float
        Values from which the search begins.
    low, high : float
        Its limits.
    """

    name: str
    starts: tuple[float, ...]
    low: float
    high: float

    @classmethod
    def parse(cls, text: str) -> Parameter:
        """Parameter of a known name, or of ``name=low:high``."""
        name, equals, limits = text.partition("=")
        if not equals:
            if name not in KNOWN:
                raise SettingError(
                    f"free must name parameters such as {', '.join(list(KNOWN)[:6])}, "
                    f"or any with its limits as in weight=0:1, got {shown(text)}"
                )
            return cls(name, *KNOWN[name])
        try:
            low, high = map(float, limits.split(":"))
        except ValueError:
            low = high = np.nan
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise SettingError(
                f"free must give limits as in {name}=0:1, got {shown(text)}"
            )
        return cls(name, ((low + high) / 2,), low, high)


class FittedModel:
    """A BSDF in which some parameters are free.

    Parameters
    ----------
    bsdf : dict
        Mitsuba dictionary of what is fixed.
    free : sequence of str, optional
        Names of parameters, or ``name=low:high``. Default: see :data:`FREE`.
    channels : sequence of str
        Those of the record; a colour has a parameter in each of R, G and B, and one
        for all wavelengths.
    """

    def __init__(
        self,
        bsdf: Mapping[str, Any],
        free: Sequence[str] | None,
        channels: Sequence[str],
    ) -> None:
        if free is None:
            kind = bsdf["type"]
            if kind not in FREE:
                raise SettingError(
                    f"free must name what is to be found of {kind}: it is known of "
                    f"{', '.join(FREE)} only{did_you_mean(kind, FREE)}"
                )
            free = [name for name in FREE[kind] if name not in bsdf]
        found = [Parameter.parse(text) for text in free]
        twice = [one.name for one in found if one.name in bsdf]
        if twice or not found:
            raise SettingError(
                f"free must name what is to be found of {bsdf['type']} and not what "
                f"is given, got {', '.join(twice) or 'nothing'}"
            )
        if any(one.name.startswith("alpha_") for one in found):
            found = [one for one in found if one.name != "alpha"]
        self.fixed = dict(bsdf)
        self.channels = tuple(channels)
        self.parameters = tuple(
            part
            for one in found
            for part in (self._colour(one) if self._is_colour(one.name) else [one])
        )

    def _is_colour(self, name: str) -> bool:
        return self.channels == RGB and name.endswith(COLOURS)

    def _colour(self, one: Parameter) -> list[Parameter]:
        """A parameter in each channel, within what Mitsuba loads as a reflectance."""
        low, high = max(one.low, 0.0), min(one.high, 1.0)
        if low >= high:
            raise SettingError(
                f"free must give limits of the colour {one.name} from 0 to 1, got "
                f"{one.low:g}:{one.high:g}"
            )
        starts = tuple(start for start in one.starts if low <= start <= high)
        names = [f"{one.name}.{channel}" for channel in self.channels]
        return [
            Parameter(name, starts or ((low + high) / 2,), low, high) for name in names
        ]

    def bsdf(self, values: Floats) -> dict[str, Any]:
        """Mitsuba dictionary with these values of the parameters."""
        numbers = {p.name: float(v) for p, v in zip(self.parameters, values)}
        single = {name: v for name, v in numbers.items() if "." not in name}
        several = dict.fromkeys(name.split(".")[0] for name in numbers if "." in name)
        colours = {
            name: {
                "type": "rgb",
                "value": [numbers[f"{name}.{channel}"] for channel in self.channels],
            }
            for name in several
        }
        return self.fixed | single | colours

    @property
    def limits(self) -> tuple[Floats, Floats]:
        """The lower and the upper limits of the parameters."""
        low, high = np.array([(p.low, p.high) for p in self.parameters]).T
        return low, high

    def starts(self) -> list[Floats]:
        """Values from which to begin: all of a roughness, the first of others."""
        first = np.array([p.starts[0] for p in self.parameters])
        most = max(len(p.starts) for p in self.parameters)
        found = []
        for i in range(most):
            start = first.copy()
            for j, p in enumerate(self.parameters):
                if re.match("alpha|roughness", p.name):
                    start[j] = p.starts[i]
            found.append(start)
        return found


class LoadedModel:
    """BSDFs of a model; those that differ in their colours alone are loaded once.

    To load a `roughplastic` takes 45 ms, in which it integrates its transmittance; to
    give it another colour takes microseconds, and the same values.

    Parameters
    ----------
    model : FittedModel
    """

    def __init__(self, model: FittedModel) -> None:
        self.model = model
        self._held: dict[tuple[float, ...], tuple[mi.BSDF, Any]] = {}

    def bsdf(self, values: Floats) -> mi.BSDF:
        """The BSDF with these values, until the next one is asked for."""
        wanted = self.model.bsdf(values)
        names = [one.name.split(".")[0] for one in self.model.parameters]
        # of Mitsuba's own only: whether another's parameters are what it was loaded
        # with is what `validate` asks
        own = self.model.fixed["type"] in FREE
        colours = {name for name in names if own and name.endswith(COLOURS)}
        rest = tuple(float(v) for n, v in zip(names, values) if n not in colours)
        if rest in self._held:
            bsdf, parameters = self._held[rest]
            for name in colours:
                number = wanted[name]
                number = number["value"] if isinstance(number, dict) else number
                key = f"{name}.value"
                parameters[key] = type(parameters[key])(number)
            parameters.update()
            return bsdf
        bsdf = loaded("the model", mi.load_dict, wanted)
        if colours:
            parameters = mi.traverse(bsdf)
            if all(f"{name}.value" in parameters for name in colours):
                self._hold(rest, bsdf, parameters)
        return bsdf

    def _hold(self, rest: tuple[float, ...], bsdf: mi.BSDF, parameters: Any) -> None:
        """Keep what was loaded, in place of the oldest."""
        while len(self._held) >= KEPT:
            del self._held[next(iter(self._held))]
        self._held[rest] = bsdf, parameters
