"""Tables of measured values: what they hold, and in which ranges."""

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats
from ..collector import Subdivision, subdivision
from ..errors import (
    FileFormatError,
    SettingError,
    checked_choice,
    checked_number,
    did_you_mean,
    number_of,
    shown,
)
from . import replacing
from .numbers import is_decimal, without_degrees

COLUMNS = ("theta_i", "phi_i", "theta_o", "phi_o", "value")
# Incident directions that are listed where a table is shown.
MAX_LISTED = 12
UNSTATED = "not stated"

QUANTITIES = ("brdf", "brdf_cos", "btdf", "reflectance_factor")
UNITS = ("1/sr", "sr^-1")

# Bounds of values in 1/sr and of relative uncertainties, far above any measured ones;
# squares of larger numbers overflow.
MAX_VALUE, MAX_RELATIVE = 1e30, 1e6

# Header keys that are numbers: interval and condition of each.
NUMBERS = {
    "uncertainty": (0, MAX_RELATIVE, "a finite number of 0 or more, below 1e6"),
    "scale_uncertainty": (0, MAX_RELATIVE, "a finite number of 0 or more, below 1e6"),
    "degrees_of_freedom": (1, 1e15, "a number of 1 or more, below 1e15"),
    "aperture_half_angle": (0, 90, "an angle in degrees in [0, 90)"),
    "aperture_solid_angle": (0, 2 * np.pi, "a solid angle in sr in [0, 2 pi)"),
    "emitter_half_angle": (0, 90, "an angle in degrees in [0, 90)"),
    "emitter_distance": (0, 1e15, "a finite distance of 0 or more, below 1e15"),
}
TEXTS = ("units", "quantity", "channel")

# What a user may state of a table beside how it is read.
STATED = ("uncertainty", "scale_uncertainty", "aperture_half_angle")

# Decimals of a degree that distinguish directions, and standard errors by which two
# values of one direction may differ.
ANGLE_DIGITS, MAX_STD_ERRS = 6, 6.0


