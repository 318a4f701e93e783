"""Exit profile: flux per area over the distance from the point of entry."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..errors import (
    SettingError,
    checked_choice,
    checked_number,
    number_of,
    printable,
    shown,
)
from ..instrument.incidence import incident_angles
from ..instrument.measure import send_all
from ..instrument.recording import records_of
from ..instrument.setup import set_up
from ..kernels import launches_kernels
from ..results.record import Record
from ..results.tally import Ledger, Tally, grouped
from ..settings import MeasurementSettings
from ..specimen.loading import specimen_of
from ..specimen.specimen_text import SpecimenLike

MAX_RINGS = 10_000
RADII = "numbers of at least 0 and less than 1e15"

# Settings that are decided here, or that say nothing of where light leaves.
REFUSED_SETTINGS = {
    *("footprint", "collector", "collector_radius", "incident"),
    *("rel_err", "noise", "max_rays"),
}

# Those that follow light to where it leaves; others deposit it by direction.
ESTIMATORS = ("weighted", "analog")


@dataclass(frozen=True, eq=False)
class ExitProfile:
    """Light that leaves, per area, over the distance from where it entered.

    Attributes
    ----------
    radii : ndarray, shape (n + 1,)
        Edges of the rings, in scene units.
    reflectance, transmittance : ndarray, shape (n, channels)
        Mean of a ring, of the incident flux per square of a scene unit; None for the
        second one if there is no lower hemisphere. Direct light is in it.
    reflectance_std_err, transmittance_std_err : ndarray, shape (n, channels)
        From the batches; NaN for a single batch and where no ray left.
    beyond : ndarray, shape (n_hemispheres, channels)
        Part of the incident flux that left further away than the last radius.
    dhr, dht : ndarray, shape (channels,)
        All that left, rings and `beyond`.
    ledger : Ledger
    specimen : str
    settings : dict
        As of a record.
    """

    radii: Floats
    reflectance: Floats
    reflectance_std_err: Floats
    transmittance: Floats | None
    transmittance_std_err: Floats | None
    beyond: Floats
    dhr: Floats
    dht: Floats | None
    ledger: Ledger
    specimen: str
    settings: dict[str, Any]

    def __repr__(self) -> str:
        n, (first, last) = len(self.radii) - 1, self.radii[[0, -1]]
        rays = f"{grouped(self.ledger.emitted)} rays"
        return (
            f"<ExitProfile of {printable(self.specimen)}: "
            f"{number_of(n, 'ring')} from {first:g} to {last:g}, {rays}, "
            f"dhr {np.array2string(self.dhr, precision=5)}>"
        )


@launches_kernels()
def exit_profile(
    specimen: SpecimenLike,
    radii: Sequence[float],
    theta_i: float = 0.0,
    phi_i: float = 0.0,
    *,
    parameters: dict[str, Any] | None = None,
    **settings: Any,
) -> ExitProfile:
    """Light per area that leaves at a distance from the point where it entered.

    What a fibre probe sees, and programs such as MCML (Wang, Jacques and Zheng 1995)
    give. All directions of a hemisphere are collected.

    Parameters
    ----------
    specimen, parameters
        As of :func:`gonio_mi.measure`.
    radii : sequence of float
        Edges of the rings in scene units, ascending and not negative; a disk if the
        first one is 0. At most 10 000 rings.
    theta_i, phi_i : float
        Degrees.
    **settings
        Those of :func:`gonio_mi.measure`, without `footprint`, which is a point, the
        collector's, `incident`, `rel_err` and `noise`; the `estimator` is weighted or
        analog.

    Returns
    -------
    ExitProfile

    Raises
    ------
    TypeError, ValueError, SpecimenError
        As of :func:`gonio_mi.measure`.
    """
    edges = _checked(radii)
    for name in sorted(REFUSED_SETTINGS & settings.keys()):
        raise SettingError(f"exit_profile does not accept {name}")
    given = {name: value for name, value in settings.items() if value is not None}
    MeasurementSettings().changed(**given)  # refused before anything is loaded
    incidents, _ = incident_angles(float(theta_i), float(phi_i))
    loaded = specimen_of(specimen, parameters, given.get("period"))
    # one ring of light inside of the first radius, and one beyond the last
    fixed = {"footprint": "point", "collector": f"angle:{edges.size + 1}x1"}
    own = {k: v for k, v in loaded.own_settings.items() if k not in REFUSED_SETTINGS}
    chosen = MeasurementSettings().changed(**own | given | fixed)
    checked_choice("the estimator of exit_profile", chosen.estimator, ESTIMATORS)
    (setup,) = set_up(loaded, chosen, incidents)
    radii = mi.Float(edges.tolist())
    dr.make_opaque(radii)
    setups = [replace(setup, radii=radii)]
    finished: list[list[Tally]] = [[]]
    if not send_all(setups, finished):
        raise KeyboardInterrupt
    (stack,) = records_of(setups, finished, complete=True)
    return _profile(stack[0], edges)


def _checked(radii: Sequence[float]) -> Floats:
    """Edges of rings as an array; raise SettingError for what is none."""
    many = radii if np.ndim(radii) else [radii]
    edges = np.array([checked_number("radii", x, 0, 1e15, RADII) for x in many])
    if not 2 <= edges.size <= MAX_RINGS + 1 or not np.all(np.diff(edges) > 0):
        raise SettingError(
            f"radii must be 2 to {MAX_RINGS + 1} ascending numbers, got {shown(radii)}"
        )
    return edges


def _profile(record: Record, edges: Floats) -> ExitProfile:
    """Profile of a record whose rings are distances."""
    areas = np.pi * np.diff(edges**2)[:, None]
    flux = record.flux_fraction[:, :, 0]  # hemispheres, rings, channels
    solid = record.subdivision.projected_solid_angles
    per_area = [one[1:-1] / areas for one in flux]
    errors = [
        (np.asarray(one)[:, 0] * solid)[1:-1] / areas
        for one in (record.brdf_std_err, record.btdf_std_err)[: len(flux)]
    ]
    return ExitProfile(
        radii=edges,
        reflectance=per_area[0],
        reflectance_std_err=errors[0],
        transmittance=per_area[1] if record.has_lower else None,
        transmittance_std_err=errors[1] if record.has_lower else None,
        beyond=flux[:, -1],
        dhr=record.dhr,
        dht=record.dht,
        ledger=record.ledger,
        specimen=record.provenance.name,
        settings=dict(record.settings),
    )
