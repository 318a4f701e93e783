"""What a model is to comparisons and quantities: values wherever they are asked for."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

from ...files.measured_table import MeasuredTable
from ...results.record import Record
from .points import Points


class Model(ABC):
    """A BSDF whose parameters are known with a covariance, as a fit has found them.

    Attributes
    ----------
    record : Record or MeasuredTable
        By what it is known.
    """

    record: Record | MeasuredTable

    @property
    @abstractmethod
    def label(self) -> str:
        """Name of the model."""

    @abstractmethod
    def points(self, like: Record | MeasuredTable) -> Points:
        """BRDF or BTDF in 1/sr at what was measured, with errors of the parameters.

        Parameters
        ----------
        like : Record or MeasuredTable
            Detectors of a record of one incident direction, of both hemispheres if it
            has both, with the channel as the last of its axes; or rows of a table.
        """

    @abstractmethod
    def quantity(self, name: str | Sequence[str], **settings: Any) -> Any:
        """As :func:`gonio_mi.quantity`, with errors of the parameters."""

    @property
    def rays(self) -> Mapping[str, str]:
        """Identifiers of the rays by which it is known; none of an instrument's."""
        own = self.record
        return own.rays if isinstance(own, MeasuredTable) else own.ray_keys
