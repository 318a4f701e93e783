"""The BRDF of a mesh as a differentiable function of its heights: light of one event.

It is an operation of Dr.Jit, whose values and derivatives
:class:`~gonio_mi.estimators.moving_surface.MovingSurface` estimates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats
from ..collector import Subdivision, subdivision
from ..collector.directions import direction
from ..errors import (
    SettingError,
    SettingTypeError,
    SpecimenError,
    VariantError,
    checked_count,
    number_of,
    shown,
)
from ..estimators.moving_surface import MovingSurface
from ..kernels import launches_kernels
from ..mitsuba_compat import has_normals, triangles_of
from ..results.statistics import student_interval
from ..settings.values import checked_period
from ..specimen.loading import load_specimen
from ..specimen.scene_objects import traversed
from ..specimen.specimen import Specimen
from ..specimen.specimen_text import SpecimenLike
from .incidence import incident_angles, towards

# Points of a map at least: of fewer, none may be lit.
MIN_POINTS = 2**8

# Triangles whose shares of the surface single precision tells apart.
MAX_TRIANGLES = 2**20

# What follows the seed: values and derivatives are multiplied with each other.
VALUE, DERIVATIVE, BATCHES = range(3)

# Flags of BSDFs that are not differentiated, with the reason.
NO_DENSITY = "a component without a density, whose direction would move"
PASSES = "a component that lets light pass"
REFUSED = {
    "Delta": NO_DENSITY,
    "Delta1D": NO_DENSITY,
    "Null": PASSES,
    "Transmission": PASSES,
}


@dataclass(frozen=True)
class BRDFDerivative:
    """Derivative of a first-order BRDF for a change of the heights.

    Attributes
    ----------
    value : ndarray
        Of the shape of the BRDF, in 1/sr for the whole change.
    std_err : ndarray
        Standard errors, from independent batches; NaN where none found any light.
    n_batches : int
    order : str
        ``"1"``: light of two or more surface events is left out.
    """

    value: Floats
    std_err: Floats
    n_batches: int
    order: str = "1"

    def interval(self, level: float = 0.95) -> tuple[Floats, Floats]:
        """Limits between which each value lies, by Student's t."""
        return student_interval(self.value, self.std_err, self.n_batches, level)


