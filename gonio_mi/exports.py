"""Records in the files of other tools, each with what it has lost."""

from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi
import numpy as np

from . import netcdf, radiance_xml, tensor_file
from .errors import VariantError
from .files import check_output, replacing
from .goniophotometer import measure
from .klems import Klems
from .measured import MeasuredTable, read_measured
from .resampling import Material, half_vector_grid, klems_matrix, patch_points

__all__ = ["ENDINGS", "Loss", "export"]

# CIE XYZ of linear sRGB (IEC 61966-2-1).
XYZ = np.array(
    [
        [0.412453, 0.357580, 0.180423],
        [0.212671, 0.715160, 0.072169],
        [0.019334, 0.119193, 0.950227],
    ]
)

# Vertices per side of the grid of half vectors in files for `measured`.
GRID = 128

# With which what was written for Mitsuba is measured again.
RAYS = 2**20

POINTS = 8


@dataclass(frozen=True)
class Loss:
    """What a file says of one incident direction and hemisphere of a record.

    Attributes
    ----------
    theta_i, phi_i : float
        In degrees.
    quantity : {"dhr", "dht"}
    recorded, std_err, written : float
        Reflectance or transmittance (mean of the channels) of the record, its standard
        error, and that of the file.
    misplaced : float
        Part of the light that is in another patch than in the record.
    noise : float
        Part that the record's own standard errors would misplace on average.
    """

    theta_i: float
    phi_i: float
    quantity: str
    recorded: float
    std_err: float
    written: float
    misplaced: float
    noise: float

    def __str__(self):
        return (
            f"theta_i {self.theta_i:.4g}, phi_i {self.phi_i:.4g}: {self.quantity} "
            f"{self.recorded:.5f} +- {self.std_err:.1g}, in the file "
            f"{self.written:.5f}; {self.misplaced:.2%} of the light is in other "
            f"patches (the record's own noise: {self.noise:.2%})"
        )


def export(record, path):
    """Write a record to a file of another tool, and say what was lost.

    What was written is read back, for Mitsuba's `measured` measured anew, and compared.

    Parameters
    ----------
    record : Record
    path : str or path
        ``.csv``: values at the middles of patches, read by `read_measured`; for several
        quantities or channels their names are put before the ending. ``.xml``: a
        Radiance BSDF in the Klems full basis. ``.bsdf``: for Mitsuba's `measured`,
        reflection only; needs a variant of rgb. ``.nc``: NetCDF, by xarray.

    Returns
    -------
    list of Loss
        One for each incident direction and hemisphere that the format holds.

    Raises
    ------
    ValueError
        For another ending, or a record that the format cannot hold.
    VariantError
        Without a variant that is needed.
    OSError
        If the file cannot be written.
    """
    check_output(path, ENDINGS)
    return _FORMATS[Path(path).suffix.lower()](record, path)


# ---------------------------------------------------------------------------- tables


def _csv(record, path):
    tables = {
        (quantity, number): _table(record, quantity, number)
        for quantity in ("brdf", "btdf")[: 1 + record.has_lower]
        for number in range(len(record.channels))
    }
    fractions = np.zeros_like(_fractions(record))
    theta, _ = record.subdivision.middles
    known = np.isfinite(theta)
    for (quantity, number), table in tables.items():
        name = Path(path)
        if len(tables) > 1:
            channel = record.channels[number] if len(record.channels) > 1 else ""
            name = name.with_suffix(f".{quantity}{channel}{name.suffix}")
        table.save(name)
        values = read_measured(name).value.reshape(len(record), -1)
        projected = record.subdivision.projected_solid_angles[known]
        fractions[:, int(quantity == "btdf"), known, number] = values * projected
    return _losses(record, fractions)


