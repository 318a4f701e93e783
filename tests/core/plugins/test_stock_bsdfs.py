"""Every stock BSDF against the converged integral of its own `eval` over each patch.

`measure` only calls `sample`, the reference only `eval`: they agree where
instrument and BSDF are right.
"""

from functools import cache, lru_cache

import mitsuba as mi
import numpy as np
import pytest
from budget import agree, disagree, scores, single, verdict
from closed_forms import eval_flux, fresnel, patch_fluxes, slab

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.specimen.specimen_text import parse_specimen

RAYS = 5 * 10**5
ANGLES = (0, 60, 89.9)
PHI_I = 25.0
COLLECTOR = "projected:8x16"


CONDUCTOR = {"type": "roughconductor", "alpha": 0.3}
REFLECTING = {
    "diffuse": "diffuse:reflectance=0.6",
    "ggx": "roughconductor:distribution=ggx,alpha=0.3,material=Au",
    "beckmann": "roughconductor:distribution=beckmann,alpha=0.3",
    "ggx anisotropic": "roughconductor:distribution=ggx,alpha_u=0.15,alpha_v=0.5",
    "beckmann anisotropic": "roughconductor:distribution=beckmann,"
    "alpha_u=0.15,alpha_v=0.5",
    "ggx all normals": "roughconductor:distribution=ggx,alpha=0.3,sample_visible=false",
    "plastic": "plastic:diffuse_reflectance=0.7",
    "plastic nonlinear": "plastic:diffuse_reflectance=0.7,nonlinear=true",
    "roughplastic": "roughplastic:alpha=0.3,diffuse_reflectance=0.7,distribution=ggx",
    "roughplastic beckmann": "roughplastic:alpha=0.3,nonlinear=true",
    "principled": "principled:roughness=0.5,anisotropic=0.5,metallic=0.3,specular=0.6",
    "principled coat": "principled:roughness=0.6,clearcoat=0.8,clearcoat_gloss=0.2,"
    "sheen=0.5,flatness=0.4",
    "twosided": {"type": "twosided", "bsdf": CONDUCTOR},
    "blendbsdf": {
        "type": "blendbsdf",
        "weight": 0.3,
        "first": {"type": "diffuse", "reflectance": 0.4},
        "second": CONDUCTOR,
    },
    "mask": {"type": "mask", "opacity": 0.7, "nested": CONDUCTOR},
}
# Textures need a variant when they are made
MAPPED = {
    "pplastic": "pplastic:alpha=0.3,diffuse_reflectance=0.5",
    "normalmap": lambda: {
        "type": "normalmap",
        "normalmap": bitmap(*2 * [2 * [[0.55, 0.5, 0.99]]]),
        "bsdf": CONDUCTOR,
    },
    "bumpmap": lambda: {
        "type": "bumpmap",
        "bump": bitmap([[0.0] * 3, [0.3] * 3], [[0.1] * 3, [0.4] * 3]),
        "bsdf": CONDUCTOR,
    },
}
TRANSMITTING = {
    "roughdielectric": "roughdielectric:alpha=0.3,int_ior=1.5",
    "roughdielectric beckmann": "roughdielectric:alpha=0.4,int_ior=1.33,"
    "distribution=beckmann",
    "principled transmission": "principled:roughness=0.5,spec_trans=0.7,eta=1.4",
    "principledthin": "principledthin:roughness=0.5,spec_trans=0.5,diff_trans=0.8,"
    "eta=1.4",
}
COLOURED = {
    "copper": "roughconductor:alpha=0.3,material=Cu",
    "coloured principled": "principled:base_color=0.8/0.4/0.1,roughness=0.5,"
    "metallic=0.5",
    "coloured roughplastic": "roughplastic:alpha=0.3,diffuse_reflectance=0.1/0.5/0.9",
}


def bitmap(*rows):
    """Texture of raw values."""
    pixels = np.array(rows, np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True}


@lru_cache(1)
def loaded(variant, name):
    """A specimen by its name, in the variant that is set: tests of it come in turn."""
    del variant
    specimen = (REFLECTING | MAPPED | TRANSMITTING | COLOURED)[name]
    if isinstance(specimen, str):
        specimen = parse_specimen(specimen)
    return mi.load_dict(specimen() if callable(specimen) else specimen)


def settings(side, nm):
    how = {"footprint": "point", "collector": COLLECTOR}
    return how | {"side": side, "wavelengths": nm}


# A record holds both hemispheres and all channels, and tests of these come in turn;
# integrals know of no sampler. The variant is a part of what they are kept by.
@lru_cache(1)
def measured(variant, name, theta_i, side, nm, sampler, rays):
    """BSDF and record."""
    bsdf = loaded(variant, name)
    return bsdf, gonio.measure(
        bsdf, theta_i, PHI_I, rays=rays, sampler=sampler, **settings(side, nm)
    )


@cache
def integrated(variant, name, theta_i, side, nm):
    """Flux fractions by the estimator `quadrature`."""
    # far below the error bars of rays
    how = settings(side, nm) | {"estimator": "quadrature", "rel_err": 1e-3}
    return gonio.measure(loaded(variant, name), theta_i, PHI_I, **how).flux_fraction


@pytest.fixture(autouse=True, scope="module")
def forgotten():
    """Leave no BSDF to tests of other files."""
    yield
    measured.cache_clear()
    loaded.cache_clear()


