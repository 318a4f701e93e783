"""The estimators: how rays, events or integrals become sums over patches.

What to take when:

``weighted``
    the default: for any specimen, with the lowest cost per ray.
``analog``
    to count rays, as the paper does and as an instrument would.
``quadrature``
    a flat specimen of one BSDF in a collimated beam, to errors below 1 %: no noise.
``next_event``
    geometry with smooth BSDFs and fine patches, or mirror facets over a cell.
``split``
    many directions of one periodic, opaque, rough surface.
``auto``
    chooses between the first, third and fourth, by rules and short runs.

:class:`~gonio_mi.transport.method.Method` is the interface. Each module has a class of
it; nothing outside of this room asks which one measures.
"""

from ..settings import Estimator
from ..transport.method import Method
from .analog import Analog
from .next_event import NextEvent
from .quadrature import Quadrature
from .split import Split
from .weighted import Weighted

# By the words of the setting; `auto` until it has chosen.
METHODS: dict[Estimator, Method] = {
    Estimator.WEIGHTED: Weighted(),
    Estimator.ANALOG: Analog(),
    Estimator.QUADRATURE: Quadrature(),
    Estimator.NEXT_EVENT: NextEvent(),
    Estimator.SPLIT: Split(),
    Estimator.AUTO: Weighted(),
}

__all__ = ["METHODS"]