def _table(record, quantity, number):
    """Table of one quantity in one channel."""
    theta, phi = (np.degrees(angle) for angle in record.subdivision.middles)
    known = np.isfinite(theta)
    n = int(known.sum())
    if quantity == "btdf":
        theta = 180 - theta
    one_sigma = 0.6827
    columns = {"value": [], "sigma": []}
    for index in range(len(record)):
        one = record[index]
        low, high = one.interval(one_sigma, quantity)
        sigma = getattr(one, f"{quantity}_std_err")
        sigma = np.where(np.isnan(sigma), (high - low) / 2, sigma)
        columns["value"].append(getattr(one, quantity)[known, number])
        columns["sigma"].append(sigma[known, number])
    columns = {key: np.concatenate(parts) for key, parts in columns.items()}
    if np.isnan(columns["sigma"]).any():
        columns["sigma"] = None
    return MeasuredTable(
        theta_i=np.clip(record.theta_i, 0, None).repeat(n),
        phi_i=record.phi_i.repeat(n),
        theta_o=np.tile(theta[known], len(record)),
        phi_o=np.tile(phi[known], len(record)),
        quantity=quantity,
        channel=record.channels[number] if len(record.channels) > 1 else None,
        header={"collector": str(record.subdivision)},
        **columns,
    )


def _netcdf(record, path):
    with replacing(path) as stream:
        netcdf.write(record, stream)
    import xarray

    with xarray.open_dataset(path, engine="scipy") as written:
        values = written["bsdf"].to_numpy()
    projected = record.subdivision.projected_solid_angles[..., None]
    return _losses(record, values * projected)


# --------------------------------------------------------------------------- Radiance


def _radiance(record, path):
    material = Material(_visible(record))
    side = record.settings.get("side", "front")
    names = ["Visible"] if len(record.channels) == 1 else ["CIE-X", "Visible", "CIE-Z"]
    matrices = {}
    for hemisphere in range(1 + record.has_lower):
        matrix = klems_matrix(material, hemisphere)
        if len(record.channels) == 3:
            matrix = matrix @ XYZ.T
        for number, name in enumerate(names):
            key = name, radiance_xml.DIRECTIONS[side, hemisphere]
            matrices[key] = matrix[..., number]
    with replacing(path) as stream:
        radiance_xml.write(
            matrices, stream, record.settings.get("specimen", "a record")
        )
    with open(path, "rb") as stream:
        written = radiance_xml.read(stream)
    points = patch_points(record.subdivision, POINTS)
    rows = Klems().patch(points)
    projected = record.subdivision.projected_solid_angles[..., None]
    fractions = np.zeros_like(_fractions(record))
    for index, hemisphere in np.ndindex(fractions.shape[:2]):
        direction = radiance_xml.DIRECTIONS[side, hemisphere]
        column = radiance_xml.incident_patch(record.theta_i[index], record.phi_i[index])
        values = np.stack([written[name, direction][:, column] for name in names], -1)
        if len(names) == 3:
            values = values @ np.linalg.inv(XYZ).T
        means = values[rows].mean(axis=1)
        fractions[index, hemisphere] = (
            means.reshape(*record.subdivision.shape, -1) * projected
        )
    return _losses(record, fractions)


# ------------------------------------------------------------------- Mitsuba's measured


