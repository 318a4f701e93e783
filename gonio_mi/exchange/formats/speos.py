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

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, BinaryIO

import numpy as np

from ...array_types import Floats
from ...files.checks import require
from ...files.numbers import decimal, is_decimal
from ...results.record import wavelengths_nm
from .format import WAVELENGTHS, Format, Lines, check_size
from .scatter import Block, Scatter, total_of

ANISOTROPIC, SPECTRAL = "OPTIS - Anisotropic BSDF surface file", "OPTIS - brdf surface"

# Wavelengths in nm between which a file holds for one channel.
VISIBLE = (360.0, 830.0)

# The first version whose rows are these.
FIRST_VERSION = 8.0

BINARY = "it is binary: save it as text with Speos's BSDF viewer"


def read(stream: BinaryIO) -> Scatter:
    """Read a file of either kind.

    Raises
    ------
    FileFormatError
        If it is something else, binary, damaged, or announces more than it holds.
    """
    rows = Lines(stream, not_text=BINARY)
    head = rows.row().strip()
    require(head.startswith("OPTIS"), "it is not a Speos file")
    kind, _, version = head.rpartition(" v")
    require(kind.startswith((ANISOTROPIC, SPECTRAL)), f"it is a {head:.60}")
    known = is_decimal(version) and decimal(version) >= FIRST_VERSION
    reason = f"it has the version {version:.10}: save it anew with Speos's BSDF viewer"
    require(known, reason)
    require(rows.row().strip()[:1] == "0", BINARY)
    comment = rows.row().strip()
    rows.skip(rows.whole(1)[0])
    rows.row()
    reader = _read_anisotropic if head.startswith(ANISOTROPIC) else _read_spectral
    return reader(rows, {"comment": comment} if comment else {})


def _read_spectral(rows: Lines, header: dict[str, str]) -> Scatter:
    """Blocks of a ``.brdf``: hemisphere, incidence, wavelength."""
    held, (kind,) = rows.whole(2), rows.whole(1)
    n_incidences, n_wavelengths = rows.whole(2)
    check_size(n_incidences, n_wavelengths)
    incidences, wavelengths = rows.numbers(n_incidences), rows.numbers(n_wavelengths)
    blocks = []
    for hemisphere in (h for h in (0, 1) if held[h]):
        for theta_i in incidences.tolist():
            parts = []
            for _ in range(n_wavelengths):
                (percent,) = rows.numbers(1)
                part = _block(rows, kind, (theta_i, 0.0), hemisphere)
                total = total_of(part)[0]
                scale = percent / 100 / total if total > 0 else 0.0
                stated = np.array([percent / 100])
                parts.append(replace(part, values=part.values * scale, total=stated))
            blocks.append(_joined(parts))
    return _scatter(wavelengths, blocks, header, kind)


def _read_anisotropic(rows: Lines, header: dict[str, str]) -> Scatter:
    """Blocks of an ``.anisotropicbsdf``: hemisphere, anisotropy, incidence."""
    vector = rows.numbers(3)
    held, (kind,) = rows.whole(2), rows.whole(1)
    hemispheres = [h for h in (0, 1) if held[h]]
    directions = {}
    for hemisphere in hemispheres:
        angles = rows.counted_numbers()
        pairs = [(a, t) for a in angles for t in rows.counted_numbers()]
        check_size(len(pairs))
        directions[hemisphere] = pairs
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
        incidences = [(float(t), _anisotropy(a)) for a, t in directions[hemisphere]]
        unscaled = [_block(rows, kind, one, hemisphere) for one in incidences]
        # nothing meets a surface at 90 degrees
        unscaled = [block for block in unscaled if block.theta_i < 90]
        require(bool(unscaled), "it has no incidence below 90 degrees")
        # an anisotropy angle of 360 is that of 0 again
        once = {(block.phi_i, block.theta_i): block for block in reversed(unscaled)}
        scale = percentages * _scale(list(once.values()), reference)
        for key in sorted(once):
            blocks.append(replace(once[key], values=once[key].values * scale))
    header = header | {"anisotropy vector": " ".join(map(str, vector))}
    return _scatter(nm, blocks, header, kind)


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