class DifferentiableSurface:
    r"""A surface whose first-order BRDF is a differentiable function of its heights.

    Light of one surface event, with shadowing and masking: what
    ``measure(order=1).brdf`` estimates. Mitsuba's optimisers take :attr:`geometry` as a
    parameter. Light of more events is left out of value and derivative: measure the
    result with all orders.

    Parameters
    ----------
    specimen : dict, mi.Scene, str or path
        As of :func:`~gonio_mi.measure`: one mesh with flat facets, such as the plugin
        `heightfield`. Its BSDF reflects, without delta components.
    theta_i, phi_i : float
        Incident direction in degrees.
    collector : str or Subdivision, optional
        Patches whose mean BRDF is wanted, in rings and sectors.
    directions : sequence of (float, float), optional
        Instead: polar angles and azimuths in degrees, at which the BRDF is wanted.
    period : {"none", "box"} or (float, float)
        As of :func:`~gonio_mi.measure`, and at least as large as the mesh.
    points : int
        Points of the surface for each map, each of which is joined to one patch.

    Attributes
    ----------
    shape : tuple of int
        Of a BRDF: of the collector's map, or the number of directions; and channels.

    Raises
    ------
    SpecimenError
        If the specimen is no such mesh.
    VariantError
        In a variant without automatic differentiation, or a spectral one.
    """

    @launches_kernels()
    def __init__(
        self,
        specimen: SpecimenLike,
        theta_i: float,
        phi_i: float = 0.0,
        *,
        collector: str | Subdivision | None = None,
        directions: Sequence[tuple[float, float]] | None = None,
        period: Any = "none",
        points: int = 2**17,
    ) -> None:
        if "_ad_" not in mi.variant() or mi.is_spectral:
            raise VariantError(
                "a differentiable surface needs a variant with automatic "
                "differentiation that is not spectral, such as llvm_ad_mono, "
                f"got {mi.variant()}"
            )
        self.points = checked_count("points", points, MIN_POINTS)
        incidents, stacked = incident_angles(theta_i, phi_i)
        if stacked or incidents == [None]:
            raise SettingError(
                "theta_i and phi_i must be one angle each in degrees, got "
                f"{shown(theta_i)} and {shown(phi_i)}"
            )
        shape, receivers = _receivers(collector, directions)
        self.shape = (*shape, len(mi.UnpolarizedSpectrum()))
        scene = load_specimen(specimen, None, period)
        given = Specimen(scene, checked_period("period", period))
        _check_mesh(given)
        self._moving = MovingSurface(given, towards(incidents[0], "front"), receivers)

    @property
    def geometry(self) -> mi.TensorXf:
        """Heights or vertices, as they were given: the parameter to differentiate for.

        Of vertices in rows and columns the heights, of shape ``(n_y, n_x)``, each once
        in a period; of other meshes all vertices, ``(n, 3)``. Of several vertices at
        one place the first moves them all.
        """
        return mi.TensorXf(self._moving.start)

    @launches_kernels()
    def specimen(self, geometry: mi.TensorXf | None = None) -> dict[str, Any]:
        """Scene with the mesh of a geometry, to be measured: as of :meth:`brdf`."""
        return {"type": "scene", "surface": self._moving.mesh(self._checked(geometry))}

    @launches_kernels()
    def brdf(self, geometry: mi.TensorXf | None = None, seed: int = 0) -> mi.TensorXf:
        """BRDF in 1/sr of light of one event, of shape :attr:`shape`, differentiable.

        Value and derivative draw different random numbers: neither is biased where both
        are multiplied, as in the gradient of a squared difference.

        Parameters
        ----------
        geometry : mi.TensorXf, optional
            Heights or vertices, of the shape of :attr:`geometry`, its default. Lengths
            are those of the scene.
        seed : int
            Other points for each seed.
        """
        seed = checked_count("seed", seed, 0)
        return dr.custom(_BRDF, self, self._checked(geometry), seed)

    def derivative(
        self,
        change: ArrayLike,
        geometry: mi.TensorXf | None = None,
        seed: int = 0,
        batches: int = 16,
    ) -> BRDFDerivative:
        """Derivative of the BRDF for a change of the geometry, with error bars.

        Parameters
        ----------
        change : array_like
            Of each height or vertex, of the shape of :attr:`geometry`.
        geometry, seed : optional
            As of :meth:`brdf`.
        batches : int
            Each has the points of one map.
        """
        geometry, change = self._checked(geometry), self._checked(change, "change")
        seed = checked_count("seed", seed, 0)
        n = checked_count("batches", batches, 2)
        keys = [(seed, BATCHES, batch) for batch in range(n)]
        each = np.stack([self._forward(geometry, change, key) for key in keys])
        std_err = each.std(axis=0, ddof=1) / np.sqrt(n)
        std_err[~each.any(axis=0)] = np.nan
        return BRDFDerivative(each.mean(axis=0), std_err, n)

    def _checked(self, given: Any, name: str = "geometry") -> mi.TensorXf:
        """The tensor, of the shape of the geometry, which is that of None."""
        shape = self._moving.start.shape
        if given is None:
            return self.geometry
        try:  # not what Dr.Jit makes of a text: it does not return
            is_tensor = isinstance(given, mi.TensorXf)
            tensor = mi.TensorXf(given if is_tensor else np.array(given, np.float32))
        except (TypeError, ValueError):
            raise SettingTypeError(
                f"{name} must be a tensor or an array of numbers, got {shown(given)}"
            ) from None
        if tensor.shape != shape:
            raise SettingError(f"{name} must be of shape {shape}, got {tensor.shape}")
        return tensor

    @launches_kernels()
    def _value(self, geometry: mi.TensorXf, key: tuple[int, ...]) -> mi.Float:
        """BRDF without derivatives."""
        found = self._moving.brdf(geometry, key, self.points)
        dr.eval(found)
        return found

    @launches_kernels()
    def _forward(
        self, geometry: mi.TensorXf, change: mi.TensorXf, key: tuple[int, ...]
    ) -> Floats:
        """Derivative for a change of all heights or vertices."""
        moved = mi.TensorXf(dr.detach(geometry))
        dr.enable_grad(moved)
        dr.set_grad(moved, change)
        with self._moving.brdf_in_motion(moved, key, self.points) as brdf:
            found = dr.forward_to(brdf)
            dr.eval(found)
        return found.numpy().astype(float).reshape(self.shape)

    @launches_kernels()
    def _backward(
        self, geometry: mi.TensorXf, adjoint: mi.TensorXf, key: tuple[int, ...]
    ) -> mi.TensorXf:
        """Derivative of the sum of the BRDF times `adjoint` for each height."""
        moved = mi.TensorXf(dr.detach(geometry))
        dr.enable_grad(moved)
        with self._moving.brdf_in_motion(moved, key, self.points) as brdf:
            dr.backward(dr.sum(brdf * adjoint.array))
        return dr.grad(moved)


