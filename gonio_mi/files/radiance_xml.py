"""Radiance's BSDF files, as WINDOW writes them: Klems matrices and tensor trees.

Radiance lights the face that WINDOW calls the back from +z, and names the incident
patch by the azimuth of flight; matrices are rows of exit and columns of incidence.
"""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from typing import BinaryIO
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats, Integers
from ..collector.klems import N_PHI, THETA_DEG, Klems
from ..errors import FileFormatError
from .header import require, size_of
from .numbers import decimal
from .tensor_tree import TensorTree

__all__ = ["DIRECTIONS", "incident_patch", "read", "write"]

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
# functions for matrices, u' and v' of CIE 1976 for trees.
WAVELENGTHS = {"Visible": "Y", "CIE-X": "X", "CIE-Z": "Z", "CIE-u": "u", "CIE-v": "v"}

# Longest file read: a hundred times what 12 matrices need.
MOST_BYTES = 2**29


def incident_patch(theta_i: ArrayLike, phi_i: ArrayLike) -> Integers:
    """Columns of incident directions in degrees, `theta_i` from the lit normal."""
    theta, phi = np.radians(theta_i), np.radians(phi_i) + math.pi
    sine = np.sin(theta)
    flight = [sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)]
    return Klems().patch(np.stack(np.broadcast_arrays(*flight), axis=-1))


# ----------------------------------------------------------------------------- writing


def write(
    blocks: Mapping[tuple[str, str], Floats | TensorTree],
    stream: BinaryIO,
    name: str = "gonio-mi",
) -> None:
    """Write a BSDF as Radiance reads it.

    Parameters
    ----------
    blocks : dict
        By ``(wavelength, direction)``, of :data:`WAVELENGTHS` and the values of
        :data:`DIRECTIONS`: arrays ``(145, 145)`` of BRDF or BTDF in 1/sr, exit patches
        times incident ones, or trees of one rank.
    stream : binary stream
    name : str
        Of the material.
    """
    first = next(iter(blocks.values()))
    if isinstance(first, TensorTree):
        definition = _structure(f"TensorTree{first.rank}")
    else:
        definition = _structure("Columns") + _klems_basis()
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
<Name>{escape(name)}</Name>
<Manufacturer>gonio-mi</Manufacturer>
<DeviceType>Other</DeviceType>
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


def _klems_basis() -> str:
    rings = "".join(
        f"<AngleBasisBlock><Theta>{(low + high) / 2 if low else 0:g}</Theta>"
        f"<nPhis>{n}</nPhis><ThetaBounds><LowerTheta>{low}</LowerTheta>"
        f"<UpperTheta>{high}</UpperTheta></ThetaBounds></AngleBasisBlock>\n"
        for low, high, n in zip(THETA_DEG, THETA_DEG[1:], N_PHI)
    )
    name = f"<AngleBasisName>{KLEMS}</AngleBasisName>"
    return f"<AngleBasis>\n{name}\n{rings}</AngleBasis>\n"


def _block(wavelength: str, direction: str, block: Floats | TensorTree) -> str:
    if isinstance(block, TensorTree):
        basis = f"<AngleBasis>{SHIRLEY_CHIU}</AngleBasis>"
        text = block.text()
    else:
        basis = (
            f"<ColumnAngleBasis>{KLEMS}</ColumnAngleBasis>\n"
            f"<RowAngleBasis>{KLEMS}</RowAngleBasis>"
        )
        text = "\n".join(" ".join(f"{v:.7g}" for v in row) for row in block) + "\n"
    kind = "BRDF" if "Reflection" in direction else "BTDF"
    return f"""<WavelengthData>
<LayerNumber>System</LayerNumber>
<Wavelength unit="Integral">{wavelength}</Wavelength>
<SourceSpectrum>CIE Illuminant D65 1nm.ssp</SourceSpectrum>
<DetectorSpectrum>ASTM E308 1931 {WAVELENGTHS[wavelength]}.dsp</DetectorSpectrum>
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
    """Read a Radiance file in the Klems full basis, or of tensor trees.

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
        if wavelength in WAVELENGTHS:
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
    for basis in ("ColumnAngleBasis", "RowAngleBasis"):
        _check_basis(block, basis, KLEMS)
    n = sum(N_PHI)
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
