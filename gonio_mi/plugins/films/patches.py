"""Film `patches`: the collector's patches, their tally and the record."""

from __future__ import annotations

from os import PathLike
from typing import Any

import mitsuba as mi
import numpy as np

from gonio_mi.settings import FILM, MeasurementSettings, plugin_table


class Patches(mi.Film):
    r"""Patches of a collector hemisphere (:monosp:`patches`).

    .. pluginparameters::

     {parameters}

    The developed map has shape ``(n_theta, n_phi, channels)``: the BRDF in 1/sr.
    With both hemispheres it has ``2 n_theta`` rows, in the order of growing theta: the
    BRDF from pole to horizon, then the BTDF from horizon to nadir. ``write`` makes the
    EXR file (or NPZ, by its ending), ``record`` holds the record.

    .. tabs::
        .. code-tab:: xml

            <film type="patches">
                <string name="subdivision" value="projected:30x30"/>
            </film>

        .. code-tab:: python

            'type': 'patches',
            'subdivision': 'projected:30x30'
    """

    def __init__(self, props: mi.Properties) -> None:
        self.settings = MeasurementSettings.from_properties(props, FILM)
        self.subdivision = self.settings.collector
        props["height"], props["width"] = self.subdivision.shape
        super().__init__(props)
        self.record = None

    def develop(self, raw: bool = False) -> mi.TensorXf:  # noqa: ARG002
        """Return the map of the finished measurement as a tensor."""
        record = self._finished()
        rows = record.brdf
        if record.has_lower:
            rows = np.concatenate([rows, record.btdf[::-1]])
        return mi.TensorXf(np.ascontiguousarray(rows, dtype=np.float32))

    def bitmap(self, raw: bool = False) -> mi.Bitmap:  # noqa: ARG002
        """Return the map of the finished measurement as a bitmap."""
        return mi.Bitmap(self.develop())

    def write(self, path: str | PathLike[str]) -> None:
        """Write the record to `path`, ``.exr`` or ``.npz``."""
        self._finished().save(path)

    def _finished(self) -> Any:
        if self.record is None:
            raise RuntimeError("film patches: nothing has been measured yet")
        return self.record

    def to_string(self) -> str:
        """Return a readable description."""
        return (
            f"Patches[subdivision={self.subdivision}, "
            f"hemispheres={self.settings.hemispheres}]"
        )


Patches.__doc__ = plugin_table(Patches.__doc__, MeasurementSettings, FILM)
PLUGIN = Patches
