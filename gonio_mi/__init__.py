"""A virtual goniophotometer for Mitsuba 3.

``import gonio_mi as gonio`` makes a usable LLVM visible to Dr.Jit and registers the
instrument's Mitsuba plugins, before or after ``mi.set_variant``. It never sets a
variant.
"""

from importlib import metadata
from typing import Any

from . import interrupts

interrupts.start_up()

from . import llvm  # noqa: E402

llvm.prepare()

from . import plugins  # noqa: E402, F401
from .campaigns.campaign import campaign  # noqa: E402
from .campaigns.measure import measure  # noqa: E402
from .charts import Chart, chart  # noqa: E402
from .collector import (  # noqa: E402
    Borders,
    EqualAngle,
    EqualProjectedSolidAngle,
    EqualSine,
    EqualSolidAngle,
    Subdivision,
    adapted,
    subdivision,
)
from .collector.apertures import Apertures  # noqa: E402
from .comparison import Comparison, compare, measure_like  # noqa: E402
from .errors import (  # noqa: E402
    FileFormatError,
    LLVMError,
    LostRaysError,
    SpecimenError,
    VariantError,
)
from .exports import Loss, Product, bsdf, export  # noqa: E402
from .files import load  # noqa: E402
from .files.measured_table import MeasuredTable  # noqa: E402
from .fitting import Fit, fit  # noqa: E402
from .formats.reading import read_measured  # noqa: E402
from .instrument.exit_profile import ExitProfile, exit_profile  # noqa: E402
from .instrument.measure import measure_orders  # noqa: E402
from .instrument.mesh import mesh  # noqa: E402
from .plots import plot  # noqa: E402
from .reports import report  # noqa: E402
from .results.planning import Plan, plan  # noqa: E402
from .results.record import Record  # noqa: E402
from .results.tally import Ledger  # noqa: E402
from .surfaces.micro_normals import MicroNormals, micro_normals  # noqa: E402
from .validation import Verdict, validate  # noqa: E402

__all__ = [
    "Apertures",
    "Borders",
    "Chart",
    "Comparison",
    "EqualAngle",
    "EqualProjectedSolidAngle",
    "EqualSine",
    "EqualSolidAngle",
    "ExitProfile",
    "FileFormatError",
    "Fit",
    "LLVMError",
    "Ledger",
    "Loss",
    "LostRaysError",
    "MeasuredTable",
    "MicroNormals",
    "Plan",
    "Product",
    "Record",
    "SpecimenError",
    "Subdivision",
    "VariantError",
    "Verdict",
    "adapted",
    "bsdf",
    "campaign",
    "chart",
    "compare",
    "exit_profile",
    "export",
    "fit",
    "load",
    "measure",
    "measure_like",
    "measure_orders",
    "mesh",
    "micro_normals",
    "plan",
    "plot",
    "read_measured",
    "report",
    "subdivision",
    "validate",
]


def __getattr__(name: str) -> Any:
    """Look up ``__version__``, of the installed package, when it is asked for."""
    if name == "__version__":
        return metadata.version("gonio-mi")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
