"""Each matrix is that of a real surface (Cloude)."""

from typing import Any

import numpy as np

from ...array_types import Floats
from ...collector.stokes import coherency_eigenvalues
from ..arrays import answer_of, drawn, full, per_first
from ..evidence import BIAS, POLARISING, SAME, Evidence, Question
from ..judgements import improper
from ..mistakes import EVAL, SAMPLE, Claim, Function, Guess, Mistake
from ..mueller import per_light
from ..samples import Samples, beyond_rounding


def realisable(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> tuple[Any]:
    """No eigenvalue of Cloude's coherency matrix, of Jones matrices, is negative."""
    bs, _ = drawn(bsdf, ctx, si, u)
    m = per_first(np.nan_to_num(full(what(bsdf, ctx, si, bs.wo, u))))
    pauli = np.array([[1, 0, 0, 1], [1, 0, 0, -1], [0, 1, 1, 0], [0, -1j, 1j, 0]])
    pauli = pauli.reshape(4, 2, 2)
    products = np.einsum("iab,jde->ijadbe", pauli, pauli.conj()) / 4
    coherency = np.einsum("ijcn,ijadbe->cnadbe", m, products)
    least = np.linalg.eigvalsh(coherency.reshape(*m.shape[2:], 4, 4))[..., 0]
    return (least + 5e-4,)


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


@REALISABLE.asks("matrices")
def check_matrices(evidence: Evidence, samples: Samples) -> None:
    """Check that no eigenvalue of the coherency matrix is negative (Cloude 1986).

    What is wrong with `eval` is with the weights that are made of it.
    """
    if samples.condition.mode == "radiance":
        return  # which has the same matrices transposed
    for function, asked in ((EVAL, samples.smooth), (SAMPLE, samples.given)):
        if evidence.of("realisable"):
            asked &= samples.delta
        claim = Claim(realisable, improper, (answer_of(function),))
        (found,) = realisable(*samples.asked, *claim.given)
        least = np.where(asked, found.min(axis=0), 0.0)
        wrong = least < 0
        if not beyond_rounding(wrong):
            continue
        name = "weight" if function is SAMPLE else "eval"
        guess = _guess(function, per_light(samples.full(name)[wrong]))
        size = ROUNDING - float(least.min())
        text = "an eigenvalue of the coherency matrix is down to "
        text += f"{-size:.3g} of their sum, and negative"
        at = samples.middle(np.arange(samples.n) == least.argmin())
        how = {"found": text, "size": size, "shown": claim, "condition": at}
        evidence.breach(REALISABLE, guess, samples, wrong, **how)


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
