"""Records as Radiance's BSDF files, and those files at the record's directions."""

from collections.abc import Sequence
from os import PathLike
from typing import Any

import numpy as np

from ...array_types import Floats
from ...collector.directions import angles
from ...collector.hemisphere import Subdivision
from ...collector.klems import KLEMS
from ...collector.shirley_chiu import ShirleyChiu
from ...errors import SettingError, abridged, warn
from ...files import replacing
from ...materials.resampling import Material, resampled, specular_peaks
from ...results.record import Record, both_sides, fractions_of
from ..formats import radiance, radiance_material
from ..formats.radiance import OTHER, Product, RadianceBSDF
from ..formats.radiance_basis import RANKS, TO_X, Basis
from .daylight import VISIBLE, lit_by, of_daylight
from .loss import Loss, losses

# Cells per axis of tensor trees; those of rank 3 are cheap enough to be finer.
TREE_SIZES = {3: 64, 4: 32}

# Points per side of a Klems patch of incidence and of exit that is averaged over, and
# of the cells of tensor trees, of which there are more.
POINTS_IN, POINTS_OUT = 3, 8
CELL_POINTS = 2

# Fraction of the flux that may be elsewhere if source and view are exchanged; that of
# reciprocal specimens of all kinds reaches 0.015, by the patches of their files.
# Means of pairs of patches are over this many points per side.
MAX_EXCHANGED, POINTS_OF_PAIRS = 0.03, 3

# Where the losses of :func:`write_radiance` and of :func:`read_back` are; of these at
# how many directions at most, and points of all patches of the record at least.
IN_FILE = "in the file's patches"
READ_BACK = "in the record's patches, as goniometric reads it"
MAX_READ_BACK, READ_BACK_POINTS = 16, 2**16

# Incident directions that are less apart have no lobes between them, in degrees.
MAX_GAP = 45


def write_radiance(
    records: Sequence[Record],
    path: str | PathLike[str],
    basis: str,
    product: Product | None,
    solar: Sequence[Record],
    progress: bool,
) -> list[Loss]:
    """Write a specimen to an XML file of Radiance, and return its losses.

    Parameters
    ----------
    records : sequence of Record
        Of one channel, of R, G, B, or of wavelengths, which are weighted as daylight
        is; one for each lit face.
    path : str or path
    basis : {"klems", "klems-half", "klems-quarter", "tensor3", "tensor4"}
        A Klems basis, or a tensor tree for isotropic (3) or any (4) materials.
    product : Product, optional
        What else the file says of the specimen.
    solar : sequence of Record
        The same of one channel or of wavelengths, for all sunlight instead of what is
        visible. Default: of `records` of wavelengths that stand for it.
    progress : bool

    Raises
    ------
    ValueError
        For another basis or other channels, for two records of one side or of unlike
        specimens, for `tensor3` if the record has several azimuths of incidence or
        colours, or if its incident directions are no grid.
    """
    _check_sides(records)
    _check_sides(solar)
    records, solar = of_daylight(records, solar)
    blocks: dict[tuple[str, str], Any] = {}
    sides = [Side(record, basis, progress) for record in records]
    if len(records) == 1:
        lit, other = records[0].asked.side, OTHER[records[0].asked.side]
        warn(
            f"the file describes light from the {lit} only, and the {other} reflects "
            f"nothing in it: measure with the side {other} too, and export both "
            "records to one file"
        )
    # a side that is black, or grey, has one channel
    colours = max(len(record.channels) for record in records)
    for side in sides:
        blocks |= side.blocks(colours)
    for record in solar:
        only = Side(record, basis, progress).blocks()
        blocks |= {("Solar", key): only["Visible", key] for _, key in only}
    product = product or Product(" ".join(records[0].provenance.name.split()))
    with replacing(path) as stream:
        radiance.write(blocks, stream, product)
    with open(path, "rb") as stream:
        written = RadianceBSDF(stream)
    every = [side.losses(written) for side in sides]
    for side, losses_of_side in zip(sides, every):
        noise = max(loss.noise for loss in losses_of_side)
        side.warn_if_exchanged(written, noise)
    return [loss for losses_of_side in every for loss in losses_of_side]