@dataclass(frozen=True, eq=False)
class MeasuredTable:
    """Values that an instrument has measured, one per pair of directions.

    Parameters
    ----------
    theta_i, phi_i, theta_o, phi_o : array_like of float, shape (n,)
        Directions of incidence and of exit in degrees, away from the surface:
        ``0 <= theta_i < 90`` from the normal of the lit face, azimuths from +x
        counter-clockwise, of any turn. ``0 <= theta_o < 90`` for reflection,
        ``90 < theta_o <= 180`` for transmission: the horizon is no direction of exit.
    value : array_like of float, shape (n,)
        `quantity` in 1/sr; noise may leave it negative.
    sigma : array_like of float, shape (n,), optional
        Standard uncertainty of `value`, in its unit, 0 or more, independent between
        points.
    quantity : {"brdf", "brdf_cos", "btdf", "reflectance_factor"}
        ``brdf_cos`` is the BRDF times cos(theta_o). A reflectance factor is pi sr times
        the BRDF: 1 for a white Lambertian; its values and `sigma` have no unit.
    degrees_of_freedom : float, optional
        Of `sigma`, found from so many repeated measurements less one (JCGM 100, G.3);
        by default it is exact.
    uncertainty : float
        Relative standard uncertainty of each value, independent between points; it adds
        to `sigma` in quadrature. 0.005 is 0.5 %.
    scale_uncertainty : float
        Relative standard uncertainty of a factor common to all values: calibration.
    aperture_half_angle : float, optional
        Of the detector's circular aperture, in degrees, seen from the specimen.
    emitter_half_angle : float
        Of a round source, in degrees; 0 is a collimated beam.
    emitter_distance : float, optional
        From the specimen to that source, in scene units.
    channel : str, optional
        Channel of a record that the values belong to, such as ``"550nm"``.
    header : dict
        Other keys of the file's header, as text.
    name : str
        Where the table came from, for messages.
    notes : tuple of str
        What its reader inferred, in sentences.

    Raises
    ------
    TypeError, ValueError
        If a column is empty, of another length than the others, or holds a value that
        is not finite or outside of its range; or a setting is.
    """

    theta_i: Floats
    phi_i: Floats
    theta_o: Floats
    phi_o: Floats
    value: Floats
    sigma: Floats | None = None
    quantity: str = "brdf"
    uncertainty: float = 0.0
    scale_uncertainty: float = 0.0
    degrees_of_freedom: float | None = None
    aperture_half_angle: float | None = None
    emitter_half_angle: float = 0.0
    emitter_distance: float | None = None
    channel: str | None = None
    header: dict[str, Any] = field(default_factory=dict)
    name: str = "the table"
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        checked_choice("quantity", self.quantity, QUANTITIES)
        for name, (low, high, condition) in NUMBERS.items():
            value = getattr(self, name, None)
            if value is not None:
                value = checked_number(name, value, low, high, condition)
                object.__setattr__(self, name, value)
        for name in ("aperture_half_angle", "emitter_distance"):
            if getattr(self, name) == 0:
                raise SettingError(f"{name} must be positive, got 0")
        for name in (*COLUMNS, "sigma"):
            column = getattr(self, name)
            if column is not None:
                object.__setattr__(self, name, self._checked(name, column))

    def _checked(self, name: str, column: ArrayLike) -> Floats:
        """Column as a read-only array, or the first row that does not fit."""
        values = np.array(column, dtype=float)
        n = np.size(self.theta_i)
        if values.ndim != 1 or values.size != n or n == 0:
            raise SettingError(
                f"{name} must hold one number for each of {n or 'at least one'} rows, "
                f"got the shape {values.shape}"
            )
        good, condition = fits(name, values, self.quantity)
        if not good.all():
            row = int(np.argmin(good))
            raise SettingError(
                f"{name} must be {condition}, got {values[row]:g} in row {row}"
            )
        values.flags.writeable = False
        return values

    def __len__(self) -> int:
        return len(self.value)

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"

    def __str__(self) -> str:
        """Summary of the table's content and of how it was interpreted."""
        incident = self.incident
        listed = [f"({theta:.5g}, {phi:.5g})" for theta, phi in incident[:MAX_LISTED]]
        if len(incident) > MAX_LISTED:
            listed.append(f"and {len(incident) - MAX_LISTED} more")
        errors, aperture = self.bsdf_std_err, self.aperture_half_angle
        known = "0" if self.sigma is not None else UNSTATED
        if errors.any():
            known = f"{np.median(errors):.3g} 1/sr (median)"
        if self.sigma is not None and self.uncertainty:
            known += f" of sigma and {self.uncertainty:.3g} of each value in quadrature"
        low, high = np.round([self.theta_o.min(), self.theta_o.max()], 6)
        exits = f"{low:.5g}" if low == high else f"{low:.5g} to {high:.5g}"
        detector = UNSTATED
        if aperture:
            detector = f"half-angle {aperture:.4g} degrees"
        elif self.patches is not None:
            detector = f"patch means, {self.patches}"
        lines = [
            f"table       {self.name}",
            f"values      {len(self)} of {self.quantity}"
            + (f", channel {self.channel}" if self.channel else ""),
            f"incident    {number_of(len(incident), 'direction')} (theta_i, phi_i) in "
            f"degrees: {' '.join(listed)}",
            f"exit        theta_o {exits} degrees",
            f"BSDF        {self.bsdf.min():.4g} to {self.bsdf.max():.4g} 1/sr, mean "
            f"{self.bsdf.mean():.4g}",
            f"uncertainty {known}; common to all {self.scale_uncertainty:.3g}",
            f"aperture    {detector}",
        ]
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])

    def __repr__(self) -> str:
        return (
            f"<MeasuredTable {self.name}: {number_of(len(self), 'value')} of "
            f"{self.quantity}, {number_of(len(self.incident), 'incident direction')}>"
        )

    def stated(self, **told: float | None) -> "MeasuredTable":
        """Return the table with what is told of it beside its file; None says nothing.

        Of `uncertainty`, `scale_uncertainty` and `aperture_half_angle`, the last only
        where the table does not state it.
        """
        given: dict[str, Any] = {k: v for k, v in told.items() if v is not None}
        if self.aperture_half_angle is not None:
            given.pop("aperture_half_angle", None)
        return replace(self, **given)

    @property
    def incident(self) -> list[tuple[float, float]]:
        """Distinct pairs (theta_i, phi_i) in degrees, in the order of the table."""
        return list(dict.fromkeys(zip(self.theta_i.tolist(), self.phi_i.tolist())))

    @property
    def patches(self) -> Subdivision | None:
        """Patches over which the values are means, if the header names a `collector`.

        As in tables that `gonio_mi.export` wrote; an aperture goes before it. None for
        a collector of apertures, too.
        """
        if self.aperture_half_angle is not None:
            return None
        try:
            patches = subdivision(self.header.get("collector", ""))
        except SettingError:
            return None
        return patches if patches.aperture_half_angle is None else None

    @property
    def rays(self) -> dict[str, str]:
        """Identifiers of the rays of the record from which the table was exported.

        As of `Record.ray_keys`; empty if the header has
        no `seed` beside a `collector`, as that of older files and of others' tables.
        """
        header = {key.lower(): text for key, text in self.header.items()}
        if not {"collector", "seed"} <= header.keys():
            return {}
        return {key: header[key] for key in ("seed", "sampler") if key in header}

    @property
    def bsdf(self) -> Floats:
        """BRDF or BTDF in 1/sr without cosine, shape (n,)."""
        return self.value / self._factor

    @property
    def bsdf_std_err(self) -> Floats:
        """Standard uncertainty of `bsdf` that is independent between points.

        `sigma` and `uncertainty` in quadrature, in 1/sr, shape (n,).
        """
        sigma = 0.0 if self.sigma is None else self.sigma
        return np.hypot(sigma, self.uncertainty * np.abs(self.value)) / self._factor

    @property
    def bsdf_dof(self) -> Floats:
        """Effective degrees of freedom of `bsdf_std_err`, shape (n,).

        After Welch and Satterthwaite; infinite where `sigma` is 0 or exact.
        """
        if self.degrees_of_freedom is None or self.sigma is None:
            return np.full(len(self), np.inf)
        of_sigma = (self.sigma / self._factor) ** 4
        found = np.full(len(self), np.inf)
        np.divide(self.bsdf_std_err**4, of_sigma, out=found, where=of_sigma > 0)
        return self.degrees_of_freedom * found

    @property
    def _factor(self) -> Floats | float:
        """Factor from BRDF or BTDF in 1/sr to `value`."""
        if self.quantity == "reflectance_factor":
            return np.pi
        if self.quantity != "brdf_cos":
            return 1.0
        return np.cos(np.radians(self.theta_o))

    def save(
        self, path: str | PathLike[str], others: Mapping[str, Floats] | None = None
    ) -> None:
        """Write the table as a CSV file that `read_measured` reads back.

        Azimuths are written in [0, 360) degrees. Columns of `others` follow, which are
        not read back.
        """
        lines = [f"# units: {UNITS[0]}", f"# quantity: {self.quantity}"]
        if self.quantity == "reflectance_factor":
            lines[0] = "# units: 1"
        for key in (*NUMBERS, "channel"):
            value = getattr(self, key, None)
            if value:
                lines.append(f"# {key}: {value}")
        lines += [f"# {key}: {value}" for key, value in self.header.items()]
        names = [*COLUMNS, *(() if self.sigma is None else ("sigma",))]
        columns = [getattr(self, name) for name in names]
        for i, name in enumerate(names):
            if name.startswith("phi"):
                turned = columns[i] % 360
                columns[i] = np.where(turned < 360, turned, 0.0)  # of -1e-15
        further = dict(others or {})
        lines.append(",".join([*names, *further]))
        columns += further.values()
        for row in zip(*(column.tolist() for column in columns)):
            lines.append(",".join(map(repr, row)))
        with replacing(path) as stream:
            stream.write(("\n".join(lines) + "\n").encode())


