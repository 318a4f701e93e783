"""A campaign that chooses its incident directions, until their material is right."""

from __future__ import annotations

import copy
import itertools
import logging
import shutil
import tempfile
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..campaigns.execution import ExecutionContext
from ..errors import SpecimenError, checked_number, warn
from ..results.azimuth_symmetry import AzimuthSymmetry, Motion, azimuth_of
from ..results.campaign_outcome import MAX_LOOKS, CampaignOutcome, PredictionError
from ..results.record import Record
from ..settings import MeasurementSettings
from .interpolation.lobes import TooLargeError
from .measured_directions import (
    CONFIRMING,
    NOISE,
    TESTING,
    EstimatorRefusedError,
    MeasuredDirections,
    may_exceed,
)
from .refinement import Axis, IncidentRings, Interval, refined
from .resolution import (
    TooCoarseError,
    check_patches_resolve,
    check_peaks,
    checked_sectors,
)
from .symmetry_recognition import N_TURNED, SymmetryRecognition

logger = logging.getLogger(__name__)

# What single precision and the points of a prediction leave of a tolerance.
MIN_TOLERANCE = 1e-4

# Polar angles, and azimuths of an anisotropic specimen, to begin with: from a tolerance
# of COARSE on fewer, whose middles, which are looked at, are as many as the others.
N_FIRST = 4, 8
COARSE, N_COARSE = 0.02, (3, 4)

# Directions never used that confirm the material, and how many may miss it in
# two looks together if any does in the last: two in a single look would let one
# material in three pass that misses a twelfth of all directions. It is refined where
# any did, and looked at anew, MAX_LOOKS times at most.
N_UNSEEN, MAX_MISSES = 40, 2

# Misses of a look that are mended where they are; for more, azimuths are refined all
# over, to half the limit: about what noise alone makes, so that most gaps are halved.
MAX_LOCAL_MISSES = 1

# Fraction of the scattered flux above which a specimen transmits, and light from behind
# is measured too: rays that slip between triangles are fewer.
MIN_TRANSMITTED = 1e-3

# What helps where directions never used go on missing the tolerance, and why.
OUTGROWN = (
    "more directions would exceed the memory: a collector of fewer patches, or a "
    "larger tolerance, helps"
)
CLOSEST = "its directions are as close to each other as they may be: "
TOLERANT = "a larger tolerance helps, another collector does not"
MORE_SECTORS = "a collector of more sectors, or a larger tolerance, helps"
LOOKED = f"it was refined for them {MAX_LOOKS - 1} times: a larger tolerance helps"


