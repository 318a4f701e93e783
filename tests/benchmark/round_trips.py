"""Round trips of formats: ``python -m tests.benchmark round_trips [SPECIMEN]``.

A specimen is measured, its record exported to each format, and the file measured as a
material (`goniometric`). Printed is how much of the light is in other patches than in
the record: as the export states it, and as found, over the incident directions, mean
and worst.
"""

import tempfile
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from gonio_mi.campaigns.measure import measure
from gonio_mi.exchange.exports.exporting import export
from gonio_mi.results.campaign_outcome import PredictionError
from gonio_mi.results.prediction_error import prediction_error
from gonio_mi.specimen.specimen_text import parse_specimen

# Each with the basis of a Radiance file.
FORMATS = {
    "a.npz": "",
    "a.zemax.bsdf": "",
    "a.brdf": "",
    "a.anisotropicbsdf": "",
    "a.json": "",
    "a.binary": "",
    "a.xml": "klems",
    "b.xml": "tensor3",
    "c.xml": "tensor4",
}
THETA_I = (0, 10, 20, 30, 40, 50, 60, 70)
COLLECTOR = "projected:30x60"


def round_trips(
    specimen: Any, rays: int = 10**6, formats: Any = FORMATS
) -> Iterator[tuple[str, list[float], list[PredictionError]]]:
    """Name of each format, the losses that are stated, and those that are found.

    Parameters
    ----------
    specimen : dict, mi.BSDF, mi.Scene, str or path
    rays : int
        Of each incident direction of the material; the record is of integrals.
    formats : mapping of str
        Names of files, and the basis of each that is Radiance's.
    """
    how: dict[str, Any] = {"collector": COLLECTOR, "hemispheres": "upper"}
    record = measure(specimen, list(THETA_I), estimator="quadrature", **how)
    with tempfile.TemporaryDirectory() as folder:
        for name, basis in formats.items():
            path = Path(folder) / name
            stated = []
            if name.endswith(".npz"):
                record.save(path)
            else:
                losses = export(record, path, basis or "klems")
                stated = [loss.misplaced for loss in losses]
            material = {"type": "goniometric", "filename": str(path)}
            back = measure(material, list(THETA_I), rays=rays, **how)
            found = [
                prediction_error(back[i], record[i].flux_fraction)
                for i in range(len(THETA_I))
            ]
            yield f"{name[1:]} {basis}".strip(), stated, found


def main(words: Sequence[str]) -> None:
    """Print the table."""
    mi.set_variant("llvm_ad_mono")
    warnings.simplefilter("ignore")  # of light that a file has no words for
    print("| file | stated, mean and worst | found, mean and worst |\n|---|---|---|")
    for specimen in words or ["roughconductor:alpha=0.3"]:
        for name, stated, found in round_trips(parse_specimen(specimen)):
            columns = stated, [one.total_variation for one in found]
            shown = [
                f"{np.mean(one):.1%}, {np.max(one):.1%}" if one else "-"
                for one in columns
            ]
            print(f"| `{name}` | {' | '.join(shown)} |", flush=True)
