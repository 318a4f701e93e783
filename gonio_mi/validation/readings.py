"""What a plugin may have mistaken where it turned frames: matrices read in other ways.

Each reading takes a plugin's matrices for something else than what Mitsuba expects; the
one in which they make sense names the mistake.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..array_types import Floats, Numbers
from ..collector.stokes import implicit_axis, plane_axis, reframed, turn
from .mueller import Matrices

# Elements over the first one that count as 0.
NOTHING = 1e-4

# Mirroring at the surface, and what it does to a Stokes vector.
FLIP = np.array([1.0, 1.0, -1.0])
MIRRORED = np.diag([1.0, 1.0, -1.0, -1.0])

IDENTITY = (
    "returns one number, which Mitsuba takes as that multiple of the identity: light "
    "keeps its polarisation in frames that do not turn with the plane of incidence; "
    "mi.mueller.depolarizer makes it unpolarised"
)


def is_identity(m: Floats) -> bool:
    """Whether matrices over their first element are the identity."""
    return bool((np.abs(m - np.eye(4)) < NOTHING).all())


def is_depolarised(m: Floats) -> bool:
    """Whether matrices over their first element have no other."""
    return bool((np.abs(m).sum(axis=(-1, -2)) - 1 < NOTHING).all())


def readings(
    matrices: Matrices, normal: Numbers, nested: Numbers | None = None
) -> Iterator[tuple[str, Floats]]:
    """Mistakes, and the matrices in frames of s = k x normal that these would mean.

    Parameters
    ----------
    matrices : Matrices
    normal : array_like, shape (3,)
        Of the surface that scatters.
    nested : ndarray, shape (3, 3), optional
        Axes of a nested BSDF, as columns.

    Yields
    ------
    mistake : str
        The rest of a sentence about the function.
    ndarray, shape (..., channels, 4, 4)
    """
    raw, (turn_in, turn_out) = matrices.raw, matrices.turns(normal)
    one, back = np.eye(4), np.swapaxes(turn_in, -1, -2)
    out_back = np.swapaxes(turn_out, -1, -2)
    if (matrices.wi[..., 2] < 0).all():
        yield (
            "returns for the back the matrix of the front, whose frames are not "
            "mirrored with the directions",
            reframed(
                MIRRORED @ raw @ MIRRORED, *_turns(matrices, normal, np.diag(FLIP))
            ),
        )
    if nested is not None:
        yield (
            "does not turn the frames of the nested BSDF to those of its own "
            "directions",
            reframed(raw, *_turns(matrices, normal, nested)),
        )
    yield (
        "does not turn its frames from the plane of incidence to Mitsuba's "
        "(mi.mueller.rotate_mueller_basis)",
        raw,
    )
    yield (
        "does not turn the frame of the incident beam to Mitsuba's",
        reframed(raw, one, turn_out),
    )
    yield (
        "does not turn the frame of the outgoing beam to Mitsuba's",
        reframed(raw, turn_in, one),
    )
    yield "turns its frames the wrong way round", reframed(raw, back, out_back)
    yield (
        "turns the frame of the incident beam the wrong way round",
        reframed(raw, back, turn_out),
    )
    yield (
        "turns the frame of the outgoing beam the wrong way round",
        reframed(raw, turn_in, out_back),
    )
    for sign in (1, -1):
        halves = _turns(matrices, normal, np.eye(3), 0.5, sign)
        yield (
            "turns Stokes vectors by the angle of their frames instead of twice that",
            reframed(raw, *halves),
        )
    yield (
        "returns the transposed matrix",
        reframed(np.swapaxes(raw, -1, -2), turn_in, turn_out),
    )
    yield (
        "takes the frames of incident and outgoing beam for each other: light arrives "
        "along -wi in importance mode, along -wo in radiance mode (ctx.mode)",
        reframed(raw, out_back, back),
    )


def _turns(
    matrices: Matrices,
    normal: Numbers,
    axes: Numbers,
    share: float = 1.0,
    sign: int = 1,
) -> tuple[Floats, Floats]:
    """What turns both frames from Mitsuba's in local directions of other axes."""
    found = []
    for k in matrices.beams:
        old = implicit_axis(k @ axes) @ np.transpose(axes)
        found.append(turn(k, old, sign * plane_axis(k, normal), share))
    turn_in, turn_out = found
    return turn_in[..., None, :, :], turn_out[..., None, :, :]
