"""Directions that a campaign has measured, as precisely as its tolerance asks."""

from __future__ import annotations

import hashlib
import logging
import re
import time
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..collector import Subdivision
from ..errors import SettingError, SpecimenError, abridged
from ..results.prediction_error import prediction_error
from ..results.record import Record
from ..settings import Estimator, MeasurementSettings
from .tasks import Surroundings, keep, records_of

__all__ = [
    "CONFIRMING",
    "NOISE",
    "KnownDirections",
    "NotIntegrableError",
    "folder_name",
]

logger = logging.getLogger(__name__)

# Parts of the tolerance: what noise may misplace at directions that a material is made
# of, or may be, and at those that confirm it; and what an integral may be off by.
# Between directions noise is averaged: of a half a third is left, which adds about by
# squares, so that it costs 6 % of the tolerance, and a third of the rays of a quarter.
# Noise at a direction where errors are looked for hides at most 0.43 of itself: of a
# difference of x standard errors x erfc(x / sqrt(2)) of them is lost, at most 0.34, and
# noise is sqrt(2 / pi) of them.
NOISE, CONFIRMING, INTEGRAL = 1 / 2, 1 / 4, 1 / 10

# Rays that tell whether sample() is as eval() says; where they seem to contradict, so
# many times as many decide, by so many standard errors. These are of misplaced light
# and up to 2.2 times too small, and those of the light in all may be twice as large: a
# right plugin of spiky weights is not beyond 3.6 of its own.
PROBE_RAYS = 2**18
AGAIN, CERTAIN = 16, 16

# Seconds of further measuring that are announced.
LONG = 600


class NotIntegrableError(Exception):
    """A direction of which an integral is refused, where rays may be taken."""


