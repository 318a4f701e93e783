"""Records in the files of other tools, each with what it has lost."""

from collections.abc import Callable, Sequence
from functools import partial
from os import PathLike
from pathlib import Path

import numpy as np

from ...annexes import check_there
from ...array_types import Floats
from ...errors import SettingError, abridged, checked_choice, warn
from ...files import check_output, netcdf, replacing
from ...files.measured_table import MeasuredTable
from ...files.writing import takes_a_stream
from ...results.record import (
    Record,
    both_sides,
    checked_records,
    fractions_of,
    wavelengths_nm,
)
from ...results.summary import OVER_THE_EDGE, summarize
from ...results.tally import ELEMENT_NAMES
from ..formats import merl
from ..formats.format import WAVELENGTHS, Format
from ..formats.radiance import Product
from ..formats.radiance_basis import BASES
from ..formats.reading import endings_of, read_measured, written_as
from ..formats.scatter import Scatter, fractions_of_scatter, scatter_of
from .loss import Loss, losses, part_names

# Rays whose flux no patch receives, or by an edge that may be none, and the fraction of
# all rays from which a warning tells of them.
NOWHERE = "; their flux is in no patch of the file"
LOST_FATES = {
    "sideways": f"left sideways{NOWHERE}",
    "astray": "went astray: a shape with a medium is open or overlaps another"
    + NOWHERE,
    "truncated": f"were truncated by max_depth or max_scatterings{NOWHERE}",
    "invalid": f"are invalid, by what the BSDF returned{NOWHERE}",
    "over_the_edge": OVER_THE_EDGE,
}
MAX_LOST = 1e-3

# Of degrees of exit in a .csv, where 29.999999999999996 is 30.
ANGLE_DECIMALS = 10


def export(
    record: Record | Sequence[Record],
    path: str | PathLike[str],
    basis: str = "klems",
    *,
    product: Product | None = None,
    solar: Sequence[Record] = (),
    progress: bool = False,
) -> list[Loss]:
    """Write a record to a file of another tool, and return what was lost.

    What was written is read back, by Mitsuba if it is for its `measured`, and compared.
    A warning tells of a specimen that was missed by a relevant part of the rays, or
    left by them over edges that may be none, of rays whose flux is in no patch, and of
    flux that a file .xml cannot describe: a side, or angles of incidence.

    Parameters
    ----------
    record : Record or sequence of Record
        Several for ``.xml``: of the front and of the back of a specimen, which may be
        one record that holds its back. All other files are of the front.
    path : str or path
        ``.csv``: values at the middles of patches, read by `read_measured`, with the
        seed by which `compare` knows rays of its own, and with the elements of Mueller
        matrices as further columns, which nothing here reads back; for several
        quantities or channels their names are put before the ending. ``.xml``: a
        Radiance BSDF. ``.bsdf``: for Mitsuba's `measured`, reflection only; needs a
        variant of rgb, or a spectral one for channels that are wavelengths. ``.nc``
        and ``.h5``: NetCDF and HDF5, by xarray. ``.zemax.bsdf``: for Zemax. ``.brdf``
        and ``.anisotropicbsdf``: for Speos. ``.json`` or ``.xompt``: OpenMATERIAL.
        ``.binary``: as the MERL database.
    basis : {"klems", "klems-half", "klems-quarter", "tensor3", "tensor4"}
        Of Radiance: a Klems basis, or a tensor tree for isotropic (3) or any (4)
        materials.
    product : Product, optional
        Of ``.xml``: name, manufacturer and sizes that the file states.
    solar : sequence of Record
        Of ``.xml``: records like the others, for all sunlight.
    progress : bool
        Show progress bars on standard error, of what takes long: ``.bsdf``, ``.xml``.

    Returns
    -------
    list of Loss
        One for each incident direction and hemisphere that the format holds.

    Raises
    ------
    ValueError
        For another ending or basis, or a record that the format cannot hold.
    VariantError
        Without a variant that is needed.
    OSError
        If the file cannot be written.
    """
    check_output(path, endings_of("writes", "writes"))
    if takes_a_stream(path):
        raise SettingError(
            f"{path} must be a file, since it is read back, got a pipe or a device"
        )
    checked_choice("basis", basis, BASES)
    records = checked_records(record)
    known, ending = written_as(path)
    if ending == ".xml":
        records, solar = both_sides(records), both_sides(solar)
    elif len(records) > 1 or product is not None or solar:
        raise SettingError(
            "several records, a product and solar light go to a file .xml, got "
            f"{Path(path).name}"
        )
    for one in (*records, *solar):
        _check_held(one, known, ending)
    for one in records:
        _warn_of_lost_light(one)
    if known.write is not None:
        write = _write_parts if known.in_parts else _write_grids
        return write(known, records[0], path)
    if ending in _PLAIN:
        return _PLAIN[ending](records[0], path)
    check_there("materials", f"a file {ending}")
    from .measured_export import write_measured
    from .radiance_export import write_radiance

    if ending == ".xml":
        return write_radiance(records, path, basis, product, solar, progress)
    if ending == ".bsdf":
        return write_measured(records[0], path, progress)
    return _write_merl(records[0], path)


