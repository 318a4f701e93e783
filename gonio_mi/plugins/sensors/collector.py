"""Sensor `collector`: the sphere around the specimen that receives the light."""

import drjit as dr
import mitsuba as mi

from gonio_mi.plugins import properties
from gonio_mi.plugins.sampling import check_sampler


class Collector(mi.Sensor):
    r"""Collector sphere of a goniophotometer (:monosp:`collector`).

    .. pluginparameters::

     * - radius
       - |float|
       - Radius in scene units of the sphere, centred at the origin, on which the exit
         *position* decides the patch. 0 is the far field: the exit *direction* decides.
         (Default: 0)

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

    def __init__(self, props):
        self.radius = properties.number(
            props, "radius", 0.0, 0, float("inf"), "a finite radius of 0 or more"
        )
        if not any(isinstance(value, mi.Sampler) for _, value in props.objects()):
            props["sampler"] = mi.load_dict({"type": "sobol"})
        super().__init__(props)
        if not hasattr(self.film(), "subdivision"):
            raise ValueError(
                "collector.film must be of type patches, "
                f"got {self.film().class_name()}"
            )
        check_sampler("collector.sampler", self.sampler())

    def arrival(self, p, d):
        """Direction from the origin of where a ray meets the collector.

        `p` lies inside of the sphere; in the far field that direction is `d`.
        """
        if self.radius == 0:
            return d
        projection = dr.dot(p, d)
        t = -projection + dr.sqrt(
            projection * projection + self.radius**2 - dr.squared_norm(p)
        )
        return dr.normalize(mi.Vector3f(p) + t * d)

    def to_string(self):
        """Return a readable description."""
        return f"Collector[radius={self.radius}, film={self.film()}]"


mi.register_sensor("collector", Collector)
