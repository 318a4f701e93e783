"""Small files as profilometers write them, after the descriptions of their formats."""

import hashlib
import struct
import zipfile

import numpy as np

# Millimetres: distances of the points along x and y, and a step of the heights.
SPACING, STEP = (0.002, 0.003), 1e-6

MAIN = """<?xml version="1.0" encoding="UTF-8"?>
<p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2">
<Record1><Revision>ISO5436 - 2000</Revision><FeatureType>SUR</FeatureType><Axes>
<CX><AxisType>I</AxisType><DataType>L</DataType><Increment>{dx}</Increment>
<Offset>0</Offset></CX>
<CY><AxisType>I</AxisType><DataType>L</DataType><Increment>{dy}</Increment>
<Offset>0</Offset></CY>
<CZ><AxisType>A</AxisType><DataType>D</DataType></CZ></Axes></Record1>
<Record2><Date>2020-01-01T00:00:00</Date><Instrument><Manufacturer>none</Manufacturer>
<Model>none</Model><Serial>0</Serial><Version>0</Version></Instrument>
<CalibrationDate>2020-01-01T00:00:00</CalibrationDate><ProbingSystem>
<Type>Software</Type><Identification>none</Identification></ProbingSystem></Record2>
<Record3><MatrixDimension><SizeX>{n_x}</SizeX><SizeY>{n_y}</SizeY><SizeZ>1</SizeZ>
</MatrixDimension><DataLink><PointDataLink>bindata/data.bin</PointDataLink>
<MD5ChecksumPointData>{digest}</MD5ChecksumPointData></DataLink></Record3>
<Record4><ChecksumFile>md5checksum.hex</ChecksumFile></Record4>
</p:ISO5436_2>
"""


def codes(n_y=12, n_x=16):
    """Heights in steps, whole numbers."""
    return np.random.default_rng(0).integers(-30000, 30000, (n_y, n_x))


def write_sur(path, grid=None, missing=()):
    """Digital Surf SUR of 32 bits in millimetres; `missing` are pairs of indices."""
    grid = (codes() if grid is None else grid).astype("<i4")
    (n_y, n_x), low = grid.shape, int(grid.min())
    for at in missing:
        grid[at] = low - 2
    words = [text.ljust(16).encode() for text in ("X", "Y", "Z", *["mm"] * 6)]
    header = struct.pack("<12s4H", b"DIGITAL SURF", 0, 1, 1, 2)
    header += b" " * 60 + struct.pack("<5H", 0, 0, 0, 1, 0) + bytes(8)
    header += struct.pack("<H5i", 32, low, int(grid.max()), n_x, n_y, n_x * n_y)
    header += struct.pack("<3f", *SPACING, STEP) + b"".join(words)
    header += struct.pack("<3f", 1, 1, 1)
    path.write_bytes(header.ljust(512, b"\0") + grid.tobytes())


def write_x3p(path, heights=None):
    """ISO 25178-72, in metres."""
    heights = codes() * STEP / 1000 if heights is None else heights
    data = heights.astype("<f8").tobytes()
    n_y, n_x = heights.shape
    digest = hashlib.md5(data).hexdigest().upper()
    dx, dy = (step / 1000 for step in SPACING)
    main = MAIN.format(dx=dx, dy=dy, n_x=n_x, n_y=n_y, digest=digest)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("main.xml", main)
        file.writestr("bindata/data.bin", data)
        checksum = hashlib.md5(main.encode()).hexdigest()
        file.writestr("md5checksum.hex", f"{checksum} *main.xml\n")


def write_nms(path, pitch):
    """NanoFocus NMS of 8 x 6 points, as surfalize reads it; heights 0 to 2 um."""
    header = bytearray(3468)
    struct.pack_into("<2d", header, 16, 0.0, 2.0)
    struct.pack_into("<2I2d", header, 1368, 8, 6, pitch, 2 * pitch)
    heights = np.linspace(0, 65534, 48).astype("<u2")
    path.write_bytes(bytes(header) + heights.tobytes())


def write_tiff(path, pixels=None):
    """Uncompressed grey TIFF of 16 bits, of one strip."""
    pixels = (codes() + 30000 if pixels is None else pixels).astype("<u2")
    n_y, n_x = pixels.shape
    tags = [(256, 4, n_x), (257, 4, n_y), (258, 3, 16), (259, 3, 1), (262, 3, 1)]
    tags += [(273, 4, 8), (277, 3, 1), (278, 4, n_y), (279, 4, pixels.nbytes)]
    directory = struct.pack("<H", len(tags))
    for tag, kind, value in tags:
        directory += struct.pack("<HHII", tag, kind, 1, value)
    start = struct.pack("<2sHI", b"II", 42, 8 + pixels.nbytes)
    path.write_bytes(start + pixels.tobytes() + directory + bytes(4))