def read_back(records: Sequence[Record], path: str | PathLike[str]) -> list[Loss]:
    """Losses of a file as `goniometric` reads it, at some of the records' directions.

    Unlike those of :func:`write_radiance`, which wrote the file, in the patches of the
    record, over which the material is averaged: where these are finer, a narrow lobe is
    lost that fills one patch of the file, and an even one is not.
    """
    every = []
    for whole in both_sides(records):
        chosen = np.unique(np.linspace(0, len(whole) - 1, MAX_READ_BACK).astype(int))
        record = lit_by(VISIBLE, Record.stack([whole[int(n)] for n in chosen]))
        with open(path, "rb") as stream:
            material = Material(radiance_material.material(stream, record.asked.side))
        patches = record.subdivision
        n_points = int(np.ceil(np.sqrt(READ_BACK_POINTS / patches.n_patches)))
        n_points = min(max(n_points, CELL_POINTS), POINTS_OUT)
        where = record.theta_i[:, None], record.phi_i[:, None], patches, n_points
        hemispheres = range(record.n_hemispheres)
        theirs: Any = [resampled(material, h, *where) for h in hemispheres]
        theirs = np.stack(theirs, axis=1)
        if len(record.channels) == 1:
            theirs = np.mean(theirs, axis=-1, keepdims=True)
        every += losses(record, theirs.reshape(fractions_of(record).shape))
    return every


def _check_sides(records: Sequence[Record]) -> None:
    """Raise ValueError unless the records are of different sides of one specimen."""
    sides = [record.asked.side for record in records]
    if len(set(sides)) < len(sides):
        raise SettingError(
            "a file takes one record of each side, front and back, got "
            f"{' and '.join(sides)}"
        )
    digests = {record.provenance.digest for record in records}
    if len(digests) > 1:
        raise SettingError(
            "the records of a file must be of one specimen, got "
            + " and ".join(abridged(r.provenance.name, 60) for r in records)
        )


