"""Quantities of a specimen, measured in the geometry of each, or of a record."""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import mitsuba as mi
import numpy as np

from ...annexes import ask
from ...array_types import Floats
from ...campaigns.measure import measure
from ...collector import Borders, Receptors, Subdivision
from ...collector.receptors import Window
from ...errors import (
    SettingError,
    SettingTypeError,
    checked_choice,
    checked_number,
    shown,
    warn,
)
from ...files.measured_table import STATED, MeasuredTable
from ...progress import counted
from ...results.record import Record
from ...specimen.loading import specimen_of
from ...specimen.specimen_text import SpecimenLike
from ..comparison.comparison import known
from ..comparison.measure_like import far_source
from ..points import Model
from .definitions import DEFINITIONS, GROUPS, Definition, Range
from .functionals import checked_weights, difference, jackknifed, ratio
from .patch_limits import PatchLimits
from .table_quantity import BOUNDS, table_estimate

# Distance of a source, in extents of the specimen: a parallax of 6e-4 degrees.
DISTANCE = 1e5


@dataclass(frozen=True)
class Quantity:
    """What an instrument would state, and how well it is known.

    Attributes
    ----------
    name : str
    value, std_err : float
        Standard uncertainty: NaN where nothing was received, or from a single batch.
    interval : (float, float)
        Of 95 %. Where few rays arrived it is that of their number.
    hits : int
        Rays that it is known by.
    definition : Definition
        What was simulated, and where the quantity is defined.
    settings : mapping
        Of the measurement, as of a record.
    unresolved : float
        Part of the interval on either side that the patches leave open in which the
        material itself, a file or a record, was measured; or the directions of a table.
    parts : mapping of str to float
        The budget, by source: standard errors (``rays``; ``values`` and ``calibration``
        of a table; ``parameters`` of a fit), and the bounds that make `unresolved`.
    notes : tuple of str
        What is not in the interval, and what stands for what.
    told_by : str
        What `hits` counts.
    """

    name: str
    value: float
    std_err: float
    interval: tuple[float, float]
    hits: int
    definition: Definition
    settings: Mapping[str, Any]
    unresolved: float = 0.0
    parts: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    told_by: str = "rays arrived"

    @classmethod
    def of(
        cls,
        name: str,
        own: Definition,
        settings: Mapping[str, Any],
        estimate: Floats,
        hits: int,
    ) -> Quantity:
        """Quantity of a definition: value, standard error and limits."""
        value, std_err, low, high = estimate.tolist()
        parts, interval = {"rays": std_err}, (low, high)
        return cls(name, value, std_err, interval, hits, own, settings, parts=parts)

    def __str__(self) -> str:
        own, (low, high) = self.definition, self.interval
        unit = own.unit and f" {own.unit}"
        text = f"{self.value:.5g}{unit} +- {self.std_err:.2g}"
        if "values" in self.parts and not self.std_err:
            text = f"{self.value:.5g}{unit}"
        text += f" (95 %: {low:.5g} to {high:.5g})"
        if not self.hits and np.isnan(self.std_err):
            text = f"0, at most {high:.3g}{unit}: no ray arrived"
        if self.unresolved > self.std_err / 10:
            text += f", of which +- {self.unresolved:.2g} by {self._unresolved_by}"
        more = f"{own.title}: {own.geometry}; {self.hits} {self.told_by}. {own.source}"
        notes = [f"note: {note}" for note in self.notes]
        return "\n    ".join([f"{self.name}: {text}", more, *notes])

    @property
    def _unresolved_by(self) -> str:
        """What leaves part of the interval open, in words."""
        bounds = {name: self.parts[name] for name in BOUNDS if name in self.parts}
        parts = [n for n, part in bounds.items() if part > self.unresolved / 10]
        return ", ".join(BOUNDS[name] for name in parts)

    def to_dict(self) -> dict[str, Any]:
        """Return all of it in JSON's types; None for what is not known."""
        words = ("title", "unit", "geometry", "source")
        found = vars(self) | {one: getattr(self.definition, one) for one in words}
        parts = {one: known(part) for one, part in self.parts.items()}
        std_err = known(self.std_err)
        found |= {"interval": list(self.interval), "parts": parts, "std_err": std_err}
        del found["definition"]
        return found


