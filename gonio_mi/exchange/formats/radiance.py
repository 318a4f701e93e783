"""Radiance's BSDF files, as WINDOW writes them: Klems matrices and tensor trees.

Radiance lights the face that WINDOW calls the back from +z, and names the incident
patch by the azimuth of flight; matrices are rows of exit and columns of incidence.
"""

import itertools
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import ArrayLike

from ...array_types import Floats, Integers
from ...collector import EqualProjectedSolidAngle
from ...collector.directions import direction as unit_vectors
from ...collector.hemisphere import Subdivision
from ...collector.klems import KLEMS, Klems
from ...errors import FileFormatError
from ...files.checks import require, size_of
from ...files.numbers import decimal
from ...results.patch_means import PatchMeans
from ...results.record import XYZ
from .format import Format
from .tensor_tree import TensorTree, coordinates

# Klems bases by their names in files.
KLEMS_BASES = {f"LBNL/Klems {one.size.capitalize()}": one for one in KLEMS.values()}
SHIRLEY_CHIU = "LBNL/Shirley-Chiu"

# Ranks of tensor trees by our names, and by those of their structures in files.
RANKS = {"tensor3": 3, "tensor4": 4}
STRUCTURES = {f"TensorTree{rank}": rank for rank in RANKS.values()}

# What a file may be written in.
BASES = (*KLEMS, *RANKS)

# Reflection and transmission, by the lit face.
DIRECTIONS = {
    ("front", 0): "Reflection Back",
    ("front", 1): "Transmission Back",
    ("back", 0): "Reflection Front",
    ("back", 1): "Transmission Front",
}

# The same in words, for those who read a file.
BLOCKS = (
    "lit from the front, the face to +z: Reflection Back and Transmission Back; "
    "from the back: Reflection Front and Transmission Front"
)

# CIE component of each block, and the detector that WINDOW names: colour-matching
# functions for matrices, u' and v' of CIE 1976 for trees; and the whole of sunlight,
# which Radiance passes over.
DETECTORS = {
    "Visible": "ASTM E308 1931 Y.dsp",
    "CIE-X": "ASTM E308 1931 X.dsp",
    "CIE-Z": "ASTM E308 1931 Z.dsp",
    "CIE-u": "ASTM E308 1931 u.dsp",
    "CIE-v": "ASTM E308 1931 v.dsp",
    "Solar": "None",
}

# Light of each block; of sunlight that of NFRC 300.
SOURCES = dict.fromkeys(DETECTORS, "CIE Illuminant D65 1nm.ssp")
SOURCES["Solar"] = "ASTM E891 Table 1 Direct AM1_5.ssp"

# Longest file read: a hundred times what 12 matrices need.
MAX_BYTES = 2**29

MATRIX_NAMES = ("CIE-X", "Visible", "CIE-Z")
TREE_NAMES = ("Visible", "CIE-u", "CIE-v")

# u' and v' of equal energy, which black has in Radiance.
WHITE = (4 / 19, 9 / 19)

# Azimuths of incidence at which tensor trees for any materials are taken.
N_AZIMUTHS = 24

# Angles of incidence at which tensor trees are taken, rings and sectors of patches by
# the rank of a tree, and points per side of a patch.
TREE_INCIDENCES = np.array([0, 10, 20, 30, 40, 50, 60, 70, 80.0])
TREE_PATCHES = {3: (45, 90), 4: (32, 64)}
TREE_POINTS = 3

# Half the width in degrees of what stands for an azimuth on an edge of patches.
EDGE_OFFSET = 1e-3


@dataclass(frozen=True)
class Product:
    """What the file says of the product, beside its light.

    Attributes
    ----------
    name, manufacturer : str
    thickness, width, height : float, optional
        In metres.
    """

    name: str = "gonio-mi"
    manufacturer: str = "gonio-mi"
    thickness: float | None = None
    width: float | None = None
    height: float | None = None

    def text(self) -> str:
        """Elements of the file."""
        lines = [
            f"<Name>{escape(self.name)}</Name>",
            f"<Manufacturer>{escape(self.manufacturer)}</Manufacturer>",
        ]
        for key in ("Thickness", "Width", "Height"):
            value = getattr(self, key.lower())
            if value is not None:
                lines.append(f'<{key} unit="meter">{value:.7g}</{key}>')
        return "\n".join([*lines, "<DeviceType>Other</DeviceType>"])


def basis_of(matrix: Floats) -> str:
    """Name of the Klems basis of a matrix ``(n, n)``, by its size."""
    n = len(matrix)
    return next(name for name, one in KLEMS_BASES.items() if one.n_patches == n)


