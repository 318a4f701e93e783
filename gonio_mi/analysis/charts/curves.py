"""Error over cost: the curves of a chart, their orders, their Pareto front, a table."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from ...annexes import ask
from ...array_types import Floats
from ...files import check_output, replacing
from ...results.summary_text import aligned

# Fewer rays than this for each patch, and a curve is not yet at its order.
MIN_RAYS_PER_PATCH = 30
# Errors that are at least this many times that of the reference say something.
MIN_REFERENCE_RATIO = 3.0
# A straight line with an error needs a degree of freedom.
MIN_POINTS = 3

# Heads of a chart's table; the order is that in the rays, with its standard error.
HEAD = ("method", "CPU s", "times the best", "rays", "order", "error bars / error")
COLUMNS = ("estimator", "sampler", "rays", "cpu_seconds", "error", "error_std_err")


@dataclass(frozen=True)
class Point:
    """Measurements of the same kind and number of rays, with different seeds.

    Attributes
    ----------
    rays : int
        Of one measurement; 0 for integrals, which send none.
    cpu_seconds : float
        Of one measurement: median, over all threads.
    error : float
        Root mean square over patches, channels and seeds of the difference to the
        reference, relative to the mean of the reference.
    error_std_err : float
        From the scatter between the seeds; NaN for one seed.
    claimed : float
        The same root mean square of the records' own standard errors, which should be
        `error`; NaN where they are not known.
    """

    rays: int
    cpu_seconds: float
    error: float
    error_std_err: float
    claimed: float


@dataclass(frozen=True)
class Cost:
    """What it takes to reach an error: `rays`, `cpu_seconds`; whether it was measured.

    What was not reached is extrapolated: errors fall as for independent rays, time
    grows as from the first point to the last. Where that tells nothing, for there is
    one point or time did not grow, all of it is taken to grow with the rays: `at_most`
    so many `cpu_seconds`.
    """

    rays: float
    cpu_seconds: float
    measured: bool
    at_most: bool = False


@dataclass(frozen=True)
class Curve:
    """One method at rising numbers of rays.

    Attributes
    ----------
    estimator, sampler : str
        The sampler of integrals, which send no rays, is empty.
    points : tuple of Point
    """

    estimator: str
    sampler: str
    points: tuple[Point, ...]

    @property
    def label(self) -> str:
        """Words for the method."""
        return f"{self.estimator}, {self.sampler}" if self.sampler else self.estimator

    @property
    def rays(self) -> Floats:
        """Rays of each point, shape ``(n_points,)``."""
        return np.array([point.rays for point in self.points], dtype=float)

    @property
    def cpu_seconds(self) -> Floats:
        """CPU seconds of each point, shape ``(n_points,)``."""
        return np.array([point.cpu_seconds for point in self.points])

    @property
    def error(self) -> Floats:
        """Error of each point, shape ``(n_points,)``."""
        return np.array([point.error for point in self.points])

    def order(self, n_patches: int, least: float) -> tuple[float, float]:
        """Order of convergence in the rays: the error falls as ``rays**-order``.

        Slope of a straight line through the logarithms of the points that have enough
        rays for `n_patches` and an error of at least `least`.

        Returns
        -------
        order, std_err : float
            NaN with fewer than three such points. The standard error is from the
            points' scatter about the line.
        """
        good = self.rays >= MIN_RAYS_PER_PATCH * n_patches
        good &= self.error >= max(least, 1e-9)
        if good.sum() < MIN_POINTS:
            return np.nan, np.nan
        x, y = np.log(self.rays[good]), np.log(self.error[good])
        (slope, _), covariance = np.polyfit(x, y, 1, cov=True)
        return -slope, float(np.sqrt(covariance[0, 0]))

    def claim(self, least: float) -> float:
        """Median of claimed over true error, of the points above `least`; NaN if none.

        It is 1 where error bars hold.
        """
        claims = [p.claimed / p.error for p in self.points if p.error > least]
        return float(np.median(claims)) if claims else np.nan

    def cost(self, target: float) -> Cost:
        """:class:`Cost` of reaching the error `target`, interpolated in logarithms."""
        reached = np.flatnonzero(self.error <= target)
        if not reached.size:
            return self._extrapolated(target)
        k = int(reached[0])
        if k == 0:
            return Cost(self.rays[0], self.cpu_seconds[0], True)
        errors = np.log(np.maximum(self.error[[k, k - 1]], 1e-300))

        def _between(values: Floats) -> float:
            if not values.all():
                return 0.0
            return float(np.exp(np.interp(np.log(target), errors, np.log(values))))

        rays, seconds = self.rays[[k, k - 1]], self.cpu_seconds[[k, k - 1]]
        return Cost(_between(rays), _between(seconds), True)

    def _extrapolated(self, target: float) -> Cost:
        rays, seconds = self.rays, self.cpu_seconds
        more = rays[-1] * ((self.error[-1] / target) ** 2 - 1)
        if seconds[-1] > seconds[0]:  # a fixed part of the time does not grow
            per_ray = (seconds[-1] - seconds[0]) / max(rays[-1] - rays[0], 1)
            return Cost(rays[-1] + more, seconds[-1] + per_ray * more, False)
        per_ray = seconds[-1] / max(rays[-1], 1)
        return Cost(rays[-1] + more, seconds[-1] + per_ray * more, False, at_most=True)


@dataclass(frozen=True, eq=False)
class Reference:
    """What is taken for the truth, and how wrong it may be.

    Attributes
    ----------
    values : ndarray of float64, shape (n_hemispheres, n_theta, n_phi, channels)
        Patch means in 1/sr.
    error : float
        Its own root mean square error over the patches, relative to `mean`.
    mean : float
        Mean BSDF in 1/sr over all patches, by projected solid angle.
    source : str
        Where it comes from.
    refused : str
        Why it is not an integral, if it is none.
    """

    values: np.ndarray
    error: float
    mean: float
    source: str
    refused: str = ""


@dataclass(frozen=True, eq=False)
class Chart:
    """Error over cost of several methods, on one specimen.

    Attributes
    ----------
    specimen : str
    theta_i, phi_i : float
        Incident direction in degrees; NaN for an emitter of finite size.
    collector : str
    curves : tuple of Curve
    reference : Reference
    independent : float
        Expected error of one counted independent ray, by multinomial statistics: that
        of `n` is this over the square root of `n`.
    settings : dict
        ``batches``, ``repeats`` and the like, in JSON's types.
    """

    specimen: str
    theta_i: float
    phi_i: float
    collector: str
    curves: tuple[Curve, ...]
    reference: Reference
    independent: float
    settings: dict[str, Any]

    def _repr_html_(self) -> str:
        """Picture and numbers, for notebooks."""
        shown: str = ask("analysis", "chart_view")(self)
        return shown

    @property
    def n_patches(self) -> int:
        """Patches of all hemispheres that were measured."""
        return int(np.prod(self.reference.values.shape[:3]))

    @property
    def least(self) -> float:
        """Error below which the reference's own error contributes."""
        return MIN_REFERENCE_RATIO * self.reference.error

    def pareto(self) -> list[tuple[Curve, Point]]:
        """Points that no other one beats in both error and CPU seconds, dearest last.

        Returns
        -------
        list of (Curve, Point)
        """
        points = [(curve, point) for curve in self.curves for point in curve.points]
        points.sort(key=lambda entry: (entry[1].cpu_seconds, entry[1].error))
        front: list[tuple[Curve, Point]] = []
        for curve, point in points:
            if not front or point.error < front[-1][1].error:
                front.append((curve, point))
        return front

    def independent_rays(self, error: float) -> float:
        """Counted independent rays that reach `error`, by multinomial statistics."""
        return (self.independent / error) ** 2

    def ranking(self, target: float) -> list[tuple[Curve, Cost]]:
        """Curves and their :class:`Cost` to reach `target`, cheapest first.

        Those that did not reach it come last.
        """
        costs = [(curve, curve.cost(target)) for curve in self.curves]
        costs.sort(key=lambda entry: (not entry[1].measured, entry[1].cpu_seconds))
        return costs

    def advice(self, target: float) -> str:
        """One line: what to use for the error `target`, and what that saves."""
        curve, cost = self.ranking(target)[0]
        text = f"to {target:.2g}: {curve.label}, {cost.cpu_seconds:.2g} CPU s"
        if cost.rays:
            text += f", {cost.rays:.2g} rays"
            saved = self.independent_rays(target) / cost.rays
            if saved > 1:
                text += f", 1/{saved:.3g} of independent ones"
        if cost.measured:
            return text
        return f"{text} (extrapolated{', at most' if cost.at_most else ''})"

    def findings(self, target: float) -> list[str]:
        """What is taken for true, why it is no integral, and what to use."""
        reference = self.reference
        refused = [f"no quadrature: {reference.refused}"] if reference.refused else []
        return [
            f"reference: {reference.source}; its error is {reference.error:.2g}",
            *refused,
            f"use {self.advice(target)}",
            f"use {self.advice(target / 10)}",
        ]

    def rows(self, target: float) -> list[list[str]]:
        """What each method needs for `target`, cheapest first: texts as of `HEAD`."""
        ranking = self.ranking(target)
        best = ranking[0][1].cpu_seconds
        rows = []
        for curve, cost in ranking:
            order, std_err = curve.order(self.n_patches, self.least)
            claim = curve.claim(self.least)
            limit = "below " if cost.at_most else ""
            about = "" if cost.measured else "about "
            rows.append(
                [
                    curve.label,
                    f"{limit or about}{cost.cpu_seconds:.2g}",
                    f"{limit}{cost.cpu_seconds / best:.3g}",
                    f"{about}{cost.rays:.2g}" if cost.rays else "none",
                    "-" if np.isnan(order) else f"{order:.3f} +- {std_err:.3f}",
                    "-" if np.isnan(claim) else f"{claim:.2f}",
                ]
            )
        return rows

    def table(self, target: float) -> str:
        """Lines for people: :meth:`rows` under their heads."""
        return aligned(HEAD, self.rows(target))

    def save_csv(self, path: str | PathLike[str]) -> None:
        """Write every point as a line of a CSV file; facts of the chart in comments.

        Raises
        ------
        ValueError, OSError
            If the name does not end in ``.csv``, or the file cannot be written.
        """
        check_output(path, (".csv",))
        facts = {
            "specimen": self.specimen,
            "theta_i": self.theta_i,
            "phi_i": self.phi_i,
            "collector": self.collector,
            "error": "root mean square over patches, relative to the mean BSDF",
            "mean BSDF (1/sr)": self.reference.mean,
            "reference": self.reference.source,
            "reference error": self.reference.error,
            "error of independent rays times sqrt(rays)": self.independent,
        } | self.settings
        text = io.StringIO()
        for key, value in facts.items():
            text.write(f"# {key}: {value}\n")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow((*COLUMNS, "claimed_error", "pareto"))
        front = {id(point) for _, point in self.pareto()}
        for curve in self.curves:
            for p in curve.points:
                row = (p.rays, p.cpu_seconds, p.error, p.error_std_err, p.claimed)
                whole = (curve.estimator, curve.sampler, *row, int(id(p) in front))
                writer.writerow(whole)
        with replacing(path) as stream:
            stream.write(text.getvalue().encode())
