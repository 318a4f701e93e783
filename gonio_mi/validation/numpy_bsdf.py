"""BSDFs that are not Mitsuba's: three functions on NumPy arrays, as a Mitsuba BSDF."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from ..errors import SettingTypeError
from ..mitsuba_compat import floats
from .probe import numbers, spectral, vectors


def from_numpy(
    sample: Callable[..., Any],
    eval: Callable[..., Any],  # noqa: A002 (as the function of Mitsuba is called)
    pdf: Callable[..., Any],
    *,
    transmits: bool = False,
    two_sided: bool = False,
) -> mi.BSDF:
    """Mitsuba BSDF of three functions on arrays of directions.

    What another engine, a shader or a port computes is judged by
    :func:`gonio_mi.validate` and measured by :func:`gonio_mi.measure` like any
    plugin. All lobes are one component without discrete directions, the same in
    both transport modes.

    Parameters
    ----------
    sample : callable
        ``sample(wi, u)``, with unit vectors to the source of shape ``(n, 3)`` and
        random numbers in [0, 1) of the same shape, returns directions ``(n, 3)``,
        weights, ``eval`` over ``pdf``, ``(n,)`` or ``(n, channels)``, 0 where it fails,
        and densities ``(n,)`` in 1/sr. The surface is z = 0, its normal +z.
    eval : callable
        ``eval(wi, wo)`` returns the BSDF times ``|cos theta_o|``, ``(n,)`` or
        ``(n, channels)``, in 1/sr.
    pdf : callable
        ``pdf(wi, wo)`` returns densities ``(n,)`` in 1/sr.
    transmits : bool
        Whether light passes to the other side.
    two_sided : bool
        Whether it scatters light that comes from below.

    Returns
    -------
    mi.BSDF
        For the variant that is set.

    Raises
    ------
    TypeError
        If one is no function.
    """
    for name, function in (("sample", sample), ("eval", eval), ("pdf", pdf)):
        if not callable(function):
            raise _no_function(name, function)
    flags = mi.BSDFFlags
    lobes = int(flags.GlossyReflection) | int(flags.FrontSide)
    lobes |= int(flags.GlossyTransmission) if transmits else 0
    lobes |= int(flags.BackSide) if two_sided or transmits else 0

    class Adapter(mi.BSDF):
        """Calls the functions with arrays, and returns what Mitsuba expects."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.m_flags, self.m_components = lobes, [lobes]

        def _on(self, ctx: Any, active: Any) -> Any:
            return active & ctx.is_enabled(flags.GlossyReflection, 0)

        def sample(
            self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True
        ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
            """Answer of the first function."""
            n = dr.width(si.wi, sample1, sample2, active)
            wi = spectral(si.wi, n)
            u = np.column_stack([numbers(sample1, n), spectral(sample2, n)])
            wo, weight, density = sample(wi, u)
            bs = dr.zeros(mi.BSDFSample3f, n)
            bs.wo, bs.pdf = vectors(np.asarray(wo)), floats(np.broadcast_to(density, n))
            bs.eta = 1.0
            kinds = (flags.GlossyTransmission, flags.GlossyReflection)
            passes = bs.wo.z * si.wi.z < 0
            bs.sampled_type = dr.select(passes, *(mi.UInt32(int(x)) for x in kinds))
            return bs, _spectrum(weight, n) & self._on(ctx, active)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> mi.Spectrum:
            """Answer of the second function."""
            n = dr.width(si.wi, wo, active)
            value = eval(spectral(si.wi, n), spectral(wo, n))
            return _spectrum(value, n) & self._on(ctx, active)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> mi.Float:
            """Answer of the third function."""
            n = dr.width(si.wi, wo, active)
            value = np.broadcast_to(pdf(spectral(si.wi, n), spectral(wo, n)), n)
            return dr.select(self._on(ctx, active), floats(value), 0)

        def to_string(self) -> str:
            return "Adapter[]"

    # the plugin of whoever wrote the functions, which read values, and none of ours
    Adapter.__module__ = "from_numpy"
    return Adapter(mi.Properties("adapter"))


def _no_function(name: str, thing: object) -> SettingTypeError:
    kind = type(thing).__name__
    return SettingTypeError(f"{name} must be a function, got {kind}")


def _spectrum(values: ArrayLike, n: int) -> mi.Spectrum:
    values = np.asarray(values, dtype=np.float32)
    values = values[:, None] if values.ndim == 1 else values
    channels = dr.size_v(mi.Spectrum)
    return mi.Spectrum(*map(floats, np.broadcast_to(values, (n, channels)).T))
