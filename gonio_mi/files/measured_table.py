"""Tables of measured values: what they hold, and in which ranges."""

from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats
from ..collector import Subdivision, subdivision
from ..errors import SettingError, checked_choice, checked_number
from . import replacing

__all__ = [
    "COLUMNS",
    "NUMBERS",
    "QUANTITIES",
    "TEXTS",
    "UNITS",
    "MeasuredTable",
    "fits",
]

COLUMNS = ("theta_i", "phi_i", "theta_o", "phi_o", "value")
QUANTITIES = ("brdf", "brdf_cos", "btdf", "reflectance_factor")
UNITS = ("1/sr", "sr^-1")

# Nothing that was measured is as large in 1/sr, nor a relative uncertainty; squares of
# what is larger are no numbers any more.
MOST, MOST_UNCERTAIN = 1e30, 1e6

# Header keys that are numbers: interval and condition of each.
NUMBERS = {
    "uncertainty": (0, MOST_UNCERTAIN, "a finite number of 0 or more, below 1e6"),
    "scale_uncertainty": (0, MOST_UNCERTAIN, "a finite number of 0 or more, below 1e6"),
    "degrees_of_freedom": (1, 1e15, "a number of 1 or more, below 1e15"),
    "aperture_half_angle": (0, 90, "an angle in degrees in [0, 90)"),
    "aperture_solid_angle": (0, 2 * np.pi, "a solid angle in sr in [0, 2 pi)"),
    "emitter_half_angle": (0, 90, "an angle in degrees in [0, 90)"),
    "emitter_distance": (0, 1e15, "a finite distance of 0 or more, below 1e15"),
}
TEXTS = ("units", "quantity", "channel")


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

    def __repr__(self) -> str:
        return (
            f"<MeasuredTable {self.name}: {len(self)} values of {self.quantity}, "
            f"{len(self.incident)} incident directions>"
        )

    @property
    def incident(self) -> list[tuple[float, float]]:
        """Distinct pairs (theta_i, phi_i) in degrees, in the order of the table."""
        return list(dict.fromkeys(zip(self.theta_i.tolist(), self.phi_i.tolist())))

    @property
    def patches(self) -> Subdivision | None:
        """Patches that the values are means over, if the header's `collector` says it.

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
        """What tells the rays of a record of which our own export made the table.

        As of :func:`~gonio_mi.results.ray_identity.ray_keys`; empty if the header has
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
        """What the BRDF or BTDF in 1/sr is multiplied by in `value`."""
        if self.quantity == "reflectance_factor":
            return np.pi
        if self.quantity != "brdf_cos":
            return 1.0
        return np.cos(np.radians(self.theta_o))

    def save(self, path: str | PathLike[str]) -> None:
        """Write the table as a CSV file that `read_measured` reads back.

        Azimuths are written in [0, 360) degrees.
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
        lines.append(",".join(names))
        columns = [getattr(self, name) for name in names]
        for i, name in enumerate(names):
            if name.startswith("phi"):
                turned = columns[i] % 360
                columns[i] = np.where(turned < 360, turned, 0.0)  # of -1e-15
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
        return (value >= 0) & (value < MOST), "a finite number of 0 or more"
    return np.abs(value) < MOST, "a finite number"
