"""The description of a record in files, besides its sums, and its checks."""

import json
import math
from collections.abc import Collection, Iterable
from typing import Any

import numpy as np

from ..array_types import Floats, Numbers
from ..collector import Subdivision, subdivision
from ..errors import FileFormatError, shown
from ..results.provenance import FACETS, read_settings
from ..results.record import Record
from ..results.tally import (
    N_ELEMENTS,
    DifferentiatedIntegrals,
    DifferentiatedTally,
    Fate,
    Integrals,
    PolarisedTally,
    Tally,
)
from .checks import require

# Stokes vectors that Mueller matrices belong to, for whoever reads a file.
FRAMES = (
    "(I, Q, U, V) in frames of s = k x z, p = k x s of directions k of flight: Q = I_s "
    "- I_p, U > 0 half-way from s to p, V > 0 clockwise seen against k"
)

FORMAT = "gonio-mi record"
VERSION = 4

# Of files that leave out copies of incident directions.
VERSION_OF_COPIES = 5

# Of files with gradients, or with the back of a material.
VERSION_OF_MORE = 6

VERSIONS = (VERSION, VERSION_OF_COPIES, VERSION_OF_MORE)

# Deflate expands by at most 1032 (zlib's technical details). A file that announces more
# than this many times its own size does not hold what it says.
MAX_EXPANSION = 1100


def header_of(record: Record) -> dict[str, Any]:
    """Everything but the integer sums, as a dictionary of JSON's types.

    Angles are in degrees; None where the incident direction is unknown.
    """
    more = record.provenance.columns or record.back is not None
    return {
        "format": FORMAT,
        "version": VERSION_OF_MORE if more else VERSION,
        "subdivision": str(record.subdivision),
        "theta_i": [None if math.isnan(x) else float(x) for x in record.theta_i],
        "phi_i": [None if math.isnan(x) else float(x) for x in record.phi_i],
        "channels": list(record.channels),
        "stacked": bool(record.stacked),
        "scales": [int(tally.scale) for tally in record.tallies],
        "settings": record.settings,
    }


def json_of(value: Any) -> str:
    """JSON text in ASCII; floats keep all their bits."""
    return json.dumps(value, ensure_ascii=True)


def parsed_json(text: Any) -> Any:
    """Parse the output of :func:`json_of`, or raise FileFormatError."""
    require(isinstance(text, str), "its description is not text")
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise FileFormatError("its description is damaged: not JSON") from None


def check_format(header: Any) -> None:
    """Raise FileFormatError unless `header` is ours and of a version that we read."""
    reason = "it was not written by gonio-mi"
    require(isinstance(header, dict) and header.get("format") == FORMAT, reason)
    version = header.get("version")
    if version not in VERSIONS:
        newer = isinstance(version, int) and version > max(VERSIONS)
        raise FileFormatError(
            f"it has format version {version!r} and this gonio-mi reads "
            f"{', '.join(map(str, VERSIONS))}"
            + (": install a newer gonio-mi" if newer else "")
        )


def rebuilt(
    header: dict[str, Any],
    tallies: Iterable[dict[str, Numbers]],
    n: int,
    added_up: bool,
) -> Record:
    """Record from its header and, per incident direction, the arrays of its tally.

    Parameters
    ----------
    header : dict
        As :func:`header_of` made it, from a file: not to be trusted.
    tallies : iterable of dict
        The arrays `hits`, `sums`, `incident`, `fates` and `direct` of :class:`Tally`,
        and those of its kind if it has some. None is asked for before the header has
        been checked.
    n : int
        How many there are.
    added_up : bool
        Keep of each :meth:`.Tally.added_up` alone.

    Raises
    ------
    FileFormatError
        If anything is missing, of another type or shape, or does not fit the rest.
    """
    theta_i, phi_i = (_angles(header, key, n) for key in ("theta_i", "phi_i"))
    channels = _listed(header, "channels", str)
    scales = _listed(header, "scales", int)
    stacked: Any = header.get("stacked")
    settings: Any = header.get("settings")
    require(len(channels) > 0, "it has no channels")
    require(isinstance(stacked, bool), "its entry stacked is not a truth value")
    require(isinstance(settings, dict), "its settings are not a dictionary")
    try:
        asked, provenance = read_settings(settings)
    except (TypeError, ValueError) as error:
        raise FileFormatError(f"its settings are wrong: {error}") from None
    require(stacked or n == 1, f"it holds {n} incident directions but is not a stack")
    require(len(scales) == n, f"it has {len(scales)} scales for {n} directions")
    patches = parsed_subdivision(header)
    collector = settings.get("collector")
    require(
        collector in (None, str(patches)),
        f"its setting collector is {shown(collector)}, its patches are "
        f"{shown(str(patches))}",
    )
    # rays take off sums what facets are said to send
    signed = {
        "elements",
        "changes",
        *(["sums"] if provenance.transport == FACETS else []),
    }
    kept = []
    for arrays, scale in zip(tallies, scales):
        fates = arrays["fates"]
        if fates.ndim == 2 and fates.shape[1] == Fate.OVER_THE_EDGE:
            # written when such rays were sideways
            arrays["fates"] = np.pad(fates, ((0, 0), (0, 1)))
        require(0 < scale < 2**63, f"its scale {scale} is out of range")
        shape = patches.shape, len(channels), len(provenance.columns)
        _check_shapes(arrays, *shape, signed)
        tally = _tally(arrays, scale)
        kept.append(tally.added_up() if added_up else tally)
    return Record(
        subdivision=patches,
        theta_i=theta_i,
        phi_i=phi_i,
        channels=tuple(channels),
        tallies=tuple(kept),
        asked=asked,
        provenance=provenance,
        stacked=stacked,
    )