def incident_patch(
    theta_i: ArrayLike, phi_i: ArrayLike, basis: Subdivision | None = None
) -> Integers:
    """Columns of incident directions in degrees, `theta_i` from the lit normal.

    Of the Klems full basis unless other patches are given.
    """
    basis = Klems() if basis is None else basis
    return basis.patch(unit_vectors(np.radians(theta_i), np.radians(phi_i) + np.pi))


# ----------------------------------------------------------------------------- writing


def write(
    blocks: Mapping[tuple[str, str], Floats | TensorTree],
    stream: BinaryIO,
    product: Product | None = None,
) -> None:
    """Write a BSDF as Radiance reads it.

    Parameters
    ----------
    blocks : dict
        By ``(wavelength, direction)``, of :data:`DETECTORS` and the values of
        :data:`DIRECTIONS`: arrays ``(n, n)`` of BRDF or BTDF in 1/sr, exit patches
        times incident ones of a Klems basis, or trees of one rank.
    stream : binary stream
    product : Product, optional
    """
    first = next(iter(blocks.values()))
    if isinstance(first, TensorTree):
        definition = _structure(f"TensorTree{first.rank}")
    else:
        definition = _structure("Columns") + _klems_basis(basis_of(first))
    product = product or Product()
    stream.write(
        f"""<?xml version="1.0" encoding="UTF-8"?>
<WindowElement xmlns="http://windows.lbl.gov"
 xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
 xsi:schemaLocation="http://windows.lbl.gov/BSDF-v1.4.xsd">
<!-- gonio-mi: {BLOCKS}. -->
<WindowElementType>System</WindowElementType>
<FileType>BSDF</FileType>
<Optical>
<Layer>
<Material>
{product.text()}
</Material>
<DataDefinition>
{definition}</DataDefinition>
""".encode()
    )
    for (wavelength, direction), block in blocks.items():
        stream.write(_block(wavelength, direction, block).encode())
    stream.write(b"</Layer>\n</Optical>\n</WindowElement>\n")


def _structure(name: str) -> str:
    return f"<IncidentDataStructure>{name}</IncidentDataStructure>\n"


def _klems_basis(name: str) -> str:
    edges, n_phi = KLEMS_BASES[name].theta_deg, KLEMS_BASES[name].n_phi
    rings = "".join(
        f"<AngleBasisBlock><Theta>{(low + high) / 2 if low else 0:g}</Theta>"
        f"<nPhis>{n}</nPhis><ThetaBounds><LowerTheta>{low}</LowerTheta>"
        f"<UpperTheta>{high}</UpperTheta></ThetaBounds></AngleBasisBlock>\n"
        for low, high, n in zip(edges, edges[1:], n_phi)
    )
    title = f"<AngleBasisName>{name}</AngleBasisName>"
    return f"<AngleBasis>\n{title}\n{rings}</AngleBasis>\n"


def _block(wavelength: str, direction: str, block: Floats | TensorTree) -> str:
    if isinstance(block, TensorTree):
        basis = f"<AngleBasis>{SHIRLEY_CHIU}</AngleBasis>"
        text = block.text()
    else:
        name = basis_of(block)
        basis = (
            f"<ColumnAngleBasis>{name}</ColumnAngleBasis>\n"
            f"<RowAngleBasis>{name}</RowAngleBasis>"
        )
        text = "\n".join(" ".join(f"{v:.7g}" for v in row) for row in block) + "\n"
    kind = "BRDF" if "Reflection" in direction else "BTDF"
    return f"""<WavelengthData>
<LayerNumber>System</LayerNumber>
<Wavelength unit="Integral">{wavelength}</Wavelength>
<SourceSpectrum>{SOURCES[wavelength]}</SourceSpectrum>
<DetectorSpectrum>{DETECTORS[wavelength]}</DetectorSpectrum>
<WavelengthDataBlock>
<WavelengthDataDirection>{direction}</WavelengthDataDirection>
{basis}
<ScatteringDataType>{kind}</ScatteringDataType>
<ScatteringData>
{text}</ScatteringData>
</WavelengthDataBlock>
</WavelengthData>
"""


# ----------------------------------------------------------------------------- reading


