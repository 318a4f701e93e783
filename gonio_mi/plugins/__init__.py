"""The instrument's Mitsuba plugins, registered for whichever variant is current.

Importing this package (``import gonio_mi`` does) is enough: before or after
``mi.set_variant``, and again at each change of variant. A plugin's module is run when
the first one of it is made, for what it imports takes a while, and again at each change
of variant, for it binds Mitsuba's types; its ``PLUGIN`` is what Mitsuba calls.
"""

import functools
import importlib
import inspect
import sys
from typing import Any

import mitsuba as mi

from ..annexes import doors
from ..kernels import know_own_variant, orderly, watched

__all__ = ["MODULES", "modules", "register"]

# By family, as Mitsuba's functions of registration name them, and plugin.
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


def modules() -> dict[str, str]:
    """Families of all plugins, by the qualified names of their modules."""
    ours = {f"{__name__}.{one}": one.partition(".")[0][:-1] for one in MODULES}
    for annex, door in doors():
        ours |= {f"{annex}.{name}": family for name, family in door.PLUGINS.items()}
    return ours


def register() -> None:
    """Register every plugin for the current variant."""
    for module, family in modules().items():
        if module in sys.modules:  # with the types of another variant
            importlib.reload(sys.modules[module])
        # no plugin of others, as those are that :func:`_watch` notes
        add = inspect.unwrap(getattr(mi, f"register_{family}"))
        add(module.rpartition(".")[2], functools.partial(_made, module))


def _made(module: str, props: mi.Properties) -> Any:
    """Plugin with these properties; Mitsuba may make plugins in threads."""
    return importlib.import_module(module).PLUGIN(props)


def _changed(_old: str, _new: str) -> None:
    """Follow a change of variant, in the thread that makes it, however it does so."""
    know_own_variant()
    register()
    _watch()


def _watch() -> None:
    """Note the plugins that others register, now that ours are."""
    for module in (mi, sys.modules[f"{mi.__name__}.{mi.variant()}"]):
        for name, value in [*vars(module).items()]:
            if name.startswith("register_") and not hasattr(value, "__wrapped__"):
                setattr(module, name, watched(value))


if not hasattr(mi.set_variant, "__wrapped__"):
    # once, though Mitsuba 3.10 reloads what an entry point names
    mi.set_variant = orderly(mi.set_variant)
    mi.detail.add_variant_callback(_changed)
if mi.variant():
    register()
    _watch()