class _BRDF(dr.CustomOp):
    """The map as an operation of Dr.Jit, whose derivative has points of its own."""

    def eval(
        self, surface: DifferentiableSurface, geometry: mi.TensorXf, seed: int
    ) -> mi.TensorXf:
        self._surface, self._geometry, self._seed = surface, geometry, seed
        found = surface._value(geometry, (seed, VALUE))
        return mi.TensorXf(found, surface.shape)

    def forward(self) -> None:
        change = mi.TensorXf(self.grad_in("geometry"))
        key = self._seed, DERIVATIVE
        found = self._surface._forward(self._geometry, change, key)
        self.set_grad_out(mi.TensorXf(found))

    def backward(self) -> None:
        adjoint, key = mi.TensorXf(self.grad_out()), (self._seed, DERIVATIVE)
        found = self._surface._backward(self._geometry, adjoint, key)
        self.set_grad_in("geometry", found)

    def name(self) -> str:
        return "first-order BRDF"


def _receivers(
    collector: str | Subdivision | None,
    directions: Sequence[tuple[float, float]] | None,
) -> tuple[tuple[int, ...], Sequence[Floats]]:
    """Shape of a map, and its receivers, as :class:`MovingSurface` has them."""
    if (collector is None) == (directions is None):
        raise SettingError(
            "either collector or directions must be given, got "
            f"{shown(collector)} and {shown(directions)}"
        )
    shape: tuple[int, ...]
    if collector is None:
        try:
            pairs = np.reshape(np.array(directions, dtype=float), (-1, 2))
        except (TypeError, ValueError):
            pairs = np.full((1, 2), np.nan)
        theta, phi = np.radians(pairs).T
        allowed = (theta >= 0) & (theta < np.pi / 2) & np.isfinite(phi)
        if not (len(pairs) and allowed.all()):
            raise SettingError(
                "directions must be pairs of a polar angle in [0, 90) and an azimuth "
                f"in degrees, got {shown(directions)}"
            )
        cells, shape = np.array([theta, theta, phi, phi]).T, theta.shape
        ratio = 1 / direction(theta, phi)[:, 2]
    else:
        patches = subdivision(collector)
        if patches.axes is not None:
            raise SettingError(
                "collector must have patches that are parts of rings about the normal, "
                f"got {patches!s:.40}"
            )
        cells, shape = patches.cells, patches.shape
        ratio = (patches.solid_angles / patches.projected_solid_angles).ravel()
    low, high = np.sin(cells[:, :2].T / 2) ** 2
    return shape, (low, high - low, cells[:, 2], cells[:, 3] - cells[:, 2], ratio)


def _check_mesh(specimen: Specimen) -> None:
    """Raise SpecimenError unless a specimen is one mesh that can be differentiated."""
    (surface, *more), what = specimen.surfaces, "a differentiable surface"
    # a rectangle is a mesh in Mitsuba's class tree, but has no vertices
    if more or specimen.groups or triangles_of(traversed(surface)) is None:
        kinds = sorted({shape.class_name() for shape in specimen.surfaces})
        raise SpecimenError(
            f"{what} must be one mesh, got "
            f"{number_of(1 + len(more), 'shape')}: {', '.join(kinds)}"
        )
    if has_normals(surface):
        raise SpecimenError(
            f"{what} must have flat facets, got interpolated normals, which would not "
            "move with its vertices: set face_normals=true"
        )
    if surface.face_count() > MAX_TRIANGLES:
        raise SpecimenError(
            f"{what} must have at most {MAX_TRIANGLES} triangles, got "
            f"{surface.face_count()}"
        )
    if specimen.media or len(specimen.shifts) > 1:
        part = "a medium" if specimen.media else "geometry wider than its period"
        raise SpecimenError(f"{what} must not have {part}")
    flags = surface.bsdf().flags()
    for flag, reason in REFUSED.items():
        if mi.has_flag(flags, getattr(mi.BSDFFlags, flag)):
            raise SpecimenError(f"the BSDF of {what} must not have {reason}")
