"""Records as NumPy's ``.npz``: a ZIP archive of plain arrays, readable by ``np.load``.

`hits` has shape ``(n_incident, n_hemispheres, n_theta, n_phi)``; `sums`, `incident`,
`fates` and `direct` hold the batches of all incident directions, `n_batches` of each,
one after the other on their first axis. `errors`, of integrals only, is `hits` with
channels. The rest is the header, `settings` as JSON.
"""

import math
import zipfile

import numpy as np

from .header import (
    MAX_EXPANSION,
    check_format,
    header_of,
    json_of,
    parsed_json,
    rebuilt,
    require,
    size_of,
)

__all__ = ["read", "write"]

# Type and number of axes of each array.
HEADER = {
    "format": ("str", 0),
    "version": ("int64", 0),
    "subdivision": ("str", 0),
    "theta_i": ("float64", 1),
    "phi_i": ("float64", 1),
    "channels": ("str", 1),
    "stacked": ("bool", 0),
    "scales": ("int64", 1),
    "settings": ("str", 0),
}
TALLIES = {
    "n_batches": ("int64", 1),
    "hits": ("uint64", 4),
    "sums": ("uint64", 5),
    "incident": ("uint64", 2),
    "fates": ("uint64", 2),
}
DIRECT = {"direct": ("uint64", 2)}
INTEGRALS = {"errors": ("uint64", 5)}


def write(record, stream):
    """Write `record` to a binary stream."""
    header = header_of(record)
    header["settings"] = json_of(header["settings"])
    arrays = {name: np.array(header[name], HEADER[name][0]) for name in HEADER}
    arrays["n_batches"] = np.array([tally.n_batches for tally in record.tallies])
    arrays["hits"] = np.stack([tally.hits for tally in record.tallies])
    if record.tallies[0].errors is not None:
        arrays["errors"] = np.stack([tally.errors for tally in record.tallies])
    for name in ("sums", "incident", "fates", "direct"):
        parts = [getattr(tally, name) for tally in record.tallies]
        arrays[name] = parts[0] if len(parts) == 1 else np.concatenate(parts)
    # like np.savez_compressed, but level 1: as small for noisy sums, six times faster
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, array, allow_pickle=False)


def read(stream):
    """Read a record from a binary file; nothing in it is executed.

    Raises
    ------
    FileFormatError
        If the file holds something else, or announces more than its size allows.
    """
    with zipfile.ZipFile(stream) as archive:
        members = {info.filename: info for info in archive.infolist()}
        require("format.npy" in members, "it was not written by gonio-mi")
        size = size_of(stream)
        announced = sum(info.file_size for info in archive.infolist())
        require(
            announced <= MAX_EXPANSION * size,
            f"it announces {announced} bytes, more than {size} bytes can hold",
        )
        header = {name: _array(archive, members, name, HEADER) for name in HEADER}
        header = {name: array.tolist() for name, array in header.items()}
        header["settings"] = parsed_json(header["settings"])
        check_format(header)
        expected = TALLIES | (INTEGRALS if "errors.npy" in members else {})
        expected |= DIRECT if header["version"] >= 3 else {}
        arrays = {name: _array(archive, members, name, expected) for name in expected}
    n_batches = arrays.pop("n_batches")
    per_direction = {k: arrays.pop(k) for k in ("hits", "errors") if k in arrays}
    require(
        all(len(array) == len(n_batches) for array in per_direction.values())
        and min(n_batches, default=0) > 0
        and all(len(array) == sum(n_batches.tolist()) for array in arrays.values()),
        "its numbers of batches do not fit its arrays",
    )
    borders = np.cumsum(n_batches)[:-1]
    per_direction |= {name: np.split(array, borders) for name, array in arrays.items()}
    tallies = zip(*per_direction.values())
    return rebuilt(header, [dict(zip(per_direction, tally)) for tally in tallies])


def _array(archive, members, name, expected):
    """Array of that name, once its header agrees with its type and its size."""
    kind, n_axes = expected[name]
    require(f"{name}.npy" in members, f"its array {name} is missing")
    info = members[f"{name}.npy"]
    with archive.open(info) as member:
        version = np.lib.format.read_magic(member)
        require(version == (1, 0), f"its array {name} has npy version {version}")
        shape, _, dtype = np.lib.format.read_array_header_1_0(member)
        n_bytes = info.file_size - member.tell()
    good = dtype.kind == "U" if kind == "str" else dtype == kind
    require(
        good and len(shape) == n_axes and dtype.itemsize > 0,
        f"its array {name} is {dtype} {shape} instead of {kind} with {n_axes} axes",
    )
    require(
        all(n >= 0 for n in shape) and math.prod(shape) * dtype.itemsize == n_bytes,
        f"its array {name} of shape {shape} does not fill its {n_bytes} bytes",
    )
    with archive.open(info) as member:
        return np.lib.format.read_array(member, allow_pickle=False)