class KnownDirections:
    """Records of a specimen by incident direction; the same wherever it is measured.

    Parameters
    ----------
    name : str
    specimen : object
        What :func:`~gonio_mi.campaigns.measure.measure` takes.
    tolerance : float
    where : Surroundings
    settings : dict
        All other settings of a measurement.

    Attributes
    ----------
    records : dict
        By polar angle and azimuth in degrees.
    rays : int
        That were sent for them, also for those that were too noisy.
    light : ndarray, shape (2,)
        Reflectances and transmittances, each summed over all of them.
    """

    def __init__(
        self,
        name: str,
        specimen: Any,
        tolerance: float,
        where: Surroundings,
        settings: dict[str, Any],
    ) -> None:
        for other in ("rays", "rel_err", "noise"):
            if settings.get(other) is not None:
                raise SettingError(
                    f"tolerance and {other} exclude each other, got both"
                )
        self.name, self.specimen, self.tolerance = name, specimen, tolerance
        self.where, self.settings = where, settings
        self.estimators = [Estimator.QUADRATURE, Estimator.WEIGHTED]
        given = {name for name, value in settings.items() if value is not None}
        if "estimator" in given:
            self.estimators = [MeasurementSettings.among(settings).estimator]
        self.chosen: Subdivision | None = None  # where no collector was asked for
        self.records: dict[tuple[float, float], Record] = {}
        # for `keep_in`, where there is no folder: arguments of `keep` but for where
        self.rounds: list[tuple[str, Record, Sequence[Any], dict[str, Any]]] = []
        self.rays = self.n_rounds = self.n_timed = 0
        self.seconds, self.announced = 0.0, False
        self.light = np.zeros(2)

    def start_anew(self, patches: Subdivision | None = None) -> None:
        """Forget all directions; take rays, or other patches if some are given."""
        if patches is None:
            del self.estimators[0]
        else:
            self.chosen = patches
            self.settings = self.settings | {"collector": patches}
        self.records.clear()
        self.light[:] = 0
        self.rays = self.n_rounds = self.n_timed = 0
        self.seconds = 0.0

    def measure(
        self,
        incidents: Iterable[tuple[float, float]],
        said: str,
        noise: float = NOISE,
    ) -> None:
        """Measure the directions that are not known yet, or not as precisely.

        `noise`: the part of the tolerance that it may misplace where they are sampled.

        Raises
        ------
        NotIntegrableError
            If an integral is refused, and no estimator was asked for.
        """
        goal = noise * self.tolerance
        new = sorted(one for one in set(incidents) if self._lacks(one, goal))
        if not new:
            return
        started = time.perf_counter()
        # fits a terminal
        said = f"{abridged(self.name, 16)}, {len(self.records)} measured, {said}"
        logger.info("%s: %d more", said, len(new))
        part = f"{self.estimators[0]}_{self.n_rounds:03d}"
        try:
            stack = self._kept(part, new, self.settings | self._goals(goal), said)
        except SpecimenError as error:
            if len(self.estimators) == 1:
                raise
            raise NotIntegrableError(error) from error
        self.rays += stack.ledger.emitted
        flux = stack.flux_fraction
        self.light += flux[:, :1].sum(), flux[:, 1:].sum()
        self.records |= zip(new, (stack[number] for number in range(len(stack))))
        self.n_rounds, self.n_timed = self.n_rounds + 1, self.n_timed + len(new)
        self.seconds += time.perf_counter() - started

    def _lacks(self, incident: tuple[float, float], noise: float) -> bool:
        """Whether a direction is not known, or is sampled and not as precise."""
        record = self.records.get(incident)
        return record is None or (record.asked.noise or 0.0) > noise

    def _kept(
        self,
        part: str,
        incidents: Sequence[tuple[float, float]],
        settings: dict[str, Any],
        said: str,
    ) -> Record:
        """Stack of directions that is kept: in the folder, or for one."""
        if self.chosen is not None:
            part += f"_{self.chosen}".replace(":", "_")
        where, specimens = self.where, {self.name: self.specimen}
        if where.folder is not None:
            where = self._where(where.folder, part)
        stack = records_of(specimens, incidents, where, settings, said)[self.name]
        if self.where.folder is None:
            self.rounds.append((part, stack, incidents, settings))
        return stack

    def check_functions(self, incident: tuple[float, float]) -> None:
        """Raise SpecimenError if samples contradict the integral of a known direction.

        By more than the tolerance. An estimator that was asked for is trusted.
        """
        if len(self.estimators) == 1 or not self.estimators[0].integrates:
            return
        settings = self.settings | {"estimator": Estimator.WEIGHTED, "rays": PROBE_RAYS}
        said = f"{abridged(self.name, 16)}, is sample() like eval()?"
        record = self._kept("functions", [incident], settings, said)
        integral = self.records[incident]
        error = prediction_error(record, integral.flux_fraction)
        if error.exceeds(self.tolerance):
            settings = settings | {"rays": AGAIN * PROBE_RAYS}
            record = self._kept("functions_again", [incident], settings, said)
            error = prediction_error(record, integral.flux_fraction)
        if error.error - CERTAIN * error.std_err > self.tolerance:
            totals = [f"{one.flux_fraction.sum():.3g}" for one in (record, integral)]
            raise SpecimenError(
                f"sample() and eval() of {self.name:.60} disagree: at theta_i "
                f"{incident[0]:.3g}, {totals[0]} of the light leaves by one and "
                f"{totals[1]} by the other, in part elsewhere; gonio-mi validate tells "
                "which is wrong, and an estimator (weighted or quadrature) says which "
                "to take"
            )

    def keep_in(self, folder: str) -> int:
        """Write all rounds of directions to a folder, from which a campaign carries on.

        Returns how many directions these are.
        """
        for part, stack, incidents, settings in self.rounds:
            where = self._where(folder, part)
            keep(stack, self.name, self.specimen, incidents, where, settings)
        return sum(len(stack) for _, stack, *_ in self.rounds)

    def _where(self, folder: str | PathLike[str], part: str) -> Surroundings:
        """Where a round is measured, which is kept in a folder."""
        own = Path(folder) / folder_name(self.name)
        return replace(self.where, folder=own / part)

    def stack(
        self,
        incidents: Sequence[tuple[float, float]],
        patches: Subdivision | None = None,
    ) -> Record:
        """Stack of directions, which are measured if they are not known.

        With other `patches` they are measured here, and not kept.
        """
        said = "are patches fine?"
        if patches is None:
            self.measure(incidents, said)
            return Record.stack(self.records[one] for one in incidents)
        where = replace(self.where, folder=None)
        settings = (
            self.settings | self._goals(NOISE * self.tolerance) | {"collector": patches}
        )
        specimens = {self.name: self.specimen}
        return records_of(specimens, incidents, where, settings, said)[self.name]

    def probe(
        self, incident: tuple[float, float], patches: Subdivision | None = None
    ) -> Record:
        """Record of a direction, of a few rays, which is not kept."""
        where = replace(self.where, folder=None, progress=False)
        settings = self.settings | {
            "estimator": self.estimators[0],
            "rays": PROBE_RAYS,
        }
        settings |= {} if patches is None else {"collector": patches}
        specimens = {self.name: self.specimen}
        return records_of(specimens, [incident], where, settings)[self.name][0]

    def announce(self, expected: float) -> None:
        """Warn, once, if so many directions in all will take long."""
        more = expected - len(self.records)
        left = more * self.seconds / max(self.n_timed, 1)
        if left > LONG and not self.announced:
            self.announced = True
            warnings.warn(
                f"{self.name}: {self.n_timed} directions took {self.seconds:.0f} s; at "
                f"least some {more:.0f} more are expected, {left / 3600:.1f} hours; a "
                "larger tolerance needs less",
                RuntimeWarning,
                stacklevel=2,
            )

    def _goals(self, noise: float) -> dict[str, Any]:
        """Estimator, and how precise each direction is to be."""
        if self.estimators[0].integrates:
            rel_err = INTEGRAL * self.tolerance
            return {"estimator": self.estimators[0], "rel_err": rel_err}
        return {"estimator": self.estimators[0], "noise": noise}


def folder_name(name: str) -> str:
    """Name of the folder of a specimen, whose own name may be a path.

    What tells names apart that would be written alike is behind it.
    """
    digest = hashlib.blake2s(name.encode(), digest_size=4).hexdigest()
    return f"{re.sub(r'[^A-Za-z0-9.,=+-]+', '_', name)[:80]}_{digest}"