def quantity(
    name: str | Sequence[str],
    specimen: SpecimenLike | Record | MeasuredTable | Model,
    *,
    phi_i: float = 0.0,
    progress: bool = False,
    **settings: Any,
) -> Any:
    """Say what an instrument would state of a specimen: gloss, haze, R_A and so on.

    Parameters
    ----------
    name : str or sequence of str
        ``"gloss60"``, with parameters ``"R_A:observation=0.33,entrance=5"``, or a name
        of several: ``"gloss"``. Those of one geometry of light share their rays.
        :data:`gonio_mi.analysis.quantities.DEFINITIONS` has all of them.
    specimen : dict, mi.BSDF, mi.Scene, str, path, MeasuredTable, Record or Fit
        See :func:`gonio_mi.measure`. The values of an instrument's own table
        (:func:`gonio_mi.read_measured`) are interpolated within the receptors; nothing
        is measured. A record and a fit tell it by their own
        :meth:`~gonio_mi.Record.quantity` and :meth:`~gonio_mi.Fit.quantity`.
    phi_i : float
        Azimuth of the plane of incidence in degrees: the rotation of the specimen. Of a
        table with a single one it may be left out.
    progress : bool
        Show a progress bar on standard error.
    **settings
        Of :func:`gonio_mi.measure`, such as `rays` for each geometry, `seed`, `side`
        and `period`. Several wavelengths of spectral variants, by default 400 to 700 nm
        in steps of 20 nm, are weighted by illuminant D65, of retroreflection by A, and
        by the photopic observer V, R, G and B by their luminance. Of a table
        `uncertainty`, `scale_uncertainty` and `aperture_half_angle`, as of
        :func:`gonio_mi.fit`.

    Returns
    -------
    Quantity or tuple of Quantity
        A tuple for several names or a name of several.

    Raises
    ------
    TypeError, ValueError
        For an unknown name, a setting that the quantity decides, transmission of an
        opaque specimen, a table that does not cover a quantity's directions, and as
        :func:`gonio_mi.measure`.
    """
    if isinstance(specimen, Model):
        return specimen.quantity(name, phi_i=phi_i, progress=progress, **settings)
    if isinstance(specimen, Record):
        for key in {**settings, **({"phi_i": phi_i} if phi_i else {})}:
            raise SettingTypeError(f"{key} applies to a specimen, got a record")
        try:
            found = tuple(record_quantity(specimen, one) for one in _names(name))
        except SettingError as error:
            raise SettingError(
                f"{error}: a record has the quantities of its own light and receptors; "
                "the table that export writes of it (.csv) is interpolated"
            ) from None
    elif isinstance(specimen, MeasuredTable):
        found = of_table(name, specimen, phi_i, settings)
    else:
        found, _ = quantities(name, specimen, phi_i, progress, settings)
    one = isinstance(name, str) and name.partition(":")[0] in DEFINITIONS
    return found[0] if one else found


def quantities(
    name: str | Sequence[str],
    specimen: SpecimenLike,
    phi_i: float,
    progress: bool,
    settings: dict[str, Any],
) -> tuple[tuple[Quantity, ...], bool]:
    """Those of :func:`quantity`, and whether Ctrl-C left some of their rays out.

    Then they are those whose light was measured, KeyboardInterrupt if none was.
    """
    if mi.is_spectral and settings.get("wavelengths") is None:
        settings = settings | {"wavelengths": ask("exchange", "VISIBLE_NM")}
    asked = {one: definition_of(one) for one in _names(name)}
    parts = [part for one in asked.values() for part in (one, one.minus) if part]
    records: dict[int, Record] = {}
    stopped = False
    loaded = specimen_of(specimen, settings.get("parameters"), settings.get("period"))
    extent, limits = loaded.reach, PatchLimits(loaded)
    # a campaign passes the description on to its folder and its workers
    elsewhere = any(settings.get(name) is not None for name in ("executor", "folder"))
    measured = specimen if elsewhere else loaded
    for group in counted(_groups(parts), progress, unit="geometry"):
        decided = _light(group[0], extent) | {"collector": _collector(group, phi_i)}
        try:
            record = measure(measured, phi_i=phi_i, **settings, **decided)
        except KeyboardInterrupt:
            stopped = True
            break
        records |= {id(one): record for one in group}
        if not (record.flux_fraction.any() or record.ledger.missed):
            text = "no light leaves the specimen: from behind a one-sided BSDF is "
            warn(f"{text}black, unless it is nested in the plugin twosided")
        if stopped := record.provenance.interrupted:
            break
    found = []
    for one, own in asked.items():
        if not {id(part) for part in (own, own.minus) if part} <= records.keys():
            continue
        estimate, hits = evaluated(own, records[id(own)])
        unresolved = limits.unresolved(own, estimate, records[id(own)])
        if own.minus:
            beside = records[id(own.minus)]
            less, _ = evaluated(own.minus, beside)
            unresolved += limits.unresolved(own.minus, less, beside)
            estimate = difference(estimate, less)
        # no flux is negative
        low = min(estimate[2], max(estimate[2] - unresolved, 0.0))
        estimate[2:] = low, estimate[3] + unresolved
        each = Quantity.of(one, own, records[id(own)].settings, estimate, hits)
        if unresolved:
            budget = {**each.parts, "patches": unresolved}
            each = replace(each, unresolved=unresolved, parts=budget)
        found.append(each)
    if not found:
        raise KeyboardInterrupt
    return tuple(found), stopped


