"""The instrument's Mitsuba plugins, registered for whichever variant is current.

Importing this package (``import gonio_mi`` does) is enough: before or after
``mi.set_variant``, and again at each change of variant.
"""

import importlib
import sys

import mitsuba as mi

from ..annexes import doors
from ..kernels import know_own_variant, orderly, watched

__all__ = ["MODULES", "modules", "register"]

# In the order of registration: a module comes after those whose plugins it looks up,
# and those of annexes after ours.
MODULES = (
    "samplers.sobol",
    "shapes.heightfield",
    "shapes.stl",
    "bsdfs.cosinelobe",
    "bsdfs.glossymixture",
    "bsdfs.anisotropicphong",
    "films.patches",
    "sensors.collector",
    "integrators.goniophotometer",
)


def modules() -> list[str]:
    """Qualified names of the modules of all plugins, in the order of registration."""
    ours = [f"{__name__}.{name}" for name in MODULES]
    return ours + [
        f"{annex}.{name}" for annex, door in doors() for name in door.PLUGINS
    ]


def register() -> None:
    """Register every plugin for the current variant.

    The plugin modules bind Mitsuba's types when they are run, so that they are run
    again for each variant.
    """
    for qualified in modules():
        if qualified in sys.modules:
            importlib.reload(sys.modules[qualified])
        else:
            importlib.import_module(qualified)


def _changed(_old: str, _new: str) -> None:
    """Follow a change of variant, in the thread that makes it, however it does so."""
    know_own_variant()
    register()
    _watch()


def _watch() -> None:
    """Note the plugins that others register, now that ours are."""
    for name, value in [*vars(mi).items()]:
        if name.startswith("register_") and not hasattr(value, "__wrapped__"):
            setattr(mi, name, watched(value))


if not hasattr(mi.set_variant, "__wrapped__"):
    # once, though Mitsuba 3.10 reloads what an entry point names
    mi.set_variant = orderly(mi.set_variant)
    mi.detail.add_variant_callback(_changed)
if mi.variant():
    register()
    _watch()
