"""Realisability: each Mueller matrix is a sum of Mueller-Jones matrices."""

from __future__ import annotations

import numpy as np

from ...array_types import Flags, Floats
from ...collector.stokes import coherency_eigenvalues
from ..evidence import Evidence
from ..mueller import Matrices, condition_of, per_light
from ..samples import beyond_rounding

# Eigenvalue over the trace that rounding may leave below 0: a few times that of
# elements, in single precision.
ROUNDING = 5e-4

# Mistakes of signs, and what takes them back.
SIGNS = {
    "the handedness of V changes sign on leaving": (np.diag([1, 1, 1, -1]), np.eye(4)),
    "the handedness of V changes sign on arrival": (np.eye(4), np.diag([1, 1, 1, -1])),
    "the last two columns change sign": (np.eye(4), np.diag([1, 1, -1, 1])),
}


def check_matrices(evidence: Evidence, matrices: Matrices, asked: Flags) -> None:
    """Check that no eigenvalue of the coherency matrix is negative (Cloude 1986)."""
    asked = asked & matrices.finite & matrices.lit
    if not asked.any():
        return
    chosen = matrices.take(asked)
    m = per_light(chosen.raw)
    least = coherency_eigenvalues(m)[..., 0].min(axis=-1)
    wrong = least < -ROUNDING
    if not beyond_rounding(wrong):
        return
    worst = int(np.argmin(least))
    condition, function = condition_of(chosen, (worst,)), chosen.function
    evidence.breach(
        "realisable",
        function,
        f"an eigenvalue of the coherency matrix is {least[worst]:.3g} of their sum at "
        f"{condition}, and negative for {100 * wrong.mean():.3g} % of the matrices"
        f"{chosen.place(wrong)}",
        f"`{function}` returns matrices that no surface has: {_mistake(m[wrong])}",
        condition,
        size=float(-least[worst]),
        off=float(wrong.mean()),
    )


def _mistake(m: Floats) -> str:
    """Likely mistake in matrices that are divided by their first element."""
    for mistake, (left, right) in SIGNS.items():
        if (coherency_eigenvalues(left @ m @ right)[..., 0] > -ROUNDING).all():
            return mistake
    row = np.linalg.norm(m[..., 0, 1:], axis=-1).max()
    column = np.linalg.norm(m[..., 1:, 0], axis=-1).max()
    if column > 1 + ROUNDING:
        return f"unpolarised light leaves with a degree of polarisation of {column:.3g}"
    if row > 1 + ROUNDING:
        return (
            f"light of one polarisation leaves with {1 + row:.3g} times the flux of "
            f"unpolarised light, and of the opposite one with {1 - row:.3g} times it"
        )
    return (
        "elements beyond the first row and column are too large for these, as where an "
        "arithmetic mean of reflectances replaces their geometric mean"
    )
