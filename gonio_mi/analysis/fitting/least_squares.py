"""BSDFs with free parameters, the least squares of a fit, and their covariance."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats
from ...errors import (
    SettingError,
    SpecimenError,
    checked_choice,
    checked_number,
    did_you_mean,
    number_of,
    shown,
)
from ...specimen.loading import loaded
from ...specimen.specimen_text import CALLED
from .observations import Observations

# Differences for derivatives, relative to a value or to a hundredth of its range: wide
# against single precision, narrow against the curvature.
REL_STEP = 3e-4

# Steps from each start, and the relative change of the sum of squares or of values by a
# step, after which the best of them is known.
FIRST_STEPS, FIRST_CHANGE = 12, 1e-3

# Rounds of refined nodes and weights; a round is the last that moves no parameter by
# more than a part of its uncertainty, or of itself, which no node would notice.
MAX_ROUNDS, MAX_MOVE_STD_ERRS, MAX_REL_MOVE = 8, 0.02, 1e-3

# Chi-square per degree of freedom beyond which noise does not explain what is left; and
# the relative distance of points from the model that may be noise of an instrument.
MAX_REDUCED_CHI2, MAX_SCATTER = 1.5, 0.1

# Standard errors by which a parameter changes the record all over its range, at least;
# and the condition beyond which parameters do the same to it, as far as derivatives by
# differences in single precision can tell.
MIN_EFFECT, MAX_CONDITION = 1.0, 1e3


class Search:
    """The sum of squares to be minimised, and how uncertain its minimum is.

    Parameters
    ----------
    observations : sequence of Observations
    model : FittedModel
    report : callable, optional
        Called with 1 for each prediction.

    Attributes
    ----------
    derivatives : str
        As of :class:`.Fit`.
    """

    model: Any

    def __init__(
        self,
        observations: Sequence[Observations],
        model: FittedModel,
        report: Callable[[float], Any] | None,
    ) -> None:
        self.observations, self.model = observations, model
        self.derivatives = "differences"
        self._loaded, self._report = LoadedModel(model), report
        # the last prediction and its parameters, with the nodes as they are
        self._last: tuple[Floats, Floats] | None = None
        self.values = np.concatenate([one.values for one in observations])
        self.scales = np.ones_like(self.values)
        self._ends = np.cumsum([one.values.size for one in observations])[:-1]
        self._predictions = [each for one in observations for each in one.predictions]
        self._order = observations[0].order  # a table is alone

    @property
    def notes(self) -> tuple[str, ...]:
        """See :class:`.Fit`; there is nothing to say."""
        return ()

    def found(self) -> tuple[Floats, Floats]:
        """Values of the parameters, and their covariance."""
        values, names = self.begin(), self.model.names
        if self.values.size <= len(names):
            raise SettingError(
                f"a fit of {', '.join(names)} needs more than "
                f"{number_of(len(names), 'value')}, got {self.values.size}"
            )
        for _ in range(MAX_ROUNDS):
            self.adapt(values)
            before, values = values, self.minimum(values)
            covariance = self.covariance(values)
            moved = np.abs(values - before)
            noise = np.nan_to_num(np.sqrt(np.diag(covariance)))
            small = np.maximum(MAX_MOVE_STD_ERRS * noise, MAX_REL_MOVE * np.abs(values))
            if np.all(moved <= small):
                break
        return values, covariance

    def begin(self) -> Floats:
        """Values of a first search on a few nodes: the best minimum of all starts."""
        self._last = None
        for one in self._predictions:
            one.begin()
        found = [self._first(start) for start in self.model.starts()]
        if all(self._is_poor(*one) for one in found):
            found += [self._first(start) for start in self.model.starts(finer=True)]
        return min(found, key=lambda one: one[0])[1]

    def _first(self, start: Floats) -> tuple[float, Floats]:
        """Misfit and values of a minimum that a first search from here finds."""
        self._weigh(self.predicted(start))
        found = self.minimum(start, FIRST_CHANGE, FIRST_CHANGE, FIRST_STEPS)
        return self.misfit(self.predicted(found)), found

    def _is_poor(self, misfit: float, values: Floats) -> bool:
        """Whether a minimum is at a limit, or far from the data."""
        stated = all(one.stated for one in self.observations)
        most = MAX_REDUCED_CHI2 if stated else MAX_SCATTER**2
        return bool(self.at_limit(values).any() or misfit > most * self.values.size)

    def misfit(self, predicted: Floats) -> float:
        """Sum of squares by which minima and models are compared."""
        parts = zip(self.observations, np.split(predicted, self._ends))
        return sum(one.misfit(part) for one, part in parts)

    def adapt(self, values: Floats) -> None:
        """Refine the nodes for these values, and take the variances of them."""
        self._last = None
        bsdf = self._loaded.bsdf(values)
        found = np.concatenate([one.adapt(bsdf) for one in self._predictions])
        self._weigh(found[self._order])

    def _weigh(self, predicted: Floats) -> None:
        """Take the variances that go with a prediction."""
        parts = zip(self.observations, np.split(predicted, self._ends))
        self.scales = np.sqrt(np.concatenate([one.variances(p) for one, p in parts]))

    def count(self) -> float:
        """How many values the sum of squared residuals has."""
        parts = zip(self.observations, np.split(self.scales**2, self._ends))
        return sum(one.count(part) for one, part in parts)

    def residuals(self, predicted: Floats) -> Floats:
        """Differences of prediction and observation over their standard errors."""
        return (predicted - self.values) / self.scales

    def minimum(
        self,
        values: Floats,
        ftol: float = 1e-9,
        xtol: float = 1e-7,
        most_steps: int | None = None,
    ) -> Floats:
        """Values of least squares, with nodes and variances as they are."""
        from scipy.optimize import least_squares

        low, high = self.model.limits
        inside = np.clip(values, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
        found = least_squares(
            lambda x: self.residuals(self.predicted(x)),
            inside,
            lambda x: self._jacobian(x) / self.scales[:, None],
            (low, high),
            x_scale="jac",
            xtol=xtol,
            ftol=ftol,
            max_nfev=most_steps,
        )
        return found.x

    def covariance(self, values: Floats) -> Floats:
        """Covariance of the minimum, from the scatter of the batches about it.

        NaN for parameters at a limit, and for those of which any value would do.
        """
        estimate, free = self._estimate(values)
        total = np.full((len(values), len(values)), np.nan)
        total[np.ix_(free, free)] = 0.0
        both = estimate, self.scales**2
        parts = (np.split(array, self._ends, axis=-1) for array in both)
        for one, part, variances in zip(self.observations, *parts):
            total[np.ix_(free, free)] += one.points(variances).covariance(part)
        return total

    def _estimate(self, values: Floats) -> tuple[Floats, Flags]:
        """How the minimum moves with each value, and which parameters move at all."""
        low, high = self.model.limits
        jacobian = self._jacobian(values) / self.scales[:, None]
        size = np.linalg.norm(jacobian, axis=0)
        free = ~self.at_limit(values) & (size * (high - low) > MIN_EFFECT)
        jacobian = jacobian[:, free]
        if free.any() and np.linalg.cond(jacobian / size[free]) > MAX_CONDITION:
            raise SpecimenError(
                f"the record does not determine {', '.join(self.model.names)} "
                "together: give some of them, as in roughconductor:alpha=0.2"
            )
        return np.linalg.pinv(jacobian) / self.scales, free

    def at_limit(self, values: Floats) -> Flags:
        """Which of the parameters would go beyond their limits."""
        low, high = self.model.limits
        near = 1e-4 * (high - low)
        return (values < low + near) | (values > high - near)

    def predicted(self, values: Floats) -> Floats:
        """Prediction with the nodes as they are."""
        if self._last is None or not np.array_equal(self._last[0], values):
            bsdf = self._loaded.bsdf(values)
            found = np.concatenate([one.of(bsdf) for one in self._predictions])
            self._last = values.copy(), found[self._order]
            if self._report is not None:
                self._report(1)
        return self._last[1]

    def _jacobian(self, values: Floats) -> Floats:
        """Derivatives of the prediction, by differences within the limits."""
        here, columns = self.predicted(values), []
        for i, (value, low, high) in enumerate(zip(values, *self.model.limits)):
            step = REL_STEP * max(abs(value), (high - low) / 100)
            moved = values.copy()
            moved[i] = value + step if value + step <= high else value - step
            there = self.predicted(moved)
            columns.append((there - here) / (moved[i] - value))
        return np.stack(columns, axis=-1)


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
# light is: it is begun with from several places, and from finer ones if these fail.
ROUGHNESS = ((0.05, 0.15, 0.4), 1e-3, 1.0)
FINER = {"roughness": (0.06, 0.12)}
FINER |= dict.fromkeys(("alpha", "alpha_u", "alpha_v"), (0.004, 0.015))
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
MAX_LOADED = 4


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
    finer : tuple of float
        Values from which it begins again, where it found nothing near.
    """

    name: str
    starts: tuple[float, ...]
    low: float
    high: float
    finer: tuple[float, ...] = ()

    @classmethod
    def parse(cls, text: str) -> Parameter:
        """Parameter of a known name, or of ``name=low:high``."""
        name, equals, limits = text.partition("=")
        if not equals:
            if name not in KNOWN:
                raise SettingError(
                    f"free must name parameters such as {', '.join(list(KNOWN)[:6])}, "
                    f"or any with its limits as in weight=0:1, got {shown(text)}"
                    f"{did_you_mean(name, KNOWN)}"
                )
            return cls(name, *KNOWN[name], FINER.get(name, ()))
        try:
            low, high = map(float, limits.split(":"))
        except ValueError:
            low = high = np.nan
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise SettingError(
                f"free must give limits as in {name}=0:1, got {shown(text)}"
            )
        return cls(name, ((low + high) / 2,), low, high)

    def begun_at(self, value: object) -> Parameter:
        """The parameter whose search begins at one value, within its limits."""
        limits = self.low, self.high, f"from {self.low:g} to {self.high:g}"
        found = checked_number(f"start of {self.name}", value, *limits)
        return replace(self, starts=(found,), finer=())