def of_table(
    name: str | Sequence[str],
    table: MeasuredTable,
    phi_i: float,
    settings: Mapping[str, Any],
) -> tuple[Quantity, ...]:
    """Quantities of a measured table."""
    told = {key: value for key, value in settings.items() if value is not None}
    for key in told.keys() - {*STATED}:
        raise SettingTypeError(f"{key} applies to a specimen, got a table")
    table = table.stated(**told)
    found = []
    for one in _names(name):
        own = definition_of(one)
        e = table_estimate(own, table, phi_i)
        numbers = np.array([e.value, e.std_err, *e.interval])
        each = Quantity.of(one, own, {"table": table.name}, numbers, e.n_values)
        parts, notes, told_by = e.parts, e.notes, "values of the table"
        each = replace(each, unresolved=e.unresolved, parts=parts)
        found.append(replace(each, notes=notes, told_by=told_by))
    return tuple(found)


def record_quantity(record: Record, what: Any, over: Any = None) -> Quantity:
    """Quantity that a record tells: one by its name, or any sum over patches.

    Parameters
    ----------
    record : Record
        Of one incident direction. For a name it is that of the quantity, and the
        collector has its windows among its receptors.
    what : str or array_like, shape (n_hemispheres, n_rows, n_columns)
        Or weights of ``flux_fraction``, of either sign.
    over : array_like, optional
        Weights of the flux that the sum is divided by, of at least 0.

    Raises
    ------
    TypeError, ValueError
        If the collector or the light is not that of the quantity.
    """
    if record.stacked:
        raise SettingError("a quantity is of one incident direction: take record[0]")
    if isinstance(what, str):
        own, theta_i = definition_of(what), record.theta_i[0]
        parallel = str(record.provenance.emitter).startswith("DirectionalEmitter")
        off = abs(theta_i - own.theta_i) > 1e-3 or parallel == bool(own.beam)
        if own.minus or own.diffuse or off:
            light = f"{'parallel ' * parallel}light from {theta_i:g} degrees"
            raise SettingError(f"{what} needs {own.light}, got a record of {light}")
        return Quantity.of(what, own, record.settings, *evaluated(own, record))
    if np.ndim(what) == 0:
        raise SettingTypeError(
            f"what must be the name of a quantity or weights of patches, got {what!r}"
        )
    rows = checked_weights(record, [what] if over is None else [what, over])
    if np.any(rows[1:] < 0):
        raise SettingError("over must hold weights of at least 0, got negative ones")
    if over is not None and not np.any(record.flux_fraction[rows[1] > 0]):
        raise SettingError("over must hold patches with light, got none")
    where = _light_of(record), _hemispheres_of(rows)
    own = Definition("weighted sum of patches", "of the record", words=", ".join(where))
    hits = int(record.counts[rows[0] != 0].sum())
    estimate = ratio(_seen(own, record), *rows)
    return Quantity.of("sum", own, record.settings, estimate, hits)


def definition_of(word: str) -> Definition:
    """Definition of a name, with the parameters that follow its colon."""
    name, _, rest = word.partition(":")
    make = DEFINITIONS[checked_choice("quantity", name, [*DEFINITIONS, *GROUPS])]
    own = inspect.signature(make).parameters.items()
    ranges: dict[str, Range] = {
        key: one.annotation.__metadata__[0]
        for key, one in own
        if hasattr(one.annotation, "__metadata__")
    }
    given: dict[str, float] = {}
    for pair in filter(None, rest.split(",")):
        key, _, value = pair.partition("=")
        if not ranges:
            raise SettingError(f"{name} takes no parameters, got {shown(pair)}")
        allowed = ranges[checked_choice(f"a parameter of {name}", key, ranges)]
        if key in given:
            raise SettingError(f"{key} of {name} must be given once, got it twice")
        given[key] = checked_number(f"{key} of {name}", value, *allowed, str(allowed))
    return make(**given)


def _names(name: str | Sequence[str]) -> list[str]:
    """Names of single quantities, of each of a group with its parameters."""
    words = [name] if isinstance(name, str) else map(str, name)
    parts = [word.partition(":") for word in words]
    return [
        f"{one}{colon}{rest}" for n, colon, rest in parts for one in GROUPS.get(n, (n,))
    ]


