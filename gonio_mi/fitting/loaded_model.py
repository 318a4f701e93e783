"""BSDFs of a model that is fitted, loaded no more often than its parameters need."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from ..array_types import Floats
from ..instrument.loading import loaded
from .fitted_models import COLOURS, FREE, FittedModel

__all__ = ["LoadedModel"]

# Loaded BSDFs that are kept: where the search is, and beside it along some parameters.
KEPT = 4


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