def _turned(polar: Floats, values: Floats, hemisphere: int) -> tuple[Floats, Floats]:
    """Rows, of transmission by angles from the other normal, and back."""
    return (180 - polar[::-1], values[::-1]) if hemisphere else (polar, values)


def _anisotropy(azimuth: float) -> float:
    """Anisotropy angle of an azimuth of incidence, and back."""
    return float(-azimuth % 360)


def _block(
    rows: Lines, kind: int, incident: tuple[float, float], hemisphere: int
) -> Block:
    """Next table, not scaled; of kind 0, intensities, divided by the cosine."""
    n_polar, n_azimuth = rows.whole(2)
    check_size(n_polar, n_azimuth)
    azimuth = rows.numbers(n_azimuth)
    table = np.array([rows.numbers(n_azimuth + 1) for _ in range(n_polar)])
    theta, values = table[:, 0], table[:, 1:]
    polar, values = _turned(theta, values, hemisphere)
    require(
        len(polar) > 0 and polar[0] >= -1e-9 and polar[-1] <= 90 * (1 + 1e-9),
        f"line {rows.number}: polar angles must be within one hemisphere",
    )
    polar = np.clip(polar, 0, 90)
    if kind == 0:
        cosine = np.cos(np.radians(polar))
        level = cosine < 1e-9
        values = values / np.where(level, 1.0, cosine)[:, None]
        if level.any() and len(cosine) > 1:  # on the horizon it is not known
            values[level] = values[-2]
    return Block(*incident, hemisphere, polar, azimuth, values[..., None])


def _joined(parts: Sequence[Block]) -> Block:
    """One block of several channels, on the grid of the first."""
    first = parts[0]
    wo = first.directions()
    values = []
    for part in parts:
        alike = np.array_equal(part.polar, first.polar)
        alike = alike and np.array_equal(part.azimuth, first.azimuth)
        values.append(part.values if alike else part.at(wo))
    totals: list[Any] = [part.total for part in parts]
    whole = np.concatenate(values, axis=-1)
    return replace(first, values=whole, total=np.concatenate(totals))


def _scatter(
    wavelengths: Floats, blocks: list[Block], header: dict[str, str], kind: int
) -> Scatter:
    """Blocks of a file; of one channel Y, if all wavelengths have the same values."""
    require(len(wavelengths) > 0, "it has neither reflection nor transmission")
    ascend = bool((np.diff(wavelengths, prepend=0) > 0).all())
    require(ascend, "its wavelengths must ascend")
    channels = tuple(f"{nm:.10g}nm" for nm in wavelengths)
    if all(np.ptp(block.values, axis=-1).max(initial=0) == 0 for block in blocks):
        channels, blocks = ("Y",), [block.channel(0) for block in blocks]
    values = "intensities, divided by the cosine" if kind == 0 else "a BSDF"
    note = f"the values are {values}, scaled to the stated percentages"
    return Scatter(blocks, channels, header, (note,))


# ----------------------------------------------------------------------------- writing


def write_spectral(scatter: Scatter, stream: BinaryIO, comment: str) -> None:
    """Write a ``.brdf``: isotropic, a distribution for each wavelength."""
    incidences = sorted({block.theta_i for block in scatter.blocks})
    held = [bool(scatter.of(hemisphere)) for hemisphere in (0, 1)]
    wavelengths, numbers = _wavelengths(scatter)
    lines = [*_beginning(f"{SPECTRAL} file v9.0", comment), _row(map(int, held)), "1"]
    lines += [_row([len(incidences), len(wavelengths)])]
    lines += [_row(incidences), _row(wavelengths)]
    for hemisphere in (0, 1):
        for block in sorted(scatter.of(hemisphere), key=lambda b: b.theta_i):
            totals = total_of(block)
            for number in numbers:
                lines.append(f"{100 * totals[number]:.9g}")
                lines += _table(block, block.values[..., number])
    stream.write(("\n".join(lines) + "\n").encode("ascii", "replace"))


