"""Parameters of a specimen's BSDFs and textures that light is differentiated by."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..errors import SettingError, SpecimenError, abridged, did_you_mean, shown
from ..specimen.scene_objects import class_of, held_objects, traversed
from .derivative import Derivative, Lobes
from .gradient_trials import Trial

# What delta lobes follow: by parameter, and whether a number of it is 0, or 1, where
# light may begin or end.
Rules: TypeAlias = dict[tuple[str, bool, bool], Lobes]

# Numbers of a parameter, each of which takes its own launch of the rays.
MAX_NUMBERS = 8


@dataclass(frozen=True, eq=False)
class Column:
    """Direction among the numbers of parameters, by their keys, and its name."""

    name: str
    directions: Mapping[str, Floats]


class Gradients:
    """Parameters of a scene by which light is differentiated, along one column each.

    Parameters
    ----------
    scene : mi.Scene
        Its parameters are as they were whenever none is :meth:`attached`.

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
        If there is no such parameter, or it cannot be differentiated.
    """

    def __init__(self, scene: mi.Scene) -> None:
        self._params = traversed(scene)
        self.unsound = 0
        self.columns: tuple[Column, ...] = ()
        self.derivatives: list[tuple[Column, Derivative]] = []

    @classmethod
    def of_names(cls, scene: mi.Scene, names: Sequence[str]) -> Gradients:
        """By each number of parameters, named as by `mi.traverse`.

        Of the scene, or of its only BSDF; several that are one are joined by ``+``.
        """
        found, columns = cls(scene), []
        for name in names:
            keys = [found._key(part) for part in name.split("+")]
            n, *others = [found._n_numbers(name, key) for key in keys]
            if not 1 <= n <= MAX_NUMBERS:
                raise SettingError(
                    f"gradients are of parameters of 1 to {MAX_NUMBERS} numbers, got "
                    f"{name} with {n}: take dr.backward of mi.render(scene, params) "
                    "with the integrator goniophotometer"
                )
            if len({*keys}) < len(keys) or {*others} - {n}:
                raise SettingError(
                    "gradients must join parameters of as many numbers, each once, got "
                    f"{shown(name)}"
                )
            for i, direction in enumerate(np.eye(n)):
                own = name if n == 1 else f"{name}[{i}]"
                columns.append(Column(own, dict.fromkeys(keys, direction)))
        found.columns = tuple(columns)
        return found

    @classmethod
    def of_enabled(cls, scene: mi.Scene, tangents: bool = False) -> Gradients:
        """By all parameters whose gradients are enabled: their one column.

        Along their `tangents`, or about as they are, to be compared with differences.

        Raises
        ------
        SpecimenError, SettingError
            If there is none, or one that cannot be differentiated.
        """
        found, directions = cls(scene), {}
        with dr.resume_grad():
            for key in found._params.keys():  # noqa: SIM118
                value = found._params[key]
                if not (dr.is_diff_v(value) and dr.grad_enabled(value)):
                    continue
                found._n_numbers(key, key)
                own = _flat(dr.grad(value)) if tangents else _sizes(value)
                if np.any(own):
                    directions[key] = own
        if not directions:
            raise SpecimenError(
                "gradients need a parameter of the scene that has them enabled, and "
                "forward one that is not 0, got none"
            )
        found.columns = (Column("parameters", directions),)
        return found

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
        """How many numbers a parameter has, which must be differentiable."""
        value, owner = self._params[key], self._owner(key)
        if not isinstance(owner, (mi.BSDF, mi.Texture)):
            raise _no_bsdf(name, owner)
        if not self._moves(key):
            raise SettingError(
                f"gradients must name differentiable parameters, got {name}, which "
                f"Mitsuba does not differentiate ({type(value).__name__})"
            )
        return _flat(value).size

    # ------------------------------------------------------------------------ attaching

    @contextmanager
    def attached(
        self, directions: Mapping[str, Floats], by: float = 0.0, follow: str = "forward"
    ) -> Iterator[dict[str, Any]]:
        """Context in which light follows parameters that are moved `by` directions.

        Forward along the directions, or backward; or it follows nothing, for `follow`
        is empty. It gives the parameters.
        """
        own, leaves = {}, {}
        try:
            with dr.resume_grad():
                for key, direction in directions.items():
                    value = self._params[key]
                    own[key] = type(value)(value)
                    along = _shaped(value, direction)
                    leaf = type(value)(dr.detach(value))
                    if by:
                        leaf = type(value)(leaf + dr.opaque(mi.Float, by) * along)
                    if follow:
                        dr.enable_grad(leaf)
                    if follow == "forward":
                        dr.set_grad(leaf, along)
                    self._params[key] = leaves[key] = leaf
                self._update(", ".join(directions))
                if follow == "forward":
                    # what functions read follows now; loops cannot look behind it
                    dr.enqueue(dr.ADMode.Forward, *leaves.values())
                    dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearEdges)
            yield leaves
        finally:
            # what could not be changed is as it was
            with dr.resume_grad(), suppress(RuntimeError):
                for key, value in own.items():
                    self._params[key] = value
                self._params.update()

    def accumulate(self, gradients: Mapping[str, Any]) -> None:
        """Add to the gradients of the scene's own parameters."""
        with dr.resume_grad():
            for key, gradient in gradients.items():
                dr.accum_grad(self._params[key], gradient)

    def _update(self, name: str) -> None:
        """Tell the scene of other values; SpecimenError if it does not take them."""
        try:
            self._params.update()
        except RuntimeError as error:
            said = abridged(" ".join(str(error).split()), 200)
            raise SpecimenError(f"Mitsuba cannot change {name}: {said}") from error

    # ------------------------------------------------------------------------- checking

    def check(
        self,
        bsdfs: Sequence[mi.BSDF],
        wavelengths: Any,
        known: Rules | None = None,
    ) -> None:
        """Compare derivatives of the BSDFs with differences.

        But for parameters whose rules are `known`, to which those of others are added.

        Raises
        ------
        SpecimenError
            If a parameter is of none of them, nothing depends on it, or a derivative is
            wrong: of `eval`, of delta lobes, or of their directions.
        """
        parts = [{id(part) for part in held_objects(bsdf)} for bsdf in bsdfs]
        for column in self.columns:
            own, rules = {} if known is None else known, set()
            for key, direction in column.directions.items():
                numbers = _flat(self._params[key])
                place = key, bool(np.any(numbers == 0)), bool(np.any(numbers == 1))
                if place not in own:
                    asked = column, direction, bsdfs, parts, wavelengths
                    own[place] = self._tried(key, *asked)
                rules.add(own[place])
            rules = rules - {Lobes.STILL} or rules
            if len(rules) > 1:
                raise SpecimenError(
                    "delta lobes follow some parameters by the weight of `sample` "
                    "alone, and others not: differentiate by one at a time, got "
                    f"{', '.join(column.directions)}"
                )
            self.derivatives.append((column, Derivative(rules.pop())))

    def _tried(
        self,
        key: str,
        column: Column,
        direction: Floats,
        bsdfs: Sequence[mi.BSDF],
        parts: Iterable[set[int]],
        wavelengths: Any,
    ) -> Lobes:
        """What delta lobes follow with a parameter, once its derivatives are right."""
        owner, value = self._owner(key), self._params[key]
        name = column.name if len(column.directions) == 1 else key
        holding = [b for b, held in zip(bsdfs, parts) if id(owner) in held]
        if not holding:
            raise _no_bsdf(name, owner)
        # towards smaller values, or off 0
        numbers = _flat(value)
        steps = np.abs(direction) / np.abs(direction).max()
        steps *= np.where(numbers, -np.sign(numbers), 1.0)
        size = float(np.max(np.abs(numbers[direction != 0]), initial=0.0)) or 1.0
        lobes, depends = Lobes.STILL, False
        for bsdf in {id(one): one for one in holding}.values():
            move = partial(self.attached, {key: steps})
            trial = Trial(name, size, bsdf, move, wavelengths)
            depends |= trial.depends
            lobes = lobes if trial.lobes is Lobes.STILL else trial.lobes
        if not depends:
            raise SpecimenError(
                f"no light depends on {name}: `eval` and `sample` are the same with "
                "another value"
            )
        return lobes


def _no_bsdf(name: str, owner: Any) -> SpecimenError:
    return SpecimenError(
        "gradients are by parameters of the specimen's BSDFs and their textures, got "
        f"{name} of {class_of(owner)}"
    )


def _flat(value: Any) -> Floats:
    """All numbers of a parameter, in the order of their memory."""
    value = dr.detach(value)
    flat = value.array if dr.is_tensor_v(value) else dr.ravel(value)
    return np.array(flat, dtype=float)


def _sizes(value: Any) -> Floats:
    """Sizes of numbers over the largest; 1 for those that are 0."""
    sizes = np.abs(_flat(value))
    largest = sizes.max(initial=0.0) or 1.0
    return np.where(sizes, sizes / largest, 1.0)


def _shaped(like: Any, numbers: Floats) -> Any:
    """Numbers as an array of Dr.Jit of the type and shape of another."""
    flat = mi.Float(np.asarray(numbers, np.float32).tolist())
    if dr.is_tensor_v(like):
        return type(like)(flat, like.shape)
    if dr.depth_v(like) > 1:
        return type(like)(dr.unravel(type(like), flat))
    return type(like)(flat)
