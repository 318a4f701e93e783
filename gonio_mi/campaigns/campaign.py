"""Campaigns: specimens times directions, in this process or in others, resumable."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..annexes import ask
from ..errors import SettingError, SettingTypeError, checked_count, shown
from ..instrument.incidence import incident_angles
from ..results.record import Record
from ..settings import MeasurementSettings
from ..variants import check_unpolarised, check_variant, is_parallel
from .execution import ExecutionContext, records_of

# Workers, and threads of each.
MAX_THREADS = 2**16


def campaign(
    specimens: Mapping[str, Any],
    theta_i: ArrayLike | None = None,
    phi_i: ArrayLike = 0.0,
    *,
    tolerance: float | None = None,
    relative_tolerance: float | None = None,
    theta_max: float = 80.0,
    executor: Executor | int | None = None,
    folder: str | PathLike[str] | None = None,
    plugins: Sequence[str | PathLike[str]] = (),
    threads: int | None = None,
    retries: int = 3,
    progress: bool = False,
    **settings: Any,
) -> dict[str, Record]:
    """Measure specimens at many incident directions, here or elsewhere.

    Every direction has the bits that :func:`measure` gives it: whatever the executor,
    the number of its workers and their order.

    Parameters
    ----------
    specimens : mapping of str to specimen
        By name, what :func:`measure` takes; for other processes a dictionary or a path.
    theta_i, phi_i : float or sequence of float
        In degrees: all azimuths for the first angle, then for the second, and so on.
        None for all patches of the setting `incident`, or with `tolerance`.
    tolerance : float, optional
        The campaign chooses its own directions: as few as make the material
        `goniometric` right everywhere, up to `theta_max`. From few directions it
        predicts others, measures them, and goes on where the difference may be above
        the tolerance, until new directions hold. The error is that of
        :class:`~gonio_mi.results.campaign_outcome.PredictionError`: the total variation
        distance of the distribution over patches, or the error of reflectance or
        transmittance, as a fraction of the flux that leaves. Isotropic specimens are
        recognised; others get azimuths, in whole sectors, where each polar angle needs
        them. Of a specimen that may be turned by a part of a whole turn, or mirrored,
        which is recognised too, the record holds copies of what was measured instead,
        and says which. Integrals are measured where the specimen allows it, unless
        there is an `estimator`, and refused where samples contradict them by more than
        the tolerance; else as many rays as noise of three quarters of the tolerance
        needs, and of a half or a quarter where directions that are never used are near
        it. The record's setting ``campaign`` holds the errors of these. Of a specimen
        that transmits light from behind is measured likewise, unless a `side` is given:
        it is the record's ``back``, in the same file.
    relative_tolerance : float, optional
        With `tolerance`: largest relative error of a patch whose BSDF is at least a
        tenth of its mean: errors that show in pictures of dim directions.
    theta_max : float
        Largest angle of incidence of such a campaign in degrees; beyond, the material
        is what it is there.
    executor : concurrent.futures.Executor or int, optional
        Where to measure: that many processes on this machine (scripts need the usual
        ``if __name__ == "__main__":``), or any executor such as Dask's
        ``client.get_executor()``. Default: this process.
    folder : path, optional
        Where finished tasks are kept, as records. Started again with the same
        arguments, a campaign that was killed or interrupted measures only what is
        missing. What was measured otherwise is refused: with other settings, versions
        or plugin files, or specimens whose files or data have changed since, as far as
        their ``digest`` shows it (:func:`gonio_mi.specimen.digest.digest`).
    plugins : sequence of path
        Python files that register plugins, to be run in each worker first.
    threads : int, optional
        Threads of each worker, or of this process until the campaign ends. Default: all
        cores, or for `executor` an int its share. Nothing changes in a forked process.
    retries : int
        How often tasks are repeated whose worker died.
    progress : bool
        Show a progress bar on standard error.
    **settings
        All other arguments of :func:`measure`.

    Returns
    -------
    dict of Record
        A stack of all incident directions for each name.

    Raises
    ------
    TypeError, ValueError
        If a setting is out of its range, `folder` holds another campaign or one is at
        work in it, or a specimen cannot be sent to another process.
    KeyboardInterrupt
        After Ctrl-C, at once: `folder` holds the tasks that were finished. With a
        `tolerance` and no folder they are in a temporary one, which the message names.
    concurrent.futures.BrokenExecutor
        If workers keep dying. What is finished is in `folder`.
    """
    check_variant(is_parallel)
    if not isinstance(specimens, Mapping) or not specimens:  # type: ignore[redundant-expr]
        raise SettingTypeError(
            "specimens must be a dictionary with at least one entry, "
            f"got {shown(specimens)}"
        )
    if isinstance(executor, int):
        checked_count("executor", executor, 1, MAX_THREADS)
        threads = threads or max(1, (os.cpu_count() or 1) // executor)
    if threads is not None:
        checked_count("threads", threads, 0, MAX_THREADS)
    where = ExecutionContext(executor, folder, plugins, threads, retries, progress)
    asked = MeasurementSettings.among(settings)
    if tolerance is None:
        if relative_tolerance is not None:
            raise SettingError("relative_tolerance applies with a tolerance only")
        incidents, _ = incident_angles(theta_i, phi_i, asked.incident)
        if None in incidents:
            raise SettingError(
                "theta_i must be given for a campaign without tolerance, got None"
            )
        return records_of(specimens, incidents, where, settings)
    check_unpolarised("tolerance")
    chosen_directions = ask("materials", "chosen_directions")
    others = {
        "theta_i": theta_i,
        "phi_i": phi_i if np.any(phi_i) else None,
        "incident": asked.incident,
        "gradients": asked.gradients or None,
    }
    for other, value in others.items():
        if value is not None:
            raise SettingError(f"tolerance and {other} are mutually exclusive")
    records: dict[str, Record] = chosen_directions(
        specimens, tolerance, theta_max, where, settings, relative_tolerance
    )
    return records
