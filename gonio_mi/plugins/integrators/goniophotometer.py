"""Integrator `goniophotometer`: a scene file is a complete measurement."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from gonio_mi.errors import SpecimenError
from gonio_mi.instrument.measure import send_all
from gonio_mi.instrument.recording import records_of
from gonio_mi.instrument.setup import set_up
from gonio_mi.kernels import launches_kernels
from gonio_mi.results.tally import Tally
from gonio_mi.settings import INTEGRATOR, MeasurementSettings, plugin_table
from gonio_mi.specimen.scene_objects import own_settings
from gonio_mi.specimen.specimen import Specimen
from gonio_mi.variants import check_variant, is_parallel


class Goniophotometer(mi.SamplingIntegrator):
    r"""Virtual goniophotometer (:monosp:`goniophotometer`).

    Sends light from the scene's one emitter to the specimen (every shape that does not
    emit) and tallies each ray in the patches of a :monosp:`collector` sensor with a
    :monosp:`patches` film. ``mi.render(scene)`` returns the film's map;
    ``mi.render(scene, spp=n)`` measures with ``n`` rays instead of `rays`.

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
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        if not isinstance(getattr(sensor, "settings", None), MeasurementSettings):
            raise SpecimenError(
                "the integrator goniophotometer needs a sensor of type collector, "
                f"got {sensor.class_name()}"
            )
        own = self.settings.of_plugin(INTEGRATOR) | own_settings(scene, sensor)
        here = {"seed": int(mi.UInt32(seed)[0]), "rays": spp or self.settings.rays}
        settings = MeasurementSettings().changed(**own | here)
        setups = set_up(Specimen(scene, settings.period), settings)
        finished: list[list[Tally]] = [[]]
        (stack,) = records_of(setups, finished, send_all(setups, finished))
        sensor.film().record = stack[0]
        if stack.provenance.interrupted:
            raise KeyboardInterrupt
        return sensor.film().develop() if develop else None

    def to_string(self) -> str:
        """Return a readable description."""
        return f"Goniophotometer[{self.settings}]"


Goniophotometer.__doc__ = plugin_table(
    Goniophotometer.__doc__, MeasurementSettings, INTEGRATOR
)
mi.register_integrator("goniophotometer", Goniophotometer)
