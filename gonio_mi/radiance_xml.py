"""Radiance's BSDF files: matrices in the Klems full basis, as WINDOW writes them.

Radiance lights the face that WINDOW calls the back from +z, and names the incident
patch by the azimuth of flight; the data are rows of exit and columns of incidence.
"""

import math
import xml.etree.ElementTree as ElementTree
from xml.sax.saxutils import escape

import numpy as np

from .errors import FileFormatError
from .header import require, size_of
from .klems import N_PHI, THETA_DEG, Klems

__all__ = ["DIRECTIONS", "incident_patch", "read", "write"]

BASIS = "LBNL/Klems Full"

# Reflection and transmission, by the lit face.
DIRECTIONS = {
    ("front", 0): "Reflection Back",
    ("front", 1): "Transmission Back",
    ("back", 0): "Reflection Front",
    ("back", 1): "Transmission Front",
}

# CIE colour-matching component of each block, and the detector that WINDOW names.
WAVELENGTHS = {"Visible": "Y", "CIE-X": "X", "CIE-Z": "Z"}

# Longest file read: a hundred times what 12 matrices need.
MOST_BYTES = 2**29


def incident_patch(theta_i, phi_i):
    """Column of an incident direction in degrees, `theta_i` from the lit normal."""
    theta, phi = np.radians([theta_i, phi_i + 180])
    sine = math.sin(theta)
    flight = [sine * math.cos(phi), sine * math.sin(phi), math.cos(theta)]
    return int(Klems().patch(flight))


def write(matrices, stream, name="gonio-mi"):
    """Write matrices as Radiance reads them.

    Parameters
    ----------
    matrices : dict
        By ``(wavelength, direction)``, of ``Visible``, ``CIE-X``, ``CIE-Z`` and the
        values of :data:`DIRECTIONS`: arrays ``(145, 145)`` of BRDF or BTDF in 1/sr,
        exit patches times incident ones.
    stream : binary stream
    name : str
        Of the material.
    """
    blocks = "".join(
        _block(wavelength, direction, matrix)
        for (wavelength, direction), matrix in matrices.items()
    )
    text = f"""<?xml version="1.0" encoding="UTF-8"?>
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
<IncidentDataStructure>Columns</IncidentDataStructure>
<AngleBasis>
<AngleBasisName>{BASIS}</AngleBasisName>
{_basis()}</AngleBasis>
</DataDefinition>
{blocks}</Layer>
</Optical>
</WindowElement>
"""
    stream.write(text.encode())


def _basis():
    return "".join(
        f"<AngleBasisBlock><Theta>{(low + high) / 2 if low else 0:g}</Theta>"
        f"<nPhis>{n}</nPhis><ThetaBounds><LowerTheta>{low}</LowerTheta>"
        f"<UpperTheta>{high}</UpperTheta></ThetaBounds></AngleBasisBlock>\n"
        for low, high, n in zip(THETA_DEG, THETA_DEG[1:], N_PHI)
    )


def _block(wavelength, direction, matrix):
    rows = "\n".join(" ".join(f"{value:.7g}" for value in row) for row in matrix)
    return f"""<WavelengthData>
<LayerNumber>System</LayerNumber>
<Wavelength unit="Integral">{wavelength}</Wavelength>
<SourceSpectrum>CIE Illuminant D65 1nm.ssp</SourceSpectrum>
<DetectorSpectrum>ASTM E308 1931 {WAVELENGTHS[wavelength]}.dsp</DetectorSpectrum>
<WavelengthDataBlock>
<WavelengthDataDirection>{direction}</WavelengthDataDirection>
<ColumnAngleBasis>{BASIS}</ColumnAngleBasis>
<RowAngleBasis>{BASIS}</RowAngleBasis>
<ScatteringDataType>{"BRDF" if "Reflection" in direction else "BTDF"}\
</ScatteringDataType>
<ScatteringData>
{rows}
</ScatteringData>
</WavelengthDataBlock>
</WavelengthData>
"""


def read(stream):
    """Read matrices from a Radiance file in the Klems full basis.

    Returns
    -------
    dict
        As `write` takes it.

    Raises
    ------
    FileFormatError
        If the file is something else or is damaged. Entities are not expanded.
    """
    size = size_of(stream)
    require(size <= MOST_BYTES, f"it has {size} bytes, more than any such file needs")
    data = stream.read()
    require(b"<!DOCTYPE" not in data and b"<!ENTITY" not in data, "it has a DTD")
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise FileFormatError(f"it is not XML: {error}") from None
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    require(root.tag == "WindowElement", "it is no WindowElement of Radiance")
    structure = root.findtext(".//IncidentDataStructure", "").strip()
    require(
        structure in ("Columns", "Rows"),
        f"its IncidentDataStructure must be Columns or Rows, got {structure!r:.40}",
    )
    matrices = {}
    for data in root.iter("WavelengthData"):
        wavelength = data.findtext("Wavelength", "").strip()
        if wavelength in WAVELENGTHS:
            for block in data.iter("WavelengthDataBlock"):
                direction, matrix = _matrix(block, structure == "Rows")
                matrices[wavelength, direction] = matrix
    require(bool(matrices), "it holds no visible BSDF")
    return matrices


def _matrix(block, by_rows):
    """Direction and matrix of one block."""
    for basis in ("ColumnAngleBasis", "RowAngleBasis"):
        name = block.findtext(basis, "").strip()
        require(name == BASIS, f"its {basis} must be {BASIS}, got {name!r:.40}")
    direction = block.findtext("WavelengthDataDirection", "").strip()
    require(
        direction in DIRECTIONS.values(),
        f"its WavelengthDataDirection {direction!r:.40} is unknown",
    )
    n = sum(N_PHI)
    words = block.findtext("ScatteringData", "").replace(",", " ").split()
    require(
        len(words) == n * n, f"{direction} must hold {n * n} values, got {len(words)}"
    )
    try:
        values = np.array([float(word) for word in words]).reshape(n, n)
    except ValueError as error:
        raise FileFormatError(f"{direction}: {error}") from None
    require(bool(np.isfinite(values).all()), f"{direction} holds a value not finite")
    return direction, values.T if by_rows else values
