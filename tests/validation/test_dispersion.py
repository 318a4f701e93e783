# ruff: noqa: ARG001 (every method has Mitsuba's signature)
"""Answers that differ by wavelength, in a spectral variant."""

import drjit as dr
import mitsuba as mi
import numpy as np
import plain_bsdf
import pytest
from reproduced import told

from gonio_mi.validation import reproducer, validate
from gonio_mi.validation.conditions import WAVELENGTHS_NM

INDICES = [1.48 + 6000 / wavelength**2 for wavelength in WAVELENGTHS_NM]


class Glass:
    """Right: each wavelength has its index, and directions are those of the first.

    In `mode`, light that crosses has a factor of each wavelength, or of it and side.
    """

    mode, front, back, eta = "Radiance", 4 * [1.0], 4 * [1.0], 1.0

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        rough = {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.3}
        self.glasses = [
            mi.load_dict(rough | {"ext_ior": 1.0, "int_ior": n}) for n in INDICES
        ]
        first = self.glasses[0]
        self.m_components, self.m_flags = (
            [first.flags(0), first.flags(1)],
            first.flags(),
        )

    def eval(self, ctx, si, wo, active):
        answers = [one.eval(ctx, si, wo, active) for one in self.glasses]
        value = mi.Spectrum([one[i] for i, one in enumerate(answers)])
        if ctx.mode == getattr(mi.TransportMode, self.mode):
            front, back = mi.Spectrum(self.front), mi.Spectrum(self.back)
            crosses = si.wi.z * wo.z < 0
            value *= dr.select(crosses, dr.select(si.wi.z > 0, front, back), 1.0)
        return value

    def pdf(self, ctx, si, wo, active):
        return self.glasses[0].pdf(ctx, si, wo, active)

    def sample(self, ctx, si, sample1, sample2, active):
        bs, weight = self.glasses[0].sample(ctx, si, sample1, sample2, active)
        bs.eta = dr.select(si.wi.z * bs.wo.z < 0, self.eta * bs.eta, bs.eta)
        given = (weight[0] > 0) & (bs.pdf > 0)
        return bs, (self.eval(ctx, si, bs.wo, active) / bs.pdf) & given

    def to_string(self):
        return "Glass[]"


def verdict(**changes):
    return validate(plain_bsdf.changed(Glass, **changes), effort="quick")


@pytest.mark.usefixtures("spectral")
def test_each_wavelength_may_have_an_index():
    """A right one has no failure at all."""
    assert not verdict().failures


@pytest.mark.usefixtures("spectral")
def test_eta_of_a_sample_is_that_of_the_first_wavelength():
    found = verdict(eta=INDICES[1] / INDICES[0])["directions"]
    assert "eta of a transmitted direction is wrong" in found.mistake
    assert f"where the transport modes of `eval` have {INDICES[0]:.4g}" in str(
        found.statistic
    )


@pytest.mark.usefixtures("spectral")
@pytest.mark.parametrize("mode", ["Radiance", "Importance"])
def test_modes_and_ways_that_contradict_each_other_are_told(mode):
    """Of the first index in one mode: or its light is coloured one way only."""
    ratio = np.square(np.array(INDICES) / INDICES[0])
    front, back = ratio.tolist(), (1 / ratio).tolist()
    if mode == "Importance":
        front, back = (1 / ratio).tolist(), ratio.tolist()
    judged = verdict(mode=mode, front=front, back=back)
    assert [one.name for one in judged.failures] == ["adjoint"]
    assert judged["adjoint"].effect == "breaks some integrators"
    assert "`eval` at 650 nm transmits" in judged.mistake
    assert "where both are eta^2 of that wavelength" in judged.mistake


@pytest.mark.usefixtures("spectral")
def test_a_first_wavelength_that_is_not_reciprocal_is_told():
    factors = [1.2, 1.0, 1.0, 1.0]
    found = {
        mode: verdict(mode=mode, front=factors) for mode in ("Radiance", "Importance")
    }
    assert found["Radiance"]["adjoint"].effect == "biases images"
    assert found["Importance"]["reciprocity"].status == "fails"


@pytest.mark.usefixtures("spectral")
@pytest.mark.parametrize("band", [(525.0, 575.0), (380.0, 430.0), (900.0, 950.0)])
def test_a_mistake_in_a_band_is_found(band):
    """Between the wavelengths of single directions; the twin is beyond the visible."""
    plain = plain_bsdf.plain()

    def weight(self, ctx, si, bs):
        inside = (si.wavelengths > band[0]) & (si.wavelengths < band[1])
        return self.reflectance * dr.select(inside, 0.9, mi.Spectrum(1.0))

    mi.register_bsdf("of_a_band", type("Plugin", (plain,), {"weight": weight}))
    judged = validate({"type": "of_a_band"}, effort="quick")
    assert judged.passed == (band[0] > 800)
    if not judged.passed:
        assert judged["sampled_weight"].effect == "biases images"
        assert told(reproducer(judged)) > 1
