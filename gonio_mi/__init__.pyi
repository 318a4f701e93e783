"""Public names by module, for type checkers; `__init__` imports them when used."""

from .analysis.charts.chart import chart as chart
from .analysis.charts.curves import Chart as Chart
from .analysis.comparison.compare import compare as compare
from .analysis.comparison.comparison import Comparison as Comparison
from .analysis.comparison.measure_like import measure_like as measure_like
from .analysis.exit_profile import (
    ExitProfile as ExitProfile,
    exit_profile as exit_profile,
)
from .analysis.fitting.fit import fit as fit
from .analysis.fitting.result import Fit as Fit
from .analysis.micro_normals import (
    MicroNormals as MicroNormals,
    micro_normals as micro_normals,
)
from .analysis.quantities import Quantity as Quantity, quantity as quantity
from .campaigns.campaign import campaign as campaign
from .campaigns.measure import measure as measure
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
from .errors import (
    FileFormatError as FileFormatError,
    LLVMError as LLVMError,
    LostRaysError as LostRaysError,
    SpecimenError as SpecimenError,
    VariantError as VariantError,
)
from .exchange.exports import (
    Loss as Loss,
    Product as Product,
    bsdf as bsdf,
    export as export,
)
from .exchange.formats.reading import read_measured as read_measured
from .files import load as load
from .files.measured_table import MeasuredTable as MeasuredTable
from .instrument.differentiable_surface import (
    BRDFDerivative as BRDFDerivative,
    DifferentiableSurface as DifferentiableSurface,
)
from .instrument.measure import measure_orders as measure_orders
from .plots import plot as plot
from .reports import report as report
from .results.planning import Plan as Plan, plan as plan
from .results.record import Record as Record
from .results.tally import Ledger as Ledger
from .specimen.mesh import mesh as mesh
from .validation.examination import validate as validate
from .validation.verdict import Verdict as Verdict

__all__: list[str]
__version__: str