def _check_held(record: Record, known: Format, ending: str) -> None:
    """Raise ValueError for a record that a format cannot hold; warn if for a part."""
    if record.polarised and not known.polarised:
        held = ", ".join(endings_of("polarised", "writes"))
        raise SettingError(
            f"a file {ending} holds no Mueller matrices, which {held} do: measure in "
            f"an unpolarised variant for it, got {record.provenance.variant}"
        )
    is_spectral = wavelengths_nm(record.channels) is not None
    kind = WAVELENGTHS if is_spectral else ", ".join(record.channels)
    if len(record.channels) > 1 and kind not in (known.channels or (kind,)):
        *first, last = "one channel", *known.channels
        raise SettingError(
            f"a {ending} file takes records of {', of '.join(first)} or of {last}, got "
            f"{abridged(', '.join(record.channels), 80)}"
        )
    n = len(set(record.phi_i.tolist()))
    if known.isotropic and n > 1:
        raise SettingError(
            f"{ending} holds one azimuth of incidence, as of isotropic materials, got "
            f"{n}"
        )
    if len(record) < known.n_incidences:
        raise SettingError(
            f"a {ending} file needs at least {known.n_incidences} angles of incidence, "
            f"got {len(record)}"
        )
    if known.reflection_only and record.dht is not None and record.dht.max() > 0:
        warn(
            f"a file {ending} holds reflection only: up to {record.dht.max():.2%} of "
            "the flux was transmitted, and is not in it"
        )


def _warn_of_lost_light(record: Record) -> None:
    """Warn of flux that is in no patch, missed the specimen, or left over its edges."""
    ledger = record.ledger
    for row, words in LOST_FATES.items():
        fraction = getattr(ledger, row) / max(ledger.emitted, 1)
        counts = row != "over_the_edge" or record.provenance.edges == "open"
        if counts and fraction > MAX_LOST:
            warn(f"{fraction:.2%} of the rays {words}")
    directions = summarize(record).directions if ledger.missed else []
    if any(direction.exceeds_error("missed") for direction in directions):
        warn(
            f"{ledger.missed / ledger.emitted:.2%} of the rays missed the specimen, "
            "and the file describes it as if it had neither openings nor edges: "
            "measure one cell of it with a period, or take a smaller footprint"
        )


def _csv(record: Record, path: str | PathLike[str]) -> list[Loss]:
    """One table for each quantity and channel."""
    fractions = np.zeros_like(fractions_of(record))
    known = np.isfinite(record.subdivision.middles[0])
    projected = record.subdivision.projected_solid_angles[known]
    for (hemisphere, number), name in part_names(record, path).items():
        quantity = ("brdf", "btdf")[hemisphere]
        table = _table(record, quantity, number)
        table.save(name, _elements(record, quantity, number))
        written = read_measured(name).value.reshape(len(record), -1)
        fractions[:, hemisphere, known, number] = written * projected
    return losses(record, fractions)


