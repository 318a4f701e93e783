"""Conditions in which two measurements differ, and rays that they should not share."""

from collections.abc import Mapping
from typing import Any

from ..errors import abridged
from ..files.measured_table import MeasuredTable
from ..results.provenance import shared_seeds
from ..results.record import Record
from ..settings import MeasurementSettings, declarations

__all__ = ["CONDITIONS", "same_rays", "unlike_conditions", "unlike_the_table"]

# What is declared as a setting, or is known of the light. Estimators, samplers, rays
# and Russian roulette change how well something is known, not what; wavelengths are
# channels; collectors and hemispheres are compared elsewhere.
CONDITIONS = (
    *("side", "footprint", "divergence", "incident", "emission", "emitter"),
    *("collector_radius", "period", "order", "max_depth", "max_scatterings"),
)


def unlike_conditions(record: Record, other: Record) -> list[str]:
    """A note on the conditions in which two records differ; none if they do not."""
    mine, theirs = _known(record), _known(other)
    cut = record.ledger.truncated or other.ledger.truncated
    unlike = [
        f"{name} {abridged(str(mine[name]), 60)} and {abridged(str(theirs[name]), 60)}"
        for name in CONDITIONS
        if name in mine.keys() & theirs.keys()
        and mine[name] != theirs[name]
        and (cut or name not in ("max_depth", "max_scatterings"))
    ]
    key = "emitter_digest"
    if mine.get(key) != theirs.get(key) and mine["emitter"] == theirs["emitter"]:
        unlike.append(f"emitters that are both {mine['emitter']}, but not the same")
    if not unlike:
        return []
    return [
        "the conditions are not the same, and may change what is measured: "
        + ", ".join(unlike)
    ]


def unlike_the_table(record: Record, table: MeasuredTable) -> list[str]:
    """A note on light that came in another cone than a table says; or none."""
    known, told = _known(record), table.emitter_half_angle
    collimated = str(known["emitter"]).startswith("Directional")
    # where the table is silent, a divergence was said with the comparison
    other_cone = collimated and told and abs(known["divergence"] - told) > 1e-6
    if known["incident"] != "none":
        said = f"filled patches of incidence ({abridged(str(known['incident']), 40)})"
    elif other_cone:
        said = f"had a divergence of {known['divergence']:g} degrees"
    else:
        return []
    return [
        "the conditions are not the same, and may change what is measured: the light "
        f"of {table.name} came within {told:g} degrees, that of "
        f"the record {said}"
    ]


def same_rays(both: str, record: Record, theirs: Mapping[str, str]) -> list[str]:
    """A note if a record has the seed, and so the rays, of another one; or none.

    Parameters
    ----------
    both : str
        Subject of the sentence.
    theirs : mapping of str
        As of `Record.ray_keys`.
    """
    seeds = shared_seeds(record.ray_keys, theirs)
    if not seeds:
        return []
    return [
        f"{both} have the seed {seeds}: their rays are not independent, so that they "
        "agree too well; measure one again with another seed"
    ]


def _known(record: Record) -> Mapping[str, Any]:
    """Settings of a record; younger ones than it are as by default."""
    declared = declarations(MeasurementSettings)
    defaults = {
        name: declared[name].text(declared[name].default)
        for name in CONDITIONS
        if name in declared
    }
    del defaults["max_scatterings"]  # it is told where there are media
    return defaults | {"emitter": "DirectionalEmitter"} | dict(record.settings)
