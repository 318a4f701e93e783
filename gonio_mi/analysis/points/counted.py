"""Points of a record, which knows the hits that its values are counted by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...array_types import Floats, Integers
from ...results.record import Record
from ...results.tally import without_chance
from .points import MANY_HITS, Points

# Degrees of freedom of errors that are not estimated from batches.
MANY_DOF = 1e9


@dataclass(frozen=True, eq=False, kw_only=True)
class CountedPoints(Points):
    """BRDF or BTDF of a record at some patches, of one incident direction.

    ``roots.T @ roots`` is the covariance that independent batches tell. Integrals have
    none, and their `chance` bounds what they are wrong by: no score of a point or a sum
    is larger by chance than the same bound allows.

    Attributes
    ----------
    chance : ndarray, shape (n,)
        Standard errors of the rays in 1/sr, NaN without a hit; `std_err` is what was
        stated beside them.
    chance_dof : float
        Its degrees of freedom.
    counts : ndarray
        Hits.
    exposure : ndarray
        Hits per unit of value.
    weight, usual : ndarray
        Mean flux of a hit, and that of all hits in the hemisphere.
    solid : ndarray
        Projected solid angles.
    """

    chance: Floats
    chance_dof: float
    counts: Floats
    exposure: Floats
    weight: Floats
    usual: Floats
    solid: Floats

    @classmethod
    def of(
        cls,
        record: Record,
        index: int,
        hemisphere: Integers | int,
        channel: Integers | int,
        patch: Integers,
    ) -> CountedPoints:
        """Points at flat patch indices, of each its hemisphere and channel."""
        hemisphere, channel, patch = np.broadcast_arrays(hemisphere, channel, patch)
        one, tally = record[index], record.tallies[index]
        estimates = record.estimates[index]
        row, column = np.divmod(patch, record.subdivision.shape[1])
        where = (hemisphere, row, column, channel)
        pair: Any = (one.brdf, one.btdf) if record.has_lower else (one.brdf,)
        errors: Any = (one.brdf_std_err, one.btdf_std_err)[: len(pair)]
        solid = record.subdivision.projected_solid_angles[row, column]
        value = np.stack(pair)[where]
        known: dict[str, Any] = {
            "value": value,
            "std_err": np.zeros_like(value),
            "chance": np.stack(errors)[where],
            "solid": solid,
        }
        if without_chance([tally]):
            return cls(
                **known,
                chance_dof=MANY_DOF,
                counts=np.full(len(value), MANY_HITS),
                exposure=MANY_HITS * solid,
                weight=np.ones(len(value)),
                usual=np.ones(len(value)),
            )
        hits, rays = estimates.hits[where[:3]], estimates.rays
        flux = tally.sums.sum(axis=(0, 2, 3), dtype=float) / tally.scale
        all_hits = estimates.hits.sum(axis=(1, 2))[:, None]
        mean_weight = flux / np.maximum(all_hits, 1)
        usual = np.where(mean_weight > 0, mean_weight, 1.0)[hemisphere, channel]
        # the mean weight of a hit, as far as the flux that came with it
        weight = np.where(hits > 0, value * solid * rays / np.maximum(hits, 1), usual)
        weight = np.where(weight > 0, weight, usual)
        roots = Points.of_record(record, index, where).roots / solid
        return cls(
            **known,
            roots=roots,
            chance_dof=MANY_DOF if estimates.binomial else len(roots) - 1.0,
            counts=hits.astype(float),
            exposure=rays * solid / weight,
            weight=weight,
            usual=usual,
        )

    @property
    def hits(self) -> Floats:
        """See :class:`Points`."""
        return self.counts

    @property
    def reported_error(self) -> Floats:
        """See :class:`Points`."""
        return self.chance

    @property
    def ray_error(self) -> Floats:
        """Standard error of the rays; one hit's worth where there was none.

        The sum of a batch is not trusted to more than a rounded hit, 1/12 in square,
        where points so regular that batches hardly differ claim it.
        """
        rounded = np.sqrt(len(self.roots) / 12) / self.exposure
        known = np.isfinite(self.chance)
        return np.where(known, np.maximum(self.chance, rounded), 1 / self.exposure)

    @property
    def error(self) -> Floats:
        """See :class:`Points`."""
        return np.hypot(self.ray_error, self.std_err)

    @property
    def welch(self) -> Floats:
        """See :class:`Points`."""
        return self.ray_error**4 / self.chance_dof + super().welch

    def total(self, weight: Floats) -> tuple[float, float, float]:
        """See :class:`Points`; with the scatter of the batches' sums, if there is."""
        dof = self.chance_dof
        if not len(self.roots):  # errors of integrals may be all of one sign
            variance = (self.ray_error @ weight) ** 2
        elif len(self.roots) < 2:
            variance = self.ray_error**2 @ weight**2
        else:
            variance, dof = np.sum((self.roots @ weight) ** 2), len(self.roots) - 1
        stated = self.std_err**2 @ weight**2
        welch = variance**2 / dof + super().welch @ weight**4
        return float(self.value @ weight), float(variance + stated), float(welch)

    def correlation(self, sigma: Floats) -> tuple[Floats, float]:
        """See :class:`Points`; nothing is known of it from fewer than three batches."""
        if len(self.roots) < 3:
            return np.zeros((0, len(self.value))), np.inf
        norm = np.sqrt(np.sum(self.roots**2, axis=0))
        share = np.where(norm > 0, self.ray_error / sigma, 0.0)
        return self.roots * (share / np.where(norm > 0, norm, 1.0)), len(self.roots) - 1
