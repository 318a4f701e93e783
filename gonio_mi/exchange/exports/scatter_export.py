"""Records in the scatter files of other programs: Zemax, Speos, OpenMATERIAL, MERL."""

from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from ...array_types import Floats
from ...collector.directions import direction
from ...errors import SettingError, abridged
from ...files import replacing
from ...materials.resampling import Material
from ...results.record import Record, fractions_of, wavelengths_nm
from ..formats import merl, zemax
from ..formats.reading import format_named, read_scatter
from ..formats.scatter import Block, Scatter, scatter_means, total_of
from .loss import Loss, check_channels, losses, part_names

# Polar angles and azimuths about the specular direction, where lobes are narrow.
RADIAL, AROUND = merl.RADIAL, np.arange(0.0, 361.0, 10.0)

# Points per side of what a value of a grid stands for.
POINTS = 3

# A direction below the horizon stands for the one at this angle above, in degrees.
MIN_ELEVATION = 0.1


def write_zemax(record: Record, path: str | PathLike[str]) -> list[Loss]:
    """Write a record for Zemax, a file for each quantity and channel.

    Their names are put before the ending ``.zemax.bsdf`` if there are several.
    """
    scatter = _scatter(record, specular=True)
    written = np.zeros_like(fractions_of(record))
    for (hemisphere, number), name in part_names(record, path).items():
        blocks = [block.channel(number) for block in scatter.of(hemisphere)]
        comment = f"gonio-mi: {_specimen(record)}, {record.channels[number]}"
        with replacing(name) as stream:
            zemax.write(Scatter(blocks, ("Y",)), stream, comment)
        fractions = _in_order(record, read_scatter(name))
        written[:, hemisphere, ..., number] = fractions[:, hemisphere, ..., 0]
    return losses(record, written)


def write_grids(record: Record, path: str | PathLike[str]) -> list[Loss]:
    """Write blocks about the normal as the format of the name does, and compare.

    Raises
    ------
    ValueError
        If the format cannot hold the record.
    """
    ending = Path(path).suffix.lower()
    known = format_named(ending)
    nm = wavelengths_nm(record.channels)
    check_channels(record, f"a {ending} file", coloured=False)
    if known.isotropic:
        _check_isotropic(record, ending)
    if len(record) < known.n_incidences:
        raise SettingError(
            f"a {ending} file needs at least {known.n_incidences} angles of incidence, "
            f"got {len(record)}"
        )
    scatter = _scatter(record, specular=known.specular)
    with replacing(path) as stream:
        known.write(scatter, stream, _specimen(record))  # type: ignore[misc]
    fractions = _in_order(record, read_scatter(path))
    fractions = fractions[:, : 1 if known.reflection_only else record.n_hemispheres]
    # the file has ascending wavelengths, or one channel for all
    order = [0] if nm is None else np.argsort(np.argsort(nm)).tolist()
    shape = (*fractions.shape[:-1], len(order))
    return losses(record, np.broadcast_to(fractions, shape)[..., order])


def write_merl(record: Record, path: str | PathLike[str]) -> list[Loss]:
    """Write the reflection of an isotropic record in the format of the MERL database.

    Between its angles of incidence it is interpolated as the BSDF `goniometric` does.
    """
    _check_isotropic(record, ".binary")
    check_channels(record, "a .binary file", spectral=False)
    material = Material(record)
    turn = np.radians(record.phi_i[0])
    cosine, sine = np.cos(turn), np.sin(turn)
    rotation = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])

    def value(theta_i: Floats, wo: Floats) -> Floats:
        values = material.values(theta_i, record.phi_i[0], wo @ rotation)
        return np.broadcast_to(values, (len(values), 3))

    with replacing(path) as stream:
        merl.write(value, stream)
    with open(path, "rb") as stream:
        again = merl.read(stream, tuple(record.theta_i.tolist()))
    return losses(record, _in_order(record, again)[..., : len(record.channels)])


