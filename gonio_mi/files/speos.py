"""Scatter files of Ansys Speos as text: ``.brdf`` and ``.anisotropicbsdf``.

Rows and their meaning are those of the Speos manual ("Structure of BRDF files",
"Structure of Anisotropic BSDF files", version 2024 R2). Angles are in degrees, polar
angles from the normal of the lit face, those of transmission from 90 to 180; azimuths
of exit count from the direction in which the light flies, so that the mirror direction
is at ``(theta_i, 0)``. Values are proportional to the BSDF (type 1) or to the
intensity, the BSDF times the cosine (type 0), and *scaled*: in ``.brdf`` so that each
block has the percentage that stands before it, in ``.anisotropicbsdf`` all by one
factor for each wavelength, such that the block of a stated incidence has the percentage
of the spectrum. The anisotropy angle is, in the manual's words ("Anisotropic BSDF
Surface Overview"), between the direction in which the light flies and the anisotropy
vector, "using trigonometrical convention", which leaves from which to which to a
figure. Here it counts from the light to the vector, counter-clockwise: azimuths of
incidence are minus that angle, and +x of the specimen is opposite to the vector.
"""

from collections.abc import Sequence
from typing import BinaryIO

import numpy as np

from ..array_types import Floats
from ..errors import FileFormatError
from .header import require
from .numbers import decimal
from .scatter import Block, Scatter, check_size, total_of

__all__ = ["ANISOTROPIC", "SPECTRAL", "is_speos", "read"]

ANISOTROPIC, SPECTRAL = "OPTIS - Anisotropic BSDF surface file", "OPTIS - brdf surface"

# The first version whose rows are these.
FIRST_VERSION = 8.0

LONGEST = 10**6


class _Rows:
    """Rows of a text, one after the other."""

    def __init__(self, stream: BinaryIO) -> None:
        content = stream.read()
        head = content[:100].replace(b"\r", b"\n").split(b"\n")[0].decode("latin-1")
        head = head.strip()
        require(head.startswith("OPTIS"), "it is no file of Speos")
        version = head.rpartition(" v")[2]
        try:
            known = decimal(version) >= FIRST_VERSION
        except ValueError:
            known = False
        require(
            known,
            f"it has the version {version:.10}: save it anew with Speos's BSDF viewer",
        )
        self._text = content.decode("latin-1").replace("\r\n", "\n").replace("\r", "\n")
        self._at = 0
        self.number = 0
        self.head = self.row()
        require(
            self.row().strip()[:1] == "0" and b"\0" not in content,
            "it is binary: save it as text with Speos's BSDF viewer",
        )
        self.comment = self.row().strip()
        self.skip(self.whole(1)[0])
        self.row()

    def row(self) -> str:
        """Text of the next row."""
        require(self._at < len(self._text), "it ends too soon")
        end = self._text.find("\n", self._at)
        end = len(self._text) if end < 0 else end
        text = self._text[self._at : end]
        require(len(text) <= LONGEST, "it has an endless line")
        self._at = end + 1
        self.number += 1
        return text

    def skip(self, n: int) -> None:
        """Go on by as many characters."""
        require(0 <= n <= len(self._text) - self._at, "it ends in its description")
        self.number += self._text.count("\n", self._at, self._at + n)
        self._at += n

    def numbers(self, n: int) -> Floats:
        """Numbers of the next row, `n` of them."""
        cells = self.row().split()
        require(
            len(cells) == n,
            f"row {self.number} must have {n} numbers, got {len(cells)}",
        )
        try:
            return np.array([decimal(cell) for cell in cells], dtype=float)
        except ValueError as error:
            raise FileFormatError(f"row {self.number}: {error}") from None

    def whole(self, n: int) -> list[int]:
        """The same, whole numbers."""
        values = self.numbers(n)
        require(
            bool((values == np.round(values)).all() and (np.abs(values) < 1e9).all()),
            f"row {self.number} must have whole numbers",
        )
        return [int(value) for value in values]

    def listed(self) -> Floats:
        """Numbers of the next row, which the one before it counts."""
        (n,) = self.whole(1)
        check_size(n)
        return self.numbers(n)

    def block(self) -> tuple[Floats, Floats, Floats]:
        """Polar angles, azimuths, and values of the next table."""
        n_polar, n_azimuth = self.whole(2)
        check_size(n_polar, n_azimuth)
        azimuth = self.numbers(n_azimuth)
        rows = [self.numbers(n_azimuth + 1) for _ in range(n_polar)]
        table = np.array(rows)
        return table[:, 0], azimuth, table[:, 1:]


