"""Derivatives of light by parameters of BSDFs and textures, by likelihood ratios.

Rays go where `sample` sends them. What they carry changes with a parameter as `eval`
does at the directions that were drawn (Glynn 1990, *Likelihood ratio gradient
estimation*): each event adds the logarithmic derivative of `eval`, and a ray that
leaves brings its weight times their sum. The patch that it reaches stays the same, so
that no edge of a patch is missed. Delta lobes have no `eval`: of these the weight of
`sample` tells, by a rule that is tried for each parameter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import Enum
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..errors import SettingError, SpecimenError, abridged, did_you_mean, shown
from ..specimen.scene_objects import class_of, held_objects, traversed
from .surface_events import flux_context, is_delta

# Numbers of parameters, each of which takes its own launch of the rays.
MAX_NUMBERS = 8

# Derivatives of a value follow the graph of its function, which stays.
FLAGS = dr.ADFlag.ClearInterior | dr.ADFlag.AllowNoGrad

# Where derivatives are compared with differences: incident directions, random numbers
# of each, a shift from limits of a parameter, and a step, both relative.
N_DIRECTIONS, N_EACH = 32, 2**11
SHIFT, STEP = 2.0**-4, 2.0**-5

# Part by which derivatives may be off the differences; of delta lobes, that random
# numbers choose; and off one-sided ones. Relative rounding of single precision.
MAX_OFF, MAX_OFF_OF_LOBES, MAX_OFF_AT_LIMIT = 0.05, 0.15, 0.5
ROUNDINGS = 2.0**-17


class Lobes(Enum):
    """What follows the light of delta lobes: nothing, weight and pdf, or a weight."""

    STILL = 0
    WEIGHT_AND_PDF = 1
    WEIGHT = 2


class Derivative:
    """How light changes, at each event, with the parameter that is attached.

    No dataclass, whose fields Dr.Jit takes for variables of a loop.
    """

    def __init__(self, lobes: Lobes = Lobes.STILL) -> None:
        self.lobes = lobes

    def of_event(
        self,
        bsdf: mi.BSDFPtr,
        si: mi.SurfaceInteraction3f,
        u1: mi.Float,
        u2: mi.Point2f,
        sampled: tuple[mi.BSDFSample3f, mi.Spectrum],
        active: mi.Bool,
    ) -> mi.Spectrum:
        """Logarithmic derivative of what goes on in the direction that was `sampled`.

        NaN where there is light and `eval` is 0.
        """
        bs, weight = sampled
        change, value = self.of_eval(bsdf, si, bs.wo, active)
        change /= value
        if self.lobes is Lobes.STILL:
            delta = mi.Spectrum(0)
        else:
            delta, light = self.of_lobe(bsdf, si, u1, u2, active)
            delta /= light
        change = dr.select(is_delta(bs), delta, change)
        return dr.select(active & (weight > 0), change, 0)

    def of_eval(
        self, bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, wo: Any, active: mi.Bool
    ) -> tuple[mi.Spectrum, mi.Spectrum]:
        """Derivative of `eval`, and its value."""
        with dr.resume_grad():
            return _derived(bsdf.eval(flux_context(), si, wo, active))

    def of_lobe(
        self,
        bsdf: mi.BSDFPtr,
        si: mi.SurfaceInteraction3f,
        u1: mi.Float,
        u2: mi.Point2f,
        active: mi.Bool,
    ) -> tuple[mi.Spectrum, mi.Spectrum]:
        """Derivative of what a delta lobe sends, and its value, up to a factor."""
        with dr.resume_grad():
            bs, weight = bsdf.sample(flux_context(), si, u1, u2, active)
            weight = mi.Spectrum(weight)
            if self.lobes is Lobes.WEIGHT_AND_PDF:
                weight *= bs.pdf
            return _derived(weight)


def _derived(value: Any) -> tuple[mi.Spectrum, mi.Spectrum]:
    """Derivative of a value by what is attached, and the value without it."""
    value = mi.Spectrum(value)
    change = mi.Spectrum(dr.forward_to(value, flags=FLAGS))
    return change, mi.Spectrum(dr.detach(value))


@dataclass(frozen=True)
class Column:
    """One number of a parameter: its name for people, key in the scene, and place."""

    name: str
    key: str
    place: int


class Gradients:
    """Parameters of a scene by which light is differentiated, one number at a time.

    Parameters
    ----------
    scene : mi.Scene
        Its parameters are as they were whenever none is :meth:`attached`.
    names : sequence of str
        As `mi.traverse` has them: of the scene, or of its only BSDF.

    Attributes
    ----------
    columns : tuple of Column
    derivatives : list of (Column, Derivative)
        Those that were found to be right, once they are checked.
    unsound : int
        Rays whose derivative was no number, so far.

    Raises
    ------
    ValueError
        If there is no such parameter, or none that can be differentiated.
    """

    def __init__(self, scene: mi.Scene, names: Sequence[str]) -> None:
        self._params = traversed(scene)
        self.unsound = 0
        self.derivatives: list[tuple[Column, Derivative]] = []
        columns: list[Column] = []
        for name in names:
            key = self._key(name)
            n = self._n_numbers(name, key)
            each = [name] if n == 1 else [f"{name}[{i}]" for i in range(n)]
            columns += (Column(one, key, i) for i, one in enumerate(each))
        self.columns = tuple(columns)

    def _key(self, name: str) -> str:
        """Key of a parameter in the scene."""
        keys = list(self._params.keys())
        found = [key for key in keys if key == name]
        found = found or [key for key in keys if key.endswith(f".{name}")]
        if len(found) > 1:
            raise SettingError(
                f"gradients must name one parameter, got {shown(name)}, which "
                f"{', '.join(found)} end in"
            )
        if not found:
            ends = [key.partition(".bsdf.")[2] for key in keys]
            short = [
                end if ends.count(end) == 1 else key for key, end in zip(keys, ends)
            ]
            moved = [one for one, key in zip(short, keys) if self._moves(key)]
            known = [one for one in moved if str(name) in one] or moved
            raise SettingError(
                "gradients must name parameters of the specimen as mi.traverse does, "
                f"such as {abridged(', '.join(known), 200) or 'none of this one'}, got "
                f"{shown(name)}{did_you_mean(name, short)}"
            )
        return found[0]

    def _owner(self, key: str) -> Any:
        """Object that has a parameter."""
        return self._params.properties[key][2]

    def _moves(self, key: str) -> bool:
        """Whether Mitsuba differentiates a parameter of a BSDF."""
        if not isinstance(self._owner(key), (mi.BSDF, mi.Texture)):
            return False
        value, fixed = self._params[key], mi.ParamFlags.NonDifferentiable.value
        free = not self._params.flags(key) & fixed
        return bool(free and dr.is_diff_v(value) and dr.is_float_v(value))

    def _n_numbers(self, name: str, key: str) -> int:
        """How many numbers a parameter has, which must be few and differentiable."""
        value, owner = self._params[key], self._owner(key)
        if not isinstance(owner, (mi.BSDF, mi.Texture)):
            raise _no_bsdf(name, owner)
        if not self._moves(key):
            raise SettingError(
                f"gradients must name differentiable parameters, got {name}, which "
                f"Mitsuba does not differentiate ({type(value).__name__})"
            )
        n = int(np.size(np.array(dr.detach(value))))
        if not 1 <= n <= MAX_NUMBERS:
            raise SettingError(
                f"gradients are of parameters of 1 to {MAX_NUMBERS} numbers, got "
                f"{name} with {n}: take dr.backward of mi.render(scene, params) with "
                "the integrator goniophotometer"
            )
        return n

    # ------------------------------------------------------------------------ attaching

    @contextmanager
    def attached(
        self, column: Column, shift: float = 0.0, step: float | None = None
    ) -> Iterator[None]:
        """Context in which light follows one number of a parameter.

        With a `shift` of the number, relative to it; by a `step` it is changed, and not
        followed.
        """
        value = self._params[column.key]
        own = type(value)(value)
        numbers = np.array(dr.detach(value), float)
        direction = np.zeros(numbers.size)
        direction[column.place] = 1
        size = float(abs(numbers.ravel()[column.place])) or 1.0
        sign = -1.0 if numbers.ravel()[column.place] else 1.0
        moved = dr.detach(own)
        along = _shaped(own, direction)
        if shift or step is not None:
            by = size * (sign * shift + (step or 0.0))
            moved = type(own)(moved + dr.opaque(mi.Float, by) * along)
        leaf = type(own)(moved)
        try:
            with dr.resume_grad():
                if step is None:
                    dr.enable_grad(leaf)
                    dr.set_grad(leaf, along)
                self._params[column.key] = leaf
                try:
                    self._params.update()
                except RuntimeError as error:
                    said = abridged(" ".join(str(error).split()), 200)
                    raise SpecimenError(
                        f"Mitsuba cannot change {column.name}: {said}"
                    ) from error
                if step is None:
                    # what functions read follows now; loops cannot look behind it
                    dr.enqueue(dr.ADMode.Forward, leaf)
                    dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearEdges)
            yield
        finally:
            # what could not be changed is as it was
            with dr.resume_grad(), suppress(RuntimeError):
                self._params[column.key] = own
                self._params.update()

    # ------------------------------------------------------------------------- checking

    def check(self, bsdfs: Sequence[mi.BSDF], wavelengths: Any) -> None:
        """Compare derivatives of the BSDFs with differences.

        Raises
        ------
        SpecimenError
            If a parameter is of none of them, nothing depends on it, or a derivative is
            wrong: of `eval`, of delta lobes, or of their directions.
        """
        parts = [{id(part) for part in held_objects(bsdf)} for bsdf in bsdfs]
        for column in self.columns:
            owner = self._owner(column.key)
            holding = [b for b, held in zip(bsdfs, parts) if id(owner) in held]
            if not holding:
                raise _no_bsdf(column.name, owner)
            lobes = Lobes.STILL
            depends = False
            for bsdf in {id(one): one for one in holding}.values():
                trial = _Trial(self, column, bsdf, wavelengths)
                depends |= trial.depends
                if trial.lobes is not Lobes.STILL:
                    lobes = trial.lobes
            if not depends:
                raise SpecimenError(
                    f"no light depends on {column.name}: `eval` and `sample` are the "
                    "same with another value"
                )
            self.derivatives.append((column, Derivative(lobes)))


def _no_bsdf(name: str, owner: Any) -> SpecimenError:
    return SpecimenError(
        "gradients are by parameters of the specimen's BSDFs and their textures, got "
        f"{name} of {class_of(owner)}"
    )


class _Trial:
    """Derivatives of one BSDF by one number of a parameter, beside differences.

    Attributes
    ----------
    depends : bool
        Whether there is any.
    lobes : Lobes
        What the delta lobes follow.
    """

    def __init__(
        self, gradients: Gradients, column: Column, bsdf: mi.BSDF, wavelengths: Any
    ) -> None:
        self._gradients, self._column, self._bsdf = gradients, column, bsdf
        self._si, self._u1, self._u2 = _questions(wavelengths)
        n = N_DIRECTIONS * N_EACH
        with dr.suspend_grad():
            bs, _ = self._sample()
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(1, n)
            other = mi.warp.square_to_uniform_sphere(sampler.next_2d())
            usual = (dr.arange(mi.UInt32, n) % 2 == 0) & ~is_delta(bs)
            self._wo = dr.select(usual, bs.wo, other)
            dr.eval(self._si, self._u1, self._u2, self._wo)
            size = self._size()
            self.depends = self._check_eval(size)
            self.lobes = Lobes.STILL
            if mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta) or mi.has_flag(
                bsdf.flags(), mi.BSDFFlags.Delta1D
            ):
                self._check_lobes(size)

    def _sample(self) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        context, active = flux_context(), mi.Bool(True)
        bs, weight = self._bsdf.sample(context, self._si, self._u1, self._u2, active)
        return bs, mi.Spectrum(weight)

    def _size(self) -> float:
        """Size of the number, of which shift and step are parts."""
        value = np.array(dr.detach(self._gradients._params[self._column.key]), float)
        return float(abs(value.ravel()[self._column.place])) or 1.0

    def _differences(self, function: Any, size: float) -> tuple[Floats, Floats]:
        """Derivatives of a function's values, and what they may be off."""
        found = []
        for step in (STEP, STEP / 2):
            ends = []
            for sign in (1, -1):
                with self._gradients.attached(self._column, SHIFT, sign * step):
                    ends.append(function())
            found.append((ends[0] - ends[1]) / (2 * step * size))
        return (4 * found[1] - found[0]) / 3, np.abs(found[1] - found[0])

    def _values(self) -> Floats:
        value = self._bsdf.eval(flux_context(), self._si, self._wo, mi.Bool(True))
        return _numbers(mi.Spectrum(value))

    def _check_eval(self, size: float) -> bool:
        """Whether `eval` depends on the parameter; SpecimenError if not as it says."""
        name, kind = self._column.name, class_of(self._bsdf)
        told = Derivative()
        asked = self._bsdf, self._si, self._wo, mi.Bool(True)
        with self._gradients.attached(self._column, SHIFT):
            change, value = map(_numbers, told.of_eval(*asked))
        expected, slack = self._differences(self._values, size)
        lit = value > 0
        off = np.abs(change - expected)[lit] / value[lit]
        allowed = 3 * slack[lit] / value[lit] + ROUNDINGS / (STEP * size)
        expected = np.abs(expected[lit]) / value[lit]
        wrong = ~(off <= allowed + MAX_OFF * expected)
        if not np.sum(off[wrong]) <= MAX_OFF * np.sum(expected):
            raise SpecimenError(
                f"the derivative of `eval` of {kind} by {name} is wrong: differences "
                f"give {np.mean(expected):.3g} of the value on average, and Dr.Jit is "
                f"off by {np.mean(off):.3g}"
            )
        self._check_off_limit(told, asked)
        return bool(np.any(expected > allowed))

    def _check_off_limit(self, told: Derivative, asked: tuple[Any, ...]) -> None:
        """Raise SpecimenError where `eval` changes otherwise than its derivative."""
        with self._gradients.attached(self._column):
            change, value = map(_numbers, told.of_eval(*asked))
        with self._gradients.attached(self._column, SHIFT, 0.0):
            step = self._values() - value
        off = np.abs(change - step / self._shift())
        beyond = np.sum(np.abs(step[value == 0])) > MAX_OFF * np.sum(np.abs(step))
        # where it is nearly linear
        lit = (value > 0) & (np.abs(step) < value / 2)
        off, step = off[lit] / value[lit], np.abs(step[lit]) / value[lit]
        allowed = MAX_OFF_AT_LIMIT * step + 2 * ROUNDINGS
        wrong = off * abs(self._shift()) > allowed
        if beyond or np.sum(wrong) > MAX_OFF_AT_LIMIT * wrong.size:
            self._raise_at_limit("eval")

    def _flux(self) -> Floats:
        """What delta lobes send up and down, on average for each direction."""
        bs, weight = self._sample()
        return _by_direction(bs, weight)

    def _check_lobes(self, size: float) -> None:
        """Find what follows delta lobes; SpecimenError if nothing does."""
        name, kind = self._column.name, class_of(self._bsdf)
        expected, _ = self._differences(self._flux, size)
        # random numbers choose lobes in steps
        with self._gradients.attached(self._column, SHIFT, 0.0):
            bs, weight = self._sample()
            shifted = _by_direction(bs, weight)
            largest = _by_direction(bs, weight, np.max)
        least = np.linalg.norm(largest) / (N_EACH * STEP * size)
        one_sided = (shifted - self._flux()) / self._shift()
        where = []
        for step in (STEP, -STEP):
            with self._gradients.attached(self._column, SHIFT, step):
                bs, weight = self._sample()
                lit = is_delta(bs) & dr.any(weight > 0)
                where.append((bs.wo.numpy(), lit.numpy(), bs.sampled_type.numpy()))
        (one, lit, kinds), (other, also, others) = where
        same = lit & also & (kinds == others)
        if np.any(np.abs(one - other)[..., same] > ROUNDINGS):
            raise SpecimenError(
                f"the direction of a delta lobe of {kind} moves with {name}, and no "
                "derivative of a patch follows it"
            )
        norm = np.linalg.norm(expected)
        for rule in Lobes:
            found, at_own = (self._found(rule, shift) for shift in (SHIFT, 0.0))
            if np.linalg.norm(found - expected) <= MAX_OFF_OF_LOBES * norm + least:
                off = np.linalg.norm(at_own - one_sided)
                if off > MAX_OFF_AT_LIMIT * np.linalg.norm(one_sided) + least:
                    self._raise_at_limit("sample")
                self.depends |= bool(norm > least)
                self.lobes = rule
                return
        raise SpecimenError(
            f"the derivative of the delta lobes of {kind} by {name} is wrong: "
            "differences disagree with the weight of `sample`, with and without `pdf`"
        )

    def _found(self, rule: Lobes, shift: float) -> Floats:
        """Derivatives of what delta lobes send, by a rule."""
        if rule is Lobes.STILL:
            return np.zeros_like(self._flux())
        asked = self._bsdf, self._si, self._u1, self._u2, mi.Bool(True)
        with self._gradients.attached(self._column, shift):
            change, light = Derivative(rule).of_lobe(*asked)
            bs, weight = self._sample()
            change = dr.select(light > 0, change / light * weight, 0)
            return _by_direction(bs, change)

    def _shift(self) -> float:
        """By how much a shift changes the number."""
        value = np.array(dr.detach(self._gradients._params[self._column.key]), float)
        own = float(value.ravel()[self._column.place])
        return -SHIFT * abs(own) if own else SHIFT

    def _raise_at_limit(self, function: str) -> None:
        raise SpecimenError(
            f"{self._column.name} is at a limit: rays do not go where a change of it "
            f"would send light, or `{function}` of {class_of(self._bsdf)} has no "
            "derivative there; take a value a little off"
        )