def fits(name: str, value: Any, quantity: str) -> tuple[Any, str]:
    """Whether each value fits its column, and the condition; NaN never does."""
    if name == "theta_i":
        return (value >= 0) & (value < 90), "an angle in degrees in [0, 90)"
    if name == "theta_o" and quantity == "btdf":
        condition = "an angle in degrees in (90, 180] for btdf"
        return (value > 90) & (value <= 180), condition
    if name == "theta_o":
        condition = f"an angle in degrees in [0, 90) for {quantity}"
        return (value >= 0) & (value < 90), condition
    if name == "sigma":
        return (value >= 0) & (value < MAX_VALUE), "a finite number of 0 or more"
    return np.abs(value) < MAX_VALUE, "a finite number"


def repeats_noted(table: MeasuredTable) -> MeasuredTable:
    """Table with a note on directions that it holds more than once.

    Raises
    ------
    FileFormatError
        If two values of one direction contradict each other: they differ by more than
        half of the larger one, the median of all, and their uncertainties.
    """
    pole = (table.theta_o == 0) | (table.theta_o == 180)
    angles = [table.theta_i, table.phi_i % 360, table.theta_o]
    angles.append(np.where(pole, 0, table.phi_o % 360))
    keys = np.round(np.stack(angles, axis=1), ANGLE_DIGITS)
    keys[:, [1, 3]] %= 360
    order = np.lexsort((table.value, *keys.T[::-1]))
    new = (np.diff(keys[order], axis=0) != 0).any(axis=1)
    first = np.flatnonzero(np.concatenate([[True], new]))
    counts = np.diff(first, append=len(keys))
    low, high = order[first], order[first + counts - 1]
    apart = table.value[high] - table.value[low]
    if counts.max() == 1:
        return table
    largest = np.maximum(np.abs(table.value[high]), np.abs(table.value[low]))
    sigma = table.bsdf_std_err * table._factor
    noise = MAX_STD_ERRS * np.hypot(sigma[high], sigma[low])
    most = np.maximum(largest / 2, np.maximum(np.median(np.abs(table.value)), noise))
    if (apart > most).any():
        k = int(np.argmax(apart - most))
        angles_of_pair = ", ".join(
            f"{name} {angle:g}" for name, angle in zip(COLUMNS, keys[order][first[k]])
        )
        raise FileFormatError(
            f"{table.name}: the direction {angles_of_pair} has the values "
            f"{table.value[low[k]]:g} and {table.value[high[k]]:g}: one is wrong, or "
            "no column distinguishes them"
        )
    with np.errstate(invalid="ignore", divide="ignore"):
        spread = np.nanmax(np.where(apart > 0, apart / largest, 0.0))
    note = (
        f"{number_of(np.count_nonzero(counts > 1), 'direction')} with several values, "
        f"which differ by up to {spread:.2g} of the larger one"
    )
    return replace(table, notes=(*table.notes, note))


