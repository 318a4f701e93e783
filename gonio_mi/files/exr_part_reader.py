"""Parts of an OpenEXR file, each read by itself.

The library reads all parts of a file at once, pictures included, which take ten times
the memory of the sums: it is given files of a few parts that are cut out.
"""

import io
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
import OpenEXR

from .checks import require

# Bytes before the first header; version 2 with the bits of such images.
BEGIN, SEVERAL_PARTS, LONG_NAMES = 8, 0x1002, 0x400


@dataclass(frozen=True)
class Part:
    """Header of a part, and where the table of its chunks of pixels is in the file.

    See openexr.com/en/latest/OpenEXRFileLayout.html.
    """

    name: str
    header: bytes
    n_chunks: int
    chunk_head: int
    table: int


def parts_of(stream: BinaryIO) -> list[Part]:
    """Parts of an image of several."""
    _, version = struct.unpack("<4sI", _exactly(stream, BEGIN))
    require(version & ~LONG_NAMES == SEVERAL_PARTS, "it is not a multi-part image")
    headers = []
    while found := _header(stream):
        headers.append(found)
    parts, table = [], stream.tell()
    for header, values in headers:
        reason = "a header of its parts is damaged"
        require(len(values.get("chunkCount", b"")) == 4 and "name" in values, reason)
        (n_chunks,) = struct.unpack("<i", values["chunkCount"])
        name = values["name"].decode("utf-8", "replace")
        # number of the part, place of the chunk, length of what follows
        chunk_head = 24 if "tiles" in values else 12
        parts.append(Part(name, header, n_chunks, chunk_head, table))
        table += 8 * n_chunks
    return parts


def _header(stream: BinaryIO) -> tuple[bytes, dict[str, bytes]] | None:
    """Bytes of the next header, and its attributes; None after the last one."""
    start, values = stream.tell(), {}
    while name := _word(stream):
        _word(stream)  # its type
        (size,) = struct.unpack("<i", _exactly(stream, 4))
        values[name] = _exactly(stream, size)
    length = stream.tell() - start
    stream.seek(start)
    content = _exactly(stream, length)
    return (content, values) if values else None


def _word(stream: BinaryIO) -> str:
    """Null-terminated string."""
    letters = bytearray()
    while (letter := _exactly(stream, 1)) != b"\0":
        letters += letter
    return letters.decode("utf-8", "replace")


def _exactly(stream: BinaryIO, n: int) -> bytes:
    """Exactly n bytes; FileFormatError if the file has fewer."""
    content = stream.read(n) if n >= 0 else b""
    require(n >= 0 and len(content) == n, "a header of its parts is damaged")
    return content


def image_of(stream: BinaryIO, parts: Sequence[Part]) -> Any:
    """Image of some parts of a file."""
    chunks: list[bytes] = []
    for number, part in enumerate(parts):
        stream.seek(part.table)
        table = _exactly(stream, 8 * part.n_chunks)
        for offset in np.frombuffer(table, "<u8").tolist():
            stream.seek(offset)
            head = _exactly(stream, part.chunk_head)
            size = int.from_bytes(head[-4:], "little", signed=True)
            own = struct.pack("<i", number) + head[4:]
            chunks.append(own + _exactly(stream, size))
    stream.seek(0)
    begin = stream.read(BEGIN)
    head = begin + b"".join(part.header for part in parts) + b"\0"
    lengths = [len(chunk) for chunk in chunks]
    first = len(head) + 8 * len(chunks)
    offsets = np.cumsum([first, *lengths], dtype="<u8")[:-1]
    content = io.BytesIO(b"".join([head, offsets.tobytes(), *chunks]))
    return OpenEXR.File(content, separate_channels=True)
