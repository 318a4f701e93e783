"""The settings of a measurement, each declared once and parsed at the entrance."""

from .declaration import Declaration, Kind, declarations, numpydoc, plugin_table
from .measurement_settings import (
    COLLECTOR,
    DEFAULTS,
    FILM,
    INTEGRATOR,
    Estimator,
    MeasurementSettings,
)
from .values import Order

__all__ = [
    "COLLECTOR",
    "DEFAULTS",
    "Estimator",
    "FILM",
    "INTEGRATOR",
    "Kind",
    "Declaration",
    "MeasurementSettings",
    "Order",
    "declarations",
    "numpydoc",
    "plugin_table",
]
