"""Quantities of a measured table: its values, interpolated within the receptors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...array_types import Flags, Floats, Integers
from ...collector import Receptors
from ...collector.directions import direction
from ...collector.receptors import Window
from ...errors import SettingError
from ...files.measured_table import MeasuredTable
from ...results.statistics import student_quantile
from ..points import Points
from ..points.interpolation import Interpolation
from ..points.points import exit_directions
from .definitions import Definition
from .functionals import LEVEL

# Part of a receptor's projected solid angle for which the nearest values may stand, and
# degrees by which an angle of incidence may be off.
MAX_MISSING, MAX_OFF = 0.05, 0.05

# Part of a value that bounds may be, all together.
MAX_UNKNOWN = 0.5

# Points per side of a window, of one wider than this in degrees, and of rings and
# sectors about the pole.
N_NODES, N_WIDE_NODES, WIDE = 24, 192, 20.0
N_RINGS, N_SECTORS = 120, 240


class Nodes(NamedTuple):
    """Directions of the sums that a quantity is a function of.

    `weight` are projected solid angles in sr, of either sign; `frame` are two
    directions across, along which a source or an aperture blurs, 0 where this changes
    nothing; `row` is the sum to which each belongs.
    """

    wo: Floats
    weight: Floats
    frame: Floats
    row: Integers

    def blurred(self, offsets: Floats) -> tuple[Floats, Floats, Integers]:
        """Directions, weights and sums, all moved by each of some angles, (n, 2)."""
        moved = self.wo + np.einsum("sj,mjx->smx", offsets, self.frame)
        moved[..., 2] = np.maximum(moved[..., 2], 1e-6)
        wo = (moved / np.linalg.norm(moved, axis=-1, keepdims=True)).reshape(-1, 3)
        n = len(offsets)
        return wo, np.tile(self.weight, n) / n, np.tile(self.row, n)


class Estimate(NamedTuple):
    """A quantity of a table.

    Attributes
    ----------
    value, std_err : float
    interval : (float, float)
        Of 95 %, with the bounds of all parts that are no matter of chance.
    parts : dict of float
        Standard errors of the table's values and of their common scale; bounds of
        interpolation, of light and apertures, and of what the table does not cover.
    n_values : int
        How many values tell the quantity.
    notes : tuple of str
    """

    value: float
    std_err: float
    interval: tuple[float, float]
    parts: dict[str, float]
    n_values: int
    notes: tuple[str, ...]

    @property
    def unresolved(self) -> float:
        """Sum of the bounds: what is no matter of chance."""
        return sum(self.parts.get(name, 0.0) for name in BOUNDS)


# Parts that are bounds, and how they read.
BOUNDS = {
    "interpolation": "interpolation",
    "source": "source",
    "aperture": "aperture",
    "missing": "missing directions",
    "patches": "the material's patches",
}


def table_estimate(own: Definition, table: MeasuredTable, phi_i: float) -> Estimate:
    """What a table tells of a quantity.

    Values are interpolated within the receptors (cubic, in triangles of neighbouring
    directions). Bounds are how far linear interpolation is from it; how much a source
    changes the result whose light moves the pattern as a mirror would, of which the
    table has one direction; the same of the table's own aperture and emitter; and all
    light of a receptor for which only the nearest values stand.

    Raises
    ------
    ValueError
        If the table holds another hemisphere or angle of incidence, or too little of
        the receptors.
    """
    here, phi_i = _rows_of(own, table, phi_i)
    points, wo = Points.of_table(table)[here], exit_directions(table)[here]
    cone = np.radians(table.aperture_half_angle or 0.0)
    field = Interpolation(wo, points, cone)
    nodes, source, blur = _nodes(own, phi_i), *_blurs(own, table)

    def sums(offsets: Floats) -> Floats:
        """Sums of smooth interpolation, with receptors that are moved."""
        wo, weight, row = nodes.blurred(offsets)
        return np.bincount(row, weight * field.values(wo)).astype(float)

    missing = ~field.covers(nodes.wo)
    lacking = _missing_part(own, nodes, missing)
    if lacking > MAX_MISSING:
        beside = _turned(_turned(nodes.wo, -phi_i) * [1, -1, 1], phi_i)
        mirrored = _missing_part(own, nodes, missing & ~field.covers(beside))
        raise _too_little(own, table, lacking, mirrored, field.is_flat)
    lit, narrow = sums(source), sums(np.zeros((1, 2)))
    found, slopes = _function(own, lit), _slopes(own, lit)
    wo, weight, row = nodes.blurred(source)
    numbers = range(len(slopes))
    linear = np.array([field.weights(wo[row == i], weight[row == i]) for i in numbers])
    each = slopes @ linear
    curved = abs(_function(own, linear @ points.value) - found)
    counted = slopes[nodes.row] * nodes.weight
    both = (source[:, None] + blur).reshape(-1, 2)
    parts = {
        "values": float(np.linalg.norm(each * points.std_err)),
        "calibration": float(np.linalg.norm(points.roots @ each)),
        "interpolation": curved + field.unresolved(wo, slopes[row] * weight),
        "source": abs(_function(own, narrow) - found),
        "aperture": abs(_function(own, sums(both)) - found),
        "missing": field.nearest(nodes.wo, counted * missing),
    }
    _check_resolved(own, table, found, parts)
    std_err = float(np.hypot(parts["values"], parts["calibration"]))
    t = student_quantile(min(points.dof_of(each), 1e9), LEVEL)
    half = t * std_err + sum(part for name, part in parts.items() if name in BOUNDS)
    # no flux is negative
    low = found - half if own.curve or found < 0 else max(found - half, 0.0)
    n_values, notes = int(np.count_nonzero(each)), _notes(own, table, lacking)
    return Estimate(found, std_err, (low, found + half), parts, n_values, notes)


def _notes(own: Definition, table: MeasuredTable, lacking: float) -> tuple[str, ...]:
    """What is not in the interval, and what stands for what."""
    notes = []
    if not (table.bsdf_std_err.any() or table.scale_uncertainty):
        notes.append(
            f"{table.name} states no uncertainty of its values, which is not in the "
            "interval: give `uncertainty` or `scale_uncertainty` (--uncertainty)"
        )
    if table.aperture_half_angle is None and table.patches is None:
        notes.append(
            f"{table.name} does not state its aperture: its values count as those of "
            "single directions, unless `aperture_half_angle` is given"
        )
    if own.beam:
        notes.append(
            "the table has one direction of light for a source: the receptor is moved "
            "over the source's angles instead, as the light of a mirror would be, and "
            "how else the BSDF changes over them is not in the interval"
        )
    if lacking:
        notes.append(
            f"{lacking:.2g} of the projected solid angle is beyond the table's "
            "directions: the nearest values stand for it, with an error as large"
        )
    return tuple(notes)


# ------------------------------------------------------------------ light and receptors


def _rows_of(
    own: Definition, table: MeasuredTable, phi_i: float
) -> tuple[Flags, float]:
    """Rows with the light of a definition, and their azimuth of incidence."""
    holds = "transmitted" if table.quantity == "btdf" else "reflected"
    if own.lower != (table.quantity == "btdf"):
        wanted = "transmitted" if own.lower else "reflected"
        raise SettingError(
            f"{own.title} needs {wanted} light, got {holds} light ({table.quantity}) "
            f"of {table.name}"
        )
    if own.diffuse:
        raise SettingError(
            f"{own.title} needs light from all directions, got "
            f"{len(table.incident)} of {table.name}: of a reciprocal specimen 8/di or "
            "8/de is the same"
        )
    angle = [theta for theta, _ in table.incident]
    off = np.abs(table.theta_i - own.theta_i)
    if off.min() > MAX_OFF:
        nearest = min(angle, key=lambda theta: abs(theta - own.theta_i))
        raise SettingError(
            f"{own.title} needs light from theta_i {own.theta_i:g} degrees, but the "
            f"nearest of {table.name} is {nearest:g}, which is {off.min():.3g} degrees "
            "away: values between angles of incidence are not interpolated"
        )
    here = off <= MAX_OFF
    azimuths = list(dict.fromkeys((table.phi_i[here] % 360).tolist()))
    if phi_i == 0 and len(azimuths) == 1:  # the only plane of incidence
        phi_i = azimuths[0]
    apart = np.abs((table.phi_i - phi_i + 180) % 360 - 180)
    here &= apart <= MAX_OFF
    if not here.any():
        known = ", ".join(f"{azimuth:g}" for azimuth in sorted(azimuths)[:6])
        raise SettingError(
            f"phi_i must be an azimuth of incidence of {table.name} ({known}), got "
            f"{phi_i:g}"
        )
    return here, phi_i


def _nodes(own: Definition, phi_i: float) -> Nodes:
    """Nodes of the sums that :func:`_function` takes."""
    signs: list[tuple[int, int, Window | None]]
    if own.patches is not None:
        middle = np.arange(own.patches.n_patches).reshape(own.patches.shape)[:, 1]
        wo = own.patches.points(4, middle)
        solid = own.patches.projected_solid_angles.ravel()[middle]
        frame = _frame((own.theta_i, 180.0 + phi_i))
        row = np.repeat(np.arange(len(middle)), wo.shape[1])
        turned = _turned(wo.reshape(-1, 3), phi_i)
        weight = solid[row] / wo.shape[1]
        return Nodes(turned, weight, np.tile(frame, (len(row), 1, 1)), row)
    signs = [(1, 0, window) for window in own.receptors or [None]]
    signs += [(-1, 0, window) for window in own.without]
    if own.over is not None:
        signs += [(1, 1, window) for window in own.over or [None]]
    found = [_window(window, sign, row, phi_i) for sign, row, window in signs]
    return Nodes(*map(np.concatenate, zip(*found)))


def _window(window: Window | None, sign: int, row: int, phi_i: float) -> Nodes:
    """Nodes of a window, or of the whole hemisphere."""
    frame, half, solid = np.zeros((2, 3)), 90.0, np.pi
    if window is not None:
        frame, half = _frame((window[0], window[1] + phi_i)), window[2] / 2
        solid = float(Receptors((window,)).projected_solid_angles[0, 0])
    if window is None or (window[0] == 0 and len(window) == 3):
        theta = np.radians(half) * (np.arange(N_RINGS) + 0.5) / N_RINGS
        phi = 2 * np.pi * (np.arange(N_SECTORS) + 0.5) / N_SECTORS
        wo = direction(theta[:, None], phi).reshape(-1, 3)
        weight = np.repeat(np.sin(2 * theta), N_SECTORS)
    else:
        n = N_NODES if max(window[2:]) <= WIDE else N_WIDE_NODES
        wo, weight = Receptors((window,)).filled(n)
    weight = sign * solid * weight / weight.sum()
    frames = np.tile(frame, (len(wo), 1, 1))
    return Nodes(_turned(wo, phi_i), weight, frames, np.full(len(wo), row))


def _turned(wo: Floats, phi_i: float) -> Floats:
    """Directions, turned about the normal by an azimuth in degrees."""
    c, s = np.cos(np.radians(phi_i)), np.sin(np.radians(phi_i))
    return wo @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def _frame(axis: tuple[float, float]) -> Floats:
    """Directions along the meridian of an axis, and across it."""
    theta, phi = np.radians(axis)
    return np.array(
        [direction(theta + np.pi / 2, phi), [-np.sin(phi), np.cos(phi), 0.0]]
    )


def _blurs(own: Definition, table: MeasuredTable) -> tuple[Floats, Floats]:
    """Offsets of the source, and of what the table has beside it, in radians.

    Each as four with the variances of both along and across: of the source without the
    table's own emitter; of the table's aperture, and of an emitter that is wider.
    """
    source, emitter = _variances(own.beam), _variances((2 * table.emitter_half_angle,))
    aperture = _variances((2 * (table.aperture_half_angle or 0.0),))
    wanted = np.maximum(source - emitter, 0), aperture + np.maximum(emitter - source, 0)
    signs = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])
    first, second = (signs[: 4 if v.any() else 1] * np.sqrt(v) for v in wanted)
    return first, second


def _variances(widths: Sequence[float]) -> Floats:
    """Variances along and across of full angles: none, a round or two sides."""
    half = np.radians(widths) / 2
    if len(half) == 2:
        return half**2 / 3
    return np.full(2, np.sum(half**2) / 4)


# ------------------------------------------------------------------------------- values


def _function(own: Definition, sums: Floats) -> float:
    """The quantity, of the sums of its nodes."""
    if own.curve and own.patches:
        fractions = np.zeros(own.patches.shape)
        fractions[:, 1] = sums
        return own.curve(fractions)
    if own.over is None:
        return float(own.scale * sums[0])
    if not sums[1] > 0:
        raise SettingError(f"{own.title} needs light that leaves, got none")
    return float(own.scale * sums[0] / sums[1])


def _slopes(own: Definition, sums: Floats) -> Floats:
    """Derivatives of the quantity by its sums, by differences."""
    step = 1e-4 * np.abs(sums).max()
    here = np.diag(np.full(len(sums), step))
    ends = [[_function(own, sums + s * one) for s in (1, -1)] for one in here]
    return np.array([(high - low) / (2 * step) for high, low in ends])


def _missing_part(own: Definition, nodes: Nodes, missing: Flags) -> float:
    """Part of the projected solid angle without values, in the sum with most of it."""
    weight, row = np.abs(nodes.weight), np.zeros_like(nodes.row)
    row = row if own.curve else nodes.row
    return float(np.max(np.bincount(row, weight * missing) / np.bincount(row, weight)))


def _too_little(
    own: Definition, table: MeasuredTable, part: float, mirrored: float, is_flat: bool
) -> SettingError:
    """Error for a table that misses a part of what a quantity needs."""
    text = (
        f"{own.title} needs values all over {own.geometry}: {table.name} covers "
        f"{100 * (1 - part):.3g} % of that projected solid angle and misses "
        f"{100 * part:.3g} %, of which at most {100 * MAX_MISSING:g} % may be"
    )
    if is_flat and table.aperture_half_angle is None:
        text += (
            "; its directions lie in one plane: `aperture_half_angle` "
            "(--aperture-half-angle) tells how far around each its value stands"
        )
    elif mirrored <= MAX_MISSING:
        text += (
            "; with the mirror image of its directions at the plane of incidence it "
            "would cover enough: add it, if the specimen is isotropic"
        )
    return SettingError(text)


def _check_resolved(
    own: Definition, table: MeasuredTable, found: float, parts: dict[str, float]
) -> None:
    """Raise ValueError for a quantity of which a table leaves too much open."""
    bounds = {name: parts[name] for name in BOUNDS if parts.get(name)}
    if sum(bounds.values()) > MAX_UNKNOWN * abs(found):
        listed = ", ".join(f"{name} {bound:.3g}" for name, bound in bounds.items())
        raise SettingError(
            f"{own.title} needs a table whose directions resolve the light about the "
            f"receptor: of {found:.3g} {own.unit} of {table.name} that much is open: "
            f"{listed}"
        )