def read(stream: BinaryIO) -> dict[tuple[str, str], Floats | TensorTree]:
    """Read a Radiance file in a Klems basis, or of tensor trees.

    Returns
    -------
    dict
        As `write` takes it.

    Raises
    ------
    FileFormatError
        If the file is something else or is damaged. Entities are not expanded.
    """
    root = _root(stream)
    structure = root.findtext(".//IncidentDataStructure", "").strip()
    known = ("Columns", "Rows", *STRUCTURES)
    require(
        structure in known,
        f"its IncidentDataStructure must be {', '.join(known)}, got {structure!r:.40}",
    )
    blocks = {}
    for data in root.iter("WavelengthData"):
        wavelength = data.findtext("Wavelength", "").strip()
        if wavelength in DETECTORS:
            for block in data.iter("WavelengthDataBlock"):
                direction = block.findtext("WavelengthDataDirection", "").strip()
                require(
                    direction in DIRECTIONS.values(),
                    f"its WavelengthDataDirection {direction!r:.40} is unknown",
                )
                require(
                    (wavelength, direction) not in blocks,
                    f"it holds {wavelength} {direction} twice",
                )
                blocks[wavelength, direction] = _data(block, direction, structure)
    require(
        any(wavelength == "Visible" for wavelength, _ in blocks),
        "it holds no visible BSDF",
    )
    return blocks


def _root(stream: BinaryIO) -> ElementTree.Element:
    """Root element of an XML file without a DTD, tags without name spaces."""
    size = size_of(stream)
    require(size <= MAX_BYTES, f"it has {size} bytes, more than any such file needs")
    parser = ElementTree.XMLParser(target=_WithoutDTD())
    try:
        root = ElementTree.parse(stream, parser).getroot()
    except FileFormatError:
        raise
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise FileFormatError(f"it is not XML: {error}") from None
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    require(root.tag == "WindowElement", "it is no WindowElement of Radiance")
    return root


class _WithoutDTD(ElementTree.TreeBuilder):
    """Builder that stops before any entity is declared, in whatever encoding."""

    def doctype(self, *_: object) -> None:
        """Raise FileFormatError."""
        raise FileFormatError("it has a DTD")


def _data(
    block: ElementTree.Element, direction: str, structure: str
) -> Floats | TensorTree:
    """Matrix or tree of one block."""
    text = block.findtext("ScatteringData", "")
    if structure in STRUCTURES:
        name = block.findtext("AngleBasis", "").strip()
        require(
            name == SHIRLEY_CHIU,
            f"its AngleBasis must be {SHIRLEY_CHIU}, got {name!r:.40}",
        )
        return TensorTree.parsed(text, STRUCTURES[structure])
    known = ", ".join(KLEMS_BASES)
    tags = "ColumnAngleBasis", "RowAngleBasis"
    names = {block.findtext(tag, "").strip() for tag in tags}
    require(
        len(names) == 1 and names <= KLEMS_BASES.keys(),
        f"its ColumnAngleBasis and RowAngleBasis must be one of {known}, got "
        f"{' and '.join(sorted(names))!r:.80}",
    )
    n = KLEMS_BASES[names.pop()].n_patches
    words = text.replace(",", " ").split()
    require(
        len(words) == n * n, f"{direction} must hold {n * n} values, got {len(words)}"
    )
    try:
        values = np.array([decimal(word) for word in words]).reshape(n, n)
    except ValueError as error:
        raise FileFormatError(f"{direction}: {error}") from None
    require(
        bool(np.isfinite(values).all()) and values.min() >= 0,
        f"{direction} holds a value that is negative or not finite",
    )
    return values.T if structure == "Rows" else values


# -------------------------------------------------------------------------- materials


