"""What ``mi.traverse`` says of a BSDF: its parameters, to be changed for a while."""

import contextlib
import re

import mitsuba as mi
import numpy as np

from .probe import blamed

__all__ = ["changed", "coloured", "traversed"]

# How much a grey parameter keeps in each channel; none gains.
TINT = (1.0, 0.8, 0.6)

# Names of parameters that are a colour.
COLOURS = re.compile("reflectance|transmittance|colou?r|albedo|tint")


def traversed(bsdf):
    """Parameters of a BSDF; raises PluginFault if the plugin does."""
    with blamed("traverse"):
        return mi.traverse(bsdf)


@contextlib.contextmanager
def changed(bsdf, values):
    """Give parameters other values, by name, until the end of the block."""
    params = traversed(bsdf) if values else {}
    before = {name: type(params[name])(params[name]) for name in values}
    try:
        _assign(params, values)
        yield
    finally:
        _assign(params, before)


def _assign(params, values):
    for name, value in values.items():
        params[name] = value
    if values:
        with blamed("parameters_changed"):
            params.update()


def coloured(bsdf, specimen):
    """BSDF of the dictionary `specimen`, with its grey parameters tinted, in rgb.

    `bsdf` is the same as it is; it is returned where there is nothing to tint.
    """
    tints = _tints(bsdf) if mi.is_rgb else {}
    if not tints:
        return bsdf
    try:
        return mi.load_dict(specimen | tints)
    except Exception:
        return bsdf  # what such a parameter may be is up to the plugin


def _tints(bsdf):
    """Tinted colours by name, as in a dictionary; none without ``traverse``."""
    try:
        params = mi.traverse(bsdf)
    except Exception:
        return {}  # `answers` says so
    tints = {}
    for key in params.keys():  # noqa: SIM118
        name, value = key.removesuffix(".value"), params[key]
        if not COLOURS.search(name) or not isinstance(value, (mi.Float, mi.Color3f)):
            continue
        value = np.ravel(value)
        if "." not in name and np.ptp(value) == 0 and 0 < value[0] <= 1:
            tint = [float(value[0]) * share for share in TINT]
            tints[name] = {"type": "rgb", "value": tint}
    return tints
