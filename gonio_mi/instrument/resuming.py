"""Whether an interrupted record is the beginning of a measurement."""

from collections.abc import Sequence

from ..errors import SettingError, SettingTypeError, shown
from ..results.provenance import told_settings
from ..results.record import Record
from ..results.tally import batch_sizes
from ..transport.bench import Bench
from ..transport.wavelengths import channel_names
from .description import described
from .schedule import rays_sent, rounds

__all__ = ["check_resumable"]

# Settings that say nothing of the rays.
FREE = {"created", "defects", "versions", "processors", "specimen"}


def check_resumable(resume: Record, benches: Sequence[Bench], step: int) -> None:
    """Raise ValueError unless `resume` is the beginning of this measurement.

    Parameters
    ----------
    resume : Record
    benches : sequence of Bench
        For each incident direction; the record may hold the first ones only.
    step : int
        Rays of each batch in the first rounds; the record may hold those of whole
        :func:`~.schedule.rounds`, or of the first round the first batches only.
    """
    if not isinstance(resume, Record):
        raise SettingTypeError(f"resume must be a Record, got {shown(resume)}")
    if len(resume) > len(benches):
        raise SettingError(
            f"resume must hold at most {len(benches)} incident directions, "
            f"got {len(resume)}"
        )
    nm, n = benches[0].settings.wavelengths, len(resume.channels)
    for i, bench in enumerate(benches[: len(resume)]):
        own = told_settings(*described(bench)) | {
            "channels": channel_names(nm, n),
            "collector": str(bench.collector.subdivision),
            "theta_i": bench.theta_i,
            "phi_i": bench.phi_i,
            "hemispheres": "both" if bench.shape[0] == 2 else "upper",
        }
        others = dict(resume.settings) | {
            "channels": resume.channels,
            "collector": str(resume.subdivision),
            "theta_i": float(resume.theta_i[i]),
            "phi_i": float(resume.phi_i[i]),
            "hemispheres": "both" if resume.has_lower else "upper",
        }
        for key in sorted(own.keys() - FREE):
            if own[key] != others.get(key) and own[key] == own[key]:
                raise SettingError(
                    "resume must be a record of this measurement, but it was made with "
                    f"{key}={shown(others.get(key))} instead of {shown(own[key])}"
                )
    settings = benches[0].settings
    plan = batch_sizes(settings.rays, settings.batches)
    for bench, tally in zip(benches, resume.tallies):
        sent = rays_sent([tally], len(bench.passes))
        ends = rounds(plan, step)
        if sent not in ends and sent != ends[0][: len(sent)]:
            raise SettingError(
                "resume must be a record of this measurement, but it was made in "
                f"{len(sent)} batches of up to {max(sent)} rays instead of "
                f"{len(plan)} of up to {max(plan)}"
            )