class RadianceBSDF:
    """A Radiance file, in grey or linear sRGB.

    Parameters
    ----------
    stream : binary stream

    Attributes
    ----------
    blocks : dict
        As `read` returns.
    channels : tuple of str
        ``("Y",)`` or ``("R", "G", "B")``.
    rank : {None, 3, 4}
        Of tensor trees; None for Klems matrices.
    basis : Klems
        Of the matrices; None for tensor trees.

    Raises
    ------
    FileFormatError
        If the file is damaged or something else.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self.blocks: dict[tuple[str, str], Any] = read(stream)
        first: Any = next(iter(self.blocks.values()))
        self.rank: int | None = None
        self.basis: Any = None
        self._names: tuple[str, ...] = MATRIX_NAMES
        if isinstance(first, TensorTree):
            self.rank, self._names = first.rank, TREE_NAMES
        else:
            self.basis = KLEMS_BASES[basis_of(first)]
            blocks: Any = self.blocks.values()
            sizes = {len(matrix) for matrix in blocks}
            require(len(sizes) == 1, "its matrices are of several bases")
        self.channels: tuple[str, ...] = ("R", "G", "B")
        if not {name for name, _ in self.blocks} >= set(self._names):
            self.channels, self._names = ("Y",), ("Visible",)
        for wavelength, direction in self.blocks:
            missing = [n for n in self._names if (n, direction) not in self.blocks]
            require(
                wavelength == "Solar" or not missing,
                f"its {direction} lacks {', '.join(missing)}",
            )

    def holds(self, side: str, hemisphere: int) -> bool:
        """Whether there is reflection (0) or transmission (1) of a lit face."""
        return ("Visible", DIRECTIONS[side, hemisphere]) in self.blocks

    def values(
        self,
        side: str,
        hemisphere: int,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        wo: Floats,
    ) -> Floats:
        """BRDF or BTDF in 1/sr, shape ``(n, channels)``.

        Parameters
        ----------
        side : {"front", "back"}
            The lit face.
        hemisphere : {0, 1}
            Reflection or transmission.
        theta_i, phi_i : float or ndarray, shape (n,)
            Incident directions in degrees, from the normal of the lit face.
        wo : ndarray, shape (n, 3)
            Unit vectors of exit; only the azimuth and the angle with the normal count.
        """
        direction = DIRECTIONS[side, hemisphere]
        blocks = [self.blocks[name, direction] for name in self._names]
        if self.rank is None:
            rows = self.basis.patch(wo * [1, 1, 0] + np.abs(wo) * [0, 0, 1])
            columns = incident_patch(theta_i, phi_i, self.basis)
            parts = np.stack([block[rows, columns] for block in blocks], axis=-1)
        else:
            points = coordinates(self.rank, theta_i, phi_i, wo)
            parts = np.stack([block.at(points) for block in blocks], axis=-1)
            if len(blocks) == 3:
                parts = _xyz_of_yuv(*parts.T)
        return parts if len(blocks) == 1 else parts @ np.linalg.inv(XYZ).T


def _xyz_of_yuv(y: Floats, u: Floats, v: Floats) -> Floats:
    """CIE XYZ of luminance and the chromaticity u', v', shape ``(n, 3)``."""
    v = np.where(v > 0, v, WHITE[1])
    x = y * 9 * u / (4 * v)
    z = y * (12 - 3 * u - 20 * v) / (4 * v)
    return np.stack([x, y, z], axis=-1)


def has_back(path: str | PathLike[str]) -> bool:
    """Whether a file, if it is one of Radiance, holds light of the back by itself."""
    if Path(path).suffix.lower() != ".xml":
        return False
    with open(path, "rb") as stream:
        bsdf = RadianceBSDF(stream)
    return any(bsdf.holds("back", hemisphere) for hemisphere in (0, 1))


def material(stream: BinaryIO, side: str) -> PatchMeans:
    """Means over patches of a file, with light on one of its faces.

    Raises
    ------
    FileFormatError
        If the file is damaged, or holds no light that meets the face.
    """
    bsdf = RadianceBSDF(stream)
    held = [h for h in (0, 1) if bsdf.holds(side, h)]
    require(bool(held), f"it holds no light that meets its {side}")
    if bsdf.rank is None:
        # at the middles of rings, of which the first is one patch around the pole, at
        # as many azimuths as the ring has that has most, on both sides of edges there
        patches, edges = bsdf.basis, bsdf.basis.theta_deg
        angles = np.array([0, *(np.add(edges[1:-1], edges[2:]) / 2)])
        n, turns = max(patches.n_phi), [-EDGE_OFFSET, EDGE_OFFSET]
        wo = unit_vectors(*(angle[:, 0] for angle in patches.middles))[:, None]
    else:
        patches = EqualProjectedSolidAngle(*TREE_PATCHES[bsdf.rank])
        angles, wo = TREE_INCIDENCES, patches.points(TREE_POINTS)
        n, turns = (N_AZIMUTHS if bsdf.rank == 4 else 1), [0.0]
    grid = np.meshgrid(angles, np.arange(n) * (360 / n), indexing="ij")
    theta_i, phi_i = (angle.ravel() for angle in grid)
    shape = len(theta_i), max(held) + 1, *patches.shape, len(bsdf.channels)
    means = np.zeros(shape)
    for hemisphere, (index, theta) in itertools.product(held, enumerate(theta_i)):
        values = [
            bsdf.values(side, hemisphere, theta, phi_i[index] + turn, wo.reshape(-1, 3))
            for turn in turns
        ]
        of_points = np.mean(values, axis=0).reshape(*wo.shape[:2], -1)
        means[index, hemisphere] = of_points.mean(axis=1).reshape(shape[2:])
    return PatchMeans.of(means, patches, (theta_i, phi_i), bsdf.channels)


FORMATS = (
    Format(
        "Radiance",
        (".xml",),
        material=material,
        loses="lobes narrower than its patches or cells",
    ),
)