@lru_cache(1)
def references(hemisphere, *condition):
    """Fluxes into patches by `eval`, and which of them converged."""
    _, _, theta_i, side, nm, _, _ = condition
    bsdf, record = measured(*condition)
    lower = (hemisphere == 1) != (side == "back")
    std_err = (record.brdf_std_err, record.btdf_std_err)[hemisphere]
    std_err = std_err * record.subdivision.projected_solid_angles[..., None]
    # a twentieth of the error bars, so that the reference's error does not show
    tolerance = 0.05 * np.nan_to_num(std_err, nan=1e-8).min(axis=2) + 1e-9
    reference, errors = patch_fluxes(
        lambda wo: eval_flux(
            bsdf, theta_i, PHI_I, wo, side=side, nm=None if nm is None else list(nm)
        ),
        record.subdivision,
        tolerance=tolerance,
        lower=lower,
    )
    keep = delta_patches(record, theta_i, PHI_I)
    keep &= (errors <= 2 * tolerance[..., None]).all(axis=2)
    return reference, keep


def delta_patches(record, theta_i, phi_i):
    """Mask without the patches of mirror and straight transmission."""
    keep = np.ones(record.subdivision.n_patches, bool)
    for azimuth in (phi_i, phi_i + 180):
        v = direction(np.radians(theta_i), np.radians(azimuth))
        keep[record.subdivision.patch(v)] = False
    return keep.reshape(record.subdivision.shape)


def compared(
    name,
    theta_i,
    *,
    hemisphere=0,
    channel=0,
    side="front",
    nm=None,
    off=None,
    sampler="independent",
    rays=RAYS,
):
    """Scores of a measurement against the integral of `eval`, and the twin's."""
    condition = mi.variant(), name, theta_i, side, nm, sampler, rays
    _, record = measured(*condition)
    reference, keep = references(hemisphere, *condition)
    assert keep.mean() > 0.9, "the quadrature did not converge"
    if record.flux_fraction[hemisphere].shape[-1] == 1:
        reference = reference[..., :1]
    z = scores(record, reference[..., channel], hemisphere, channel, keep)
    if z.size:  # the estimator `quadrature`, which knows nothing of this reference
        exact = integrated(*condition[:5])[hemisphere][..., channel]
        agree(verdict(scores(record, exact, hemisphere, channel, keep)))
    # a grazing beam leaves few hits in the diffuse part of a plastic
    off = off or (1.02 if theta_i < 89 else 1.2)
    wrong = off * reference[..., channel]
    return z, scores(record, wrong, hemisphere, channel, keep)


def judged(z, twin):
    agree(verdict(z))
    disagree(verdict(twin))


@pytest.mark.parametrize("theta_i", ANGLES)
@pytest.mark.parametrize("name", REFLECTING)
def test_brdf(name, theta_i):
    judged(*compared(name, theta_i))


@pytest.mark.parametrize("name", REFLECTING | TRANSMITTING)
def test_sobol(name):
    """Fewer rays, since they are worth more."""
    judged(*compared(name, 60, sampler="sobol", rays=10**5, off=1.1))


@pytest.mark.usefixtures("rgb")
@pytest.mark.parametrize("theta_i", [0, 60])
@pytest.mark.parametrize("name", MAPPED)
def test_brdf_of_mapped(name, theta_i):
    judged(*compared(name, theta_i))


@pytest.mark.parametrize("theta_i", ANGLES)
@pytest.mark.parametrize("thin", [False, True])
def test_thindielectric_against_fresnel(theta_i, thin):
    """Delta components are tested by direction and weight, not by density."""
    name = "thindielectric" if thin else "dielectric"
    record = gonio.measure(
        {"type": name, "int_ior": 1.5, "ext_ior": 1.0}, theta_i, sampler="independent"
    )
    cosine = np.cos(np.radians(theta_i))
    r = slab(cosine, 1.5) if thin else fresnel(cosine, 1.5)
    n = record.ledger.emitted
    z = (record.ledger.reflected - n * r) / np.sqrt(n * r * (1 - r))
    agree(single(z))
    off = 0.05 * min(r, 1 - r) if theta_i < 89 else 0.2 * (1 - r)
    disagree(single(z + 2 * off * np.sqrt(n / (r * (1 - r)))))


@pytest.mark.parametrize("hemisphere", [0, 1])
@pytest.mark.parametrize("theta_i", ANGLES)
@pytest.mark.parametrize("side", ["front", "back"])
@pytest.mark.parametrize("name", TRANSMITTING)
def test_bsdf_of_transmitting(name, hemisphere, side, theta_i):
    z, twin = compared(name, theta_i, hemisphere=hemisphere, side=side, off=1.05)
    if not z.size:
        pytest.skip("too few rays for one score")
    agree(verdict(z))
    if z.size > 10:
        disagree(verdict(twin))


@pytest.mark.usefixtures("rgb")
@pytest.mark.parametrize("channel", [0, 1, 2])
@pytest.mark.parametrize("name", COLOURED)
def test_colours(name, channel):
    judged(*compared(name, 45, channel=channel))


@pytest.mark.usefixtures("spectral")
@pytest.mark.parametrize("channel", [0, 3])
def test_wavelengths(channel):
    nm = (450.0, 520.0, 580.0, 650.0)
    judged(*compared("copper", 45, channel=channel, nm=nm))
