"""Integrals over patches that samples are compared with: exact ones, steps, spikes."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import right_bsdfs

from gonio_mi import SpecimenError
from gonio_mi.collector import EqualAngle
from gonio_mi.validation import integrals as of_lattices
from gonio_mi.validation.conditions import Condition
from gonio_mi.validation.integrals import LATTICE_SHARE, SUM_ERROR, SUM_WIDTH, integrals
from gonio_mi.validation.probe import Probe
from gonio_mi.validation.samples import rounding
from gonio_mi.validation.tally import Damping, patch_totals

GRID = EqualAngle(6, 8)
BEAM = Condition(40.0, 25.0)
N = 2**16
KEY = (0, 1)
UNDAMPED = Damping(np.zeros(0, int), np.full(2 * GRID.n_patches + 1, np.inf))
LIMITS = UNDAMPED.limits


def samples():
    """Cosine-distributed ones."""
    white = mi.load_dict({"type": "diffuse", "reflectance": 1.0})
    return patch_totals(white, BEAM, GRID, N, KEY, UNDAMPED)


class Density:
    """The functions of a BSDF that is a function of wo, for :func:`integrals`."""

    condition = BEAM

    def __init__(self, function):
        self.function = function
        self.bsdf = mi.load_dict({"type": "diffuse"})
        self.wi = mi.Vector3f(BEAM.wi.tolist())

    def pdf(self, wo, wi=None):  # noqa: ARG002
        return dr.select(wo.z > 0, self.function(wo), 0.0)

    def eval(self, wo, wi=None):  # noqa: ARG002
        return mi.Spectrum(self.pdf(wo))

    def eval_and_pdf(self, wo):
        return self.eval(wo), self.pdf(wo)

    def sample(self, sample1, sample2):
        return Probe(self.bsdf, BEAM).sample(sample1, sample2)


def lambert(wo):
    return dr.inv_pi * wo.z


def steps(wo):
    """Half of the Lambertian in a chequered pattern that no patch border follows."""
    half = 0.5 * (dr.floor(5.3 * wo.x) + dr.floor(5.3 * wo.y))
    return lambert(wo) * dr.select(half == dr.floor(half), 0.5, 1.5)


def test_lambertian_is_exact():
    exact = np.concatenate([GRID.projected_solid_angles.ravel() / np.pi, np.zeros(48)])
    probe = Probe(mi.load_dict({"type": "diffuse", "reflectance": 0.5}), BEAM)
    due = integrals(probe, GRID, samples(), LIMITS)
    pdf, (value,) = due.counts, due.channels
    slack = SUM_WIDTH * pdf.std_err + rounding(probe, KEY)[0] * exact
    assert np.all(np.abs(pdf.values - exact) <= slack)
    assert abs(pdf.values.sum() - 1) <= pdf.sum_bound + rounding(probe, KEY)[0]
    assert pdf.sum_bound <= SUM_ERROR
    # all functions share the points
    np.testing.assert_allclose(value.values, 0.5 * pdf.values, rtol=2**-20)


@pytest.mark.parametrize("function", [lambert, steps])
def test_as_precise_as_samples_can_judge(function):
    drawn = samples()
    pdf = integrals(Density(function), GRID, drawn, LIMITS).counts
    noise = np.sqrt(np.maximum(pdf.values, 1 / N) / N)
    assert np.all(pdf.std_err <= LATTICE_SHARE * noise)


def test_errors_of_steps_are_as_they_say():
    """A midpoint rule of 512 x 512 points a patch is 500 times finer."""
    pdf = integrals(Density(steps), GRID, samples(), LIMITS).counts
    n = 512
    theta, phi = ((np.arange(k * n) + 0.5) / n for k in GRID.shape)
    theta, phi = theta * np.pi / 12, phi * np.pi / 4
    sine = np.sin(theta)[:, None]
    wo = np.stack(
        np.broadcast_arrays(
            sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)[:, None]
        )
    )
    values = steps(mi.Vector3f(wo.reshape(3, -1).astype(np.float32))).numpy()
    values = values.reshape(wo.shape[1:]) * sine * (np.pi / 12 / n) * (np.pi / 4 / n)
    fine = values.reshape(6, n, 8, n).sum(axis=(1, 3), dtype=float).ravel()
    off = np.abs(pdf.values[:48] - fine)
    # Student's t of 15 degrees of freedom is beyond twice SUM_WIDTH in one of 1e6 cases
    assert np.all(off <= 2 * SUM_WIDTH * pdf.std_err[:48])
    # the twin: without its errors, it would not agree
    assert np.any(off > rounding(Density(steps), KEY)[0] * fine)


@pytest.mark.parametrize("looks_twice", [True, False])
def test_patches_that_look_smooth_are_looked_at_again(looks_twice, monkeypatch):
    """A table of bright and dark cells, normalised, at grazing incidence.

    Points between the bright cells see little light and a small error: by the points
    that say so, a sum is too small.
    """
    if not looks_twice:
        points, first = of_lattices._lattice_values, {}

        def same_again(probe, subdivision, limits, patches, level, repeat=0):
            if not repeat:
                values = points(probe, subdivision, limits, patches, level)
                each = values.swapaxes(0, 1)
                first.update(zip([(level, k) for k in patches], each))
            return np.stack([first[level, k] for k in patches], axis=1)

        monkeypatch.setattr(of_lattices, "_lattice_values", same_again)
    right_bsdfs.register()
    table = mi.load_dict({"type": "tabulated"})
    grazing = Condition(85.0, 25.0)
    drawn = patch_totals(table, grazing, GRID, N, KEY, UNDAMPED)
    pdf = integrals(Probe(table, grazing), GRID, drawn, LIMITS).counts
    # Student's t of 15 degrees of freedom is beyond twice SUM_WIDTH in one of 1e6 cases
    assert (abs(pdf.values.sum() - 1) <= 2 * pdf.sum_bound) == looks_twice


def test_a_spike_that_a_lattice_misses_is_found_by_samples():
    """A lobe 1e-3 wide, in which samples are, is integrated by smaller cells."""
    sharp = mi.load_dict(
        {"type": "roughconductor", "alpha": 1e-3, "distribution": "ggx"}
    )
    drawn = patch_totals(sharp, BEAM, GRID, N, KEY, UNDAMPED)
    pdf = integrals(Probe(sharp, BEAM), GRID, drawn, LIMITS).counts
    mass = drawn.counts.sum() / N
    # 6 sigma of the binomial, and rounding of so sharp a lobe
    slack = 6 * np.sqrt(mass * (1 - mass) / N) + rounding(Probe(sharp, BEAM), KEY)[0]
    assert abs(pdf.values.sum() - mass) <= pdf.sum_bound + slack


def test_what_takes_too_long_is_refused():
    """Noise has no integral; samples of the spike ask for ever smaller cells."""
    drawn = samples()
    drawn.peaks[:] = 1e9

    def noise(wo):
        number = dr.sin(1e7 * wo.x) * 1e5
        return number - dr.floor(number)

    with pytest.raises(SpecimenError, match="too many evaluations"):
        integrals(Density(noise), GRID, drawn, LIMITS)
