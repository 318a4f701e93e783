"""Mitsuba's own BSDFs and phase functions, with sets of parameters of each."""

from collections.abc import Iterator
from typing import Any

import mitsuba as mi
import numpy as np


def bsdfs() -> Iterator[list[dict[str, Any]]]:
    """Mitsuba's own BSDFs, with three sets of parameters each where there are as many.

    `measured` and `measured_polarized` need files and are left out. Polarising ones are
    included in polarised variants, `hair` with its pigments in variants with colours.
    """
    ggx = {"distribution": "ggx"}
    checkers: Any = {"type": "checkerboard", "color0": 0.2, "color1": 0.7}
    sets: dict[str, list[dict[str, Any]]] = {
        "diffuse": [{"reflectance": x} for x in (0.6, checkers, 1.0)],
        "conductor": [{"material": x} for x in ("none", "Al", "Au")],
        "roughconductor": [
            {"alpha": 0.1},
            {"alpha": 0.3} | ggx,
            {"alpha_u": 0.1, "alpha_v": 0.4} | ggx,
            {"alpha": 0.3, "sample_visible": False} | ggx,
        ],
        "dielectric": [{"int_ior": x} for x in (1.33, 1.5, 2.4)],
        "thindielectric": [{"int_ior": x} for x in (1.33, 1.5, 2.4)],
        "roughdielectric": [
            {"alpha": 0.3},
            {"alpha": 0.2} | ggx,
            {"alpha": 0.3, "sample_visible": False} | ggx,
        ],
        "plastic": [
            {},
            {"nonlinear": True},
            {"int_ior": 1.9},
            {"specular_reflectance": 0.8},
        ],
        "roughplastic": [{"alpha": 0.1}, {"alpha": 0.3} | ggx, {"alpha": 0.6}],
        "pplastic": [{"alpha": x} for x in (0.1, 0.3, 0.6)],
        "principled": [
            {},
            {"metallic": 1.0, "anisotropic": 0.8, "roughness": 0.3},
            {"clearcoat": 1.0, "sheen": 0.5, "flatness": 0.5},
            {"spec_trans": 0.7, "eta": 1.5, "roughness": 0.4},
        ],
        "principledthin": [
            {},
            {"spec_trans": 0.5, "diff_trans": 1.0, "roughness": 0.4},
            {"diff_trans": 2.0},
        ],
        "hair": [{"sigma_a": x} for x in (0.0, 0.2, 2.0)],
        "null": [{}],
    }
    sets |= _composed()
    if mi.is_polarized:
        sets |= {
            "polarizer": [{"theta": x} for x in (0.0, 20.0, 90.0)],
            "retarder": [{"theta": x} for x in (0.0, 20.0, 90.0)],
            "circular": [{}, {"left_handed": True}, {"transmittance": 0.5}],
        }
    if not mi.is_monochromatic:
        sets["hair"].append({})
    for name, ones in sets.items():
        yield [{"type": name} | one for one in ones]


def _composed() -> dict[str, list[dict[str, Any]]]:
    """Parameters of BSDFs that nest other BSDFs."""
    diffuse, glossy = {"type": "diffuse"}, {"type": "roughconductor", "alpha": 0.2}
    heights = np.linspace(0, 0.3, 16, dtype=np.float32).reshape(4, 4, 1)
    normals = np.tile(np.array([0.55, 0.5, 0.99], np.float32), (2, 2, 1))
    bumps, slopes = (
        {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": True}
        for values in (heights, normals)
    )
    nested = (diffuse, glossy, {"type": "plastic"})
    bright, dark = (
        {"type": "conductor", "specular_reflectance": x} for x in (0.9, 0.4)
    )
    return {
        "mask": [{"opacity": x, "nested": diffuse} for x in (0.2, 0.5, 0.9)],
        "twosided": [
            {"nested": glossy},
            {"nested": {"type": "plastic"}},
            {"front": diffuse, "back": glossy},
        ],
        "blendbsdf": [
            {"weight": 0.3, "first": diffuse, "second": glossy},
            {"weight": 0.7, "first": diffuse, "second": {"type": "plastic"}},
            {"weight": 0.25, "first": diffuse, "second": {"type": "conductor"}},
            {"weight": 0.3, "first": bright, "second": dark},
        ],
        "bumpmap": [{"heights": bumps, "nested": one} for one in nested],
        "normalmap": [{"normalmap": slopes, "nested": one} for one in nested],
    }


def cases() -> Iterator[tuple[str, dict[str, Any]]]:
    """Name, as on the command line where possible, and dictionary of each BSDF."""
    for ones in bsdfs():
        for one in ones:
            yield word_of(one), one


def word_of(one: dict[str, Any]) -> str:
    """Name of a plugin and its parameters, as on the command line where possible."""
    nested = " and ".join(x["type"] for x in one.values() if isinstance(x, dict))
    plain = {k: x for k, x in one.items() if not isinstance(x, dict)}
    text = plain.pop("type")
    given = ",".join(f"{k}={x}" for k, x in plain.items())
    if given:
        text += f":{given}"
    return f"{text} of {nested}" if nested else text


def phase_functions() -> Iterator[list[dict[str, Any]]]:
    """Mitsuba's own phase functions, with sets of parameters of each."""
    lobes = [{"g": x} for x in (-0.5, 0.5, 0.9)]
    values = ("0.5, 1.0, 1.5", "1.0, 0.2, 1.0", "0.1, 0.1, 3.0")
    flakes = ((1, 1, 1, 0, 0, 0), (0.05, 1, 1, 0, 0, 0), (0.1, 1, 0.3, 0.1, 0, 0))
    first = {"type": "isotropic"}
    nearest: dict[str, Any] = {"type": "gridvolume", "filter_type": "nearest"}
    sets: dict[str, list[dict[str, Any]]] = {
        "isotropic": [{}],
        "hg": lobes,
        "rayleigh": [{}],
        "tabphase": [{"values": one} for one in values],
        "sggx": [
            {"S": nearest | {"grid": mi.VolumeGrid(np.array([[[one]]], np.float32))}}
            for one in flakes
        ],
        "blendphase": [
            {"weight": x, "first": first, "second": {"type": "hg", "g": 0.6}}
            for x in (0.2, 0.5, 0.8)
        ],
    }
    for name, ones in sets.items():
        yield [{"type": name} | one for one in ones]
