"""Integrator `goniophotometer`: a scene file is a complete measurement."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from gonio_mi.array_types import Floats
from gonio_mi.errors import SpecimenError
from gonio_mi.instrument.differentiation import (
    backward,
    follows_parameters,
    forward,
)
from gonio_mi.instrument.measure import send_all
from gonio_mi.instrument.recording import records_of
from gonio_mi.instrument.setup import set_up
from gonio_mi.kernels import launches_kernels
from gonio_mi.results.tally import Tally
from gonio_mi.settings import INTEGRATOR, MeasurementSettings, plugin_table
from gonio_mi.specimen.scene_objects import (
    class_of,
    held_objects,
    own_settings,
    traversed,
)
from gonio_mi.specimen.specimen import Specimen
from gonio_mi.transport.gradients import Rules
from gonio_mi.variants import check_variant, is_parallel


class Goniophotometer(mi.SamplingIntegrator):
    r"""Virtual goniophotometer (:monosp:`goniophotometer`).

    Sends light from the scene's one emitter to the specimen (every shape that does not
    emit) and tallies each ray in the patches of a :monosp:`collector` sensor with a
    :monosp:`patches` film. ``mi.render(scene)`` returns the film's map;
    ``mi.render(scene, spp=n)`` measures with ``n`` rays instead of `rays`. The map of
    ``mi.render(scene, params)`` follows parameters of BSDFs and textures, forward and
    backward.

    .. pluginparameters::

     {parameters}

    .. tabs::
        .. code-tab:: xml

            <integrator type="goniophotometer">
                <integer name="rays" value="1000000"/>
            </integrator>

        .. code-tab:: python

            'type': 'goniophotometer',
            'rays': 1000000
    """

    def __init__(self, props: mi.Properties) -> None:
        check_variant(is_parallel)
        self.settings = MeasurementSettings.from_properties(props, INTEGRATOR)
        super().__init__(props)
        # what delta lobes follow with each parameter, of scenes that are alike
        self._rules: dict[tuple[str, ...], Rules] = {}

    @launches_kernels(is_parallel)
    def render(
        self,
        scene: mi.Scene,
        sensor: Any = 0,
        seed: int = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> mi.TensorXf:
        """Measure; see the class. The film keeps the record, after Ctrl-C too."""
        del evaluate
        sensor, settings = self._asked(scene, sensor, seed, spp)
        setups = set_up(Specimen(scene, settings.period), settings)
        finished: list[list[Tally]] = [[]]
        (stack,) = records_of(setups, finished, send_all(setups, finished))
        sensor.film().record = stack[0]
        if stack.provenance.interrupted:
            raise KeyboardInterrupt
        if not develop:
            return None
        rows = sensor.film().develop()
        # a grey map may become one of colours
        return of_colours(rows) if mi.is_rgb and follows_parameters(scene) else rows

    @launches_kernels(is_parallel)
    def render_forward(
        self,
        scene: mi.Scene,
        params: Any,
        sensor: Any = 0,
        seed: int = 0,
        spp: int = 0,
    ) -> mi.TensorXf:
        """Derivative of the map along the gradients that parameters of BSDFs have."""
        del params  # the scene has them
        _, settings = self._asked(scene, sensor, seed, spp)
        rules = self._rules.setdefault(kinds_of(scene), {})
        return of_colours(rows_of(forward(scene, settings, rules)))

    @launches_kernels(is_parallel)
    def render_backward(
        self,
        scene: mi.Scene,
        params: Any,
        grad_in: mi.TensorXf,
        sensor: Any = 0,
        seed: int = 0,
        spp: int = 0,
    ) -> None:
        """Add to the gradients of parameters of BSDFs what a loss makes of the map."""
        del params
        sensor, settings = self._asked(scene, sensor, seed, spp)
        film = sensor.film()
        if film.record is None:
            self.render(scene, sensor, seed, spp, develop=False)
        n_theta, n_phi = film.subdivision.shape
        rows = np.array(grad_in, float).reshape(-1, n_theta, n_phi, grad_in.shape[-1])
        rows[1:] = rows[1:, ::-1]
        rules = self._rules.setdefault(kinds_of(scene), {})
        backward(scene, settings, rules, rows, film.record)

    def _asked(
        self, scene: mi.Scene, sensor: Any, seed: int, spp: int
    ) -> tuple[Any, MeasurementSettings]:
        """The sensor, and settings of scene, sensor and call."""
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        if not isinstance(getattr(sensor, "settings", None), MeasurementSettings):
            raise SpecimenError(
                "the integrator goniophotometer needs a sensor of type collector, "
                f"got {sensor.class_name()}"
            )
        own = self.settings.of_plugin(INTEGRATOR) | own_settings(scene, sensor)
        here = {"seed": int(mi.UInt32(seed)[0]), "rays": spp or self.settings.rays}
        return sensor, MeasurementSettings().changed(**own | here)

    def to_string(self) -> str:
        """Return a readable description."""
        return f"Goniophotometer[{self.settings}]"


def kinds_of(scene: mi.Scene) -> tuple[str, ...]:
    """Names of a scene's parameters, and classes of all that its shapes hold.

    No `id`, which a later scene may have.
    """
    held = (class_of(one) for shape in scene.shapes() for one in held_objects(shape))
    return (*traversed(scene).keys(), *held)


def of_colours(rows: mi.TensorXf) -> mi.TensorXf:
    """Map with all channels of the variant, of one that has the first alone."""
    several = 3 if mi.is_rgb else rows.shape[-1]
    if rows.shape[-1] == several:
        return rows
    return mi.TensorXf(np.repeat(np.array(rows), several, axis=-1))


def rows_of(both: Floats) -> mi.TensorXf:
    """Map of all hemispheres in one, as the film `patches` has it."""
    rows = np.concatenate([both[0], *(one[::-1] for one in both[1:])])
    return mi.TensorXf(np.ascontiguousarray(rows, dtype=np.float32))


Goniophotometer.__doc__ = plugin_table(
    Goniophotometer.__doc__, MeasurementSettings, INTEGRATOR
)
PLUGIN = Goniophotometer
