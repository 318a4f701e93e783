"""What a whole BSDF costs: campaigns that choose their directions, beside grids."""

import bisect
import itertools
import logging
import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from gonio_mi.campaigns.campaign import campaign
from gonio_mi.campaigns.execution import ExecutionContext, records_of
from gonio_mi.errors import SpecimenError
from gonio_mi.materials.measured_directions import CONFIRMING, NOISE, may_exceed
from gonio_mi.materials.prediction import Prediction
from gonio_mi.results.campaign_outcome import PredictionError
from gonio_mi.results.prediction_error import prediction_error
from gonio_mi.results.record import Record

from .table import print_table
from .timing import cpu_seconds

# Random directions that no campaign has seen.
N_UNSEEN, SEED = 200, 12345

# Polar angles of the grids that are tried, in equal steps; and of those of anisotropic
# specimens, with the azimuths of each.
ANGLES = (5, 7, 9, 11, 13, 16, 19, 23, 28, 34, 41, 50)
ANGLES_OF_AZIMUTHS, AZIMUTHS = (6, 8, 11, 16), (16, 32, 64)


@dataclass(frozen=True)
class Case:
    """A specimen, and how it is measured."""

    specimen: dict[str, Any]
    settings: dict[str, Any] = field(default_factory=dict)


def _cases() -> dict[str, Case]:
    """The specimens by name."""
    conductor = {"type": "roughconductor", "distribution": "ggx"}
    glass = {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.3}
    heights = np.array([[0.0, -0.25], [0.0, -0.25]], dtype=np.float32)
    grooves = {
        "type": "heightfield",
        "heights": mi.TensorXf(heights),
        "size": 1.0,
        "bsdf": {"type": "roughconductor", "alpha": 0.3},
    }
    field = {
        "type": "heightfield",
        "alpha": 0.3,
        "resolution": 512,
        "bsdf": {"type": "twosided", "bsdf": conductor | {"alpha": 0.3}},
    }
    return {
        "conductor 0.3": Case(conductor | {"alpha": 0.3}),
        "plastic 0.3": Case({"type": "roughplastic", "alpha": 0.3}),
        "glass 0.3, outside": Case(glass, {"side": "front"}),
        "glass 0.3, inside": Case(glass, {"side": "back"}),
        "brushed 0.15 x 0.4": Case(conductor | {"alpha_u": 0.15, "alpha_v": 0.4}),
        "conductor 0.05": Case(conductor | {"alpha": 0.05}),
        "grooves": Case(grooves, {"period": "box"}),
        "rough field": Case(field, {"period": "box"}),
    }


def print_campaigns(
    tolerance: float, names: Sequence[str], theta_max: float, grids: bool = True
) -> None:
    """Print what campaigns of a tolerance cost, and how right their materials are.

    Parameters
    ----------
    tolerance : float
    names : sequence of str
        Cases whose name begins like this; none for all.
    theta_max : float
        In degrees.
    grids : bool
        Whether grids are tried beside integrals; beside rays they would take hours.
    """
    for name, case in _cases().items():
        if names and not name.startswith(tuple(names)):
            continue
        logging.getLogger(__name__).info("%s at %g", name, tolerance)
        try:
            rows = _rows(case, tolerance, theta_max, grids)
        except SpecimenError as refused:
            print(f"{name}: {refused}", flush=True)
            continue
        print_table(
            f"{name}, tolerance {tolerance:g} up to {theta_max:g} degrees",
            ("incident directions", "collector", "used", "measured", "rays")
            + ("core-s", "MB", "within", "mean", "worst"),
            rows,
        )


