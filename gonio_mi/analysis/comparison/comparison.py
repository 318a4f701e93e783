"""The result of a comparison: point by point, in numbers, words and a picture."""

from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from ...plots import check_picture
from ...plots.figure import finished
from ...reports.page import picture_and_text
from .agreement import MIN_STUDENT_HITS
from .figure import comparison_figure, conclusion, p_text
from .table_pairs import NO_UNCERTAINTY

N_WORST = 5


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """How well two sets of values agree, point by point and as a whole.

    A point is a patch of the record, in one channel; with measured values, the patch
    that holds the point. All arrays have the shape ``(n_points,)``.

    Attributes
    ----------
    theta_i, phi_i, theta_o, phi_o : ndarray of float64
        Directions of incidence and exit in degrees; ``theta_o > 90`` is transmission.
    channel : ndarray of str
    value, std_err : ndarray of float64
        The record's BRDF or BTDF in 1/sr and its standard error, NaN without a hit.
    other, other_std_err : ndarray of float64
        The same of what it is compared with.
    z : ndarray of float64
        Difference in units of its standard error, as the normal score of the same
        probability: positive where the record is larger; approximate beyond 37. A
        common scale uncertainty has no part in it: `other` counts times ``scale``, see
        below.
    statistics : dict of float
        ``chi2``, the sum of the squares of `z`; ``chi2_dof``, its effective degrees of
        freedom (correlated points count less); ``scale``, the most likely common factor
        of the other's values, 1 without a scale uncertainty; ``worst``, the largest
        ``abs(z)``; ``total``, the largest normal score of a hemisphere's total, NaN if
        none had hits enough to be tested.
    p_values : dict of float
        Of ``chi2``, ``worst`` and ``total``: the probability of a statistic this large
        if both have the same true values; 1 of what was not tested.
    alpha : float
        Probability with which the verdict is ``"differ"`` although they have.
    notes : tuple of str
        What a reader of the verdict should know.
    labels : tuple of str
        What to call the record and the other: what differs in their settings.
    undecided : bool
        Whether they agree only as far as what the BRDF may do within patches explains
        what differs.
    within_patches : bool
        Whether `z` is of what exceeds the BSDF's possible variation within patches, as
        of points beside the patches of a record.
    """

    theta_i: np.ndarray
    phi_i: np.ndarray
    theta_o: np.ndarray
    phi_o: np.ndarray
    channel: np.ndarray
    value: np.ndarray
    std_err: np.ndarray
    other: np.ndarray
    other_std_err: np.ndarray
    z: np.ndarray
    statistics: dict[str, float]
    p_values: dict[str, float]
    alpha: float
    notes: tuple[str, ...] = ()
    labels: tuple[str, str] = ("record", "other")
    undecided: bool = False
    within_patches: bool = False

    @property
    def rms(self) -> float:
        """Root of the mean squared difference in 1/sr, the RMS error of the paper."""
        return float(np.sqrt(np.mean((self.value - self.other) ** 2)))

    @property
    def rms_expected(self) -> float:
        """RMS error in 1/sr that the uncertainties alone would give.

        A patch without a hit counts with the uncertainty of the other alone.
        """
        square = self.other_std_err**2 + np.nan_to_num(self.std_err) ** 2
        return float(np.sqrt(np.mean(square)))

    @property
    def relative_rms(self) -> float:
        """`rms` over the mean of the other's values; NaN if that is not positive."""
        mean = float(np.mean(self.other))
        return self.rms / mean if mean > 0 else float("nan")

    @property
    def p_value(self) -> float:
        """The least of `p_values`, times their number (Bonferroni), at most 1."""
        return min(1.0, len(self.p_values) * min(self.p_values.values()))

    @property
    def passed(self) -> bool:
        """Whether nothing tells the two apart, and patches can: ``p_value >= alpha``.

        False where it is `undecided`.
        """
        return self.p_value >= self.alpha and not self.undecided

    @property
    def verdict(self) -> str:
        """One of ``"agree"``, ``"differ"`` and ``"undecided"``."""
        if self.undecided:
            return "undecided"
        return "agree" if self.passed else "differ"

    @property
    def worst(self) -> list[dict[str, Any]]:
        """The points of largest ``abs(z)``, worst first: up to five dictionaries."""
        order = np.argsort(-np.abs(self.z), kind="stable")[:N_WORST]
        return [self._point(i) for i in order]

    def to_dict(self) -> dict[str, Any]:
        """Everything in JSON's types; what is not known is None."""
        return {
            "passed": self.passed,
            "undecided": self.undecided,
            "p_value": self.p_value,
            "alpha": self.alpha,
            "n_points": len(self.z),
            "rms": self.rms,
            "rms_expected": self.rms_expected,
            "relative_rms": known(self.relative_rms),
            "statistics": {name: known(x) for name, x in self.statistics.items()},
            "p_values": dict(self.p_values),
            "worst": self.worst,
            "notes": list(self.notes),
            "labels": list(self.labels),
            "points": [self._point(i) for i in range(len(self.z))],
        }

    def plot(self, path: str | PathLike[str]) -> None:
        """Write a picture of both curves with error bars, and of `z` below them.

        One panel per incident direction and channel, along the measured half-planes
        next to the plane of incidence.

        Parameters
        ----------
        path : str or path
            Ends in ``.pdf``, ``.png`` or ``.svg``.

        Raises
        ------
        ImportError
            Without Matplotlib.
        ValueError, OSError
            For another ending, or if the file cannot be written.
        """
        check_picture(path)
        finished(comparison_figure(self), path)

    def _point(self, i: int) -> dict[str, Any]:
        directions = ("theta_i", "phi_i", "theta_o", "phi_o")
        names = (*directions, "value", "std_err", "other", "other_std_err", "z")
        point = {name: known(float(getattr(self, name)[i])) for name in names}
        return point | {"channel": str(self.channel[i])}

    def _repr_html_(self) -> str:
        """Picture and numbers, for notebooks; numbers alone without Matplotlib."""
        return picture_and_text(lambda: comparison_figure(self), self)

    def __repr__(self) -> str:
        said = f"{len(self.z)} points: {self.verdict}, {p_text(self.p_value)}"
        return f"<Comparison of {said}>"

    def __str__(self) -> str:
        found, p, n = self.statistics, self.p_values, len(self.z)
        together = f" ({found['chi2']:.4g} for {n} points, before correlation)"
        if np.isclose(found["chi2_dof"], n):
            together = ""
        scaled = "" if found["scale"] == 1 else f" (times {found['scale']:.4g} in z)"
        lines = [
            *(f"note: {one}" for one in self.notes if one.endswith(NO_UNCERTAINTY)),
            f"rms error   {self.rms:.4g} 1/sr, {100 * self.relative_rms:.3g} % of the "
            f"mean; {self.rms_expected:.4g} from the uncertainties alone",
            *(
                [f"scale       the other's values times {found['scale']:.5g} fit best"]
                if found["scale"] != 1
                else []
            ),
            f"chi-square  {found['chi2'] / n * found['chi2_dof']:.6g} for "
            f"{found['chi2_dof']:.4g} effective degrees of freedom{together}, "
            f"{p_text(p['chi2'])}",
            f"worst       |z| = {found['worst']:.3g} of {n} points, "
            f"{p_text(p['worst'])}",
            f"total       |z| = {found['total']:.3g} of the sum over all points of a "
            f"hemisphere, {p_text(p['total'])}"
            if np.isfinite(found["total"])
            else "total       not tested: each hemisphere's points had fewer than "
            f"{MIN_STUDENT_HITS} hits",
            f"verdict     {conclusion(self)}: {p_text(self.p_value)}; a correct model "
            f"gives p < {self.alpha:g} in one of {1 / self.alpha:.4g} comparisons",
            "",
            "worst points, angles in degrees, values in 1/sr: value of "
            f"{self.labels[0]}, other of {self.labels[1]}{scaled}, z: normal "
            "score of the difference",
            "theta_i  phi_i  theta_o  phi_o  channel   value +- std_err      "
            "other +- std_err          z",
        ]
        for point in self.worst:
            angles = [f"{point[name]:7.4g}" for name in ("theta_i", "phi_i")]
            # 359.99999 of single precision is 0
            phi_o = float(f"{point['phi_o']:.4g}") % 360
            angles += [f"{point['theta_o']:7.4g}", f"{phi_o:7.4g}"]
            lines.append(
                f"{''.join(angles)}  {point['channel']:>6}  "
                f"{_pair(point['value'], point['std_err'])}  "
                f"{_pair(point['other'], point['other_std_err'])}  {point['z']:6.2f}"
            )
        notes = [f"note: {x}" for x in self.notes if not x.endswith(NO_UNCERTAINTY)]
        return "\n".join([*lines, *notes])


def known(value: float) -> float | None:
    """None in place of NaN and infinity, which JSON does not have."""
    return value if np.isfinite(value) else None


def _pair(value: float, std_err: float) -> str:
    if std_err is None:
        return f"{value:9.4g} +- {'-':<8}"
    return f"{value:9.4g} +- {std_err:<8.2g}"
