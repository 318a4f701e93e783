"""How many rays a measurement needs, from a pilot or for a Lambertian specimen."""

import html
from dataclasses import dataclass

import numpy as np

from ..array_types import Floats
from ..collector import Subdivision, subdivision
from ..errors import SettingError, SettingTypeError
from .precision import FLOOR, lobe, patch_values
from .ray_bounds import (
    chebyshev_rays,
    paper_rays,
    relative_rays,
    standard_error_rays,
    union_rays,
)
from .record import Record

__all__ = ["Plan", "plan"]


@dataclass(frozen=True)
class Plan:
    """Numbers of rays that the bounds ask for; see :func:`plan`.

    Attributes
    ----------
    n_patches, n_lobe : int
        Patches of the hemisphere, and those worth reporting (the paper's m').
    chebyshev, paper, paper_lobe, union : int
        Absolute error: eq. 17 for one patch, eq. 21 for all, eq. 21 with m', and the
        union bound for all.
    standard_error : int
        Relative standard error `rel_err` of each patch worth reporting, which is what
        the setting `rel_err` of a measurement asks for.
    relative : int
        Relative error `rel_err` of the patches worth reporting, all at once.
    epsilon, delta, rel_err, level : float
        What was asked.
    source : str
        Where the probabilities come from.
    """

    n_patches: int
    n_lobe: int
    chebyshev: int
    paper: int
    paper_lobe: int
    union: int
    standard_error: int
    relative: int
    epsilon: float
    delta: float
    rel_err: float
    level: float
    source: str

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"

    def __str__(self) -> str:
        absolute = (
            f"|error| < {self.epsilon:g} of the incident flux, {1 - self.delta:.3g}"
        )
        relative = f"relative error < {self.rel_err:g}, {self.level:.3g}"
        rows = [
            (self.chebyshev, "one patch (eq. 17)", absolute),
            (self.paper, f"{self.n_patches} patches (eq. 21)", absolute),
            (
                self.paper_lobe,
                f"{self.n_lobe} patches in the lobe (eq. 21, m')",
                absolute,
            ),
            (self.union, f"{self.n_patches} patches, union bound", absolute),
            (
                self.standard_error,
                f"{self.n_lobe} patches in the lobe, each",
                f"relative standard error < {self.rel_err:g} (measure --rel-err)",
            ),
            (
                self.relative,
                f"{self.n_lobe} patches in the lobe, all at once",
                relative,
            ),
        ]
        lines = [f"patch probabilities from {self.source}"]
        lines += [f"{rays:14.4g}  {what:42s}{asked}" for rays, what, asked in rows]
        return "\n".join(lines)


def plan(
    pilot: Record | None = None,
    *,
    collector: str | Subdivision = "projected:30x30",
    epsilon: float = 0.005,
    delta: float = 0.01,
    rel_err: float = 0.01,
    level: float = 0.95,
    floor: float = FLOOR,
) -> Plan:
    """Plan the rays of a measurement.

    Parameters
    ----------
    pilot : Record, optional
        A first measurement of the specimen at one incident direction, which says how
        the light is spread. Without one a Lambertian specimen of reflectance 1 is
        assumed: the worst case of all specimens that light every patch.
    collector : str or Subdivision
        Patches of the Lambertian; a pilot brings its own.
    epsilon, delta : float
        The paper's absolute error tolerance and confidence, in (0, 1).
    rel_err, level : float
        Relative standard error of each patch worth reporting; and relative error that
        all of them keep at once with probability `level`.
    floor : float
        Patches below this fraction of the mean BRDF are not worth reporting.

    Returns
    -------
    Plan
        For independent rays.

    Raises
    ------
    TypeError, ValueError
        If a number is out of its range, or the pilot is no record, a stack, or
        reflects nothing.
    """
    if pilot is None:
        patches = subdivision(collector)
        probabilities = (patches.projected_solid_angles / np.pi).ravel()
        n_patches, source = patches.n_patches, f"a white Lambertian specimen, {patches}"
    else:
        probabilities, n_patches = _pilot_probabilities(pilot, floor)
        source = f"a pilot of {pilot.ledger.emitted:.3g} rays, {pilot.subdivision}"
    n_lobe = len(probabilities)
    return Plan(
        n_patches=n_patches,
        n_lobe=n_lobe,
        chebyshev=chebyshev_rays(epsilon, delta),
        paper=paper_rays(n_patches, epsilon, delta),
        paper_lobe=paper_rays(n_lobe, epsilon, delta),
        union=union_rays(n_patches, epsilon, delta),
        standard_error=standard_error_rays(probabilities, rel_err),
        relative=relative_rays(probabilities, rel_err, level),
        epsilon=epsilon,
        delta=delta,
        rel_err=rel_err,
        level=level,
        source=source,
    )


def _pilot_probabilities(pilot: Record, floor: float) -> tuple[Floats, int]:
    """Flux fractions of the patches worth reporting, and the number of all patches."""
    if not isinstance(pilot, Record):
        raise SettingTypeError(
            f"pilot must be a Record, got {pilot!r:.80} (collector= takes patches)"
        )
    if len(pilot) != 1:
        raise SettingError(
            f"the pilot must be of one incident direction, got a stack of {len(pilot)}"
        )
    record = pilot[0]
    values = patch_values(record, "brdf", "btdf")
    if not values.any():
        raise SettingError("the pilot must have received some light, got none")
    projected = record.subdivision.projected_solid_angles
    # the channel with the least light in a patch asks for most rays
    least = values.min(axis=-1)
    inside = lobe(least, projected, floor)
    return (least * projected)[inside], inside.size
