"""Radiance's BSDF files, as WINDOW writes them: Klems matrices and tensor trees.

Radiance lights the face that WINDOW calls the back from +z, and names the incident
patch by the azimuth of flight; matrices are rows of exit and columns of incidence.
"""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from typing import BinaryIO
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats, Integers
from ..collector.hemisphere import Subdivision
from ..collector.klems import Klems
from ..errors import FileFormatError
from .header import require, size_of
from .numbers import decimal
from .tensor_tree import TensorTree

__all__ = ["DIRECTIONS", "Product", "basis_of", "incident_patch", "read", "write"]

BASES = {
    f"LBNL/Klems {size.capitalize()}": Klems(size)
    for size in ("full", "half", "quarter")
}
KLEMS = "LBNL/Klems Full"
SHIRLEY_CHIU = "LBNL/Shirley-Chiu"

# Ranks of the data structures of tensor trees.
RANKS = {"TensorTree3": 3, "TensorTree4": 4}

# Reflection and transmission, by the lit face.
DIRECTIONS = {
    ("front", 0): "Reflection Back",
    ("front", 1): "Transmission Back",
    ("back", 0): "Reflection Front",
    ("back", 1): "Transmission Front",
}

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
MOST_BYTES = 2**29


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
        sizes = {
            "Thickness": self.thickness,
            "Width": self.width,
            "Height": self.height,
        }
        lines = [
            f"<Name>{escape(self.name)}</Name>",
            f"<Manufacturer>{escape(self.manufacturer)}</Manufacturer>",
            *(
                f'<{key} unit="meter">{value:.7g}</{key}>'
                for key, value in sizes.items()
                if value is not None
            ),
            "<DeviceType>Other</DeviceType>",
        ]
        return "\n".join(lines)


def basis_of(matrix: Floats) -> Klems:
    """Klems basis of a matrix ``(n, n)``, by its size."""
    return next(basis for basis in BASES.values() if basis.n_patches == len(matrix))


def incident_patch(
    theta_i: ArrayLike, phi_i: ArrayLike, basis: Subdivision | None = None
) -> Integers:
    """Columns of incident directions in degrees, `theta_i` from the lit normal.

    Of the Klems full basis unless other patches are given.
    """
    theta, phi = np.radians(theta_i), np.radians(phi_i) + math.pi
    sine = np.sin(theta)
    flight = [sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)]
    basis = Klems() if basis is None else basis
    return basis.patch(np.stack(np.broadcast_arrays(*flight), axis=-1))


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


def _name_of(basis: Klems) -> str:
    return next(name for name, one in BASES.items() if one == basis)


def _klems_basis(basis: Klems) -> str:
    edges = basis.theta_deg
    rings = "".join(
        f"<AngleBasisBlock><Theta>{(low + high) / 2 if low else 0:g}</Theta>"
        f"<nPhis>{n}</nPhis><ThetaBounds><LowerTheta>{low}</LowerTheta>"
        f"<UpperTheta>{high}</UpperTheta></ThetaBounds></AngleBasisBlock>\n"
        for low, high, n in zip(edges, edges[1:], basis.n_phi)
    )
    name = f"<AngleBasisName>{_name_of(basis)}</AngleBasisName>"
    return f"<AngleBasis>\n{name}\n{rings}</AngleBasis>\n"


def _block(wavelength: str, direction: str, block: Floats | TensorTree) -> str:
    if isinstance(block, TensorTree):
        basis = f"<AngleBasis>{SHIRLEY_CHIU}</AngleBasis>"
        text = block.text()
    else:
        name = _name_of(basis_of(block))
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
    known = ("Columns", "Rows", *RANKS)
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
    require(size <= MOST_BYTES, f"it has {size} bytes, more than any such file needs")
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
    if structure in RANKS:
        _check_basis(block, "AngleBasis", SHIRLEY_CHIU)
        return TensorTree.parsed(text, RANKS[structure])
    known = ", ".join(BASES)
    tags = "ColumnAngleBasis", "RowAngleBasis"
    names = {block.findtext(tag, "").strip() for tag in tags}
    require(
        len(names) == 1 and names <= BASES.keys(),
        f"its ColumnAngleBasis and RowAngleBasis must be one of {known}, got "
        f"{' and '.join(sorted(names))!r:.80}",
    )
    n = BASES[names.pop()].n_patches
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


def _check_basis(block: ElementTree.Element, tag: str, wanted: str) -> None:
    name = block.findtext(tag, "").strip()
    require(name == wanted, f"its {tag} must be {wanted}, got {name!r:.40}")
