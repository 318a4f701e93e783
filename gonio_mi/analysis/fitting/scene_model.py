"""Scenes with free parameters, which are measured with their derivatives.

A scene has no integrals of one ``eval``. It is measured as the record was, with rays of
its own, at each step of the search, and once more with gradients, which tell where to
go. The noise of the model is in the uncertainties.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from os import PathLike
from typing import Any

import mitsuba as mi
import numpy as np

from ...array_types import Floats
from ...errors import SettingError, SpecimenError, checked_choice, shown
from ...instrument.setup import try_gradients
from ...results.record import Record
from ...specimen.loading import specimen_of
from ...specimen.specimen_text import SpecimenLike
from ...transport.gradients import Gradients
from ..comparison.measure_like import measure_like
from .least_squares import KNOWN, Limited, Parameter, Search
from .observations import RecordObservations

# Rays of a model for each of the record: a fifth of the variance of a difference. With
# as many as the record's, the noise of the derivatives made parameters of a field of
# facets 1.2 times as uncertain as was said (120 seeds), with these 1.08: Student's t.
RAYS_PER_RAY, MAX_RAYS = 4, 2**24

# Estimators that differentiate; for records of others, rays that carry their weights.
DIFFERENTIATING = ("weighted", "next_event", "quadrature")

# Differences where there is no derivative, relative to a value or to a tenth of its
# range.
DIFFERENCE = 0.1

# Of the first search: the relative change of chi-square, or of a parameter, by its last
# step, and its steps at most. Steps after it, and the standard errors of the last one.
FIRST_CHANGE, FIRST_STEPS, MAX_STEPS, LAST_STEP = 0.01, 12, 6, 0.5


def is_scene(model: Any, free: Sequence[str]) -> bool:
    """Whether a model is measured: what is no BSDF, or has parameters within it."""
    if any("." in one or "+" in one for one in (text.split("=")[0] for text in free)):
        return True
    if not isinstance(model, Mapping):
        return isinstance(model, (str, PathLike, mi.Object))
    return "type" in model and _has_geometry(model)


def _has_geometry(model: Mapping[str, Any]) -> bool:
    """Whether a dictionary is that of a shape or a scene."""
    kind = mi.PluginManager.instance().plugin_type(str(model["type"]))
    if kind is not mi.ObjectType.Unknown:
        return kind in (mi.ObjectType.Shape, mi.ObjectType.Scene)
    try:  # one in Python
        return isinstance(mi.load_dict(dict(model)), (mi.Shape, mi.Scene))
    except (RuntimeError, ValueError, TypeError):
        return False  # a BSDF without its free parameters, or what is refused as one


class FittedScene(Limited):
    """A scene in which parameters of BSDFs and textures are free.

    Parameters
    ----------
    scene : dict, mi.Scene, str or path
        As of :func:`gonio_mi.measure`. What it has is where the search begins.
    free : sequence of str
        Parameters as `mi.traverse` names them, or the ends of their names, with limits
        as in ``"bsdf.weight.value=0:1"``; those of a known kind, such as ``alpha``,
        have limits of their own. Several that are one and the same are joined by ``+``.
    start : mapping of str to float, optional
        Where the search for some of them begins.
    record : Record
        As which it is measured.

    Raises
    ------
    ValueError
        If there is no such parameter, or one without limits.
    """

    def __init__(
        self,
        scene: SpecimenLike,
        free: Sequence[str],
        start: Mapping[str, float] | None,
        record: Record,
    ) -> None:
        self.record = record
        loaded = specimen_of(scene, period=record.asked.period)
        self.scene, self.name = loaded.source, loaded.name.partition(":")[0]
        self._params = mi.traverse(self.scene)
        self.keys: list[list[str]] = []
        found, unlike = [], {}
        for text in free:
            joined, equals, limits = text.partition("=")
            own, *others = Gradients.of_names(self.scene, [joined]).columns
            if others:
                raise SettingError(
                    f"free must name parameters of one number each, got {shown(text)}"
                )
            keys = list(own.directions)
            kind = keys[0].removesuffix(".value").rpartition(".")[2]
            known = f"{kind}={KNOWN[kind][1]}:{KNOWN[kind][2]}" if kind in KNOWN else ""
            if not (equals or known):
                raise SettingError(
                    f"free must give limits as in {joined}=0:1, got {shown(text)}"
                )
            one = Parameter.parse(f"{joined}={limits}" if equals else known)
            numbers = [self._number(key) for key in keys]
            now = float(np.clip(numbers[0], one.low, one.high))
            found.append(Parameter(joined, (now,), one.low, one.high))
            self.keys.append(keys)
            if len({*numbers}) > 1:
                unlike[joined] = ", ".join(f"{x:.6g}" for x in numbers)
        names = [one.name for one in found]
        for name, value in (start or {}).items():
            i = names.index(checked_choice("start", name, names))
            found[i] = found[i].begun_at(value)
        self.parameters = tuple(found)
        self.notes = tuple(
            f"the search for {name} began at the first of the scene's values, "
            f"{values}: start (--start) gives another"
            for name, values in unlike.items()
            if name not in (start or {})
        )

    @property
    def joined_keys(self) -> list[str]:
        """Keys of each parameter, as names of gradients."""
        return ["+".join(keys) for keys in self.keys]

    def refusals(self, values: Floats) -> dict[str, str]:
        """Reason why a parameter is not differentiable, for each that is not."""
        found = {}
        with self.at(values) as scene:
            specimen = specimen_of(scene, period=self.record.asked.period)
            for name, keys in zip(self.names, self.joined_keys):
                gradients = Gradients.of_names(specimen.source, [keys])
                try:
                    try_gradients(gradients, specimen, self.record.asked)
                except SpecimenError as error:
                    found[name] = str(error)
        return found

    def _number(self, key: str) -> float:
        value = self._params[key]
        return float(np.ravel(value)[0])

    @contextmanager
    def at(self, values: Floats) -> Iterator[mi.Scene]:
        """Context in which the scene has these values; it is the user's, and stays."""
        own = {key: self._params[key] for keys in self.keys for key in keys}
        own = {key: type(value)(value) for key, value in own.items()}
        try:
            for keys, value in zip(self.keys, values):
                for key in keys:
                    self._params[key] = type(own[key])(float(value))
            self._params.update()
            yield self.scene
        finally:
            for key, value in own.items():
                self._params[key] = value
            self._params.update()

    def described(self, values: Floats) -> dict[str, Any]:
        """The scene's name, and the parameters by their keys."""
        own = {
            key: float(value) for keys, value in zip(self.keys, values) for key in keys
        }
        return {"type": self.name} | own


