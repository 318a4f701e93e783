"""Mitsuba's own BSDFs with parameters that matter: what `diff` asks by itself."""

from collections.abc import Iterator
from typing import Any

import mitsuba as mi
import numpy as np

# Its name and dictionary.
Case = tuple[str, dict[str, Any]]

GGX = {"distribution": "ggx"}


def _bumps() -> Iterator[dict[str, Any]]:
    """Height and normal maps with a slope, of raw values."""
    heights = np.linspace(0, 0.3, 16, dtype=np.float32).reshape(4, 4, 1)
    normals = np.tile(np.array([0.55, 0.5, 0.99], np.float32), (2, 2, 1))
    return (
        {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": True}
        for values in (heights, normals)
    )


def _texture() -> dict[str, Any]:
    """Checkerboard."""
    return {"type": "checkerboard", "color0": 0.2, "color1": 0.7}


def cases() -> Iterator[Case]:
    """Name as on the command line, and dictionary, of every case."""
    diffuse = {"type": "diffuse", "reflectance": 0.6}
    ggx = {"type": "roughconductor", "alpha": 0.2} | GGX
    yield from (
        ("diffuse", diffuse),
        ("diffuse, checkerboard", {"type": "diffuse", "reflectance": _texture()}),
        ("conductor", {"type": "conductor", "material": "Au"}),
        ("dielectric", {"type": "dielectric"}),
        ("thindielectric", {"type": "thindielectric"}),
    )
    for distribution in ("ggx", "beckmann"):
        for alpha in (0.05, 0.3, 1.0):
            name = f"alpha={alpha:g},distribution={distribution}"
            settings = {"alpha": alpha, "distribution": distribution}
            yield f"roughconductor:{name}", {"type": "roughconductor"} | settings
            yield f"roughdielectric:{name}", {"type": "roughdielectric"} | settings
    yield from (
        (
            "roughconductor:alpha_u=0.1,alpha_v=0.4,distribution=ggx",
            {"type": "roughconductor", "alpha_u": 0.1, "alpha_v": 0.4} | GGX,
        ),
        (
            "roughconductor:alpha=0.3,sample_visible=false,distribution=ggx",
            ggx | {"sample_visible": False},
        ),
        ("plastic", {"type": "plastic"}),
        ("plastic:nonlinear=true", {"type": "plastic", "nonlinear": True}),
        ("roughplastic:alpha=0.1", {"type": "roughplastic", "alpha": 0.1}),
        (
            "roughplastic:alpha=0.3,distribution=ggx",
            {"type": "roughplastic", "alpha": 0.3} | GGX,
        ),
        ("pplastic:alpha=0.3", {"type": "pplastic", "alpha": 0.3}),
    )
    yield from _principled()
    yield from (
        ("hair:sigma_a=0.2", {"type": "hair", "sigma_a": 0.2}),
        ("null", {"type": "null"}),
    )
    yield from _composed(diffuse, ggx)


def _composed(diffuse: dict[str, Any], ggx: dict[str, Any]) -> Iterator[Case]:
    """Cases of BSDFs that hold others."""
    bump, normal = _bumps()
    yield from (
        ("mask of diffuse", {"type": "mask", "opacity": 0.4, "nested": diffuse}),
        ("twosided roughconductor", {"type": "twosided", "nested": ggx}),
        ("twosided, two BSDFs", {"type": "twosided", "front": diffuse, "back": ggx}),
        (
            "blendbsdf of diffuse and roughconductor",
            {"type": "blendbsdf", "weight": 0.3, "first": diffuse, "second": ggx},
        ),
        (
            "blendbsdf of diffuse and conductor",
            {
                "type": "blendbsdf",
                "weight": 0.25,
                "first": diffuse,
                "second": {"type": "conductor"},
            },
        ),
        (
            "bumpmap of diffuse",
            {"type": "bumpmap", "arbitrary": bump, "nested": diffuse},
        ),
        (
            "normalmap of roughconductor",
            {"type": "normalmap", "normalmap": normal, "nested": ggx},
        ),
    )


def _principled() -> Iterator[Case]:
    """Cases of both principled BSDFs."""
    yield from (
        ("principled", {"type": "principled"}),
        (
            "principled:metallic=1,anisotropic=0.8,roughness=0.3",
            {
                "type": "principled",
                "metallic": 1.0,
                "anisotropic": 0.8,
                "roughness": 0.3,
            },
        ),
        (
            "principled:clearcoat=1,sheen=0.5,flatness=0.5",
            {"type": "principled", "clearcoat": 1.0, "sheen": 0.5, "flatness": 0.5},
        ),
        (
            "principled:spec_trans=0.7,eta=1.5,roughness=0.4",
            {"type": "principled", "spec_trans": 0.7, "eta": 1.5, "roughness": 0.4},
        ),
        ("principledthin", {"type": "principledthin"}),
        (
            "principledthin:spec_trans=0.5,diff_trans=1,roughness=0.4",
            {
                "type": "principledthin",
                "spec_trans": 0.5,
                "diff_trans": 1.0,
                "roughness": 0.4,
            },
        ),
    )
