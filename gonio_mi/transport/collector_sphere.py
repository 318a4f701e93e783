"""The collector as rays see it: where on it they arrive, and in which patch."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import drjit as dr
import mitsuba as mi

from ..array_types import Floats, Numbers
from ..collector import Subdivision
from ..collector.hemisphere import SHARED_NAMES


def _count_below(edges: Floats, x: mi.Float) -> mi.Float:
    """Count the ascending `edges` that are not above `x`."""
    edges = mi.Float(edges.tolist())
    count = dr.binary_search(
        0, dr.width(edges), lambda i: dr.gather(mi.Float, edges, i) <= x
    )
    return mi.Float(count)


def _take(table: Numbers, index: mi.Float) -> mi.Float:
    """Entries of a float32 `table` at whole floating-point numbers; 0 at NaN."""
    return dr.gather(mi.Float, mi.Float(table), mi.UInt32(index), index >= 0)


def _parameter(x: float) -> mi.Float:
    """Return a number that kernels read: another one compiles nothing."""
    return dr.opaque(mi.Float, x)


# Dr.Jit's array functions under the names that subdivisions call: see
# gonio_mi.collector.Subdivision.patch_index.
DRJIT = SimpleNamespace(
    **{name: getattr(dr, name) for name in SHARED_NAMES},
    atan2=dr.atan2,
    where=dr.select,
    parameter=_parameter,
    count_below=_count_below,
    take=_take,
)


@dataclass(frozen=True)
class CollectorSphere:
    """Sphere about the origin whose hemispheres are cut into patches.

    Attributes
    ----------
    subdivision : Subdivision
        Of one hemisphere; the other one is its mirror image.
    hemispheres : {"auto", "upper", "both"}
        ``upper`` is the emitter's side; ``auto`` lets the specimen decide.
    radius : float
        In scene units; 0 is the far field.
    """

    subdivision: Subdivision
    hemispheres: str = "auto"
    radius: float = 0.0

    def patch_index(self, d: mi.Vector3f) -> mi.UInt32:
        """Index of the patch of each unit vector `d` (mirrored into z > 0)."""
        return mi.UInt32(self.subdivision.patch_index(DRJIT, d.x, d.y, dr.abs(d.z)))

    def arrival(self, p: mi.Point3f, d: mi.Vector3f) -> mi.Vector3f:
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

    def seen(self, p: mi.Point3f, u: mi.Vector3f) -> tuple[mi.Vector3f, mi.Float]:
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
        return wo, self.radius**2 * dr.maximum(dr.dot(u, wo), 0) / dr.squared_norm(path)
