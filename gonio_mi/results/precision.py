"""Precision of a measurement: its patches worth reporting, and the worst of them."""

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Flags, Floats
from ..errors import checked_number
from .record import Record

# Patches whose BRDF is below this fraction of the mean BRDF are not worth reporting.
FLOOR = 0.1


def lobe(
    values: ArrayLike, projected_solid_angles: ArrayLike, floor: float = FLOOR
) -> Flags:
    """Patches worth reporting: those that reach `floor` times the collector's mean.

    Parameters
    ----------
    values : array_like, shape (..., n_theta, n_phi)
        BRDF, or BRDF and BTDF, of one channel in 1/sr.
    projected_solid_angles : array_like, shape (n_theta, n_phi)
    floor : float
        In [0, 1).

    Returns
    -------
    ndarray of bool, shape of `values`
        Their number is the paper's m', the patches inside of the lobe.
    """
    floor = checked_number("floor", floor, 0, 1, "a fraction in [0, 1)")
    values = np.asarray(values, dtype=float)
    weights = np.broadcast_to(projected_solid_angles, values.shape)
    return (values > 0) & (values >= floor * np.average(values, weights=weights))


def relative_errors(record: Record, floor: float = FLOOR) -> Floats:
    """Relative standard errors of the patches worth reporting; NaN elsewhere.

    Of one incident direction, shape ``(n_hemispheres, n_theta, n_phi, channels)``;
    infinite where a standard error is not known.
    """
    value = patch_values(record, "brdf", "btdf")
    std_err = patch_values(record, "brdf_std_err", "btdf_std_err")
    relative = np.full(value.shape, np.nan)
    weights = record.subdivision.projected_solid_angles
    for channel in range(value.shape[-1]):
        inside = lobe(value[..., channel], weights, floor)
        errors = std_err[..., channel][inside] / value[..., channel][inside]
        relative[..., channel][inside] = np.where(np.isnan(errors), np.inf, errors)
    return relative


def precision(record: Record, floor: float = FLOOR) -> tuple[float, int]:
    """Largest relative standard error among the patches worth reporting.

    Parameters
    ----------
    record : Record
        Of one incident direction.
    floor : float
        See :func:`lobe`.

    Returns
    -------
    worst : float
        Over all channels; infinite where a standard error is not known, or if no light
        was received at all.
    n_lobe : int
        Number of patches worth reporting, the paper's m'; the most of any channel.
    """
    relative = relative_errors(record, floor)
    inside = ~np.isnan(relative)
    n_lobe = int(inside.sum(axis=(0, 1, 2)).max())
    return (float(relative[inside].max()) if n_lobe else np.inf), n_lobe


def patch_values(record: Record, upper: str, lower: str) -> Floats:
    """Quantity over all hemispheres, ``(n_hemispheres, n_theta, n_phi, channels)``."""
    parts = [getattr(record, upper)]
    if record.has_lower:
        parts.append(getattr(record, lower))
    return np.stack(parts)
