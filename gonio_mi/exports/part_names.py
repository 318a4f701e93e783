"""Names of the files of formats that hold one quantity and channel each."""

from os import PathLike
from pathlib import Path

from ..results.record import Record

__all__ = ["ZEMAX", "part_names", "written_files"]

ZEMAX = ".zemax.bsdf"

# Of which each file holds one quantity and channel.
IN_PARTS = (".csv", ZEMAX)


def part_names(
    record: Record, path: str | PathLike[str]
) -> dict[tuple[int, int], Path]:
    """Files by hemisphere (0 for reflection) and number of the channel.

    Where there are several, what each holds is put before the ending of the path:
    ``run.brdf450nm.csv``.
    """
    path = Path(path)
    (ending,) = (one for one in IN_PARTS if path.name.lower().endswith(one))
    stem, ending = path.name[: -len(ending)], path.name[-len(ending) :]
    channels = record.channels if len(record.channels) > 1 else ("",)
    parts = {
        (hemisphere, number): f"{stem}.{quantity}{channel}{ending}"
        for hemisphere, quantity in enumerate(("brdf", "btdf")[: 1 + record.has_lower])
        for number, channel in enumerate(channels)
    }
    if len(parts) == 1:
        return {(0, 0): path}
    return {key: path.with_name(name) for key, name in parts.items()}


def written_files(record: Record, path: str | PathLike[str]) -> list[Path]:
    """All files that an export to a path writes."""
    if str(path).lower().endswith(IN_PARTS):
        return list(part_names(record, path).values())
    return [Path(path)]
