"""Right plugins pass, whatever the seed; with GONIO_SEEDS=200 more of them are tried.

All verdicts on one plugin share one share of the suite's budget (see budget.py); the
twins are the broken plugins of test_validation.py.
"""

import os

import budget
import mitsuba as mi
import pytest

from gonio_mi.validation import maps, validate
from gonio_mi.validation.integrals import integrals

SEEDS = int(os.environ.get("GONIO_SEEDS", "1"))

GGX = {"type": "roughconductor", "distribution": "ggx"}
RIGHT = {
    "lambert": {"type": "diffuse", "reflectance": 1.0},
    "ggx 0.05": GGX | {"alpha": 0.05},
    "ggx 0.2": GGX | {"alpha": 0.2},
    "ggx 1": GGX | {"alpha": 1.0},
    "ggx brushed, all normals": GGX
    | {"alpha_u": 0.1, "alpha_v": 0.4, "sample_visible": False},
    "rough glass": {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.2},
    "glossymixture": {"type": "glossymixture"},
    "cosinelobe": {"type": "cosinelobe"},
    "anisotropicphong": {"type": "anisotropicphong"},
    "mirror": {"type": "conductor"},
    "glass": {"type": "dielectric"},
    "plastic": {"type": "plastic"},
}


@pytest.fixture
def remembered(monkeypatch):
    """Integrals do not depend on the seed, but for how far they are refined."""
    known = {}

    def integral(probe, *args):
        if probe.condition not in known:
            known[probe.condition] = integrals(probe, *args)
        return known[probe.condition]

    monkeypatch.setattr(maps, "integrals", integral)


@pytest.mark.usefixtures("mono", "remembered")
@pytest.mark.parametrize("name", RIGHT)
def test_right_plugins_pass(name):
    bsdf = mi.load_dict(RIGHT[name])
    alpha = budget.ALPHA / SEEDS
    for seed in range(SEEDS):
        verdict = validate(bsdf, effort="quick", seed=seed, alpha=alpha)
        assert verdict.passed, f"seed {seed}\n{verdict}"