def is_speos(content: bytes) -> bool:
    """Whether a file begins as files of Speos do."""
    return content.startswith(b"OPTIS - ")


def read(stream: BinaryIO) -> Scatter:
    """Read a file of either kind.

    Raises
    ------
    FileFormatError
        If it is something else, binary, damaged, or announces more than it holds.
    """
    rows = _Rows(stream)
    if rows.head.startswith(ANISOTROPIC):
        return _read_anisotropic(rows)
    require(rows.head.startswith(SPECTRAL), f"it is a {rows.head:.60}")
    return _read_spectral(rows)


def _read_spectral(rows: _Rows) -> Scatter:
    """Blocks of a ``.brdf``: hemisphere, incidence, wavelength."""
    held, intensity = rows.whole(2), rows.whole(1)[0] == 0
    n_incidences, n_wavelengths = rows.whole(2)
    check_size(n_incidences, n_wavelengths)
    incidences, wavelengths = rows.numbers(n_incidences), rows.numbers(n_wavelengths)
    blocks = []
    for hemisphere in (h for h in (0, 1) if held[h]):
        for theta_i in incidences.tolist():
            parts = []
            for _ in range(n_wavelengths):
                (percent,) = rows.numbers(1)
                part = _block(rows, theta_i, 0.0, hemisphere, intensity)
                total = total_of(part)[0]
                scale = percent / 100 / total if total > 0 else 0.0
                parts.append(
                    _scaled(part, np.array([scale]), np.array([percent / 100]))
                )
            blocks.append(_joined(parts))
    channels, blocks = _grey_if_one(_names(wavelengths), blocks)
    return Scatter(blocks, channels, _header(rows), _note(intensity))


def _read_anisotropic(rows: _Rows) -> Scatter:
    """Blocks of an ``.anisotropicbsdf``: hemisphere, anisotropy, incidence."""
    vector = rows.numbers(3)
    held, intensity = rows.whole(2), rows.whole(1)[0] == 0
    hemispheres = [h for h in (0, 1) if held[h]]
    directions = {}
    for hemisphere in hemispheres:
        angles = rows.listed()
        directions[hemisphere] = [(a, t) for a in angles for t in rows.listed()]
        check_size(len(directions[hemisphere]))
    spectra = {}
    for hemisphere in hemispheres:
        reference = rows.numbers(2)
        rows.row()  # a description
        (n,) = rows.whole(1)
        check_size(n)
        spectrum = np.array([rows.numbers(2) for _ in range(n)])
        spectra[hemisphere] = reference, spectrum[:, 0], spectrum[:, 1] / 100
    nm = spectra[hemispheres[0]][1] if hemispheres else np.zeros(0)
    blocks = []
    for hemisphere in hemispheres:
        reference, own, parts_of_one = spectra[hemisphere]
        # of transmission the spectrum may have other wavelengths
        percentages = np.interp(nm, own, parts_of_one)
        unscaled = [
            _block(rows, float(theta), float(-angle % 360), hemisphere, intensity)
            for angle, theta in directions[hemisphere]
        ]
        # nothing meets a surface at 90 degrees
        unscaled = [block for block in unscaled if block.theta_i < 90]
        require(bool(unscaled), "it has no incidence below 90 degrees")
        # an anisotropy angle of 360 is that of 0 again
        once = {(block.phi_i, block.theta_i): block for block in reversed(unscaled)}
        scale = percentages * _scale(list(once.values()), reference)
        blocks += [_scaled(once[key], scale) for key in sorted(once)]
    channels, blocks = _grey_if_one(_names(nm), blocks)
    header = _header(rows) | {"anisotropy vector": " ".join(map(str, vector))}
    return Scatter(blocks, channels, header, _note(intensity))


