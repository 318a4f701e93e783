"""``gonio-mi doctor``: check the installation.

Check the installation with a measurement whose result is known; if something is
missing, print the line that fixes it.
"""

import platform
from argparse import ArgumentParser, Namespace
from importlib import metadata
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import llvm
from ..campaigns.measure import measure_whole
from ..errors import LLVMError, to_install
from ..results.record import Record
from ..variants import parallel_variants
from .arguments import DEFAULT_VARIANT, set_variant

REQUIRED = ("gonio-mi", "mitsuba", "drjit", "numpy", "scipy", "OpenEXR")
OPTIONAL = {"matplotlib": "plot"}

SELF_TEST_RAYS = 10**6
# Chance that a correct instrument fails the self-test, over all patches together.
FALSE_ALARM = 1e-6


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command: it has none of its own."""


def run(_: Namespace) -> int:
    """Print the diagnosis, and return the exit code: 0 able, 1 not."""
    rows, able = diagnose()
    width = max(len(row.name) for row in rows)
    for row in rows:
        print(f"{'ok ' if row.ok else 'BAD'}  {row.name:{width}}  {row.value}")
    print(f"this machine is {'able' if able else 'not able'} to measure")
    return 0 if able else 1


class Row(NamedTuple):
    """One finding.

    Attributes
    ----------
    name, value : str
    ok : bool
        False only for what prevents measuring.
    """

    name: str
    value: str
    ok: bool


def diagnose() -> tuple[list[Row], bool]:
    """Look at everything a measurement needs, and make one.

    Sets the variant ``llvm_ad_mono`` if none is set: meant for a process of its own.

    Returns
    -------
    rows : list of Row
    able : bool
        Whether all rows are in order.
    """
    status = llvm.status()
    both = dr.JitBackend.LLVM, dr.JitBackend.CUDA
    usable = tuple(one.name.lower() for one in both if dr.has_backend(one))
    variants = [name for name in parallel_variants() if name.startswith(usable)]
    rows = [
        Row("python", platform.python_version(), True),
        *(_package(name) for name in REQUIRED),
        *(_package(name, extra) for name, extra in OPTIONAL.items()),
        Row("LLVM library", status.path or "unknown", status.usable),
        Row("LLVM version", llvm.dotted(status.version), status.usable),
        Row("LLVM verdict", status.reason, status.usable),
        Row("variants", ", ".join(variants) or "none", bool(variants)),
        Row("threads", str(dr.thread_count()), True),
        _self_test(),
    ]
    return rows, all(row.ok for row in rows)


# ------------------------------------------------------------------------- findings


def _package(name: str, extra: str = "") -> Row:
    try:
        return Row(name, metadata.version(name), True)
    except metadata.PackageNotFoundError:
        remedy = f", optional: {to_install(extra)}" if extra else ""
        remedy = remedy or f": run `pip install {name}`"
        return Row(name, f"not installed{remedy}", bool(extra))


def _self_test() -> Row:
    """Row on a white Lambertian plate, whose BRDF is 1 / pi in every patch."""
    try:
        if mi.variant() is None:
            set_variant(DEFAULT_VARIANT)
        faults = _faults(_measure_white(), 1 / np.pi)
    except LLVMError as error:
        return Row("self-test", f"not run: {error}", False)
    except Exception as error:  # whatever it is, a diagnosis reports it
        line = " ".join(str(error).split())
        return Row("self-test", f"{type(error).__name__}: {line}", False)
    passed = f"white Lambertian is 1/pi everywhere (false alarm {FALSE_ALARM:g})"
    return Row("self-test", "; ".join(faults) or passed, not faults)


def _measure_white() -> Record:
    """Record of counted independent rays on a white Lambertian plate."""
    plate = {"type": "diffuse", "reflectance": 1.0}
    method: Any = {"estimator": "analog", "sampler": "independent", "seed": 0}
    where: Any = {"theta_i": 45, "phi_i": 0, "collector": "projected:10x10"}
    return measure_whole(plate, rays=SELF_TEST_RAYS, **where, **method)


def _faults(record: Record, brdf: float) -> list[str]:
    """Deviations from the constant `brdf`, as sentences; none for a correct record.

    Every patch's exact interval has to contain it, at a level that shares `FALSE_ALARM`
    among the patches (Bonferroni); rays are counted, so totals have to agree exactly.
    """
    faults = []
    low, high = record.interval(1 - FALSE_ALARM / record.brdf.size)
    n_off = int(np.count_nonzero(~((low <= brdf) & (brdf <= high))))
    if n_off:
        faults.append(f"{n_off} of {low.size} patches exclude the BRDF {brdf:.5f}")
    ledger = record.ledger
    if ledger.emitted != SELF_TEST_RAYS:
        faults.append(f"the ledger holds {ledger.emitted} of {SELF_TEST_RAYS} rays")
    if record.counts.sum() != ledger.reflected + ledger.transmitted:
        faults.append("the patches do not hold what the ledger says has left")
    dhr = ledger.reflected / (ledger.emitted - ledger.missed - ledger.unlit)
    if np.any(record.dhr != dhr):
        faults.append(f"dhr is {record.dhr}, but {dhr} by the ledger")
    return faults