def _in_order(record: Record, scatter: Scatter) -> Floats:
    """Flux fractions in the patches and for the incident directions of a record."""
    if len(set(record.phi_i.tolist())) == 1:  # which no file of one azimuth tells
        phi_i = float(record.phi_i[0])
        turned = [replace(block, phi_i=phi_i) for block in scatter.blocks]
        scatter = Scatter(turned, scatter.channels)
    means = scatter_means(scatter, record.subdivision)
    wanted = direction(np.radians(record.theta_i), np.radians(record.phi_i))
    held = direction(np.radians(means.theta_i), np.radians(means.phi_i))
    nearest = np.argmax(wanted @ held.T, axis=1)
    # at normal incidence azimuths are told apart by nothing but themselves
    turn = np.mod(means.phi_i[None] - record.phi_i[:, None] + 180, 360) - 180
    normal = np.abs(record.theta_i) < MIN_ELEVATION
    distance = np.where(means.theta_i[None] < MIN_ELEVATION, np.abs(turn), np.inf)
    return means.flux_fraction[np.where(normal, distance.argmin(axis=1), nearest)]


def _scatter(record: Record, specular: bool) -> Scatter:
    """Means of a record around the points of grids, with the light of its maps."""
    if record.subdivision.axes is not None:
        raise SettingError(
            "a collector of apertures measures some directions only: the file needs "
            "a whole hemisphere, or write a .csv"
        )
    blocks = []
    fractions = fractions_of(record)
    projected = record.subdivision.projected_solid_angles[..., None]
    n_patches = record.subdivision.n_patches
    for index, hemisphere in np.ndindex(fractions.shape[:2]):
        fraction = fractions[index, hemisphere]
        polar, azimuth = (RADIAL, AROUND) if specular else _grid(record)
        empty = np.zeros((len(polar), len(azimuth), 1))
        theta_i = float(np.clip(record.theta_i[index], 0, None))
        phi_i = float(record.phi_i[index]) % 360
        frame = Block(theta_i, phi_i, hemisphere, polar, azimuth, empty, specular)
        # a sum that is negative by chance is no light
        means = (np.maximum(fraction, 0) / projected).reshape(n_patches, -1)
        block = replace(frame, values=_around_nodes(record, frame, means))
        total, wanted = total_of(block), np.maximum(fraction.sum(axis=(0, 1)), 0)
        factor = np.where(total > 0, wanted / np.where(total > 0, total, 1), 1.0)
        blocks.append(replace(block, values=block.values * factor, total=wanted))
    return Scatter(blocks, record.channels)


def _grid(record: Record) -> tuple[Floats, Floats]:
    """Polar angles and azimuths about the normal, some for each patch."""
    n_theta, n_phi = record.subdivision.shape
    step = 90 / np.clip(3 * n_theta, 18, 90).astype(int)
    turn = 360 / np.clip(4 * n_phi, 36, 180).astype(int)
    return np.arange(0, 90 + step / 2, step), np.arange(0, 360 + turn / 2, turn)


def _around_nodes(record: Record, frame: Block, means: Floats) -> Floats:
    """Means of patch means around the points of a grid, ``(n, m, channels)``."""
    low, high = _cells(frame.polar), _cells(frame.azimuth, periodic=True)
    steps = (np.arange(POINTS) + 0.5) / POINTS
    sums = np.zeros((len(frame.polar), len(frame.azimuth), means.shape[-1]))
    for along, around in np.ndindex(POINTS, POINTS):
        polar = low[0] + (low[1] - low[0]) * steps[along]
        azimuth = high[0] + (high[1] - high[0]) * steps[around]
        wo = frame.directions(polar, azimuth)
        wo[..., 2] = np.maximum(wo[..., 2], np.sin(np.radians(MIN_ELEVATION)))
        wo /= np.linalg.norm(wo, axis=-1, keepdims=True)
        sums += means[record.subdivision.patch(wo)]
    return sums / POINTS**2


def _cells(angles: Floats, periodic: bool = False) -> tuple[Floats, Floats]:
    """Where what an angle stands for begins and ends: half-way to its neighbours."""
    middles = (angles[1:] + angles[:-1]) / 2
    low, high = angles[0], angles[-1]
    if periodic:
        low, high = low - (angles[1] - low) / 2, high + (high - angles[-2]) / 2
    return np.append(low, middles), np.append(middles, high)


def _specimen(record: Record) -> str:
    """Name of the specimen, short."""
    return abridged(record.provenance.name, 200)


def _check_isotropic(record: Record, what: str) -> None:
    """Raise ValueError for several azimuths of incidence."""
    n = len(set(record.phi_i.tolist()))
    if n > 1:
        raise SettingError(
            f"{what} holds one azimuth of incidence, as of isotropic materials, got {n}"
        )
