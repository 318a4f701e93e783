"""Calls of a BSDF's functions, and access to its parameters.

Whatever a plugin does wrong there is raised as a :class:`PluginFault`.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats, Numbers
from ..errors import own_place
from ..mitsuba_compat import floats
from ..specimen.bsdf_trial import (
    PluginFault,
    checked_answer,
    checked_parts,
    checked_sample,
    missing_method,
)
from .conditions import N_SPOTS, POSITION, TURN, Condition, surroundings

# What surroundings have of a field besides.
WITH = {"sh_frame": "s", "dp_du": "dp_dv"}

# Rays of the sample of a map that is not `quick`.
MANY = 2**20

# Of no rays, with which nothing was asked yet.
NOTHING = 0, None, None, ()

# Mitsuba's record of a sample, and its weight.
Sample: TypeAlias = "tuple[mi.BSDFSample3f, mi.Spectrum]"


class Probe:
    """The functions of a BSDF under one condition.

    Each call is a kernel of its own, from arrays in memory to arrays in memory, so that
    all calls of a function share one: compiling a large plugin takes far longer than
    evaluating it.

    Parameters
    ----------
    bsdf : mi.BSDF
    condition : Condition
    """

    def __init__(self, bsdf: mi.BSDF, condition: Condition) -> None:
        self.bsdf, self.condition = bsdf, condition
        self.ctx, self.differentials = condition.context, condition.differentials
        wi = condition.wi
        self.wi = mi.Vector3f(wi.tolist()) if wi.ndim == 1 else vectors(wi)
        self.uv = mi.Point2f(*map(floats, condition.uvs.reshape(-1, 2).T))
        self.wavelengths = mi.Color0f()
        if mi.is_spectral:
            each = np.atleast_2d(condition.wavelengths).T
            self.wavelengths = mi.UnpolarizedSpectrum(*map(floats, each))
        axes = TURN if condition.turned else np.eye(3)
        self.axes = [mi.Vector3f(axis.tolist()) for axis in axes.T]
        self.p = mi.Point3f((POSITION if condition.turned else 0 * POSITION).tolist())
        self.spots = mi.UInt32(floats(condition.spots))
        names = {*condition.fields} - {"uv"}
        names |= {WITH[name] for name in names & WITH.keys()}
        self.fields = {}
        for name in sorted(names):
            columns = np.reshape(surroundings()[name], (N_SPOTS, -1)).T
            kind = mi.Float if len(columns) == 1 else mi.Vector3f
            self.fields[name] = kind(*map(floats, columns))
        # one kernel for all
        dr.make_opaque(self.axes, self.p, self.fields)
        self._known: tuple[Any, ...] = NOTHING

    def of_lanes(self, i: mi.UInt32) -> Probe:
        """Ask the samples of these numbers, of as many as there are; return itself."""
        self._known = NOTHING
        self.wi, self.uv, self.wavelengths, self.spots = (
            x if dr.width(x) <= 1 else dr.gather(type(x), x, i)
            for x in (self.wi, self.uv, self.wavelengths, self.spots)
        )
        return self

    def _surround(self, si: mi.SurfaceInteraction3f, spots: mi.UInt32) -> None:
        """Give a surface interaction the fields of its spots."""
        own = {k: dr.gather(type(x), x, spots) for k, x in self.fields.items()}
        if "sh_frame" in own:
            normal, s = own.pop("sh_frame"), own.pop("s")
            si.sh_frame = mi.Frame3f(s, dr.cross(normal, s), normal)
            si.n, si.dp_du, si.dp_dv = mi.Normal3f(normal), 2 * s, 2 * si.sh_frame.t
        for name in own.keys() & {"n", "dp_du", "dp_dv"}:
            own[name] = si.to_world(own[name])
        for name, value in own.items():
            setattr(si, name, type(getattr(si, name))(value))

    def interaction(
        self, wi: mi.Vector3f | None = None, spots: mi.UInt32 | None = None
    ) -> mi.SurfaceInteraction3f:
        """Point of a flat surface of 2 x 2 scene units, lit from `wi`.

        Its other fields are those of some spots, by default of the first one.
        """
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.t = 1.0
        si.uv, si.p = self.uv, self.p
        u, v, normal = self.axes
        si.n, si.sh_frame = mi.Normal3f(normal), mi.Frame3f(u, v, normal)
        si.dp_du, si.dp_dv = 2 * u, 2 * v
        si.wavelengths = self.wavelengths
        if self.differentials:
            si.duv_dx, si.duv_dy = mi.Vector2f(0.3, 0.1), mi.Vector2f(-0.1, 0.2)
        si.wi = self.wi if wi is None else wi
        if self.fields and spots is None:
            spots = dr.gather(mi.UInt32, self.spots, mi.UInt32(0))
        if self.fields:
            self._surround(si, spots)
        return si

    def sample(
        self,
        sample1: mi.Float,
        sample2: mi.Point2f,
        active: mi.Bool = True,
        wi: mi.Vector3f | None = None,
        **at: Any,
    ) -> Sample:
        """Answer of ``sample``."""
        answer = self._call("sample", sample1, sample2, active=active, wi=wi, **at)
        n = self._width(wi, sample1, sample2, active)
        return checked_sample("sample", answer, n)

    def eval(
        self,
        wo: mi.Vector3f,
        active: mi.Bool = True,
        wi: mi.Vector3f | None = None,
        **at: Any,
    ) -> mi.Spectrum:
        """Answer of ``eval``."""
        answer = self._call("eval", wo, active=active, wi=wi, **at)
        return checked_answer("eval", answer, self._width(wi, wo, active), mi.Spectrum)

    def pdf(
        self,
        wo: mi.Vector3f,
        active: mi.Bool = True,
        wi: mi.Vector3f | None = None,
        **at: Any,
    ) -> mi.Float:
        """Answer of ``pdf``."""
        answer = self._call("pdf", wo, active=active, wi=wi, **at)
        return checked_answer("pdf", answer, self._width(wi, wo, active), mi.Float)

    def values(self, wo: Floats, wi: Floats | None = None) -> Floats:
        """``eval`` towards directions of shape (n, 3); shape ``(n, channels)``."""
        return spectral(self.eval(vectors(wo), wi=_or_none(wi)), len(wo))

    def densities(self, wo: Floats, wi: Floats | None = None) -> Floats:
        """``pdf`` towards directions of shape (n, 3); shape ``(n,)``."""
        return numbers(self.pdf(vectors(wo), wi=_or_none(wi)), len(wo)).astype(float)

    def eval_and_pdf(self, wo: mi.Vector3f) -> tuple[mi.Spectrum, mi.Float]:
        """Answers of ``eval`` and of ``pdf``, of many from a kernel that shares work.

        A few take less time than compiling one for both.
        """
        if dr.width(wo) < MANY:
            return self.eval(wo), self.pdf(wo)
        answers = [self._asked(name, wo) for name in ("eval", "pdf")]
        with as_plugin_fault("eval"):
            dr.eval(answers)
        return self._pair(("eval", "pdf"), answers, self._width(None, wo))

    def eval_pdf(
        self, wo: mi.Vector3f, active: mi.Bool = True, **at: Any
    ) -> tuple[mi.Spectrum, mi.Float]:
        """Both answers of ``eval_pdf``."""
        answer = self._call("eval_pdf", wo, active=active, **at)
        parts = checked_parts("eval_pdf", answer, 2)
        return self._pair(("eval_pdf", "eval_pdf"), parts, dr.width(wo, active))

    def in_turn(self, functions: str, wo: mi.Vector3f) -> Any:
        """Answer of the last of some functions, which get the same arguments."""
        return self._call(functions, wo)

    def eval_pdf_sample(
        self, wo: mi.Vector3f, sample1: mi.Float, sample2: mi.Point2f, **at: Any
    ) -> tuple[mi.Spectrum, mi.Float, mi.BSDFSample3f, mi.Spectrum]:
        """Value, density, sample and weight that ``eval_pdf_sample`` returns."""
        name = "eval_pdf_sample"
        answer = self._call(name, wo, sample1, sample2, **at)
        value, pdf, *sample = checked_parts(name, answer, 4)
        n = dr.width(wo, sample1, sample2)
        sampled = checked_sample(name, tuple(sample), n)
        return *self._pair((name, name), (value, pdf), n), *sampled

    def of_surface(self, function: str) -> Floats:
        """Answer of a function that takes no direction wo; shape ``(channels,)``."""
        with as_plugin_fault(function):
            answer = getattr(self.bsdf, function)(self.interaction(), True)
        return spectral(checked_answer(function, answer, 1, mi.Spectrum), 1)[0]

    def _width(self, wi: mi.Vector3f | None, *arguments: Any) -> int:
        """Number of rays of a call."""
        return dr.width(self.wi if wi is None else wi, *arguments)

    def _call(self, function: str, *arguments: Any, **options: Any) -> Any:
        """Answer of a function, evaluated.

        The sample of ``eval_pdf_sample`` gets a kernel of its own: by default Mitsuba
        calls two functions there, whose kernels exist already.
        """
        answer = self._asked(function, *arguments, **options)
        joint = function == "eval_pdf_sample" and isinstance(answer, (tuple, list))
        with as_plugin_fault(function):
            for part in (answer[:2], answer[2:]) if joint else (answer,):
                dr.eval(part)
        return answer

    def _asked(
        self,
        function: str,
        *arguments: Any,
        active: mi.Bool = True,
        wi: mi.Vector3f | None = None,
        ctx: mi.BSDFContext | None = None,
        si: mi.SurfaceInteraction3f | None = None,
    ) -> Any:
        """Answer of a function before it is evaluated, from arguments in memory."""
        n = self._width(wi if si is None else si.wi, *arguments, active)
        *_, every = self._inputs(n)
        if si is None:
            si = self.interactions(n, wi)
        active = active if isinstance(active, mi.Bool) else every
        dr.make_opaque(active, arguments)
        # a plugin may change its copies in place: narrow its mask, or flip a direction
        copies, answer = [type(one)(one) for one in (*arguments, active)], None
        with as_plugin_fault(function):
            for name in function.split():
                method = getattr(self.bsdf, name)
                answer = method(ctx or self.condition.context, si, *copies)
            return answer

    def interactions(
        self, n: int, wi: mi.Vector3f | None = None
    ) -> mi.SurfaceInteraction3f:
        """Points of `n` rays, in memory."""
        own, uv, nm, spots, _ = self._inputs(n)
        wi = own if wi is None else wi
        if dr.width(wi) < n:
            wi = wi + dr.zeros(mi.Vector3f, n)
        dr.make_opaque(wi)
        si = self.interaction(wi, spots)
        si.uv, si.wavelengths = uv, nm
        return si

    def _inputs(self, n: int) -> tuple[Any, ...]:
        """What `n` rays are asked with but for directions wo, in memory.

        One direction of incidence for all, or no mask, would be another kernel.
        """
        rays, wi, uv, known = self._known
        if not (rays == n and wi is self.wi and uv is self.uv):
            # `n` may be so many times the samples, which are then asked again and again
            spots = self.spots if self.fields else None
            wide = [
                x if dr.width(x) in (0, n) else dr.tile(x, n // dr.width(x))
                for x in (self.wi, self.uv, self.wavelengths, spots)
            ]
            wide.append(dr.full(mi.Bool, True, n))
            dr.make_opaque(wide)
            self._known, known = (n, self.wi, self.uv, wide), wide
        return known

    @staticmethod
    def _pair(
        names: tuple[str, str], answers: Any, n: int
    ) -> tuple[mi.Spectrum, mi.Float]:
        """A value and a density, checked for their form."""
        value = checked_answer(names[0], answers[0], n, mi.Spectrum)
        return value, checked_answer(names[1], answers[1], n, mi.Float)


# Functions that properties ask, and how many arguments they have between the
# interaction and the mask.
ASKED = {"sample": 2, "eval": 1, "pdf": 1, "eval_pdf": 1, "eval_pdf_sample": 3}


class Shared:
    """A BSDF as properties ask it: each call is made once, and its answer is kept.

    Answers of a wrong form, and exceptions, are faults of the plugin as of a
    :class:`Probe`.
    """

    def __init__(self, probe: Probe) -> None:
        self._probe = probe
        self._kept: dict[Any, Any] = {}

    def __getattr__(self, name: str) -> Any:
        if name not in ASKED:
            return getattr(self._probe.bsdf, name)
        return functools.partial(self._once, name)

    def _once(self, name: str, ctx: Any, si: Any, *arguments: Any) -> Any:
        """Answer to a call, which is known by the variables of its arguments."""
        given, mask = arguments[: ASKED[name]], arguments[ASKED[name] :]
        active = mask[0] if mask else True
        dr.make_opaque(si.wi, given)
        known = dr.detail.collect_indices((si, active, given))
        key = name, ctx.mode, ctx.type_mask, ctx.component, *known
        if key not in self._kept:
            own = type(si)(si), *given  # nobody else gets these variables' numbers
            # a plugin may change these, too
            context = mi.BSDFContext(ctx.mode, ctx.type_mask, ctx.component)
            how = {"si": type(si)(si), "ctx": context, "active": active}
            answer = getattr(self._probe, name)(*given, **how)
            self._kept[key] = answer, own, active
        return self._kept[key][0]


@contextlib.contextmanager
def as_plugin_fault(function: str) -> Iterator[None]:
    """Raise whatever goes wrong in the block as a fault of that plugin function."""
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


# ------------------------------------------------------------------------- parameters


def traversed(bsdf: mi.BSDF) -> Any:
    """Parameters of a BSDF; raises PluginFault if the plugin does."""
    with as_plugin_fault("traverse"):
        return mi.traverse(bsdf)


def number_parameters(bsdf: mi.BSDF, *others: type) -> tuple[Any, dict[str, Any]]:
    """Parameters of a BSDF, and the values of those that are numbers or colours.

    Values of the types `others` count too. The rest may be anything: asking for a None
    raises, and a Python float cannot be set.
    """
    params, numbers_only = traversed(bsdf), {}
    kinds = (mi.Float, mi.Color3f, mi.Spectrum, *others)
    for name in params.keys():  # noqa: SIM118
        with contextlib.suppress(TypeError):
            if isinstance(params[name], kinds):
                numbers_only[name] = params[name]
    return params, numbers_only


@contextlib.contextmanager
def changed(bsdf: mi.BSDF, values: Mapping[str, Any]) -> Iterator[None]:
    """Give parameters other values, by name, until the end of the block."""
    params = traversed(bsdf) if values else {}
    before = {name: type(params[name])(params[name]) for name in values}
    try:
        assign(params, values)
        yield
    finally:
        assign(params, before)


def update(bsdf: mi.BSDF, names: Iterable[str]) -> None:
    """Tell a BSDF that parameters have changed, whether they have or not."""
    params = traversed(bsdf)
    for name in names:
        params.set_dirty(name)
    with as_plugin_fault("parameters_changed"):
        params.update()


def assign(params: Any, values: Mapping[str, Any]) -> None:
    """Give parameters that were traversed other values, by name."""
    for name, value in values.items():
        params[name] = value
    if values:
        with as_plugin_fault("parameters_changed"):
            params.update()


# ----------------------------------------------------------------------------- arrays


def uniform(n: int, key: tuple[int, ...]) -> tuple[mi.Float, mi.Point2f]:
    """Independent uniform numbers for ``sample``."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed_of(key), n)
    numbers = sampler.next_1d(), sampler.next_2d()
    dr.eval(numbers)  # in a kernel that all share
    return numbers


