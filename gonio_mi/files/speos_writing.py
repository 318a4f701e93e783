"""Writers of the text files of Ansys Speos; see :mod:`gonio_mi.files.speos`."""

from collections.abc import Iterable
from typing import BinaryIO

import numpy as np

from ..array_types import Floats
from .channels import wavelengths_nm
from .scatter import Block, Scatter, total_of
from .speos import ANISOTROPIC, SPECTRAL

__all__ = ["write_anisotropic", "write_spectral"]

# Wavelengths in nm between which a file holds for one channel.
VISIBLE = (360.0, 830.0)


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
            by_angle.setdefault(-block.phi_i % 360, []).append(block)
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
    polar = 180 - block.polar[::-1] if block.hemisphere else block.polar
    values = values[::-1] if block.hemisphere else values
    lines = [_row([len(polar), len(block.azimuth)]), "\t" + _row(block.azimuth)]
    return [*lines, *(_row([angle, *row]) for angle, row in zip(polar, values))]


def _row(numbers: Iterable[float]) -> str:
    """Numbers of a row, six digits, or whole."""
    return "\t".join(f"{number:.6g}" for number in numbers)
