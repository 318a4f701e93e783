"""Sensor `collector`: the sphere around the specimen that receives the light."""

from __future__ import annotations

import mitsuba as mi

from gonio_mi.errors import SettingError
from gonio_mi.settings import COLLECTOR, MeasurementSettings, plugin_table
from gonio_mi.transport.sampling import check_sampler


class Collector(mi.Sensor):
    r"""Collector sphere of a goniophotometer (:monosp:`collector`).

    .. pluginparameters::

     {parameters}

     * - (Nested plugin)
       - :paramtype:`film`
       - A :monosp:`patches` film.

     * - (Nested plugin)
       - :paramtype:`sampler`
       - Any sampler but ``ldsampler``. (Default: ``sobol``)

    .. tabs::
        .. code-tab:: xml

            <sensor type="collector">
                <film type="patches"/>
            </sensor>

        .. code-tab:: python

            'type': 'collector',
            'film': {'type': 'patches'}
    """

    def __init__(self, props: mi.Properties) -> None:
        self.settings = MeasurementSettings.from_properties(props, COLLECTOR)
        for name, value in props.objects():
            known = mi.Sampler if name == "sampler" else (mi.Film, mi.Sampler)
            if not isinstance(value, known):
                raise SettingError(
                    f"collector.{name} must be a sampler, got {value.class_name()}"
                )
        if not any(isinstance(value, mi.Sampler) for _, value in props.objects()):
            # not by mi.load_dict, which changes where plugins beside it look for files
            default = mi.Properties("sobol")
            props["sampler"] = mi.PluginManager.instance().create_object(default)
        super().__init__(props)
        if not hasattr(self.film(), "settings"):
            raise SettingError(
                "collector.film must be of type patches, "
                f"got {self.film().class_name()}"
            )
        check_sampler("collector.sampler", self.sampler())

    def to_string(self) -> str:
        """Return a readable description."""
        return (
            f"Collector[radius={self.settings.collector_radius:g}, film={self.film()}]"
        )


Collector.__doc__ = plugin_table(Collector.__doc__, MeasurementSettings, COLLECTOR)
PLUGIN = Collector