def _table(record: Record, quantity: str, number: int) -> MeasuredTable:
    """Table of one quantity in one channel."""
    middles = (np.degrees(angle) for angle in record.subdivision.middles)
    theta, phi = (np.round(angle, ANGLE_DECIMALS) for angle in middles)
    known = np.isfinite(theta)
    n = int(known.sum())
    if quantity == "btdf":
        theta = 180 - theta
    one_sigma = 0.6827
    values, sigmas = [], []
    for one in record:
        low, high = one.interval(one_sigma, quantity)
        sigma = getattr(one, f"{quantity}_std_err")
        sigma = np.where(np.isnan(sigma), (high - low) / 2, sigma)
        values.append(getattr(one, quantity)[known, number])
        sigmas.append(sigma[known, number])
    sigma = np.concatenate(sigmas)
    exact = record.n_batches < 2 or all(one.binomial for one in record.estimates)
    return MeasuredTable(
        theta_i=np.clip(record.theta_i, 0, None).repeat(n),
        phi_i=record.phi_i.repeat(n),
        theta_o=np.tile(theta[known], len(record)),
        phi_o=np.tile(phi[known], len(record)),
        quantity=quantity,
        channel=record.channels[number] if len(record.channels) > 1 else None,
        degrees_of_freedom=None if exact else record.n_batches - 1,
        aperture_half_angle=record.subdivision.aperture_half_angle,
        emitter_half_angle=record.asked.divergence,
        header={"collector": str(record.subdivision)} | record.ray_keys,
        value=np.concatenate(values),
        sigma=None if np.isnan(sigma).any() else sigma,
    )


def _elements(record: Record, quantity: str, number: int) -> dict[str, Floats]:
    """Columns of a table beside its own: elements of Mueller matrices but the first."""
    if not record.polarised:
        return {}
    known = np.isfinite(record.subdivision.middles[0])
    shape = len(record), *known.shape, len(record.channels), 16
    columns: dict[str, Floats] = {}
    for prefix, ending in (("", ""), ("sigma_", "_std_err")):
        matrices = getattr(record, f"{quantity}_mueller{ending}").reshape(shape)
        of_rows = matrices[:, known, number].reshape(-1, 16)
        names = [f"{prefix}{name}" for name in ELEMENT_NAMES]
        columns |= dict(zip(names, of_rows.T[1:]))
    return columns


def _write_netcdf(
    record: Record, path: str | PathLike[str], engine: str = "scipy"
) -> list[Loss]:
    """Labelled arrays."""
    with replacing(path) as stream:
        netcdf.write(record, stream, engine)
    import xarray

    with xarray.open_dataset(path, engine=engine) as written:
        values = written["bsdf"].to_numpy()
    projected = record.subdivision.projected_solid_angles[..., None]
    return losses(record, values * projected)


_PLAIN: dict[str, Callable[[Record, str | PathLike[str]], list[Loss]]] = {
    ".csv": _csv,
    ".nc": _write_netcdf,
    ".h5": partial(_write_netcdf, engine="h5netcdf"),
}


# --------------------------------------------------------------- scatter data on grids


def _write_parts(
    known: Format, record: Record, path: str | PathLike[str]
) -> list[Loss]:
    """A file for each quantity and channel."""
    scatter = scatter_of(record, known.specular)
    written = np.zeros_like(fractions_of(record))
    for (hemisphere, number), name in part_names(record, path).items():
        blocks = [block.channel(number) for block in scatter.of(hemisphere)]
        part = Scatter(blocks, (record.channels[number],))
        fractions = _written(known, part, record, name)
        written[:, hemisphere, ..., number] = fractions[:, hemisphere, ..., 0]
    return losses(record, written)


def _write_grids(
    known: Format, record: Record, path: str | PathLike[str]
) -> list[Loss]:
    """One file of all."""
    scatter, nm = scatter_of(record, known.specular), wavelengths_nm(record.channels)
    fractions = _written(known, scatter, record, path)
    fractions = fractions[:, : 1 if known.reflection_only else record.n_hemispheres]
    # the file has ascending wavelengths, or one channel for all
    order = [0] if nm is None else np.argsort(np.argsort(nm)).tolist()
    shape = (*fractions.shape[:-1], len(order))
    return losses(record, np.broadcast_to(fractions, shape)[..., order])


def _written(
    known: Format, scatter: Scatter, record: Record, path: str | PathLike[str]
) -> Floats:
    """Flux fractions of a record in the file that a format writes of its grids."""
    with replacing(path) as stream:
        known.write(scatter, stream, abridged(record.provenance.name, 200))  # type: ignore[misc]
    with open(path, "rb") as stream:
        return fractions_of_scatter(known.scatter(stream), record)  # type: ignore[misc]


def _write_merl(record: Record, path: str | PathLike[str]) -> list[Loss]:
    """The reflection of an isotropic record in the format of the MERL database.

    Between its angles of incidence it is interpolated as the BSDF `goniometric` does.
    """
    from ...materials.resampling import Material

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
    fractions = fractions_of_scatter(again, record)
    return losses(record, fractions[..., : len(record.channels)])