def seed_of(key: tuple[int, ...]) -> mi.UInt32:
    """32-bit seed mixed from whole numbers, which is no literal of a kernel."""
    seed = int(np.random.SeedSequence(key).generate_state(1)[0])
    return dr.opaque(mi.UInt32, seed)


def is_delta(bs: mi.BSDFSample3f) -> mi.Bool:
    """Whether samples have a discrete direction."""
    return mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)


def numbers(value: Any, n: int) -> Numbers:
    """NumPy array of a scalar quantity, shape ``(n,)``."""
    flat = np.ravel(np.array(value))
    return flat if len(flat) == n else np.broadcast_to(flat, n)


def spectral(value: Any, n: int) -> Floats:
    """NumPy array of a vector or spectrum in float64, shape ``(n, channels)``.

    Of Mueller matrices it is the first element.
    """
    value = value[0, 0] if dr.is_matrix_v(value) else value
    found = np.empty((len(value), n))
    for row, channel in zip(found, value):
        # one by one: all together, they would be interleaved in a kernel
        row[:] = np.ravel(np.array(channel))
    return found.T


def full(value: Any, n: int) -> Floats:
    """The same, of Mueller matrices all elements, shape ``(n, channels, 4, 4)``."""
    if not dr.is_matrix_v(value):
        return spectral(value, n)
    each = np.array([spectral(value[i, j], n) for i in range(4) for j in range(4)])
    return np.moveaxis(each, 0, -1).reshape(n, -1, 4, 4)


def vectors(rows: Numbers) -> mi.Vector3f:
    """Mitsuba's vectors from an array of shape (n, 3), or (3,) for one."""
    return mi.Vector3f(*map(floats, np.reshape(rows, (-1, 3)).T))


def random_numbers(rows: Numbers) -> tuple[mi.Float, mi.Point2f]:
    """Numbers for ``sample`` from an array of shape (..., 3)."""
    first, *second = map(floats, np.reshape(rows, (-1, 3)).T)
    return first, mi.Point2f(*second)


def _or_none(rows: Numbers | None) -> mi.Vector3f | None:
    return None if rows is None else vectors(rows)
