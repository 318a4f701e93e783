"""The functions of a BSDF, called with care: what they answer is checked for its form.

Whatever a plugin does wrong there ends in a :class:`PluginFault`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats, Numbers
from ..errors import own_place
from ..transport.plugin_answers import (
    PluginFault,
    checked_answer,
    checked_parts,
    checked_sample,
    missing_method,
)
from .conditions import Condition

__all__ = ["PluginFault", "Probe", "Sampled", "blamed", "numbers", "spectral"]

# Channels of a spectral variant, in nm.
WAVELENGTHS_NM = (450.0, 520.0, 580.0, 650.0)


@dataclass
class Sampled:
    """Answer of ``sample``: Mitsuba's record and the weight."""

    bs: mi.BSDFSample3f
    weight: mi.Spectrum

    @property
    def delta(self) -> mi.Bool:
        """Whether in a discrete set of directions."""
        return mi.has_flag(self.bs.sampled_type, mi.BSDFFlags.Delta)


class Probe:
    """The functions of a BSDF under one condition.

    Each call is a kernel of its own, from arrays in memory to arrays in memory, so that
    all that ask for the same function share one: of a large plugin, compiling takes far
    longer than all evaluations.

    Parameters
    ----------
    bsdf : mi.BSDF
    condition : Condition
    """

    def __init__(self, bsdf: mi.BSDF, condition: Condition) -> None:
        self.bsdf, self.condition = bsdf, condition
        self.ctx = condition.context
        self.wi = mi.Vector3f(condition.wi.tolist())
        self.uv = mi.Point2f(list(condition.uv))

    def interaction(self, wi: mi.Vector3f | None = None) -> mi.SurfaceInteraction3f:
        """Point of a flat surface in z = 0, of 2 x 2 scene units, lit from `wi`."""
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.t = 1.0
        si.uv = self.uv
        si.n = mi.Normal3f(0, 0, 1)
        si.sh_frame = mi.Frame3f(
            mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1)
        )
        si.dp_du, si.dp_dv = mi.Vector3f(2, 0, 0), mi.Vector3f(0, 2, 0)
        if mi.is_spectral:
            si.wavelengths = mi.Spectrum(list(WAVELENGTHS_NM))
        si.wi = self.wi if wi is None else wi
        return si

    def sample(
        self,
        sample1: mi.Float,
        sample2: mi.Point2f,
        active: mi.Bool = True,
        wi: mi.Vector3f | None = None,
    ) -> Sampled:
        """Answer of ``sample``."""
        answer = self._call("sample", sample1, sample2, active=active, wi=wi)
        return self._sampled(
            "sample", answer, self._width(wi, sample1, sample2, active)
        )

    def eval(
        self,
        wo: mi.Vector3f,
        active: mi.Bool = True,
        wi: mi.Vector3f | None = None,
        ctx: mi.BSDFContext | None = None,
    ) -> mi.Spectrum:
        """Answer of ``eval``."""
        answer = self._call("eval", wo, active=active, wi=wi, ctx=ctx)
        return self._spectrum("eval", answer, self._width(wi, wo, active))

    def pdf(
        self, wo: mi.Vector3f, active: mi.Bool = True, wi: mi.Vector3f | None = None
    ) -> mi.Float:
        """Answer of ``pdf``."""
        answer = self._call("pdf", wo, active=active, wi=wi)
        return self._float("pdf", answer, self._width(wi, wo, active))

    def eval_and_pdf(self, wo: mi.Vector3f) -> tuple[mi.Spectrum, mi.Float]:
        """Answers of ``eval`` and of ``pdf``, whose kernel shares their work."""
        answers = [self._asked(name, wo) for name in ("eval", "pdf")]
        with blamed("eval"):
            dr.eval(answers)
        n = self._width(None, wo)
        return self._spectrum("eval", answers[0], n), self._float("pdf", answers[1], n)

    def eval_pdf(
        self, wo: mi.Vector3f, active: mi.Bool = True
    ) -> tuple[mi.Spectrum, mi.Float]:
        """Both answers of ``eval_pdf``."""
        answer = self._call("eval_pdf", wo, active=active)
        value, pdf = checked_parts("eval_pdf", answer, 2)
        n = dr.width(wo, active)
        return self._spectrum("eval_pdf", value, n), self._float("eval_pdf", pdf, n)

    def eval_pdf_sample(
        self,
        wo: mi.Vector3f,
        sample1: mi.Float,
        sample2: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.Spectrum, mi.Float, Sampled]:
        """Value, density and :class:`Sampled` of ``eval_pdf_sample``."""
        name = "eval_pdf_sample"
        answer = self._call(name, wo, sample1, sample2, active=active)
        value, pdf, bs, weight = checked_parts(name, answer, 4)
        n = dr.width(wo, sample1, sample2)
        sampled = self._sampled(name, (bs, weight), n)
        return self._spectrum(name, value, n), self._float(name, pdf, n), sampled

    def null_transmission(self) -> mi.Spectrum:
        """Answer of ``eval_null_transmission``."""
        with blamed("eval_null_transmission"):
            answer = self.bsdf.eval_null_transmission(self.interaction())
        return self._spectrum("eval_null_transmission", answer, 1)

    def _width(self, wi: mi.Vector3f | None, *arguments: Any) -> int:
        """Number of rays of a call."""
        return dr.width(self.wi if wi is None else wi, self.uv, *arguments)

    def _call(self, function: str, *arguments: Any, **options: Any) -> Any:
        """Answer of a function, in memory."""
        answer = self._asked(function, *arguments, **options)
        with blamed(function):
            dr.eval(answer)
        return answer

    def _asked(
        self,
        function: str,
        *arguments: Any,
        active: mi.Bool = True,
        wi: mi.Vector3f | None = None,
        ctx: mi.BSDFContext | None = None,
    ) -> Any:
        """The same before it is evaluated; what it is asked for is in memory."""
        n = self._width(wi, *arguments, active)
        # one direction of incidence for all lanes would be another kernel
        wi = mi.Vector3f(self.wi if wi is None else wi)
        if dr.width(wi) < n:
            wi += dr.zeros(mi.Vector3f, n)
        dr.make_opaque(wi, self.uv, arguments)
        with blamed(function):
            method = getattr(self.bsdf, function)
            return method(ctx or self.ctx, self.interaction(wi), *arguments, active)

    def _sampled(self, function: str, answer: Any, n: int) -> Sampled:
        return Sampled(*checked_sample(function, answer, n))

    def _spectrum(self, function: str, value: Any, n: int) -> mi.Spectrum:
        return checked_answer(function, value, n, mi.Spectrum)

    def _float(self, function: str, value: Any, n: int) -> mi.Float:
        return checked_answer(function, value, n, mi.Float)


@contextlib.contextmanager
def blamed(function: str) -> Iterator[None]:
    """Whatever goes wrong within is the fault of the plugin's function of that name."""
    try:
        yield
    except (KeyboardInterrupt, PluginFault):
        raise
    except Exception as error:
        # a plugin may raise anything
        if (missing := missing_method(error)) is not None:
            raise PluginFault(missing, "is missing") from error
        text = " ".join(str(error).split())
        raise PluginFault(
            function, f"raised {type(error).__name__}: {text:.200}{own_place(error)}"
        ) from error


def numbers(value: Any, n: int) -> Numbers:
    """NumPy array of a scalar quantity, shape ``(n,)``."""
    return np.broadcast_to(np.ravel(np.array(value)), n)


def spectral(value: Any, n: int) -> Floats:
    """NumPy array of a vector or spectrum in float64, shape ``(n, channels)``."""
    array = np.array(value, dtype=float)
    return np.broadcast_to(array.reshape(len(array), -1).T, (n, len(array)))
