"""Derivatives of a map by parameters of its scene, as Dr.Jit's graph asks for them.

Forward they are measured like any gradient; backward a loss goes along the rays to all
parameters at once, however many numbers they have.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..errors import SpecimenError
from ..results.record import Record
from ..results.tally import Tally, batch_sizes
from ..settings import Estimator, MeasurementSettings
from ..specimen.scene_objects import traversed
from ..specimen.specimen import Specimen
from ..transport.derivative import Lobes
from ..transport.gradients import Gradients, Rules
from ..transport.launch import send_back
from ..transport.polarisation import n_channels
from ..transport.setup import Setup
from .launcher import Launcher
from .measure import send_all
from .recording import records_of
from .schedule import Round
from .setup import check_differentiable, set_up, try_gradients


def forward(scene: mi.Scene, settings: MeasurementSettings, rules: Rules) -> Floats:
    """Derivative of the map along the gradients that the scene's parameters have.

    Parameters
    ----------
    scene : mi.Scene
    settings : MeasurementSettings
    rules : dict
        What delta lobes of the scene follow, by parameter; those that are not known are
        found, and remembered.

    Returns
    -------
    ndarray, shape (n_hemispheres, n_theta, n_phi, channels)
    """
    own = Gradients.of_enabled(scene, tangents=True)
    (setup,) = _set_up(scene, settings, own, rules)
    finished: list[list[Tally]] = [[]]
    (stack,) = records_of([setup], finished, send_all([setup], finished))
    record, (column,) = stack[0], own.columns
    both = ("brdf", "btdf")[: record.n_hemispheres]
    return np.stack([record.gradient(column.name, of) for of in both])


def backward(
    scene: mi.Scene,
    settings: MeasurementSettings,
    rules: Rules,
    loss: Floats,
    known: Record,
) -> None:
    """Add to the gradients of the scene's parameters what a loss makes of the map.

    Parameters
    ----------
    scene, settings, rules
        As of :func:`forward`.
    loss : ndarray, shape (n_hemispheres, n_theta, n_phi, channels)
        Derivative of the loss by the map.
    known : Record
        Of the map: it tells what power rays have on average.
    """
    if settings.estimator is not Estimator.WEIGHTED:
        raise SpecimenError(
            f"dr.backward needs the estimator weighted, got {settings.estimator}: "
            "gradients= of measure, and dr.forward, take others"
        )
    own = Gradients.of_enabled(scene)
    (setup,) = _set_up(scene, settings, own, rules)
    tally = known.tallies[0]
    rays = sum(plan := batch_sizes(settings.rays, settings.batches))
    sent = tally.scale * tally.ledger.emitted // known.provenance.passes
    power = tally.incident.sum(axis=0) / sent
    solid = setup.collector.subdivision.projected_solid_angles[..., None]
    loss = loss / (solid * rays * power)
    ((column, derivative),) = own.derivatives
    launcher = Launcher([setup])
    with own.attached(column.directions, follow="backward") as leaves:
        _send_all_back(launcher, setup, plan, derivative.lobes, loss)
        dr.eval([dr.grad(leaf) for leaf in leaves.values()])
        found = {key: dr.grad(leaf) for key, leaf in leaves.items()}
    own.accumulate(found)


def follows_parameters(scene: mi.Scene) -> bool:
    """Whether gradients of a parameter of the scene are enabled."""
    values = (value for _, value in traversed(scene))
    with dr.resume_grad():
        return any(dr.is_diff_v(one) and dr.grad_enabled(one) for one in values)


def _send_all_back(
    launcher: Launcher, setup: Setup, plan: list[int], lobes: Lobes, loss: Floats
) -> None:
    """Send the rays of all batches, at all wavelengths, for their part of the loss."""
    first, n = 0, n_channels()
    for number, nm in enumerate(setup.passes):
        several = len(nm) if nm else n
        own = np.zeros((setup.n_collected, n))
        flat = loss.reshape(setup.n_collected, -1)[:, first : first + several]
        own[:, :several] = flat
        first += several
        table = mi.Float(own.ravel().astype(np.float32))
        for planned in launcher.plan([setup], Round(tuple(plan))):
            for piece in launcher.pieces(planned[number]):
                with dr.suspend_grad():
                    started = send_back(piece, lobes, table)
                launcher.size.learn(piece.rays, started)


def _set_up(
    scene: mi.Scene,
    settings: MeasurementSettings,
    gradients: Gradients,
    rules: Rules,
) -> list[Setup]:
    """Set-up with gradients that are known to be right."""
    setups = set_up(Specimen(scene, settings.period), settings)
    check_differentiable(setups[0].specimen, settings)
    try_gradients(gradients, setups[0].specimen, settings, rules)
    setups = [replace(one, gradients=gradients) for one in setups]
    for one in setups:
        one.method.check(one)
    return setups
