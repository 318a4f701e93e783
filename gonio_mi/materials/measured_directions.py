"""Directions that a campaign has measured, and the material that they make."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..campaigns.execution import ExecutionContext, records_of
from ..campaigns.folder import folder_name
from ..collector import Subdivision
from ..errors import LABEL, SettingError, SpecimenError, abridged, warn
from ..estimators import METHODS
from ..progress import MIN_ANNOUNCED, note
from ..results.azimuth_symmetry import AzimuthSymmetry
from ..results.campaign_outcome import PredictionError
from ..results.patch_means import PatchMeans
from ..results.prediction_error import expected_noise, prediction_error
from ..results.record import Record
from ..settings import Estimator, MeasurementSettings
from ..settings.measurement_settings import ANY_SPECIMEN
from ..specimen.specimen_text import SpecimenLike
from ..transport.method import Method
from .interpolation.lobes import check_table, is_significant
from .prediction import Prediction

logger = logging.getLogger(__name__)

# Parts of the tolerance. What noise may misplace: at the directions of a material and,
# to begin with, at those that test it; where this leaves a test open, and in tests of a
# symmetry, which may misplace half the tolerance; and where that leaves it open too.
# Last, what an integral may be off by. Between directions noise is averaged: of three
# quarters a half is left, which adds about by squares, so that it costs 13 % of the
# tolerance. Of a half it would be 6 %, for twice the rays.
NOISE, TESTING, CONFIRMING, INTEGRAL = 3 / 4, 1 / 2, 1 / 4, 1 / 10

# Fraction of an error that noise masks. Of a difference of x standard errors
# x erfc(x / sqrt(2)) of them is lost, at most 0.34, and noise is sqrt(2 / pi) of them:
# at most 0.43, or a half in as few as four batches. If all differences up to x = 3 are
# equally frequent, a fifth is lost on average.
HIDDEN_AT_MOST, HIDDEN_ON_AVERAGE = 1 / 2, 1 / 5

# Rays that tell whether sample() is as eval() says; where they seem to contradict, so
# many times as many decide, by so many standard errors. These are of misplaced light
# and up to 2.2 times too small, and those of the light in all may be twice as large: a
# right plugin of spiky weights is not beyond 3.6 of its own.
PROBE_RAYS = 2**18
REPEAT_FACTOR, N_STD_ERRS_REFUSED = 16, 16


def may_exceed(error: PredictionError, tolerance: float, noise: float) -> bool:
    """Whether the true error may be above a tolerance.

    By two standard errors, and what `noise`, a part of the tolerance, can hide.
    """
    seen = error.error + 2 * error.std_err
    return seen + HIDDEN_AT_MOST * noise * tolerance > tolerance


class EstimatorRefusedError(Exception):
    """A direction refuses an estimator, where another may be taken."""


class MeasuredDirections:
    """Records of a specimen by incident direction, and the material that they make.

    They are the same wherever they are measured, and as precise as the tolerance asks.

    Parameters
    ----------
    name : str
    specimen : object
        What :func:`~gonio_mi.campaigns.measure.measure` takes.
    tolerance : float
        Fraction of the flux that leaves; see
        :class:`~gonio_mi.results.campaign_outcome.PredictionError`.
    where : ExecutionContext
    settings : dict
        All other settings of a measurement.
    relative : float, optional
        Largest relative error of a bright patch; see the same.

    Attributes
    ----------
    records : dict
        By polar angle and azimuth in degrees.
    rays : int
        That were sent for them, also for those that were too noisy.
    flux : ndarray, shape (2,)
        Reflectances and transmittances, each summed over all of them.
    n_kept : int
        How many the folder of `where` holds of the specimen.
    """

    def __init__(
        self,
        name: str,
        specimen: SpecimenLike,
        tolerance: float,
        where: ExecutionContext,
        settings: dict[str, Any],
        relative: float | None = None,
    ) -> None:
        self.relative = relative
        for other in ("rays", "rel_err", "noise"):
            if settings.get(other) is not None:
                raise SettingError(f"tolerance and {other} are mutually exclusive")
        self.name, self.specimen, self.tolerance = name, specimen, tolerance
        self.where, self.settings = where, settings
        self.estimators = [Estimator.QUADRATURE, Estimator.SPLIT, ANY_SPECIMEN]
        given = {name for name, value in settings.items() if value is not None}
        estimator = MeasurementSettings.among(settings).estimator
        if "estimator" in given and estimator is not Estimator.AUTO:
            self.estimators = [estimator]
        self.chosen: Subdivision | None = None  # where no collector was asked for
        self.n_kept, self.announced = 0, False
        self._forget()

    @property
    def method(self) -> Method:
        """The estimator that measures, until it is refused."""
        return METHODS[self.estimators[0]]

    def _forget(self) -> None:
        """Begin without any direction."""
        self.records: dict[tuple[float, float], Record] = {}
        self.rays = self.n_rounds = self.n_timed = 0
        self.expected, self.seconds, self.flux = 0.0, 0.0, np.zeros(2)

    def start_anew(self, patches: Subdivision | None = None) -> None:
        """Forget all directions; take the next estimator, or `patches` if given."""
        if patches is None:
            del self.estimators[0]
        else:
            self.chosen = patches
            self.settings = self.settings | {"collector": patches}
        self._forget()

    def measure(
        self,
        incidents: Iterable[tuple[float, float]],
        purpose: str,
        noise: float = NOISE,
        seed: int | None = None,
    ) -> None:
        """Measure the directions that are not known yet, or not as precisely.

        `purpose` stands beside the progress bar; `noise` is the total variation
        distance that it may make where directions are sampled, over the tolerance;
        `seed` is that of points of the surface that the others do not share.

        Raises
        ------
        EstimatorRefusedError
            If a direction refuses the estimator, and none was asked for.
        """
        goal = noise * self.tolerance
        # not known, or sampled and not as precise
        found = ((one, self.records.get(one)) for one in set(incidents))
        new = sorted(i for i, r in found if r is None or (r.asked.noise or 0.0) > goal)
        if not new:
            return
        started = time.perf_counter()
        label = f"{abridged(self.name, 24)}, {purpose}"
        logger.info("%s: %d more", label, len(new))
        part = f"{self.estimators[0]}_{self.n_rounds:03d}"
        settings = self.settings | self._goals(goal)
        if seed is not None and self.method.shares_points:
            settings["seed"] = seed
        known, expected = len(self.records.keys() - set(new)), self.expected
        where = replace(self.where, measured=known, expected=expected)
        stack = self._kept(part, new, settings, label, where)
        self.rays += stack.ledger.emitted
        flux = stack.flux_fraction
        self.flux += flux[:, :1].sum(), flux[:, 1:].sum()
        self.records |= zip(new, stack)
        self.n_rounds, self.n_timed = self.n_rounds + 1, self.n_timed + len(new)
        self.seconds += time.perf_counter() - started

    def _kept(
        self,
        part: str,
        incidents: Sequence[tuple[float, float]],
        settings: dict[str, Any],
        label: str,
        where: ExecutionContext | None = None,
    ) -> Record:
        """Stack of directions that is kept in a part of the folder, if there is one."""
        where = where or self.where
        if where.folder is not None:
            if self.chosen is not None:
                part += f"_{self.chosen}".replace(":", "_")
            own = Path(where.folder) / folder_name(self.name)
            where = replace(where, folder=own / part)
        stack = self._stack(incidents, where, settings, label)
        self.n_kept += len(stack)
        return stack

    def _stack(
        self,
        incidents: Sequence[tuple[float, float]],
        where: ExecutionContext,
        settings: dict[str, Any],
        label: str | None = None,
    ) -> Record:
        """Stack of directions, measured anew or found in the folder of `where`.

        Rays alone tell a round that `split` refuses, if it has told others before.
        """
        specimens = {self.name: self.specimen}
        try:
            return records_of(specimens, incidents, where, settings, label)[self.name]
        except SpecimenError as error:
            if len(self.estimators) == 1:
                raise
            own = settings["estimator"]
            if not (self.records and METHODS[own].shares_points):
                raise EstimatorRefusedError(error) from error
            logger.info("%s: rays alone in this round: %s", self.name, error)
        settings = settings | {"estimator": ANY_SPECIMEN}
        if where.folder is not None:
            where = replace(where, folder=f"{where.folder}_{ANY_SPECIMEN}")
        stack = self._stack(incidents, where, settings, label)
        # what holds of intervals and sums of points and rays holds of rays alone
        return replace(stack, asked=replace(stack.asked, estimator=own))

    def check_functions(self, incident: tuple[float, float]) -> None:
        """Raise SpecimenError if samples contradict the integral of a known direction.

        By more than the tolerance. An estimator that was asked for is trusted.
        """
        if len(self.estimators) == 1:
            return
        settings = self.settings | {"estimator": ANY_SPECIMEN, "rays": PROBE_RAYS}
        label = f"{abridged(self.name, 12)}, is sample() like eval()?"
        record = self._kept("functions", [incident], settings, label)
        integral = self.records[incident]
        error = prediction_error(record, integral.flux_fraction)
        if error.exceeds(self.tolerance):
            settings = settings | {"rays": REPEAT_FACTOR * PROBE_RAYS}
            record = self._kept("functions_again", [incident], settings, label)
            error = prediction_error(record, integral.flux_fraction)
        if error.error - N_STD_ERRS_REFUSED * error.std_err > self.tolerance:
            totals = [f"{one.flux_fraction.sum():.3g}" for one in (record, integral)]
            raise SpecimenError(
                f"sample() and eval() of {abridged(self.name, LABEL)} disagree: at "
                f"theta_i {incident[0]:.3g}, {totals[0]} of the flux leaves by one and "
                f"{totals[1]} by the other, in part elsewhere; gonio-mi validate tells "
                f"which is wrong, and an estimator (weighted or {self.estimators[0]}) "
                "says which to take"
            )

    def stack(
        self,
        incidents: Sequence[tuple[float, float]],
        patches: Subdivision | None = None,
    ) -> Record:
        """Stack of directions, which are measured if they are not known.

        With other `patches` they are measured here, and not kept.
        """
        purpose = "are patches fine?"
        if patches is None:
            self.measure(incidents, purpose)
            return self.stacked(self.records[one] for one in incidents)
        settings = self.settings | self._goals(NOISE * self.tolerance)
        return self._stack(
            incidents,
            replace(self.where, folder=None),
            settings | {"collector": patches},
            purpose,
        )

    def stacked(self, records: Iterable[Record]) -> Record:
        """Stack of records, some of which may be more precise than the others."""
        noise = self._goals(NOISE * self.tolerance).get("noise")
        return Record.stack(
            replace(one, asked=replace(one.asked, noise=noise)) for one in records
        )

    def probe(
        self, incident: tuple[float, float], patches: Subdivision | None = None
    ) -> Record:
        """Record of a direction, of a few rays, which is not kept."""
        settings = {"estimator": self.estimators[-1], "rays": PROBE_RAYS}
        settings |= {} if patches is None else {"collector": patches}
        where = replace(self.where, folder=None, progress=False)
        return self._stack([incident], where, self.settings | settings)[0]

    def announce(self, expected: float, most: float = 0) -> None:
        """Tell the progress bar how many directions in all there may be.

        Warn, once, if they will take long. With `most` of them, of an anisotropic
        specimen, both numbers are told where progress is shown.
        """
        self.expected, more = expected, expected - len(self.records)
        each = self.seconds / max(self.n_timed, 1)
        left = more * each
        if most and self.where.progress:
            longest = (most - len(self.records)) * each
            note(
                f"{abridged(self.name, 24)}: about {expected:.0f} directions "
                f"({left:.0f} s) or more if isotropic, otherwise about {most:.0f} "
                f"({longest:.0f} s)"
            )
        if left > MIN_ANNOUNCED and not self.announced:
            self.announced = True
            warn(
                f"{self.name}: {self.n_timed} directions took {self.seconds:.0f} s; at "
                f"least some {more:.0f} more are expected, {left / 3600:.1f} hours; a "
                "larger tolerance needs less"
            )

    def _goals(self, noise: float) -> dict[str, Any]:
        """Estimator, and how precise each direction is to be."""
        if self.method.integrates:
            rel_err = INTEGRAL * self.tolerance
            return {"estimator": self.estimators[0], "rel_err": rel_err}
        return {"estimator": self.estimators[0], "noise": noise}

    # ------------------------------------------------------------------- the material

    @property
    def patches(self) -> Subdivision:
        """What all directions are measured in."""
        return next(iter(self.records.values())).subdivision

    def prediction(
        self,
        incidents: Iterable[tuple[float, float]],
        symmetry: AzimuthSymmetry | None = None,
    ) -> Prediction:
        """Of some known directions, and their images, of which no counts are copied."""
        symmetry = symmetry or AzimuthSymmetry(self.patches.shape[1])
        sources = symmetry.sources(self.records, incidents)
        flux = [
            motion.moved(self.records[source].flux_fraction, 2)
            for source, motion in sources.values()
        ]
        theta_i, phi_i = np.array(list(sources)).T
        means = PatchMeans(self.patches, theta_i, phi_i, self._channels, np.array(flux))
        return Prediction.within(self.tolerance, means)

    def error(
        self, prediction: Prediction, theta: float, phi: float
    ) -> PredictionError:
        """Error of a prediction at a known direction."""
        found = prediction_error(self.records[theta, phi], prediction.flux(theta, phi))
        if self.relative is None:
            return found
        return replace(found, relative_weight=self.tolerance / self.relative)

    def expected_error(self, prediction: Prediction, theta: float, phi: float) -> float:
        """Error of a prediction at a known direction, with what noise there hides."""
        error, record = self.error(prediction, theta, phi), self.records[theta, phi]
        noise = record.asked.noise
        if noise is None or record.n_batches < 2:
            return error.error
        hidden = HIDDEN_ON_AVERAGE * min(noise, expected_noise(record))
        return max(error.error, error.total_variation + hidden)

    def check_size(self, azimuths: Iterable[float], n_angles: int) -> None:
        """Raise TooLargeError if the table of such a material is too large.

        Parameters
        ----------
        azimuths : iterable of float
            Of all its directions, images included, in degrees.
        n_angles : int
            Polar angles.
        """
        n_hemispheres = 1 + is_significant(self.flux[1], self.flux.sum())
        lobes = n_hemispheres, *self.patches.shape, len(self._channels)
        check_table(len(set(azimuths)), n_angles, lobes)

    @property
    def _channels(self) -> tuple[str, ...]:
        return next(iter(self.records.values())).channels
