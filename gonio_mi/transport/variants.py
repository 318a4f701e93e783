"""The Mitsuba variants in which the instrument measures."""

import mitsuba as mi

__all__ = ["is_usable", "usable_variants"]


def is_usable(variant: str) -> bool:
    """Whether it computes many rays at once, and without polarisation."""
    return not (variant.startswith("scalar") or variant.endswith("polarized"))


def usable_variants() -> list[str]:
    """Return those of this Mitsuba, whether or not they work on this machine."""
    return [name for name in mi.variants() if is_usable(name)]
