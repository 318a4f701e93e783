"""A virtual goniophotometer for Mitsuba 3.

``import gonio_mi as gonio`` makes a usable LLVM visible to Dr.Jit and registers the
instrument's Mitsuba plugins, before or after ``mi.set_variant``. It never sets a
variant. What it offers is imported when it is first used.
"""

import importlib
from typing import TYPE_CHECKING, Any

from . import start_up

start_up.begin()

from . import llvm  # noqa: E402

llvm.prepare()

from . import plugins  # noqa: E402, F401

if TYPE_CHECKING:
    from .campaigns.campaign import campaign as campaign
    from .campaigns.measure import measure as measure
    from .charts.chart import chart as chart
    from .charts.curves import Chart as Chart
    from .collector import (
        Borders as Borders,
        EqualAngle as EqualAngle,
        EqualProjectedSolidAngle as EqualProjectedSolidAngle,
        EqualSine as EqualSine,
        EqualSolidAngle as EqualSolidAngle,
        Subdivision as Subdivision,
        adapted as adapted,
        subdivision as subdivision,
    )
    from .collector.apertures import Apertures as Apertures
    from .comparison.compare import compare as compare
    from .comparison.comparison import Comparison as Comparison
    from .comparison.measure_like import measure_like as measure_like
    from .errors import (
        FileFormatError as FileFormatError,
        LLVMError as LLVMError,
        LostRaysError as LostRaysError,
        SpecimenError as SpecimenError,
        VariantError as VariantError,
    )
    from .exports import (
        Loss as Loss,
        Product as Product,
        bsdf as bsdf,
        export as export,
    )
    from .files import load as load
    from .files.measured_table import MeasuredTable as MeasuredTable
    from .fitting.fit import Fit as Fit, fit as fit
    from .formats.reading import read_measured as read_measured
    from .instrument.exit_profile import (
        ExitProfile as ExitProfile,
        exit_profile as exit_profile,
    )
    from .instrument.measure import measure_orders as measure_orders
    from .instrument.mesh import mesh as mesh
    from .plots import plot as plot
    from .reports import report as report
    from .results.planning import Plan as Plan, plan as plan
    from .results.record import Record as Record
    from .results.tally import Ledger as Ledger
    from .surfaces.micro_normals import (
        MicroNormals as MicroNormals,
        micro_normals as micro_normals,
    )
    from .validation.validate import validate as validate
    from .validation.verdict import Verdict as Verdict

# Modules of the public names, the same as above.
MODULES = {
    "campaigns.campaign": ("campaign",),
    "campaigns.measure": ("measure",),
    "charts": ("Chart", "chart"),
    "collector": (
        "Borders",
        "EqualAngle",
        "EqualProjectedSolidAngle",
        "EqualSine",
        "EqualSolidAngle",
        "Subdivision",
        "adapted",
        "subdivision",
    ),
    "collector.apertures": ("Apertures",),
    "comparison": ("Comparison", "compare", "measure_like"),
    "errors": (
        "FileFormatError",
        "LLVMError",
        "LostRaysError",
        "SpecimenError",
        "VariantError",
    ),
    "exports": ("Loss", "Product", "bsdf", "export"),
    "files": ("load",),
    "files.measured_table": ("MeasuredTable",),
    "fitting": ("Fit", "fit"),
    "formats.reading": ("read_measured",),
    "instrument.exit_profile": ("ExitProfile", "exit_profile"),
    "instrument.measure": ("measure_orders",),
    "instrument.mesh": ("mesh",),
    "plots": ("plot",),
    "reports": ("report",),
    "results.planning": ("Plan", "plan"),
    "results.record": ("Record",),
    "results.tally": ("Ledger",),
    "surfaces.micro_normals": ("MicroNormals", "micro_normals"),
    "validation": ("Verdict", "validate"),
}
_module_of = {name: module for module, names in MODULES.items() for name in names}

__all__ = sorted(_module_of)


def __getattr__(name: str) -> Any:
    """Import a public name, and with the first one how records show themselves.

    ``__version__`` is that of the installed package.
    """
    if name == "__version__":
        from importlib import metadata  # slow to import

        return metadata.version("gonio-mi")
    if name not in _module_of:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    importlib.import_module(".reports", __name__)
    module = importlib.import_module(f".{_module_of[name]}", __name__)
    globals()[name] = value = getattr(module, name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
