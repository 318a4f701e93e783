"""Radiance's BSDF files, as WINDOW writes them: Klems matrices and tensor trees.

Radiance lights the face that WINDOW calls the back from +z. Patches, incident light and
colours are those of :mod:`.radiance_basis`.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import ArrayLike

from ...array_types import Floats
from ...collector.directions import angles, direction as unit_vectors
from ...collector.klems import KLEMS, Klems
from ...errors import FileFormatError, printable
from ...files.checks import require, size_of
from ...files.numbers import decimal
from .radiance_basis import MATRIX_NAMES, RANKS, TREE_NAMES, Basis
from .tensor_tree import TensorTree

# Klems bases by their names in files.
KLEMS_BASES = {f"LBNL/Klems {one.size.capitalize()}": one for one in KLEMS.values()}
NAME_OF = {one: name for name, one in KLEMS_BASES.items()}
SHIRLEY_CHIU = "LBNL/Shirley-Chiu"

STRUCTURES = {f"TensorTree{rank}": rank for rank in RANKS.values()}

# Reflection and transmission, by the lit face.
DIRECTIONS = {
    ("front", 0): "Reflection Back",
    ("front", 1): "Transmission Back",
    ("back", 0): "Reflection Front",
    ("back", 1): "Transmission Front",
}

OTHER = {"front": "back", "back": "front"}

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


@dataclass(frozen=True)
class Product:
    """Product data of the file, apart from its BSDF.

    Attributes
    ----------
    name, manufacturer : str
    thickness, width, height : float, optional
        In metres. A file states a thickness of 0 if it is unknown: pyWinCalc reads
        none without.
    """

    name: str = "gonio-mi"
    manufacturer: str = "gonio-mi"
    thickness: float | None = None
    width: float | None = None
    height: float | None = None

    def text(self) -> str:
        """Elements of the file."""
        texts = {"Name": self.name, "Manufacturer": self.manufacturer}
        lines = [f"<{k}>{escape(printable(x))}</{k}>" for k, x in texts.items()]
        for key in ("Thickness", "Width", "Height"):
            value = getattr(self, key.lower())
            value = 0.0 if value is None and key == "Thickness" else value
            if value is not None:
                lines.append(f'<{key} unit="meter">{value:.7g}</{key}>')
        return "\n".join([*lines, "<DeviceType>Other</DeviceType>"])


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
        definition = _structure("Columns") + _klems_basis(Basis.of(first).patches)
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


def _klems_basis(patches: Klems) -> str:
    edges, n_phi = patches.theta_deg, patches.n_phi
    rings = "".join(
        f"<AngleBasisBlock><Theta>{(low + high) / 2 if low else 0:g}</Theta>"
        f"<nPhis>{n}</nPhis><ThetaBounds><LowerTheta>{low}</LowerTheta>"
        f"<UpperTheta>{high}</UpperTheta></ThetaBounds></AngleBasisBlock>\n"
        for low, high, n in zip(edges, edges[1:], n_phi)
    )
    title = f"<AngleBasisName>{NAME_OF[patches]}</AngleBasisName>"
    return f"<AngleBasis>\n{title}\n{rings}</AngleBasis>\n"


def _block(wavelength: str, direction: str, block: Floats | TensorTree) -> str:
    if isinstance(block, TensorTree):
        basis = f"<AngleBasis>{SHIRLEY_CHIU}</AngleBasis>"
        text = block.text()
    else:
        name = NAME_OF[Basis.of(block).patches]
        basis = f"<ColumnAngleBasis>{name}</ColumnAngleBasis>\n"
        basis += f"<RowAngleBasis>{name}</RowAngleBasis>"
        # as WINDOW has them; pyWinCalc reads no other
        text = ",\n".join(", ".join(f"{v:.7g}" for v in row) for row in block) + "\n"
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
    must = f"must be {', '.join(known)}, got {structure!r:.40}"
    require(structure in known, f"its IncidentDataStructure {must}")
    blocks = {}
    for data in root.iter("WavelengthData"):
        wavelength = data.findtext("Wavelength", "").strip()
        if wavelength not in DETECTORS:
            continue
        for block in data.iter("WavelengthDataBlock"):
            direction = block.findtext("WavelengthDataDirection", "").strip()
            unknown = f"its WavelengthDataDirection {direction!r:.40} is unknown"
            require(direction in DIRECTIONS.values(), unknown)
            key = wavelength, direction
            require(key not in blocks, f"it holds {wavelength} {direction} twice")
            blocks[key] = _data(block, direction, structure)
    visible = any(wavelength == "Visible" for wavelength, _ in blocks)
    require(visible, "it holds no visible BSDF")
    return blocks


def _root(stream: BinaryIO) -> ElementTree.Element:
    """Root element of an XML file without a DTD, tags without name spaces.

    Text before the XML declaration, as genBSDF may leave there, is passed over.
    """
    size = size_of(stream)
    require(size <= MAX_BYTES, f"it has {size} bytes, more than any such file needs")
    parser = ElementTree.XMLParser(target=_WithoutDTD())
    data = stream.read()
    try:
        root = ElementTree.fromstring(data[max(data.find(b"<?xml"), 0) :], parser)
    except FileFormatError:
        raise
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise FileFormatError(f"it is not XML: {error}") from None
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    require(root.tag == "WindowElement", "it is not a Radiance WindowElement")
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
        reason = f"its AngleBasis must be {SHIRLEY_CHIU}, got {name!r:.40}"
        require(name == SHIRLEY_CHIU, reason)
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
    reason = f"{direction} must hold {n * n} values, got {len(words)}"
    require(len(words) == n * n, reason)
    try:
        values = np.array([decimal(word) for word in words]).reshape(n, n)
    except ValueError as error:
        raise FileFormatError(f"{direction}: {error}") from None
    reason = f"{direction} holds a value that is negative or not finite"
    require(bool(np.isfinite(values).all()) and values.min() >= 0, reason)
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
    basis : Basis
        Of trees the finest.

    Raises
    ------
    FileFormatError
        If the file is damaged or something else.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self.blocks: dict[tuple[str, str], Any] = read(stream)
        bases = {Basis.of(block) for block in self.blocks.values()}
        self.basis = max(bases, key=lambda one: one.size)
        is_tree = self.basis.rank is not None
        require(is_tree or len(bases) == 1, "its matrices are of several bases")
        self._names: tuple[str, ...] = TREE_NAMES if is_tree else MATRIX_NAMES
        self.channels: tuple[str, ...] = ("R", "G", "B")
        if not {name for name, _ in self.blocks} >= set(self._names):
            self.channels, self._names = ("Y",), ("Visible",)
        for wavelength, direction in self.blocks:
            missing = [n for n in self._names if (n, direction) not in self.blocks]
            reason = f"its {direction} lacks {', '.join(missing)}"
            require(wavelength == "Solar" or not missing, reason)

    def holds(self, side: str, hemisphere: int) -> bool:
        """Whether the file has reflection (0) or transmission (1) of a lit face."""
        if ("Visible", DIRECTIONS[side, hemisphere]) in self.blocks:
            return True
        return self.is_reciprocal(side, hemisphere)

    def is_reciprocal(self, side: str, hemisphere: int) -> bool:
        """Whether the file tells this transmission by that of the other side only."""
        names = [("Visible", DIRECTIONS[face, 1]) for face in (side, OTHER[side])]
        told = [name in self.blocks for name in names]
        return hemisphere == 1 and told == [False, True]

    def values(
        self,
        side: str,
        hemisphere: int,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        wo: Floats,
    ) -> Floats:
        """BRDF or BTDF in 1/sr, shape ``(n, channels)``.

        Transmission that the file tells of the other side only is that of light that
        flies back, as Radiance has it.

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
        wo = wo * [1, 1, 0] + np.abs(wo) * [0, 0, 1]
        if self.is_reciprocal(side, hemisphere):
            wi = unit_vectors(np.radians(theta_i), np.radians(phi_i))
            side, (theta_i, phi_i) = OTHER[side], np.degrees(angles(wo))
            wo = np.broadcast_to(wi, wo.shape)
        direction = DIRECTIONS[side, hemisphere]
        blocks = [self.blocks[name, direction] for name in self._names]
        return self.basis.values(blocks, theta_i, phi_i, wo)


def has_back(path: str | PathLike[str]) -> bool:
    """Whether a file, if it is one of Radiance, holds light of the back by itself."""
    if Path(path).suffix.lower() != ".xml":
        return False
    with open(path, "rb") as stream:
        bsdf = RadianceBSDF(stream)
    return any(bsdf.holds("back", hemisphere) for hemisphere in (0, 1))