def parsed_subdivision(header: dict[str, Any]) -> Subdivision:
    """Return the subdivision that the header names, or raise FileFormatError."""
    name: Any = header.get("subdivision")
    try:
        return subdivision(name)
    except (TypeError, ValueError):
        raise FileFormatError(f"its subdivision {name!r:.80} is unknown") from None


def _tally(arrays: dict[str, Numbers], scale: int) -> Tally:
    """Sums of the kind that the arrays are of."""
    if "elements" in arrays:
        return PolarisedTally(**arrays, scale=scale)
    kinds = (Integrals, DifferentiatedIntegrals), (Tally, DifferentiatedTally)
    kind: Any = kinds["errors" not in arrays]["changes" in arrays]
    found: Tally = kind(**arrays, scale=scale)
    return found


def shapes_of_tally(
    n_batches: int,
    n_hemispheres: int | None,
    patches: tuple[int, int],
    n_channels: int,
    n_changes: int | None = None,
) -> dict[str, tuple[int | None, ...]]:
    """Shapes of all possible arrays of a tally; None where unknown."""
    return {
        "hits": (n_hemispheres, *patches),
        "sums": (n_batches, n_hemispheres, *patches, n_channels),
        "incident": (n_batches, n_channels),
        "fates": (n_batches, len(Fate)),
        "direct": (n_batches, n_channels),
        "errors": (n_hemispheres, *patches, n_channels),
        "elements": (n_batches, n_hemispheres, *patches, N_ELEMENTS, n_channels),
        "changes": (n_batches, n_hemispheres, *patches, n_changes, n_channels),
    }


def _check_shapes(
    arrays: dict[str, Numbers],
    patches: tuple[int, int],
    n_channels: int,
    n_numbers: int,
    signed: Collection[str],
) -> None:
    """Raise FileFormatError unless the arrays of a tally fit the header.

    Those of `signed` names may be negative.
    """
    n_hemispheres, n_batches = len(arrays["hits"]), len(arrays["fates"])
    require(n_hemispheres in (1, 2), f"it has {n_hemispheres} hemispheres")
    require(n_batches > 0, "it holds no batch")
    own = patches, n_channels, 2 * n_numbers
    shapes = shapes_of_tally(n_batches, n_hemispheres, *own)
    weights = arrays["incident"].dtype == np.float64
    for name in (*Tally.arrays, *(arrays.keys() - {*Tally.arrays})):
        array, shape = arrays[name], shapes[name]
        floats = weights and name in ("sums", "incident", "errors", "direct")
        floats |= name in ("elements", "changes")
        kind = np.dtype(np.float64 if floats else np.uint64)
        reason = f"its array {name} is {array.dtype} {array.shape}, not {kind} {shape}"
        require(array.shape == shape and array.dtype == kind, reason)
        sound = np.isfinite(array) & ((array >= 0) | (name in signed))
        reason = f"its array {name} holds negative numbers, infinity or NaN"
        require(not floats or bool(np.all(sound)), reason)


def _angles(header: dict[str, Any], key: str, n: int) -> Floats:
    """Array of `n` angles in degrees."""
    values = _listed(header, key, (float, type(None)))
    angles = np.array(values, dtype=float)  # NaN for None
    require(
        len(values) == n and not np.isinf(angles).any(), f"its {key} are not {n} angles"
    )
    return angles


def _listed(
    header: dict[str, Any], key: str, kinds: type | tuple[type, ...]
) -> list[Any]:
    """List of values of certain types; a boolean does not count as a number."""
    values: Any = header.get(key)
    require(
        isinstance(values, list)
        and all(isinstance(value, kinds) for value in values)
        and not any(isinstance(value, bool) for value in values),
        f"its entry {key} is not a list of the right type",
    )
    return values
