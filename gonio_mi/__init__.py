"""A virtual goniophotometer for Mitsuba 3.

``import gonio_mi as gonio`` makes a usable LLVM visible to Dr.Jit and registers the
instrument's Mitsuba plugins, before or after ``mi.set_variant``. It never sets a variant.
"""

from . import llvm

llvm.prepare()

from . import plugins  # noqa: E402, F401
from .errors import (  # noqa: E402
    FileFormatError,
    LLVMError,
    SpecimenError,
    VariantError,
)
from .files import load  # noqa: E402
from .goniophotometer import measure  # noqa: E402
from .record import Record  # noqa: E402
from .subdivision import (  # noqa: E402
    EqualAngle,
    EqualProjectedSolidAngle,
    EqualSolidAngle,
    Subdivision,
    subdivision,
)
from .tally import Ledger  # noqa: E402

__all__ = [
    "EqualAngle",
    "EqualProjectedSolidAngle",
    "EqualSolidAngle",
    "FileFormatError",
    "LLVMError",
    "Ledger",
    "Record",
    "SpecimenError",
    "Subdivision",
    "VariantError",
    "load",
    "measure",
    "subdivision",
]