class Side:
    """What a record of one lit face becomes in a file."""

    def __init__(self, record: Record, basis: str, progress: bool = False) -> None:
        self.record, self.progress = record, progress
        own, cells = record.subdivision, TREE_SIZES.get(RANKS.get(basis, 0), 0)
        cells = own.size if isinstance(own, ShirleyChiu) else cells
        self.basis = Basis.named(basis, cells)
        self.face = record.asked.side
        self.hemispheres = range(record.n_hemispheres)
        self.measured = _is_measured(record, basis, self.basis)
        if not self.measured:
            _check_resampled(record, self.basis.rank)
            self.material = Material(record, specular_peaks(record))

    def blocks(self, colours: int = 1) -> dict[tuple[str, str], Any]:
        """Matrices or trees by wavelength and direction, of so many channels."""
        blocks: dict[tuple[str, str], Any] = {}
        projected = self.basis.patches.projected_solid_angles.reshape(-1, 1)
        for hemisphere in self.hemispheres:
            name = radiance.DIRECTIONS[self.face, hemisphere]
            values = self._flux(hemisphere) / projected
            values = np.repeat(values, colours // values.shape[-1] or 1, axis=-1)
            blocks |= self.basis.blocks(values, name)
        return blocks

    def _flux(self, hemisphere: int) -> Floats:
        """Flux fractions of the file's patches, incident times exit times channels."""
        record = self.record
        if self.measured:  # in the order of the file
            patches = self.basis.incident_patch(record.theta_i, record.phi_i)
            flux = fractions_of(record)[np.argsort(patches), hemisphere]
            return flux.reshape(len(flux), -1, flux.shape[-1])
        n_in, n_out = CELL_POINTS, CELL_POINTS
        if self.basis.rank is None:
            n_in, n_out = POINTS_IN, POINTS_OUT
        where = *self.basis.incident_points(n_in), self.basis.patches, n_out
        return resampled(self.material, hemisphere, *where, progress=self.progress)

    def warn_if_exchanged(self, written: RadianceBSDF, noise: float) -> None:
        """Warn of reflection that Radiance renders with source and view exchanged.

        `noise` is the fraction of flux that the record's standard errors misplace.
        """
        patches = KLEMS["klems-quarter"]
        elsewhere, shown, true = exchanged(written, self.face, patches)
        # noise of both of a pair, which grows as the root of the number of patches
        n_patches = self.record.subdivision.n_patches
        chance = 2 * noise * np.sqrt(patches.n_patches / n_patches)
        if elsewhere <= MAX_EXCHANGED + chance:
            return
        worst = int(np.argmax(np.abs(shown - true)))
        theta, phi = (np.degrees(angle[worst, 0]) for angle in patches.middles)
        warn(
            f"the {self.face} is not reciprocal: Radiance takes the view for incident "
            f"light, and so shows {elsewhere:.0%} of the reflected flux in other "
            f"directions; in a uniform sky {shown[worst]:.3f} for {true[worst]:.3f} as "
            f"seen from theta {theta:.3g}, phi {phi:.3g}"
        )

    def losses(self, written: RadianceBSDF) -> list[Loss]:
        """What the file has lost at the record's own incident directions."""
        record, patches = self.record, self.basis.patches
        theta, phi = record.theta_i, record.phi_i
        if self.basis.rank == 3:
            phi = np.full_like(phi, TO_X)
        middles = patches.points(1)[:, 0]
        projected = patches.projected_solid_angles.reshape(-1, 1)
        theirs: Any = [
            [
                written.values(self.face, hemisphere, one_theta, one_phi, middles)
                * projected
                for hemisphere in self.hemispheres
            ]
            for one_theta, one_phi in zip(theta, phi)
        ]
        if len(record.channels) == 1:
            theirs = np.mean(theirs, axis=-1, keepdims=True)
        if self.measured:
            return losses(record, np.reshape(theirs, fractions_of(record).shape))
        where = theta[:, None], phi[:, None], patches, POINTS_OUT
        ours = [resampled(self.material, h, *where) for h in self.hemispheres]
        return losses(record, np.array(theirs), np.stack(ours, axis=1))


def exchanged(
    written: RadianceBSDF, side: str, patches: Subdivision
) -> tuple[float, Floats, Floats]:
    """How reflection changes if source and view are exchanged.

    Returns
    -------
    elsewhere : float
        Fraction of the flux of all pairs of patches, in [0, 1]; 0 if it is reciprocal.
    shown, true : ndarray, shape (n_patches,)
        Radiance of a uniform sky of 1 as Radiance shows it from each patch, which is
        the reflectance of light from there, and as it is.
    """
    points = patches.points(POINTS_OF_PAIRS)
    n, each, _ = points.shape
    incident = np.degrees(angles(points.reshape(-1, 3)))
    theta, phi = np.repeat(incident, n * each, axis=1)
    wo = np.tile(points.reshape(-1, 3), (n * each, 1))
    values = written.values(side, 0, theta, phi, wo).mean(axis=-1)
    means = values.reshape(n, each, n, each).mean(axis=(1, 3))
    solid = patches.projected_solid_angles.ravel()
    light = means * solid[:, None] * solid
    total = light.sum()
    elsewhere = np.abs(light - light.T).sum() / 2 / total if total else 0.0
    return float(elsewhere), means @ solid, solid @ means


def _is_measured(record: Record, name: str, basis: Basis) -> bool:
    """Whether a record was measured in the patches of the file, on both ends.

    Raises
    ------
    ValueError
        If it was on one end only, or not in all of them.
    """
    filled = record.asked.incident
    if filled is None:
        return False
    if filled != basis.incident or record.subdivision != basis.patches:
        raise SettingError(
            f"a record whose light fills patches of incidence goes to a file of the "
            f"same patches, got the incident {filled!s:.40}, the collector "
            f"{record.subdivision!s:.40} and the basis {name}: take the same for all"
        )
    n = len(basis.incident_points(1)[0])
    n_held = len(np.unique(basis.incident_patch(record.theta_i, record.phi_i)))
    if not n_held == len(record) == n:
        raise SettingError(
            f"the record must hold each of the {n} incident patches of {name} once, "
            f"got {n_held} of them in {len(record)} directions: measure with "
            f"incident {basis.incident!s:.40} and without theta_i"
        )
    return True


def _check_resampled(record: Record, rank: int | None) -> None:
    """Raise ValueError for a tree that cannot hold the record; warn of few angles."""
    azimuths = len(np.unique(np.round(record.phi_i, 3)))
    if rank == 3 and azimuths > 1:
        raise SettingError(
            "the basis tensor3 is for isotropic materials, and the record has "
            f"{azimuths} azimuths of incidence: take tensor4"
        )
    # it drops their chromaticity with their diffuse light (seen in version 6.0a)
    if rank == 3 and len(record.channels) > 1:
        raise SettingError(
            "Radiance loses the colours of tensor trees of rank 3: take tensor4"
        )
    angles = np.unique(np.round(record.theta_i, 3))
    edges = np.diff([0.0, *angles, 90.0])
    if edges.max() > MAX_GAP:
        known = ", ".join(f"{angle:g}" for angle in angles[:6])
        warn(
            f"the record has light from theta_i {known} only: what the file says "
            f"between and beyond, up to {edges.max():g} degrees away, is made of these"
        )