class WholeBsdf:
    """All incident directions that the material of one specimen needs.

    The directions depend on what was measured, and that on the seed: they are the same
    wherever it is measured, and what a folder holds is not measured again.

    Parameters
    ----------
    directions : MeasuredDirections
        Of which none is measured yet.
    theta_max : float
        In degrees, up to where the material shall be right.
    """

    def __init__(self, directions: MeasuredDirections, theta_max: float) -> None:
        self.directions, self.theta_max = directions, theta_max
        self.name, self.tolerance = directions.name, directions.tolerance
        asked = MeasurementSettings.among(directions.settings)
        self.seed = asked.seed
        self.n_first = N_FIRST if self.tolerance < COARSE else N_COARSE
        self.knows_peaks = False
        self.has_own_collector = directions.settings.get("collector") is not None
        if self.has_own_collector:
            checked_sectors(asked.collector)

    def measured(self) -> Record:
        """Stack of the directions that the material needs, with its errors.

        Integrals where the specimen allows it, else rays; where no collector is asked
        for, and the default is too coarse, one whose patches resolve the lobes.

        Raises
        ------
        SpecimenError
            If lobes are narrower than the patches that were asked for.
        """
        while True:
            try:
                return self._measured()
            except EstimatorRefusedError as error:
                logger.info("%s: another estimator: %s", self.name, error)
                self.directions.start_anew()
            except TooCoarseError as error:
                if self.has_own_collector:
                    raise
                logger.info("%s: the collector is %s", self.name, error.enough)
                self.directions.start_anew(error.enough)

    def _measured(self) -> Record:
        """Recognise the specimen, and choose directions until they hold."""
        if not (self.directions.method.integrates or self.knows_peaks):
            check_peaks(self.directions, self.theta_max)
            self.knows_peaks = True
        angles = np.linspace(0, self.theta_max, self.n_first[0]).tolist()
        first = [(theta, 0.0) for theta in angles]
        self.directions.measure(first, "first directions", TESTING)
        self.directions.check_functions((angles[1], 0.0))
        self.directions.announce(len(angles) + N_UNSEEN)  # at least
        n_sectors = checked_sectors(self.directions.patches).n_phi
        check_patches_resolve(self.directions, angles[-2:])
        self._announce_first(len(angles) - 1)
        self.recognition = SymmetryRecognition(self.directions, angles)
        self.isotropic = self.recognition.is_isotropic()
        self.symmetry = AzimuthSymmetry(n_sectors)
        quarter = azimuth_of(round(n_sectors / 4), n_sectors)
        if not self.isotropic:
            # lobes that are wide along this azimuth may be narrow along the other
            check_patches_resolve(self.directions, angles[-2:], quarter)
            self.symmetry = self.recognition.symmetry()
        self._refine(angles)
        while (errors := self._confirmed()) is None:
            if self.isotropic:
                check_patches_resolve(self.directions, angles[-2:], quarter)
            self.isotropic, self.symmetry = False, AzimuthSymmetry(n_sectors)
            self._refine(angles)
        return self._described(errors)

    def _refine(self, angles: Sequence[float]) -> None:
        """Refine polar angles, then azimuths, as far as middles of intervals tell."""
        n_azimuths = 1 if self.isotropic else self.n_first[1]
        self.rings = IncidentRings(angles, self.symmetry, n_azimuths)
        # errors along both axes add up by their squares, about
        self.limit = self.tolerance * (1.0 if self.isotropic else 0.5**0.5)
        self._check()
        self._refine_axis(self.rings.segments, self.limit)
        if not self.isotropic:
            self.rings.begin_gaps()
            self._refine_axis(self.rings.gaps, self.limit)

    def _refine_axis(self, axis: Axis, limit: float) -> None:
        """Refine polar angles or azimuths, as far as middles of intervals tell."""
        errors_at: Callable[..., list[float]] = self._errors_of_gaps
        of = "azimuths"
        if axis is self.rings.segments:
            errors_at, of = self._errors_of_segments, "angles"
        try:
            self._check()
            refined(axis, limit, errors_at, self._check)
        except TooLargeError as error:
            logger.info("%s: no more %s: %s", self.name, of, error)

    def _check(self) -> None:
        """Raise TooLargeError if the material's table would not fit into memory."""
        levels = self.rings.segments.levels()
        azimuths = {phi for theta in levels[1:] for _, phi in self.rings.ring(theta)}
        azimuths |= set(self.rings.first_azimuths)
        every = {one.azimuth(phi) for phi in azimuths for one in self.symmetry.motions}
        self.directions.check_size(every, len(levels))

    def _announce_first(self, n_segments: int) -> None:
        """Tell how many directions are expected before the first of them are chosen."""
        known = len(self.directions.records) + N_TURNED + N_UNSEEN
        # twice as many segments, and gaps, as there are at first
        most = 2 * n_segments * 2 * self.n_first[1]
        self.directions.announce(known + n_segments, known + most)

    def _announce(self) -> None:
        """Tell how many directions are expected by what the known ones tell."""
        records, levels = self.directions.records, self.rings.segments.levels()
        known = sum(theta in levels for theta, _ in records)
        more = max(self.rings.expected(self.limit) - known, 0)
        self.directions.announce(len(records) + more + N_UNSEEN)

    # ------------------------------------------------------------------- predicting

    def _errors_of_segments(
        self, _: Sequence[Interval], middles: Sequence[float]
    ) -> list[float]:
        """Errors in the middles of segments: the largest of all first azimuths."""
        self._announce()
        first = self.rings.first_azimuths
        levels = self.rings.segments.levels()
        lines = [[(theta, phi if theta else 0.0) for theta in levels] for phi in first]
        new = [(theta, phi) for theta in middles for phi in first]
        self.directions.measure([*itertools.chain(*lines), *new], "polar angles")
        errors = []
        for phi, line in zip(first, lines):
            prediction = self.directions.prediction(line)
            expected = partial(self.directions.expected_error, prediction, phi=phi)
            errors.append(list(map(expected, middles)))
        return np.max(errors, axis=0, initial=0.0).tolist()

    def _errors_of_gaps(
        self, gaps: Sequence[Interval], middles: Sequence[float]
    ) -> list[float]:
        """Errors in the middles of gaps between azimuths of rings."""
        self._announce()
        middles = [self.rings.azimuth(sector) for sector in middles]
        new = [(gap.on, phi) for gap, phi in zip(gaps, middles)]
        self.directions.measure([*self.rings.directions(), *new], "azimuths")
        of_ring = defaultdict(list)
        for number, gap in enumerate(gaps):
            of_ring[gap.on].append(number)
        errors = [0.0] * len(gaps)
        for theta, numbers in of_ring.items():
            ring = self.rings.ring(theta)
            prediction = self.directions.prediction(ring, self.symmetry)
            for number in numbers:
                errors[number] = self.directions.expected_error(
                    prediction, theta, middles[number]
                )
        return errors

    # ------------------------------------------------------------------- confirming

    def _confirmed(self) -> list[PredictionError] | None:
        """Errors at directions never used, few of which miss the tolerance.

        Where they do, the material is refined, as long as it can be and its table fits
        into memory. None if the specimen is not as symmetric there as it seemed.
        """
        before = MAX_MISSES
        errors: list[PredictionError] = []
        fitting, self.helps = self.rings, LOOKED
        for number in range(MAX_LOOKS):
            generator = np.random.default_rng([self.seed, number])
            height = 1 - np.cos(np.radians(self.theta_max))  # of the cap
            cosines = 1 - height * generator.random(N_UNSEEN)
            theta = np.degrees(np.arccos(cosines))
            phi = 360 * generator.random(N_UNSEEN)
            unseen = list(zip(theta.tolist(), phi.tolist()))
            try:
                errors = self._errors_at(unseen)
            except TooLargeError as error:
                if not errors:
                    raise
                logger.info("%s: not refined further: %s", self.name, error)
                self.rings, self.helps = fitting, OUTGROWN
                break
            missed = [one for one in errors if one.exceeds(self.tolerance)]
            worst = [f"{one.error:.2g} at {one.theta_i:.1f}" for one in missed]
            logger.info(
                "%s: %d of %d missed: %s", self.name, len(missed), N_UNSEEN, worst
            )
            enough = not missed or len(missed) + before <= MAX_MISSES
            if enough or number == MAX_LOOKS - 1:
                break
            before = len(missed)
            worst_one = max(missed, key=lambda one: one.error)
            if self._is_refuted_at(worst_one.theta_i, worst_one.phi_i):
                return None
            fitting = copy.deepcopy(self.rings)
            if not self.rings.split_at(missed):
                self.helps = CLOSEST + (TOLERANT if self.isotropic else MORE_SECTORS)
                break
            if len(missed) > MAX_LOCAL_MISSES and not self.isotropic:
                # errors of both axes add up in between, and azimuths are the cheaper
                self._refine_axis(self.rings.gaps, self.limit / 2)
        return errors

    def _is_refuted_at(self, theta: float, phi: float) -> bool:
        """Whether the specimen is not as symmetric at a direction as it seemed."""
        motions = self.symmetry.generators
        if self.isotropic:  # turned to about the azimuth of the material
            n = self.symmetry.n_sectors
            motions = [Motion(n - round(phi * n / 360), False, n)]
        return self.recognition.is_any_refuted(motions, theta, phi)

    def _errors_at(
        self, unseen: Sequence[tuple[float, float]]
    ) -> list[PredictionError]:
        """What is wrong at directions, with less noise where that may be too much."""
        purpose = "random tests only"
        self._check()
        own = self.rings.directions()
        self.directions.measure(own, purpose)
        self.directions.announce(len(self.directions.records) + N_UNSEEN)
        prediction = self.directions.prediction(own, self.symmetry)
        found: dict[tuple[float, float], PredictionError] = {}
        left = unseen
        for noise in (NOISE, TESTING, CONFIRMING):
            self.directions.measure(left, purpose, noise, self.seed + 1)
            found |= {one: self.directions.error(prediction, *one) for one in left}
            if self.directions.method.integrates:
                break
            left = [
                one for one in left if may_exceed(found[one], self.tolerance, noise)
            ]
        return list(found.values())

    def _described(self, errors: Sequence[PredictionError]) -> Record:
        """The material's record, with what is known of its errors."""
        known = self.directions.records
        every = self.symmetry.whole(known, self.rings.directions())
        record = self.directions.stacked(every)
        directions = zip(record.theta_i.tolist(), record.phi_i.tolist())
        within = np.mean([not one.exceeds(self.tolerance) for one in errors])
        outcome = CampaignOutcome(
            tolerance=self.tolerance,
            theta_max=self.theta_max,
            isotropic=self.isotropic,
            turns=self.symmetry.turns,
            mirror=self.symmetry.mirror_azimuth,
            copies=tuple(one for one in directions if one not in known),
            measured=len(known),
            rays=self.directions.rays,
            within=float(within),
            unseen=tuple(errors),
        )
        if sum(one.exceeds(self.tolerance) for one in errors) > MAX_MISSES:
            warn(
                f"tolerance of {self.tolerance:g} was not reached for {self.name}: of "
                f"{N_UNSEEN} random directions that only test it {within:.0%} are "
                f"within it, and {self.helps}"
            )
        return record.with_provenance(campaign=outcome)


