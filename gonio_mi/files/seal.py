"""A check sum over all bytes of a file, at its very end.

What follows the last image of an EXR file is read by nobody, and a ZIP archive may end
in a comment: both formats carry it, and other programs do not mind.
"""

import hashlib
from typing import BinaryIO

from .header import require, size_of

__all__ = ["LEAST_COMPRESSED", "MOST_UNSEALED", "SEAL_LENGTH", "is_sealed", "seal_of"]

MARK = b"gonio-mi sha256 "
SEAL_LENGTH = len(MARK) + 2 * hashlib.sha256().digest_size

# A file without a seal may be anything: no more is read of it than this many bytes, or
# this many times its own size, which the sums of a few rays hardly reach.
MOST_UNSEALED = 2**30
LEAST_COMPRESSED = 64

# Bytes that are read at once.
PIECE = 2**20


def seal_of(content: bytes | memoryview) -> bytes:
    """What is put after the content of a file."""
    return MARK + hashlib.sha256(content).hexdigest().encode()


def is_sealed(stream: BinaryIO) -> bool:
    """Whether a file ends in a seal; files of older versions have none.

    The position is at the beginning afterwards.

    Raises
    ------
    FileFormatError
        If it has one that does not agree with its content.
    """
    size = size_of(stream)
    stream.seek(max(size - 2 * SEAL_LENGTH, 0))
    end = stream.read()
    stream.seek(0)
    _, mark, seal = end.rpartition(MARK)
    if not mark:
        return False
    length = size - SEAL_LENGTH
    require(len(mark + seal) == SEAL_LENGTH, "it is truncated or longer than it was")
    digest = hashlib.sha256()
    while piece := stream.read(min(PIECE, length - stream.tell())):
        digest.update(piece)
    stream.seek(0)
    require(
        seal == digest.hexdigest().encode(),
        "it is damaged: its content does not agree with its check sum",
    )
    return True