def _measured(record, path):
    if not (mi.variant() or "").endswith("rgb"):
        raise VariantError(
            "Mitsuba's measured needs a variant of rgb for a .bsdf file, such as "
            f"llvm_ad_rgb, got {mi.variant()}"
        )
    material = Material(_visible(record))
    theta_i, phi_i = material.theta_i, material.phi_i
    if len(phi_i) == 1:
        origins, azimuths = phi_i, np.zeros(1)
    else:
        turned = np.unique(np.mod(phi_i + 180, 360) - 180)
        azimuths = np.unique([-180, *turned, 180])
        origins, phi_i = np.zeros(len(azimuths)), azimuths
    values = np.stack(
        [
            [half_vector_grid(material, theta, phi, origin, GRID) for theta in theta_i]
            for phi, origin in zip(phi_i, origins)
        ]
    )
    if values.shape[2] == 1:
        values = values.repeat(3, axis=2)
    fields = {
        "theta_i": np.radians(theta_i),
        "phi_i": np.radians(azimuths),
        "ndf": np.ones((2, 2)),
        "sigma": np.ones((2, 2)),
        "vndf": np.ones((*values.shape[:2], 2, 2)),
        "luminance": _importance(values.mean(axis=2), theta_i, azimuths, origins),
        "rgb": values,
    }
    fields = {name: array.astype(np.float32) for name, array in fields.items()}
    text = record.settings.get("specimen", "a record").encode()
    fields["description"] = np.frombuffer(text, np.uint8)
    fields["jacobian"] = np.zeros(1, np.uint8)
    with replacing(path) as stream:
        tensor_file.write(fields, stream)
    with open(path, "rb") as stream:
        tensor_file.read(stream)
    fractions = np.zeros_like(_fractions(record)[:, :1])
    for index, (theta, phi) in enumerate(zip(record.theta_i, record.phi_i)):
        again = measure(
            {"type": "measured", "filename": str(path)},
            theta,
            phi,
            collector=record.subdivision,
            rays=RAYS,
        )
        fractions[index] = again.flux_fraction[:1]
    return _losses(record, fractions)


def _importance(values, theta_i, azimuths, origins):
    """Light per area of the grid of half vectors: where `measured` samples."""
    u = np.linspace(0, 1, GRID)
    theta_m, turn = u**2 * (np.pi / 2), 2 * np.pi * u[:, None] - np.pi
    weights = np.empty_like(values)
    for (j, i), _ in np.ndenumerate(values[..., 0, 0]):
        theta, phi = np.radians(theta_i[i]), np.radians(azimuths[j])
        relative = turn if len(azimuths) == 1 else turn - phi + np.radians(origins[j])
        cosine = np.sin(theta) * np.sin(theta_m) * np.cos(relative)
        cosine = cosine + np.cos(theta) * np.cos(theta_m)
        weights[j, i] = values[j, i] * u * np.sin(theta_m) * np.maximum(cosine, 0)
    # sampled a little everywhere, lest values are interpolated where none would be
    return weights + 1e-4 * np.maximum(weights.mean(axis=(2, 3), keepdims=True), 1e-12)


# ------------------------------------------------------------------------------ losses


def _visible(record):
    """Return the record if its channels are those that pictures have."""
    if len(record.channels) > 1 and record.channels != ("R", "G", "B"):
        raise ValueError(
            "this format takes records of one channel or of R, G, B, got "
            f"{', '.join(record.channels)[:80]}"
        )
    return record


def _fractions(record):
    return record.flux_fraction if record.stacked else record.flux_fraction[None]


def _losses(record, written):
    """Compare flux fractions of the file with those of the record."""
    recorded = _fractions(record)
    projected = record.subdivision.projected_solid_angles[..., None]
    losses = []
    for index, hemisphere in np.ndindex(written.shape[:2]):
        one = record[index]
        name = ("dhr", "dht")[hemisphere]
        errors = (one.brdf_std_err, one.btdf_std_err)[hemisphere] * projected
        total = recorded[index, hemisphere].sum()
        difference = np.abs(written[index, hemisphere] - recorded[index, hemisphere])
        # mean of the absolute value of a normal deviate
        noise = np.sqrt(2 / np.pi) * np.nansum(errors)
        n = len(record.channels)
        losses.append(
            Loss(
                float(one.theta_i[0]),
                float(one.phi_i[0]),
                name,
                float(total / n),
                float(np.mean(getattr(one, f"{name}_std_err"))),
                float(written[index, hemisphere].sum() / n),
                float(difference.sum() / 2 / total) if total else 0.0,
                float(noise / 2 / total) if total else 0.0,
            )
        )
    return losses


_FORMATS = {".csv": _csv, ".xml": _radiance, ".bsdf": _measured, ".nc": _netcdf}
ENDINGS = tuple(_FORMATS)