class Limited:
    """What has free parameters, each within its limits.

    Attributes
    ----------
    parameters : tuple of Parameter
    """

    parameters: tuple[Parameter, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def limits(self) -> tuple[Floats, Floats]:
        """The lower and the upper limits of the parameters."""
        low, high = np.array([(p.low, p.high) for p in self.parameters]).T
        return low, high

    def part_within_limits(self, values: Floats, step: Floats) -> float:
        """Largest part of a step from some values, up to 1, that passes no limit."""
        low, high = self.limits
        room = np.where(step > 0, high - values, values - low)
        with np.errstate(divide="ignore", invalid="ignore"):
            parts = np.where(step != 0, room / np.abs(step), 1.0)
        return float(np.clip(parts.min(), 0.0, 1.0))

    def starts(self, finer: bool = False) -> list[Floats]:
        """Values from which to begin, of a parameter with fewer in turn."""
        if finer and not any(p.finer for p in self.parameters):
            return []
        each = [(finer and p.finer) or p.starts for p in self.parameters]
        most = max(map(len, each))
        return list(np.transpose([(one * most)[:most] for one in each]))


class FittedModel(Limited):
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
    start : mapping of str to float, optional
        Where the search for some of them begins.
    """

    def __init__(
        self,
        bsdf: Mapping[str, Any],
        free: Sequence[str] | None,
        channels: Sequence[str],
        start: Mapping[str, float] | None = None,
    ) -> None:
        if free is None:
            kind = bsdf["type"]
            if kind not in FREE:
                meant = did_you_mean(kind, FREE)
                if kind in CALLED:
                    meant = f"; did you mean {CALLED[kind]}?"
                raise SettingError(
                    f"free must name the parameters of {kind} to fit: there are "
                    f"defaults for {', '.join(FREE)} only{meant}"
                )
            free = [name for name in FREE[kind] if name not in bsdf]
        found = [Parameter.parse(text) for text in free]
        twice = [one.name for one in found if one.name in bsdf]
        if twice or not found:
            raise SettingError(
                f"free must name parameters of {bsdf['type']} to fit, none of which "
                f"has a given value, got {', '.join(twice) or 'nothing'}"
            )
        if any(one.name.startswith("alpha_") for one in found):
            found = [one for one in found if one.name != "alpha"]
        names = [one.name for one in found]
        for name, value in (start or {}).items():
            i = names.index(checked_choice("start", name, names))
            found[i] = found[i].begun_at(value)
        self.fixed, self.name = dict(bsdf), str(bsdf["type"])
        self.channels = tuple(channels)
        self.parameters = tuple(part for one in found for part in self._by_channel(one))

    def _by_channel(self, one: Parameter) -> list[Parameter]:
        """Of a colour one for each channel, within what Mitsuba loads as such."""
        if self.channels != RGB or not one.name.endswith(COLOURS):
            return [one]
        low, high = max(one.low, 0.0), min(one.high, 1.0)
        if low >= high:
            raise SettingError(
                f"free must give limits of the colour {one.name} from 0 to 1, got "
                f"{one.low:g}:{one.high:g}"
            )
        inside = tuple(start for start in one.starts if low <= start <= high)
        parts = inside or ((low + high) / 2,), low, high
        return [Parameter(f"{one.name}.{channel}", *parts) for channel in self.channels]

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

    described = bsdf

    @contextmanager
    def at(self, values: Floats) -> Iterator[dict[str, Any]]:
        """Context with the dictionary of these values, as of a scene."""
        yield self.bsdf(values)


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
        if not isinstance(bsdf, mi.BSDF):
            raise SettingError(f"model must be a BSDF, got {shown(bsdf)}")
        if colours:
            parameters = mi.traverse(bsdf)
            if all(f"{name}.value" in parameters for name in colours):
                while len(self._held) >= MAX_LOADED:
                    del self._held[next(iter(self._held))]  # the oldest
                self._held[rest] = bsdf, parameters
        return bsdf