class SceneSearch(Search):
    """The search of a scene's parameters, by measurements.

    Rays of their own tell the derivatives and the weights of the patches: with those of
    the prediction, a patch that by chance is too bright would have too much of both,
    and pull the parameters.

    Parameters
    ----------
    model : FittedScene
    report : callable, optional
        Called with 1 for each measurement.
    settings : mapping
        Of :func:`gonio_mi.measure`, for the predictions.

    Attributes
    ----------
    derivatives : {"exact", "differences"}
        What measurements tell of themselves, or differences of some.
    refused : dict of str to str
        Reasons for finite differences, by parameter.
    """

    def __init__(
        self,
        model: FittedScene,
        report: Callable[[float], Any] | None,
        settings: Mapping[str, Any],
    ) -> None:
        record, self.model, self._report = model.record, model, report
        self.derivatives, self.refused = "exact", dict[str, str]()
        self.observations = self._observed = _observed(record)
        self.values = np.concatenate([one.values for one in self.observations])
        self.scales = np.ones_like(self.values)
        self._ends = np.cumsum([one.values.size for one in self.observations])[:-1]
        known, own = record.settings, dict[str, Any]()
        if known["estimator"] not in DIFFERENTIATING:
            own["estimator"] = "weighted"
        if known.get("rays"):
            own["rays"] = min(RAYS_PER_RAY * known["rays"], MAX_RAYS)
        own["seed"] = max(record.provenance.seeds, default=0) + 1
        own |= {name: value for name, value in settings.items() if value is not None}
        self._predicting, self._guiding = own, own | {"seed": own["seed"] + 1}
        self._held: dict[str, tuple[Floats, Record]] = {}

    def _measured(self, what: str, values: Floats) -> Record:
        """The model's record for a prediction, or for what guides the search."""
        if what in self._held and np.array_equal(self._held[what][0], values):
            return self._held[what][1]
        own = dict(self._predicting if what == "prediction" else self._guiding)
        if what == "guide":
            pairs = zip(self.model.names, self.model.joined_keys)
            gradients = [keys for name, keys in pairs if name not in self.refused]
            own |= {"gradients": gradients} if gradients else {}
        if self._report is not None:
            self._report(1)
        try:
            with self.model.at(values) as scene:
                (found,) = measure_like(scene, self.model.record, **own)
        except SpecimenError as error:
            if "gradients" not in own:
                raise
            self._refuse(values, str(error))
            return self._measured(what, values)
        self._held[what] = values.copy(), found
        return found

    def _refuse(self, values: Floats, why: str) -> None:
        """Switch to differences for what is not differentiable; for all if unknown."""
        names = [name for name in self.model.names if name not in self.refused]
        found = self.model.refusals(values)
        new = {name: found[name] for name in names if name in found}
        self.refused |= new or dict.fromkeys(names, why)
        self.derivatives = "differences"

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on starting values, and reasons for finite differences."""
        reasons = [
            f"derivatives by {name} are differences: {why}"
            for name, why in self.refused.items()
        ]
        return (*self.model.notes, *reasons)

    def measured(self, values: Floats) -> Record:
        """The model's record."""
        return self._measured("prediction", values)

    def predicted(self, values: Floats) -> Floats:
        """Flux fractions of the detectors, as the model has them."""
        return _fluxes(self.measured(values))

    def found(self) -> tuple[Floats, Floats]:
        """Values of the parameters, and their covariance.

        After a first search Gauss-Newton steps, of which the last is within the noise:
        more of them would only follow that of the model.
        """
        (values,) = self.model.starts()
        self._weigh(_fluxes(self._measured("guide", values)))
        values = self.minimum(values, FIRST_CHANGE, FIRST_CHANGE, FIRST_STEPS)
        for _ in range(MAX_STEPS):
            self._adapt(values)
            covariance = self.covariance(values)
            inverse = np.linalg.pinv(self._jacobian(values) / self.scales[:, None])
            before = values
            step = -inverse @ self.residuals(self.predicted(values))
            values = np.clip(values + step, *self.model.limits)
            noise = np.linalg.norm(inverse, axis=1)
            if np.all(np.abs(values - before) <= LAST_STEP * noise):
                break
        return values, covariance

    def _adapt(self, values: Floats) -> None:
        """Take the variances of the record, and the model's own noise beside them."""
        self._weigh(_fluxes(self._measured("guide", values)))
        noise = _variances(_observed(self.measured(values))).sum()
        self.scales = self.scales * np.sqrt(1 + noise / np.sum(self.scales**2))

    def _jacobian(self, values: Floats) -> Floats:
        """Derivatives of the prediction."""
        record, model = self._measured("guide", values), self.model
        columns = [
            self._difference(values, i)
            if name in self.refused
            else _flux_gradient(record, keys)
            for i, (name, keys) in enumerate(zip(model.names, model.joined_keys))
        ]
        return np.stack(columns, axis=-1)

    def _difference(self, values: Floats, i: int) -> Floats:
        """Central difference by one parameter."""
        low, high = (one[i] for one in self.model.limits)
        step = DIFFERENCE * max(abs(values[i]), (high - low) / 10)
        ends = np.array([values, values])
        ends[:, i] = np.clip([values[i] + step, values[i] - step], low, high)
        above, below = (_fluxes(self._measured("beside", end)) for end in ends)
        return (above - below) / (ends[0, i] - ends[1, i])

    def count(self) -> float:
        """How many values chi-square has; one of less than a hit counts in part."""
        own = _observed(self._held["prediction"][1])
        both = _variances(self._observed) + _variances(own)
        return float(np.sum(both / self.scales**2))

    def covariance(self, values: Floats) -> Floats:
        """Covariance of the minimum: noise of the record, and that of the model."""
        found = super().covariance(values)
        estimate, free = self._estimate(values)
        parts = np.split(estimate, self._ends, axis=-1)
        for one, part in zip(_observed(self.measured(values)), parts):
            own = one.points(one.variances(one.values)).covariance(part)
            found[np.ix_(free, free)] += own
        return found


def _observed(record: Record) -> list[RecordObservations]:
    return [RecordObservations(single) for single in record]


def _fluxes(record: Record) -> Floats:
    """Flux fractions of all detectors."""
    return np.concatenate([one.values for one in _observed(record)])


def _variances(observed: Sequence[RecordObservations]) -> Floats:
    """Variances of the flux fractions, by the scatter of batches."""
    return np.concatenate([one.std_errs() ** 2 for one in observed])


def _flux_gradient(record: Record, key: str) -> Floats:
    """Derivative of the flux fractions of all detectors, in one row for each record.

    Zero for detectors without hits; a NaN of the BSDF is an error.
    """
    solid = record.subdivision.projected_solid_angles[..., None]
    rows, sides = [], ("brdf", "btdf")[: record.n_hemispheres]
    for single, observed in zip(record, _observed(record)):
        each = [single.gradient(key, of) * solid for of in sides]
        rows.append(observed.kept(np.stack(each)))
    found = np.concatenate(rows)
    if np.isnan(found).any():
        raise SpecimenError(
            f"the derivative by {key} is NaN at {np.isnan(found).sum()} of "
            f"{found.size} detectors: give the parameter as known, or other limits"
        )
    return found
