"""Each matrix is that of a real surface (Cloude)."""

from typing import Any

import numpy as np

from ...array_types import Flags, Floats
from ...collector.stokes import coherency_eigenvalues
from ..arrays import answer_of, drawn, per_first
from ..evidence import BIAS, POLARISING, SAME, Evidence, Question
from ..judgements import same
from ..mistakes import Claim, Function, Guess, Mistake
from ..mueller import Matrices, per_light
from ..samples import beyond_rounding


def realisable(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> tuple[int, int]:
    """No eigenvalue of Cloude's coherency matrix, of Jones matrices, is negative."""
    bs, _ = drawn(bsdf, ctx, si, u)
    m = np.nan_to_num(np.array(what(bsdf, ctx, si, bs.wo, u)))
    m = per_first(m.reshape(4, 4, -1))
    pauli = np.array([[1, 0, 0, 1], [1, 0, 0, -1], [0, 1, 1, 0], [0, -1j, 1j, 0]])
    pauli = pauli.reshape(4, 2, 2)
    coherency = np.einsum("ijk,iab,jcd->kacbd", m, pauli, pauli.conj()) / 4
    least = np.linalg.eigvalsh(coherency.reshape(-1, 4, 4))[:, 0]
    return int(np.sum(least < -5e-4)), 0


# Eigenvalue over the trace that rounding may leave below 0: a few times that of
# elements, in single precision.
ROUNDING = 5e-4

REALISABLE = Question(
    "realisable",
    __doc__,
    BIAS,
    POLARISING,
    rank=0,
    needed=True,
    alone=True,
    matrices=SAME,
)


class Unreal(Mistake):
    """Why matrices are those of no surface."""

    V_ON_LEAVING = """{who} returns matrices that no surface has: the handedness of V
        changes sign on leaving"""
    V_ON_ARRIVAL = """{who} returns matrices that no surface has: the handedness of V
        changes sign on arrival"""
    POLARISES = """{who} returns matrices that no surface has: unpolarised light leaves
        with a degree of polarisation of {degree:.3g}"""
    ONE_POLARISATION = """{who} returns matrices that no surface has: light of one
        polarisation leaves with {most:.3g} times the flux of unpolarised light, and of
        the opposite one with {least:.3g} times it"""
    TOO_COHERENT = """{who} returns matrices that no surface has: elements beyond the
        first row and column are too large for these, as where an arithmetic mean of
        reflectances replaces their geometric mean"""


# Mistakes of signs, and what takes them back.
SIGNS = {
    Unreal.V_ON_LEAVING: (np.diag([1, 1, 1, -1]), np.eye(4)),
    Unreal.V_ON_ARRIVAL: (np.eye(4), np.diag([1, 1, 1, -1])),
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
    size, guess = float(-least.min()), _guess(chosen.function, m[wrong])
    text = "an eigenvalue of the coherency matrix is down to "
    text += f"{-size:.3g} of their sum, and negative"
    at = chosen.by(-least), wrong
    shown = Claim(realisable, same, (answer_of(chosen.function),))
    evidence.breach(REALISABLE, guess, *at, found=text, size=size, shown=shown)


def _guess(function: Function, m: Floats) -> Guess:
    """Likely mistake in matrices that are divided by their first element."""
    for mistake, (left, right) in SIGNS.items():
        if (coherency_eigenvalues(left @ m @ right)[..., 0] > -ROUNDING).all():
            return mistake(function)
    row = np.linalg.norm(m[..., 0, 1:], axis=-1).max()
    column = np.linalg.norm(m[..., 1:, 0], axis=-1).max()
    if column > 1 + ROUNDING:
        return Unreal.POLARISES(function, degree=column)
    if row > 1 + ROUNDING:
        return Unreal.ONE_POLARISATION(function, most=1 + row, least=1 - row)
    return Unreal.TOO_COHERENT(function)