def parsed_keys(
    place: str, comments: Sequence[tuple[int, str]]
) -> tuple[dict[str, Any], dict[str, str]]:
    """Settings of a `MeasuredTable`, and other keys as text.

    Parameters
    ----------
    place : str
        The file, for messages.
    comments : sequence of (int, str)
        Line numbers, and lines without their mark.

    Raises
    ------
    FileFormatError
        If a key is out of its range, there twice, or looks misspelt.
    """
    settings: dict[str, Any] = {}
    header: dict[str, str] = {}
    for number, comment in comments:
        _read_key(f"{place}, line {number}", comment, settings, header)
    solid_angle = settings.pop("aperture_solid_angle", None)
    if solid_angle is not None:
        if "aperture_half_angle" in settings:
            raise FileFormatError(
                f"{place} must have either aperture_half_angle or aperture_solid_angle"
            )
        # solid angle of a cone: 4 pi sin^2(a / 2)
        half = 2 * math.asin(math.sqrt(solid_angle / (4 * math.pi)))
        settings["aperture_half_angle"] = math.degrees(half)
    if settings.pop("units", None) == "1":
        settings.setdefault("quantity", "reflectance_factor")
    return settings, header


def _read_key(
    place: str, comment: str, settings: dict[str, Any], header: dict[str, str]
) -> None:
    """Take ``key: value`` from a comment line into `settings` or `header`."""
    key, colon, text = (part.strip() for part in comment.partition(":"))
    if not colon:
        return
    known = (*NUMBERS, *TEXTS)
    name = key.lower().replace(" ", "_")
    if name in settings:
        raise FileFormatError(f"{place}: the key {key} must occur once, got it again")
    if name not in known:
        meant = did_you_mean(name, known)
        if meant:
            raise FileFormatError(f"{place}: unknown key {shown(key)}{meant}")
        header[key] = text
        return
    try:
        if name in NUMBERS:
            number = without_degrees(text) if name.endswith("half_angle") else text
            if not is_decimal(number):
                condition = NUMBERS[name][2]
                raise SettingError(f"{name} must be {condition}, got {shown(text)}")
            settings[name] = checked_number(name, number, *NUMBERS[name])
            return
        if name != "channel":
            choices = (*UNITS, "1") if name == "units" else QUANTITIES
            checked_choice(name, text, choices)
    except ValueError as error:
        raise FileFormatError(f"{place}: {error}") from None
    settings[name] = text
