"""What makes the commands of pages and the cells of notebooks short."""

import pytest

from gonio_mi.analysis.fitting.least_squares import FittedModel, Search

LESS = {
    "exchange.exports.measured_export.GRID": 32,
    "exchange.exports.measured_export.READ_BACK_RAYS": 2**14,
    "exchange.exports.radiance_export.read_back": lambda *_: [],
    "exchange.exports.radiance_export.TREE_SIZES": {3: 16, 4: 8},
    "exchange.exports.radiance_export.POINTS_OUT": 2,
    "exchange.exports.radiance_export.POINTS_IN": 1,
    "materials.interpolation.interpolated_bsdf.MAX_TRIALS": 2,
    "materials.whole_bsdf.N_UNSEEN": 4,
}


@pytest.fixture
def less(monkeypatch):
    """Fewer points, directions that confirm a material, and steps of a fit.

    Radiance's files are not read back, as in other tests.
    """
    starts = FittedModel.starts
    first = lambda model, finer=False: starts(model, finer)[:1]  # noqa: E731
    monkeypatch.setattr(FittedModel, "starts", first)
    monkeypatch.setattr(Search.minimum, "__defaults__", (1e-3, 1e-3, 3))
    for name, fewer in LESS.items():
        monkeypatch.setattr(f"gonio_mi.{name}", fewer)
