"""Whether an interrupted record is the beginning of a measurement."""

from collections.abc import Sequence

from ..errors import SettingError, SettingTypeError, shown
from ..results.joined_settings import DIGESTS
from ..results.record import Record
from ..settings import MeasurementSettings, declarations
from ..transport.bench import Bench
from .batches import rays_sent, rounds
from .instrument import Instrument

__all__ = ["check_resumable"]

# Settings that say nothing of the rays.
FREE = {"created", "versions", "processors", "specimen"}


def check_resumable(
    resume: Record,
    instrument: Instrument,
    benches: Sequence[Bench],
    seed: int,
    plan: Sequence[int],
) -> None:
    """Raise ValueError unless `resume` is the beginning of this measurement.

    Parameters
    ----------
    resume : Record
    instrument : Instrument
    benches : sequence of Bench
        For each incident direction; the record may hold the first ones only.
    seed : int
    plan : sequence of int
        Rays of each batch; the record may hold the first ones only, or those of whole
        rounds (:func:`~.batches.rounds`).
    """
    if not isinstance(resume, Record):
        raise SettingTypeError(f"resume must be a Record, got {shown(resume)}")
    if len(resume) > len(benches):
        raise SettingError(
            f"resume must hold at most {len(benches)} incident directions, "
            f"got {len(resume)}"
        )
    for i, bench in enumerate(benches[: len(resume)]):
        own = instrument.describe(bench, seed) | {
            "collector": str(bench.collector.subdivision),
            "theta_i": bench.theta_i,
            "phi_i": bench.phi_i,
            "hemispheres": "both" if bench.shape[0] == 2 else "upper",
        }
        # a setting that is younger than the record was as its default is
        others = (
            _defaults()
            | dict(resume.settings)
            | {
                "collector": str(resume.subdivision),
                "theta_i": float(resume.theta_i[i]),
                "phi_i": float(resume.phi_i[i]),
                "hemispheres": "both" if resume.has_lower else "upper",
            }
        )
        lacking = set(DIGESTS) - others.keys()
        if others.get("digest"):
            lacking.add("surface")  # which older records have cut short
        for key in sorted(own.keys() - FREE - lacking):
            if own[key] != others.get(key) and own[key] == own[key]:
                raise SettingError(
                    "resume must be a record of this measurement, but it was made with "
                    f"{key}={shown(others.get(key))} instead of {shown(own[key])}"
                )
    if resume.ledger.missed and resume.settings.get("period", "none") != "none":
        raise SettingError(
            "resume must be a record of this measurement, but it is of an older "
            "gonio-mi, which left out the light that passes openings of the cell"
        )
    for bench, tally in zip(benches, resume.tallies):
        sent = rays_sent([tally], instrument.passes)
        ends = rounds(plan, instrument.round_rays(bench))
        if sent not in [end[: len(sent)] for end in ends]:
            raise SettingError(
                "resume must be a record of this measurement, but it was made in "
                f"{len(sent)} batches of up to {max(sent)} rays instead of "
                f"{len(plan)} of up to {max(plan)}"
            )


def _defaults() -> dict[str, object]:
    """Settings as records tell them, where nothing was asked for."""
    declared = declarations(MeasurementSettings)
    return {name: each.text(each.default) for name, each in declared.items()}