def _with_back(front: WholeBsdf, record: Record, materials: list[WholeBsdf]) -> Record:
    """Record with that of light from behind, if the specimen transmits.

    A side that was asked for is alone. `materials` gets what is measured besides.
    """
    known, flux = front.directions, record.flux_fraction
    transmits = flux[:, 1:].sum() > MIN_TRANSMITTED * flux.sum()
    if known.settings.get("side") or record.asked.side == "back" or not transmits:
        return record
    settings = known.settings | {"side": "back"}
    if known.chosen is not None:  # for the front
        settings["collector"] = None
    asked = known.specimen, known.tolerance, known.where, settings, known.relative
    name = f"back of {known.name}"
    back = WholeBsdf(MeasuredDirections(name, *asked), front.theta_max)
    materials.append(back)
    try:
        return replace(record, back=back.measured())
    except SpecimenError as error:
        warn(f"{known.name} transmits, and its back was not measured: {error}")
        return record


def chosen_directions(
    specimens: Mapping[str, Any],
    tolerance: float,
    theta_max: float,
    where: ExecutionContext,
    settings: dict[str, Any],
    relative: float | None = None,
) -> dict[str, Record]:
    """Records of the directions that each specimen needs, as `campaign` says.

    They are kept in a temporary folder if there is no other, which stays after Ctrl-C.
    """
    condition = (
        f"a number from {MIN_TOLERANCE:g}, below which single precision shows, "
        "to below 0.5"
    )
    tolerance = checked_number("tolerance", tolerance, MIN_TOLERANCE, 0.5, condition)
    if relative is not None:
        at_least = "a number from 0.001 to below 10"
        relative = checked_number("relative_tolerance", relative, 1e-3, 10, at_least)
    condition = "degrees from 10 to below 89.5"
    theta_max = checked_number("theta_max", theta_max, 10, 89.5, condition)
    temporary = where.folder is None
    if temporary:
        where = replace(where, folder=tempfile.mkdtemp(prefix="gonio_mi_"))
    materials: list[WholeBsdf] = []
    try:
        for name, specimen in specimens.items():
            asked = specimen, tolerance, where, settings, relative
            known = MeasuredDirections(str(name), *asked)
            materials.append(WholeBsdf(known, theta_max))
        return {
            material.name: _with_back(material, material.measured(), materials)
            for material in list(materials)
        }
    except KeyboardInterrupt:
        n_kept = sum(material.directions.n_kept for material in materials)
        if not (temporary and n_kept):
            raise
        temporary = False  # it stays
        raise KeyboardInterrupt(
            f"{where.folder} holds the {n_kept} directions that were finished: with it "
            "as folder the same campaign carries on"
        ) from None
    finally:
        if temporary and where.folder is not None:
            shutil.rmtree(where.folder, ignore_errors=True)
