"""A check sum over all bytes of a file, at its very end.

What follows the last image of an EXR file is read by nobody, and a ZIP archive may end
in a comment: both formats carry it, and other programs do not mind.
"""

import hashlib
from typing import BinaryIO

from .header import require, size_of

__all__ = ["SEAL_LENGTH", "check_seal", "seal_of"]

MARK = b"gonio-mi sha256 "
SEAL_LENGTH = len(MARK) + 2 * hashlib.sha256().digest_size

# Bytes that are read at once.
PIECE = 2**20


def seal_of(content: bytes | memoryview) -> bytes:
    """What is put after the content of a file."""
    return MARK + hashlib.sha256(content).hexdigest().encode()


def check_seal(stream: BinaryIO) -> None:
    """Raise FileFormatError unless a file ends in a seal that agrees with its content.

    The position is at the beginning afterwards.
    """
    size = size_of(stream)
    stream.seek(max(size - 2 * SEAL_LENGTH, 0))
    _, mark, seal = stream.read().rpartition(MARK)
    stream.seek(0)
    require(
        bool(mark),
        "it ends in no check sum: it is truncated or was not written by gonio-mi",
    )
    require(len(mark + seal) == SEAL_LENGTH, "it is truncated or longer than it was")
    length = size - SEAL_LENGTH
    digest = hashlib.sha256()
    while piece := stream.read(min(PIECE, length - stream.tell())):
        digest.update(piece)
    stream.seek(0)
    require(
        seal == digest.hexdigest().encode(),
        "it is damaged: its content does not agree with its check sum",
    )