def _questions(wavelengths: Any) -> tuple[Any, Any, Any]:
    """Interactions at random places of a square, and numbers to sample there."""
    n = N_DIRECTIONS * N_EACH
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, N_DIRECTIONS)
    wi = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    uv, below = sampler.next_2d(), sampler.next_1d() < 0.5
    wi.z = dr.select(below, -wi.z, wi.z)
    lane = dr.arange(mi.UInt32, n)
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = dr.gather(mi.Vector3f, wi, lane // N_EACH)
    si.uv = dr.gather(mi.Point2f, uv, lane // N_EACH)
    si.t, si.n = mi.Float(1), mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)
    si.dp_du, si.dp_dv = mi.Vector3f(2, 0, 0), mi.Vector3f(0, 2, 0)
    si.wavelengths = wavelengths
    sampler.seed(2, n)
    u1 = (mi.Float(lane % N_EACH) + 0.5) * (1 / N_EACH)
    return si, u1, sampler.next_2d()


def _by_direction(
    bs: mi.BSDFSample3f, light: mi.Spectrum, of: Callable[..., Floats] = np.mean
) -> Floats:
    """Means of the light of delta lobes up and down, for each incident direction."""
    delta, up = is_delta(bs).numpy(), bs.wo.z.numpy() > 0
    values = _numbers(light)
    sides = [np.where(delta & side, values, 0) for side in (up, ~up)]
    return of(np.stack(sides).reshape(-1, N_DIRECTIONS, N_EACH), axis=-1)


def _numbers(value: mi.Spectrum) -> Floats:
    """Values of all channels, shape ``(channels, n)``."""
    n = N_DIRECTIONS * N_EACH
    return np.stack([np.broadcast_to(one.numpy(), n).astype(float) for one in value])


def _shaped(like: Any, numbers: Floats) -> Any:
    """Numbers as an array of Dr.Jit of the type and shape of another."""
    flat = mi.Float(numbers.astype(np.float32).tolist())
    if dr.is_tensor_v(like):
        return type(like)(flat, like.shape)
    if dr.depth_v(like) > 1:
        return type(like)(dr.unravel(type(like), flat))
    return type(like)(flat)
