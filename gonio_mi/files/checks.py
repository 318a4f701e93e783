"""Checks of files that are read: size, check sum, consistency of the record.

The check sum, over all bytes, is at the very end of a file: what follows the last image
of an EXR file is read by nobody, and a ZIP archive may end in a comment.
"""

import hashlib
import math
import os
from typing import BinaryIO

import numpy as np

from ..errors import FileFormatError
from ..results.record import Record
from ..results.tally import Integrals, Tally

SEAL_MARK = b"gonio-mi sha256 "
SEAL_LENGTH = len(SEAL_MARK) + 2 * hashlib.sha256().digest_size

# Bytes that are read at once.
PIECE = 2**20

# A polar angle of incidence that was computed may be this much below 0 degrees.
BELOW_NORMAL = 1e-4

# Azimuths are taken modulo a turn; beyond this nothing is left of them.
MAX_AZIMUTH = 1e6


def require(condition: object, reason: str) -> None:
    """Raise FileFormatError with `reason`, a clause about the file, unless it holds."""
    if not condition:
        raise FileFormatError(reason)


def size_of(stream: BinaryIO) -> int:
    """Size of an open file in bytes; the position is kept."""
    position = stream.tell()
    size = stream.seek(0, os.SEEK_END)
    stream.seek(position)
    return size


# -------------------------------------------------------------------------- seal


def seal_of(content: bytes | memoryview) -> bytes:
    """Trailer after the content of a file: its check sum."""
    return SEAL_MARK + hashlib.sha256(content).hexdigest().encode()


def check_seal(stream: BinaryIO) -> None:
    """Raise FileFormatError unless a file ends in a seal that agrees with its content.

    The position is at the beginning afterwards.
    """
    size = size_of(stream)
    stream.seek(max(size - 2 * SEAL_LENGTH, 0))
    _, mark, seal = stream.read().rpartition(SEAL_MARK)
    stream.seek(0)
    reason = "it ends in no check sum: it is truncated or was not written by gonio-mi"
    require(bool(mark), reason)
    require(len(mark + seal) == SEAL_LENGTH, "it is truncated or longer than it was")
    length = size - SEAL_LENGTH
    digest = hashlib.sha256()
    while piece := stream.read(min(PIECE, length - stream.tell())):
        digest.update(piece)
    stream.seek(0)
    reason = "it is damaged: its content does not agree with its check sum"
    require(seal == digest.hexdigest().encode(), reason)


# ------------------------------------------------------------------------ records


def check_record(record: Record) -> None:
    """Raise FileFormatError unless the parts of a record are consistent."""
    collimated = record.provenance.emitter == "DirectionalEmitter"
    for theta, phi in zip(record.theta_i.tolist(), record.phi_i.tolist()):
        known = not (math.isnan(theta) or math.isnan(phi))
        require(known or not collimated, "its incident direction is NaN")
        below = math.isnan(theta) or -BELOW_NORMAL <= theta < 90  # NaN is not known
        require(below, f"its theta_i is {theta:g}, not in [0, 90) degrees")
        require(math.isnan(phi) or abs(phi) <= MAX_AZIMUTH, f"its phi_i is {phi:g}")
    for tally in record.tallies:
        _check_tally(tally, record)
    if record.back is not None:
        require(record.back.asked.side == "back", "its back was lit from the front")
        check_record(record.back)


def _check_tally(tally: Tally, record: Record) -> None:
    """Raise FileFormatError unless the sums of one incident direction fit each other.

    Every ray in a patch is one in the ledger and the reverse, and light that was
    received had to come. Sums that 64 bits do not hold would be wrong in silence.
    """
    asked, integrated = record.asked, isinstance(tally, Integrals)
    require(
        asked.integrates == integrated,
        f"its estimator is {asked.estimator} and its errors of integrals are "
        f"{'there' if integrated else 'missing'}",
    )
    for name in tally.arrays:
        reason = f"its {name} add up to more than 64 bits hold"
        require(float(np.abs(getattr(tally, name)).sum(dtype=float)) < 2.0**64, reason)
    ledger = tally.ledger
    require(
        bool(ledger.direct) or not tally.direct.any(),
        "it has direct light without a ray",
    )
    if not (asked.sends_points or asked.joins_points):
        left = (ledger.reflected, ledger.transmitted + ledger.direct)
        for hits, listed in zip(tally.hits, left):
            counted = int(hits.sum())
            reason = f"its patches received {counted} rays and its ledger says {listed}"
            require(counted == listed, reason)
        if not integrated:
            empty = tally.sums[:, tally.hits == 0]
            require(not empty.any(), "patches without a hit received light")
    met = ledger.emitted - ledger.missed - ledger.unlit
    incident = tally.incident.sum(axis=0, dtype=float)
    reason = "it received light of an incident power of 0"
    require(not (met or integrated) or bool((incident > 0).all()), reason)
    rays, passes = record.provenance.rays, record.provenance.passes
    goal = record.asked.precision or record.asked.noise
    if goal is None and rays is not None:
        held = f"its ledger holds {ledger.emitted} rays of {rays} x {passes} asked for"
        require(ledger.emitted <= rays * passes, held)