def _rows(
    case: Case, tolerance: float, theta_max: float, grids: bool
) -> list[tuple[str, ...]]:
    """Rows of the campaign, and of the first grid that is as right."""
    started = cpu_seconds()
    settings = {"tolerance": tolerance, "theta_max": theta_max} | case.settings
    chosen = campaign({"it": case.specimen}, progress=True, **settings)["it"]
    spent = cpu_seconds() - started
    found = chosen.settings["campaign"]
    incidents = _random_incidents(theta_max)
    unseen = _measured(case, chosen, incidents, NOISE)
    errors = _errors(chosen, unseen, tolerance)
    is_sampled = chosen.settings["estimator"] != "quadrature"
    large = [n for n, one in enumerate(errors) if may_exceed(one, tolerance, NOISE)]
    if is_sampled and large:
        finer = _measured(case, chosen, [incidents[n] for n in large], CONFIRMING)
        for n, one in zip(large, _errors(chosen, finer, tolerance)):
            errors[n] = one
    counts = found["measured"], found["rays"], spent
    rows = [_row("chosen", chosen, counts, errors, tolerance)]
    if not grids or is_sampled:
        return rows
    enough = min(_within(errors, tolerance), 0.95)
    found_rows: dict[tuple[int, int], tuple[str, ...]] = {}

    def is_right(n_azimuths: int, steps: int) -> bool:
        """Whether a grid is as right; its row is kept."""
        started = cpu_seconds()
        grid = _measured(case, chosen, _incidents(steps, n_azimuths, theta_max), NOISE)
        counts = len(grid), grid.ledger.emitted, cpu_seconds() - started
        errors = _errors(grid, unseen, tolerance)
        name = f"{steps} x {n_azimuths}"
        found_rows[steps, n_azimuths] = _row(name, grid, counts, errors, tolerance)
        return _within(errors, tolerance) >= enough

    if found["isotropic"]:
        fewest = _fewest(ANGLES, (1,), is_right)
    else:
        fewest = _fewest(ANGLES_OF_AZIMUTHS, AZIMUTHS, is_right)
    return [*rows, found_rows[fewest]]


def _fewest(
    angles: Sequence[int], azimuths: Sequence[int], is_right: Callable[[int, int], bool]
) -> tuple[int, int]:
    """Polar angles and azimuths of the smallest grid that is right; else the largest.

    More of either are taken to be as right, so that few grids need be looked at.
    """
    best = angles[-1], azimuths[-1]
    for n_azimuths in azimuths:
        fewer = [one for one in angles if one * n_azimuths <= math.prod(best)]
        right = partial(is_right, n_azimuths)
        first = bisect.bisect_left(fewer, True, key=right)
        if first < len(fewer):
            best = fewer[first], n_azimuths
    return best


def _incidents(
    steps: int, n_azimuths: int, theta_max: float
) -> list[tuple[float, float]]:
    """Directions of a grid of polar angles and azimuths; the normal once."""
    angles = np.linspace(0, theta_max, steps)[1:].tolist()
    azimuths = (np.arange(n_azimuths) * (360 / n_azimuths)).tolist()
    return [(0.0, 0.0), *itertools.product(angles, azimuths)]


def _random_incidents(theta_max: float) -> list[tuple[float, float]]:
    """Random directions, uniform in solid angle."""
    generator = np.random.default_rng(SEED)
    least = np.cos(np.radians(theta_max))
    theta_i = np.degrees(np.arccos(1 - generator.random(N_UNSEEN) * (1 - least)))
    phi_i = 360 * generator.random(N_UNSEEN)
    return list(zip(theta_i.tolist(), phi_i.tolist()))


def _measured(
    case: Case, chosen: Record, incidents: Sequence[tuple[float, float]], noise: float
) -> Record:
    """Stack of incident directions, with the settings of the chosen ones.

    `noise` is the part of the tolerance that it may misplace where they are sampled.
    """
    names = ("estimator", "rel_err")
    own = {name: chosen.settings.get(name) for name in names}
    if own["rel_err"] is None:
        own["noise"] = noise * chosen.settings["campaign"]["tolerance"]
    settings = own | {"collector": chosen.subdivision} | case.settings
    where = ExecutionContext()
    return records_of({"it": case.specimen}, incidents, where, settings)["it"]


def _errors(record: Record, unseen: Record, tolerance: float) -> list[PredictionError]:
    """What the material of a record gets wrong at unseen directions."""
    prediction = Prediction.within(tolerance, record)
    return [
        prediction_error(
            one, prediction.flux(float(one.theta_i[0]), float(one.phi_i[0]))
        )
        for one in (unseen[number] for number in range(len(unseen)))
    ]


def _within(errors: Sequence[PredictionError], tolerance: float) -> float:
    return float(np.mean([not one.exceeds(tolerance) for one in errors]))


def _row(
    name: str,
    record: Record,
    counts: tuple[int, int, float],
    errors: Sequence[PredictionError],
    tolerance: float,
) -> tuple[str, ...]:
    """Cells of a row; `counts` are directions, rays and core-seconds."""
    measured, rays, spent = counts
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "material.npz"
        record.save(path)
        size = path.stat().st_size
    every = [one.error for one in errors]
    return (
        name,
        str(record.subdivision),
        str(len(record)),
        str(measured),
        f"{rays:.2g}",
        f"{spent:.3g}",
        f"{size / 1e6:.2g}",
        f"{_within(errors, tolerance):.1%}",
        f"{np.mean(every):.2%}",
        f"{max(every):.2%}",
    )
