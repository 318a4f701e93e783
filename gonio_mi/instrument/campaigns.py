"""Campaigns: specimens times directions, in this process or in others, resumable."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

from ..errors import SettingError, SettingTypeError, checked_count, shown
from ..results.record import Record
from ..settings.parsed import checked_incident
from .campaign_tasks import Surroundings, records_of
from .incidence import incident_angles
from .loading import check_variant

__all__ = ["campaign"]


def campaign(
    specimens: Mapping[str, Any],
    theta_i: Any,
    phi_i: Any = 0.0,
    *,
    executor: Any = None,
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
        None for all patches of the setting `incident`.
    executor : concurrent.futures.Executor or int, optional
        Where to measure: that many processes on this machine (scripts need the usual
        ``if __name__ == "__main__":``), or any executor such as Dask's
        ``client.get_executor()``. Default: this process.
    folder : path, optional
        Where finished tasks are kept, as records. Started again with the same
        arguments, a campaign that was killed or interrupted measures only what is
        missing. What was measured otherwise is refused: with other settings, versions
        or plugin files, or specimens whose files or data have changed since, as far as
        their ``digest`` shows it (:func:`gonio_mi.transport.digest.digest`).
    plugins : sequence of path
        Python files that register plugins, to be run in each worker first.
    threads : int, optional
        Threads of each worker. Default: all cores, or for `executor` an int its share.
    retries : int
        How often tasks are sent again whose worker died.
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
        After Ctrl-C, at once: `folder` holds the tasks that were finished.
    concurrent.futures.BrokenExecutor
        If workers keep dying. What is finished is in `folder`.
    """
    check_variant()
    if not isinstance(specimens, Mapping) or not specimens:
        raise SettingTypeError(
            "specimens must be a dictionary with at least one entry, "
            f"got {shown(specimens)}"
        )
    patches = checked_incident("incident", settings.get("incident"))
    incidents, _ = incident_angles(theta_i, phi_i, patches)
    if None in incidents:
        raise SettingError("theta_i must be given for a campaign, got None")
    if isinstance(executor, int):
        checked_count("executor", executor)
        threads = threads or max(1, (os.cpu_count() or 1) // executor)
    where = Surroundings(executor, folder, plugins, threads, retries, progress)
    return records_of(specimens, incidents, where, settings)