def evaluated(own: Definition, record: Record) -> tuple[Floats, int]:
    """Estimate of a definition, whose `minus` is left to others, and rays that tell.

    Raises
    ------
    ValueError
        If nothing is transmitted, or the collector lacks a window.
    """
    name, over = record.provenance.name, None
    weights = _within(own, record, own.receptors)
    if own.without:
        weights = weights - _within(own, record, own.without)
    if own.over is not None:
        over = _within(own, record, own.over)
        if not record.flux_fraction[over > 0].any():
            raise SettingError(f"{own.title} needs light that leaves, got none: {name}")
    grey, hits = _seen(own, record), record.counts[weights > 0].sum()
    if own.curve and own.patches == record.subdivision:
        return jackknifed(grey, own.curve), int(hits)
    if own.curve:
        raise SettingError(f"{own.title} needs the collector {own.patches}")
    return own.scale * ratio(grey, weights, over), int(hits)


def _light_of(record: Record) -> str:
    """Incident light of a record in words."""
    if record.asked.incident is not None:
        return f"light that fills patches of {record.asked.incident}"
    theta_i, phi_i = record.theta_i[0], record.phi_i[0]
    if not np.isfinite(theta_i):
        return f"light of {record.provenance.emitter}"
    text = f"light from (theta_i, phi_i) = ({theta_i:g}, {phi_i:g}) degrees"
    divergence = record.asked.divergence
    return f"{text}, a divergence of {divergence:g}" if divergence else text


def _hemispheres_of(rows: Floats) -> str:
    """Which hemispheres have weight, in words."""
    lit = np.any(rows != 0, axis=(0, 2, 3))
    names = [one for one, has in zip(("reflected", "transmitted"), lit) if has]
    return " and ".join(names) or "no patch of weight"


# ---------------------------------------------------------------- light and receptors


def _light(own: Definition, extent: float) -> dict[str, Any]:
    """Settings of the light that a definition asks for."""
    if own.diffuse:
        return {"theta_i": 0.0, "incident": Borders((0, 90), (0, 360))}
    light: dict[str, Any] = {"theta_i": own.theta_i}
    if own.beam:
        half_angles = [angle / 2 for angle in own.beam]
        light["emitter"] = far_source(half_angles, DISTANCE * extent)
        light["emission"] = ("radiometric", "equal_power")[len(half_angles) - 1]
    return light


def _groups(definitions: Sequence[Definition]) -> list[list[Definition]]:
    """Definitions that share light, and whose windows do not overlap."""
    groups: list[list[Definition]] = []
    for one in definitions:
        for group in groups:
            with contextlib.suppress(SettingError):
                alike = (one.light, one.patches) == (group[0].light, group[0].patches)
                if alike and _collector([*group, one]).n_patches:
                    group.append(one)
                    break
        else:
            groups.append([one])
    return groups


def _collector(group: Sequence[Definition], phi_i: float = 0.0) -> Subdivision:
    """Receptors of some definitions, the smaller ones first; or their patches."""
    parts = [(*x.receptors, *x.without, *(x.over or ())) for x in group]
    windows = {_turned(window, phi_i) for part in parts for window in part}
    if not windows:
        return group[0].patches or Borders((0, 90), (0, 360))
    return Receptors(tuple(sorted(windows, key=lambda w: (w[2] * w[-1], w))))


def _turned(window: Window, phi_i: float) -> Window:
    """The window where the plane of incidence has an azimuth."""
    return (window[0], (window[1] + phi_i) % 360.0, *window[2:])


def _within(own: Definition, record: Record, windows: Sequence[Window]) -> Floats:
    """1 for patches within windows, or of all the hemisphere; 0 for others."""
    patches = record.subdivision
    name = f"{own.title} needs {{}}, got {record.provenance.name}"
    if own.lower and not record.has_lower:
        raise SettingError(name.format("transmitted light") + ", which is opaque")
    if own.lower and record.ledger.missed:
        text = name.format("a specimen that fills the beam, such as a periodic one")
        raise SettingError(f"{text}, which light misses")
    weights = np.zeros((record.n_hemispheres, patches.n_patches))
    turned = tuple(_turned(window, float(record.phi_i[0])) for window in windows)
    inside = patches.within(turned) if windows else True
    if inside is None:
        wanted = f"the collector {Receptors(turned)}"
        raise SettingError(f"{own.title} needs {wanted}, got {patches!s:.40}")
    weights[int(own.lower)] = inside
    return weights.reshape(-1, *patches.shape)


def _seen(own: Definition, record: Record) -> Record:
    """Record of one channel: the luminance, under the definition's illuminant."""
    found: Record = ask("exchange", "seen")(record, own.illuminant)
    return found
