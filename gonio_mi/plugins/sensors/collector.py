"""Sensor `collector`: the sphere around the specimen that receives the light."""

import drjit as dr
import mitsuba as mi

from gonio_mi import properties
from gonio_mi.transport.sampling import check_sampler

# Its square, in single precision, is a number too.
LARGEST = 1e15


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
            props, "radius", 0.0, 0, LARGEST, "a finite radius of 0 or more"
        )
        for name, value in props.objects():
            known = mi.Sampler if name == "sampler" else (mi.Film, mi.Sampler)
            if not isinstance(value, known):
                raise ValueError(
                    f"collector.{name} must be a sampler, got {value.class_name()}"
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

        In the far field that direction is `d`. NaN for a ray that passes by: on a
        periodic specimen `p` may lie outside of the sphere.
        """
        if self.radius == 0:
            return d
        projection = dr.dot(p, d)
        t = -projection + dr.sqrt(
            projection * projection + self.radius**2 - dr.squared_norm(p)
        )
        return dr.normalize(mi.Vector3f(p) + t * d)

    def seen(self, p, u):
        """Direction from `p` to the point of the collector in the direction `u`.

        Returns
        -------
        wo : mi.Vector3f
            For which `arrival` is `u`.
        change : mi.Float
            Solid angle seen from `p` by that seen from the origin; 0 where `p` is
            outside of the sphere, and the point on its near side.
        """
        if self.radius == 0:
            return u, mi.Float(1)
        path = self.radius * u - p
        wo = dr.normalize(path)
        cosine = dr.maximum(dr.dot(u, wo), 0)
        return wo, self.radius**2 * cosine / dr.squared_norm(path)

    def to_string(self):
        """Return a readable description."""
        return f"Collector[radius={self.radius}, film={self.film()}]"


mi.register_sensor("collector", Collector)