def write_anisotropic(scatter: Scatter, stream: BinaryIO, comment: str) -> None:
    """Write an ``.anisotropicbsdf``: one distribution, and a spectrum for its scale."""
    wavelengths, numbers = _wavelengths(scatter)
    hemispheres = [h for h in (0, 1) if scatter.of(h)]
    lines = [*_beginning(f"{ANISOTROPIC} v8.0", comment), _row([1, 0, 0])]
    lines += [_row(int(h in hemispheres) for h in (0, 1)), "1"]
    spectra, tables = [], []
    for hemisphere in hemispheres:
        blocks = scatter.of(hemisphere)
        by_angle: dict[float, list[Block]] = {}
        for block in blocks:
            by_angle.setdefault(_anisotropy(block.phi_i), []).append(block)
        lines += [str(len(by_angle)), _row(sorted(by_angle))]
        for angle in sorted(by_angle):
            by_angle[angle].sort(key=lambda block: block.theta_i)
            lines += [str(len(by_angle[angle]))]
            lines += [_row(block.theta_i for block in by_angle[angle])]
            for block in by_angle[angle]:
                tables += _table(block, block.values.mean(axis=-1))
        angle = min(by_angle)
        reference = by_angle[angle][0]
        totals = total_of(reference)
        spectra += [_row([reference.theta_i, angle]), "by gonio-mi"]
        spectra += [str(len(wavelengths))]
        spectra += [_row([nm, 100 * totals[k]]) for nm, k in zip(wavelengths, numbers)]
    text = "\n".join([*lines, *spectra, *tables, "End of file"]) + "\n"
    stream.write(text.encode("ascii", "replace"))


def _wavelengths(scatter: Scatter) -> tuple[list[float], list[int]]:
    """Wavelengths in nm, ascending, and the channel of each."""
    nm = wavelengths_nm(scatter.channels)
    if nm is None or len(nm) == 1:
        return list(VISIBLE), [0, 0]
    order = np.argsort(nm)
    return nm[order].tolist(), order.tolist()


def _beginning(head: str, comment: str) -> list[str]:
    """First rows of both kinds."""
    return [head, "0", " ".join(comment.split()), "0", ""]


def _table(block: Block, values: Floats) -> list[str]:
    """Rows of one table."""
    polar, values = _turned(block.polar, values, block.hemisphere)
    lines = [_row([len(polar), len(block.azimuth)]), "\t" + _row(block.azimuth)]
    return [*lines, *(_row([angle, *row]) for angle, row in zip(polar, values))]


def _row(numbers: Iterable[float]) -> str:
    """Numbers of a row, six digits, or whole."""
    return "\t".join(f"{number:.6g}" for number in numbers)


BEGINS = re.compile(r"OPTIS - ")
FORMATS = (
    Format(
        "Ansys Speos",
        (".brdf",),
        begins=BEGINS,
        scatter=read,
        writes=(".brdf",),
        write=write_spectral,
        channels=(WAVELENGTHS,),
        isotropic=True,
        n_incidences=2,
        loses="azimuth of incidence",
    ),
    Format(
        "Ansys Speos",
        (".anisotropicbsdf",),
        begins=BEGINS,
        scatter=read,
        writes=(".anisotropicbsdf",),
        write=write_anisotropic,
        channels=(WAVELENGTHS,),
        loses="lobes of each wavelength (one shape for all)",
    ),
    Format(
        "Ansys Speos",
        (".bsdf180",),
        refused="it is a .bsdf180 of Speos, which names two other files, one for each "
        "face: give those, .anisotropicbsdf or .brdf",
    ),
    Format(
        "Ansys Speos",
        (".scattering", ".simplescattering"),
        refused="it is a surface of Speos that holds parameters of a model, and no "
        "table of a BSDF",
    ),
)