def _scale(blocks: Sequence[Block], reference: Floats) -> float:
    """Factor that gives the block of the reference incidence a total of 1.

    Between two incidences the mean of their factors, weighted by the distance.
    """
    azimuths = np.array([block.phi_i for block in blocks])
    turned = np.mod(azimuths + reference[1] + 180, 360) - 180
    nearest = azimuths[np.argmin(np.abs(turned))]
    own = sorted((b.theta_i, total_of(b)[0]) for b in blocks if b.phi_i == nearest)
    angles, totals = np.array(own).T
    require(bool((totals > 0).all()), "it has an incidence without any light")
    return float(np.interp(reference[0], angles, 1 / totals))


def _block(
    rows: _Rows, theta_i: float, phi_i: float, hemisphere: int, intensity: bool
) -> Block:
    """Next table as BSDF values, not scaled."""
    theta, azimuth, values = rows.block()
    polar = 180 - theta[::-1] if hemisphere else theta
    values = values[::-1] if hemisphere else values
    require(
        len(polar) > 0 and polar[0] >= -1e-9 and polar[-1] <= 90 * (1 + 1e-9),
        f"row {rows.number}: polar angles must be within one hemisphere",
    )
    polar = np.clip(polar, 0, 90)
    if intensity:
        cosine = np.cos(np.radians(polar))[:, None]
        level = cosine[:, 0] < 1e-9
        values = values / np.where(level[:, None], 1.0, cosine)
        if level.any() and len(polar) > 1:  # on the horizon it is not known
            values[level] = values[-2]
    return Block(theta_i, phi_i, hemisphere, polar, azimuth, values[..., None])


def _scaled(block: Block, scale: Floats, total: Floats | None = None) -> Block:
    """Block with a factor for each channel."""
    return Block(
        block.theta_i,
        block.phi_i,
        block.hemisphere,
        block.polar,
        block.azimuth,
        block.values * scale,
        total=total,
    )


def _joined(parts: Sequence[Block]) -> Block:
    """One block of several channels, on the grid of the first."""
    first = parts[0]
    polar, azimuth = np.meshgrid(first.polar, first.azimuth, indexing="ij")
    theta, phi = np.radians(polar), np.radians(azimuth + first.phi_i + 180)
    sine = np.sin(theta)
    wo = np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)], axis=-1)
    values = [
        part.values
        if np.array_equal(part.polar, first.polar)
        and np.array_equal(part.azimuth, first.azimuth)
        else part.at(wo)
        for part in parts
    ]
    totals = [part.total for part in parts if part.total is not None]
    return Block(
        first.theta_i,
        first.phi_i,
        first.hemisphere,
        first.polar,
        first.azimuth,
        np.concatenate(values, axis=-1),
        total=np.concatenate(totals) if totals else None,
    )


def _names(wavelengths: Floats) -> tuple[str, ...]:
    """Names of channels."""
    require(len(wavelengths) > 0, "it has neither reflection nor transmission")
    require(
        bool((wavelengths > 0).all()) and bool((np.diff(wavelengths) > 0).all()),
        "its wavelengths must ascend",
    )
    return tuple(f"{nm:.10g}nm" for nm in wavelengths)


def _grey_if_one(
    channels: tuple[str, ...], blocks: list[Block]
) -> tuple[tuple[str, ...], list[Block]]:
    """One channel Y, if all wavelengths have the same values."""
    if any(np.ptp(b.values, axis=-1).max(initial=0) > 0 for b in blocks):
        return channels, blocks
    one = slice(0, 1)
    grey = [
        Block(b.theta_i, b.phi_i, b.hemisphere, b.polar, b.azimuth, b.values[..., one],
              total=None if b.total is None else b.total[one])
        for b in blocks
    ]  # fmt: skip
    return ("Y",), grey


def _header(rows: _Rows) -> dict[str, str]:
    """What the file says of itself."""
    return {"comment": rows.comment} if rows.comment else {}


def _note(intensity: bool) -> tuple[str, ...]:
    """Sentence on what the values were."""
    kind = "intensities, divided by the cosine" if intensity else "a BSDF"
    return (f"the values are {kind}, scaled to the stated percentages",)
