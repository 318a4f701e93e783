"""The specimen: the shapes of a scene without its emitters, and whether it is flat."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import FrozenInstanceError
from functools import cached_property
from itertools import islice
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Integers
from ..collector import Subdivision
from ..errors import SpecimenError, abridged, warn
from ..kernels import in_memory
from ..mitsuba_compat import MINIMAL, SURFACE, has_normals, recompute_box
from ..settings.values import Period
from .bsdf_trial import check_works, warn_of_roughness
from .digest import digest, digest_and_parts, kinds_of
from .media import check_media, media_of, phase_defect
from .plane import Plane
from .rays import RETREAT, START, SURFACE_OFFSET, escapes, intersect
from .scene_objects import holds_foreign_plugins, own_settings, traversed
from .shapes import (
    Corners,
    bounds,
    encloses_medium,
    farthest,
    groups_of,
    in_one_plane,
    is_height_map,
    refracts,
    scene_of,
    surfaces_of,
    transmits,
    walls_in_sides,
)
from .wavelengths import check_covered, check_files_cover, lanes_of

# Rays that look for gaps, the most surfaces that each passes, and the fraction of rays
# in thin gaps that is worth a warning: some are near the edges of rough glass.
N_POINTS = 2**12
MAX_PASSED = 16
MAX_THIN = 2.0**-9

# Characters of a BSDF's description in the record: nested principled ones have 1500.
MAX_DESCRIPTION = 4000

# Most copies of a geometry wider than its cell that reach into one cell.
MAX_COPIES = 121

# Extents in scene units in which rays can be traced. In a box from -MAX_COORDINATE to
# MAX_COORDINATE the product of four lengths, 2^128, exceeds single precision. Measured:
# glass 4.2e9 wide has the bits of a small slab; from 8.4e9 on, rays do not get out.
MIN_WIDTH = 1e-9
MAX_COORDINATE = 2.0**31

# Relative error of reflectances due to the distance at which rays start off a surface,
# in units of its coordinates over the specimen's detail (measured on grooves and
# spheres), and the error that is worth a warning.
OFFSET_ERROR = 2.0**-19
MAX_OFFSET_ERROR = 1e-4


class Box:
    """Lengths of a specimen in memory: specimens of any size share kernels.

    Attributes
    ----------
    low, high : list of mi.Float
        Corners, as of :class:`Specimen`.
    period, per_period : list of mi.Float
        Extents in x and y, and their reciprocals.
    reach, detail : mi.Float
    shifts : mi.Float or None
        Of the copies that reach into a cell, three numbers each; None of a cell that
        holds its geometry, and without one.
    n_shifts : mi.UInt32
    """

    def __init__(self, specimen: Specimen) -> None:
        low, high = specimen.low, specimen.high
        period = (high - low)[:2]
        # as Dr.Jit divides by numbers that are known
        per_period = 1 / period.astype(np.float32)
        self.low, self.high, self.period, self.per_period = (
            in_memory(lengths) for lengths in (low, high, period, per_period)
        )
        self.reach, self.detail = in_memory([specimen.reach, specimen.detail])
        self.shifts: Any = None
        if len(specimen.shifts) > 1:
            self.shifts = mi.Float(specimen.shifts.ravel().tolist())
            self.n_shifts = dr.opaque(mi.UInt32, len(specimen.shifts))
            dr.make_opaque(self.shifts)


class Specimen:
    """The shapes of a scene that emit nothing, loaded, described and tried once.

    Frozen, but not a dataclass: Dr.Jit would set its fields in recorded loops.

    Parameters
    ----------
    source : mi.Scene
        With its emitters, sensors and integrator.
    period : {"none", "box"} or (float, float)
        ``"none"``: the geometry is all there is. ``"box"``: its bounding box is a cell
        of an infinite surface, and what leaves through a side of it enters again
        through the opposite one. Extents in x and y: the same with a cell of that size
        about the middle of the box; geometry beyond it reaches into the next ones.
    name : str
        Short name for records and messages.
    files : sequence of (str, float, float)
        Name of each spectral file of the plugin `measured`, and the first and last
        wavelength of its data in nm.

    Raises
    ------
    SpecimenError
        If there is no shape, an unsupported one, or too many copies of the geometry
        reach into a cell.
    """

    source: mi.Scene
    period: Period
    name: str
    files: Sequence[tuple[str, float, float]]

    def __init__(
        self,
        source: mi.Scene,
        period: Period = "none",
        name: str = "a scene",
        files: Sequence[tuple[str, float, float]] = (),
    ) -> None:
        vars(self).update(source=source, period=period, name=name, files=files)
        if not self._shapes:
            raise SpecimenError(
                "the scene must contain a shape to measure, got none: a BSDF alone "
                "must be the root of its file, <bsdf ...> in place of <scene ...>"
            )
        _ = self.scene
        if self.periodic:
            self._check_walls()
        self._check_extent()
        _ = self.box  # not while a kernel is being recorded
        if self.plane is None:
            self._warn_of_distance()
        if self.holds_foreign:
            _ = self.digest  # before plugins are called, which may count their calls
        _ = self.description

    def __setattr__(self, name: str, value: object) -> None:
        raise FrozenInstanceError(f"cannot set {name} of a specimen: it is frozen")

    @property
    def own_settings(self) -> dict[str, Any]:
        """Settings of the scene file, if it is a complete measurement."""
        return own_settings(self.source)

    @cached_property
    def _shapes(self) -> list[mi.Shape]:
        """Shapes of the scene that emit nothing."""
        return [shape for shape in self.source.shapes() if not shape.is_emitter()]

    @cached_property
    def holds_foreign(self) -> bool:
        """Whether the shapes hold plugins in Python of others."""
        return any(map(holds_foreign_plugins, self._shapes))

    @cached_property
    def groups(self) -> list[mi.Shape]:
        """Shape groups that its instances repeat."""
        return groups_of(self.source)

    @cached_property
    def surfaces(self) -> list[mi.Shape]:
        """Shapes that light meets: those of the groups, and all but instances."""
        surfaces = surfaces_of(self._shapes, self.groups)
        for shape in surfaces:
            if isinstance(shape, mi.Mesh) and not shape.bbox().valid():
                # Mitsuba 3.9.1 merges meshes without a bounding box
                recompute_box(shape)
        return surfaces

    @cached_property
    def media(self) -> list[mi.Medium]:
        """Media on either side of the surfaces."""
        return media_of(self.surfaces)

    @cached_property
    def scene(self) -> mi.Scene:
        """Scene of the specimen only: emitters do not block their own light."""
        _ = self.surfaces  # with boxes
        return scene_of(self._shapes, self.groups)

    @property
    def periodic(self) -> bool:
        """Whether the specimen is a cell of an infinite surface."""
        return self.period != "none"

    @cached_property
    def _corners(self) -> tuple[Corners, Floats]:
        """Corners of the bounding box or the cell, and the shifts of copies."""
        low, high = bounds(self._shapes)
        if not (np.isfinite(low).all() and np.isfinite(high).all()):
            raise SpecimenError(
                f"the specimen must be of finite size, got {low} to {high}"
            )
        shifts = np.zeros((1, 3))
        if self.periodic:
            extent = (high - low)[:2]
            cell: Any = extent if self.period == "box" else np.array(self.period)
            wide = cell < extent * (1 - 2.0**-20)
            if np.any(wide):
                shifts = self._copies(extent, cell, wide)
            # to the bit where cell and geometry are equal
            alike = ~wide & (cell < extent * (1 + 2.0**-20))
            margin = (np.where(alike, extent, cell) - extent) / 2
            low[:2] -= margin
            high[:2] += margin
        return (low, high), shifts

    @property
    def low(self) -> Floats:
        """Lower corner of the bounding box in scene units; in x and y, of the cell."""
        return self._corners[0][0]

    @property
    def high(self) -> Floats:
        """Upper corner, likewise."""
        return self._corners[0][1]

    @property
    def shifts(self) -> Floats:
        """Shifts of the copies that reach into the cell, shape ``(n, 3)``."""
        return self._corners[1]

    @cached_property
    def box(self) -> Box:
        """Its corners and extents for kernels."""
        return Box(self)

    @cached_property
    def closed_to_light(self) -> bool:
        """Whether no shape's BSDF has a transmitting component."""
        return not any(map(transmits, self.surfaces))

    @cached_property
    def plane(self) -> Any:
        """:class:`Plane` of a single rectangle parallel to z = 0 without a medium.

        None for all other specimens, and for periodic ones.
        """
        (shape, *others), (low, high) = self._shapes, self._corners[0]
        if self.periodic or self.media or others or shape.class_name() != "Rectangle":
            return None
        if low[2] != high[2]:
            return None
        above = mi.Point3f(((low + high) / 2 + [0, 0, 1]).tolist())
        ray = mi.Ray3f(above, mi.Vector3f(0, 0, -1))
        si = intersect(self.scene, ray, SURFACE, True)
        dr.make_opaque(si)
        return Plane(shape.bsdf(), si, by_ray=self.holds_foreign)

    @cached_property
    def transmits(self) -> bool:
        """Whether light may reach the other side, as far as declared.

        False only for a flat rectangle whose BSDF has no transmitting component.
        """
        return self.plane is None or mi.has_flag(
            self.plane.bsdf.flags(), mi.BSDFFlags.Transmission
        )

    @cached_property
    def description(self) -> str:
        """Shapes and BSDFs in Mitsuba's words."""
        parts = list(map(_describe, self.surfaces[:4]))
        if len(self.surfaces) > 4:
            parts.append(f"and {len(self.surfaces) - 4} more shapes")
        return "; ".join(parts)

    @cached_property
    def measured_patches(self) -> tuple[Subdivision | None, ...]:
        """Patches in which the material of a flat specimen was measured.

        Lit from the front, and from the back: those that a BSDF declares as `patches`;
        None of others, and of geometry, whose light is not that of one surface.
        """
        for part in traversed(self.plane.bsdf).hierarchy if self.plane else ():
            front, back = getattr(part, "patches", (None, None))
            if front is not None:
                return front, back or front
        return None, None

    @cached_property
    def digest(self) -> str:
        """:func:`~gonio_mi.specimen.digest.digest` of its shapes, taken once."""
        return digest(self._digested())

    def state(self) -> tuple[str, list[mi.Object]]:
        """Current digest, and all objects in the shapes.

        For specimens without others' Python plugins.
        """
        return digest_and_parts(self._digested())

    def _digested(self) -> list[mi.Shape]:
        """Shapes, those of groups and those that are repeated."""
        repeated = [*self.groups, *self.surfaces] if self.groups else []
        return [*self.scene.shapes(), *repeated]

    @cached_property
    def kinds(self) -> set[type]:
        """Classes of its shapes and of everything they contain."""
        return kinds_of(self.scene.shapes())

    @property
    def size(self) -> float:
        """Diagonal of the bounding box."""
        return float(np.linalg.norm(self.high - self.low))

    @property
    def reach(self) -> float:
        """Largest coordinate of the bounding box, the unit of rounding errors."""
        own = float(np.abs([self.low, self.high]).max())
        return own + float(np.abs(self.shifts).max())

    @cached_property
    def radius(self) -> float:
        """Radius of the sphere about the origin that holds the surfaces or the cell."""
        if self.periodic:
            corner = np.abs([self.low, self.high]).max(axis=0)
            return float(np.linalg.norm(corner))
        return farthest(self.scene.shapes())

    @property
    def detail(self) -> float:
        """Smallest non-zero extent of the bounding box, plus the largest shift."""
        extents = self.high - self.low
        least = float(extents[extents > 1e-6 * extents.max()].min())
        return least + float(np.abs(self.shifts).max())

    @property
    def transmission(self) -> str:
        """How light may pass: as BSDFs ``declared``, through ``gaps``, or ``none``."""
        if not self.closed_to_light:
            return "declared"
        return "none" if self.plane is not None or self.appears_opaque else "gaps"

    @cached_property
    def appears_opaque(self) -> bool:
        """Whether no surface transmits, and no ray of a few thousand finds a gap.

        They come from above, from all directions and all over the cell. What is
        free-standing is not: light goes down around its edges.
        """
        if not (self.closed_to_light and self.periodic):
            return False
        active = mi.Bool(True)
        free = escapes(self, 1, self._rays(1), mi.Normal3f(0), mi.Float(0), active)
        return not dr.any(free)

    def _rays(self, side: int) -> mi.Ray3f:
        """A few thousand rays from above or below (-1), all over the box."""
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(0, N_POINTS)
        x, y = sampler.next_2d()
        face = self.high if side > 0 else self.low
        (z,) = in_memory([face[2] + side * self.reach * START])
        low, extent = self.box.low, self.box.period
        start = mi.Point3f(low[0] + x * extent[0], low[1] + y * extent[1], z)
        d = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
        ray = mi.Ray3f(start, -side * d)
        dr.eval(ray)
        return ray

    def tried(
        self, wavelengths: Sequence[float], functions: Callable[[Any], set[str]]
    ) -> tuple[str, ...]:
        """Try its BSDFs and media once; return sentences on defects.

        Defects do not prevent a measurement; each gives a warning.

        Parameters
        ----------
        wavelengths : sequence of float
            In nm, of a spectral variant.
        functions : callable
            Returns the names of the functions that are called on a BSDF.

        Raises
        ------
        SpecimenError
            If it has no data at a wavelength, or light cannot reach a medium.
        Exception
            Whatever a BSDF raises.
        """
        key = tuple(wavelengths), functions
        if key not in self._trials:
            self._trials[key] = self._try(*key)
        return self._trials[key]

    @cached_property
    def _trials(self) -> dict[Any, tuple[str, ...]]:
        """Defects by wavelengths and functions, shared by directions and orders."""
        return {}

    def _try(
        self, wavelengths: Sequence[float], functions: Callable[[Any], set[str]]
    ) -> tuple[str, ...]:
        """Try its BSDFs and media, and look for thin gaps."""
        lanes = lanes_of(wavelengths)
        bsdfs = [surface.bsdf() for surface in self.surfaces]
        if mi.is_spectral:
            check_files_cover(self.files, wavelengths)
        check_works(bsdfs, lanes[0], functions)
        warn_of_roughness(bsdfs)
        if mi.is_spectral:
            check_covered([*bsdfs, *self.media], wavelengths)
        if self.media:
            check_media(self, lanes)
        _ = self.digest  # evaluates its objects' data, and kernels have other bits then
        phases = [medium.phase_function() for medium in self.media]
        box = self.low, self.high
        found = filter(None, (phase_defect(phase, lanes[0], *box) for phase in phases))
        sentences = tuple(dict.fromkeys([*self.thin_gaps(), *found]))
        for sentence in sentences:
            warn(sentence)
        return sentences

    def thin_gaps(self) -> list[str]:
        """Sentence on surfaces so close together that rays may miss one of them.

        Empty if there are none, or if no light gets between them.
        """
        if self.closed_to_light or self.plane is not None:
            return []
        flat = all(
            isinstance(shape, mi.Mesh) and not has_normals(shape)
            for shape in self.surfaces
        )
        least = (self.detail + self.reach) * (RETREAT if flat else SURFACE_OFFSET)
        share = self._thin(least)
        if share >= MAX_THIN:
            apart, where = f"less than {least:.2g} scene units", f"{share:.2g} of rays"
        elif not self.groups and in_one_plane(self.surfaces, least):
            apart, where = "0 scene units", "some rays"
        else:
            return []
        return [
            f"{where} meet two surfaces {apart} apart, which is too little for single "
            "precision: light may pass one of them unseen; move them further apart, or "
            "describe both by one BSDF"
        ]

    def _thin(self, least: float) -> float:
        """Fraction of the rays that pass a gap of less than `least`.

        The larger one of rays from either side. They go straight through all surfaces
        that transmit. Looking back from `least` behind each surface, a ray sees the
        same one if there is no gap.
        """
        above, below = self._rays(1), self._rays(-1)
        none = dr.zeros(mi.Float, N_POINTS)  # heights are one number
        o, d = (
            [dr.concat([one + none, other + none]) for one, other in zip(*both)]
            for both in ((above.o, below.o), (above.d, below.d))
        )
        ray = mi.Ray3f(mi.Point3f(*o), mi.Vector3f(*d))
        through = {
            _number(mi.ShapePtr(shape))[0]
            for shape in self.surfaces
            if transmits(shape)
        }
        thin, met = np.zeros((2, 2 * N_POINTS), bool)
        active = np.ones(2 * N_POINTS, bool)
        (step,) = in_memory([least])
        for _ in range(MAX_PASSED):
            mask = mi.Bool(active)
            first = self.scene.ray_intersect_preliminary(ray, active=mask)
            ray.o = ray(first.t + step)
            back = mi.Ray3f(mi.Ray3f(ray.o, -ray.d), 2 * step)
            last = self.scene.ray_intersect_preliminary(back, active=mask)
            dr.eval(ray, first, last)
            seen = [one.is_valid().numpy() for one in (first, last)]
            shapes = [_number(one.shape) for one in (first, last)]
            faces = [one.prim_index.numpy() for one in (first, last)]
            passed = [np.isin(numbers, [*through]) for numbers in shapes]
            other = (shapes[0] != shapes[1]) | (faces[0] != faces[1])
            met |= seen[0]
            thin |= seen[0] & seen[1] & other & (passed[0] | passed[1])
            active = seen[0] & passed[0]
            if not active.any():
                break
        found, all_rays = (one.reshape(2, -1).sum(axis=1) for one in (thin, met))
        return float(np.max(found / np.maximum(all_rays, 1)))

    @cached_property
    def edges(self) -> str | None:
        """``closed``, or ``open`` if it may be part of a larger surface.

        Of a few thousand rays to points all over the box, all that are vertical meet an
        open surface, and some of the others meet it from behind: a height field, or a
        pane without walls, and no solid. A tube without ends is closed: along two axes
        all rays meet its one side. None for a flat rectangle, and in a cell.
        """
        if self.periodic or self.plane is not None:
            return None
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(0, N_POINTS)
        d = mi.warp.square_to_uniform_sphere(sampler.next_2d())
        low, high = map(mi.Point3f, (self.box.low, self.box.high))
        place = mi.Vector3f(*sampler.next_2d(), sampler.next_1d())
        aim, (size,) = low + place * (high - low), in_memory([self.size])
        ray, down = mi.Ray3f(aim - size * d, d), mi.Vector3f(0, 0, -1)
        si = intersect(self.scene, ray, MINIMAL, True)
        behind = si.is_valid() & (dr.dot(si.n, d) > 0)
        covered = self.scene.ray_test(mi.Ray3f(aim - size * down, down))
        dr.eval(behind, covered)  # by one kernel
        if not (dr.any(behind) and dr.all(covered)):
            return "closed"
        # two are enough
        along = (1 for axis in np.eye(3) if not self._is_closed_along(axis, aim))
        return "open" if sum(islice(along, 2)) == 2 else "closed"

    def _is_closed_along(self, axis: Floats, aim: mi.Point3f) -> bool:
        """Whether rays in both directions along an axis all meet one side."""
        cosines, (size,) = [], in_memory([self.size])
        for end in (axis, -axis):
            d = mi.Vector3f(in_memory(end))  # one kernel for all axes
            ray = mi.Ray3f(aim - size * d, d)
            si = intersect(self.scene, ray, MINIMAL, True)
            cosines.append(dr.select(si.is_valid(), dr.dot(si.n, d), 0.0))
        dr.eval(cosines)
        signs = np.sign(cosines)
        return bool(np.all(signs < 0) or np.all(signs > 0))

    @cached_property
    def is_height_map(self) -> bool:
        """Whether it is one mesh of heights that fills a periodic cell."""
        if len(self.shifts) > 1 or not self.periodic or len(self.scene.shapes()) > 1:
            return False
        return is_height_map(self.surfaces[0], self.box.low, self.box.high)

    def _check_extent(self) -> None:
        """Raise SpecimenError for extents that single precision cannot trace."""
        extent = (self.high - self.low)[:2]
        if extent.min() < MIN_WIDTH or self.reach > MAX_COORDINATE:
            raise SpecimenError(
                f"the specimen must be at least {MIN_WIDTH:g} scene units wide in x "
                f"and y, and within {MAX_COORDINATE:g} of the origin, got "
                f"{extent[0]:g} x {extent[1]:g} within {self.reach:g}"
            )

    def _warn_of_distance(self) -> None:
        """Warn of rounding errors of geometry far from the origin."""
        error = (self.reach - self.size) * OFFSET_ERROR / self.detail
        if error > MAX_OFFSET_ERROR:
            warn(
                f"the specimen lies up to {self.reach:g} scene units from the origin, "
                f"where rounding changes results by up to {100 * min(error, 1):.3g} % "
                "of their value: move it to the origin"
            )

    def _check_walls(self) -> None:
        """Refuse media, and warn of glass, that end at the cell's sides."""
        walls = walls_in_sides(self.surfaces, self.low, self.high, encloses_medium)
        if walls:
            raise SpecimenError(
                f"{walls[0]} must have no walls in the sides of the periodic cell, for "
                "light that leaves its medium there is inside of the next cell's at "
                "once: leave these walls out (an endless layer is two rectangles), or "
                "make the period larger"
            )
        walls = walls_in_sides(self.surfaces, self.low, self.high, refracts)
        if walls:
            warn(
                f"{walls[0]} refracts light at walls in the sides of the periodic "
                "cell: if the specimen is one piece, such as a film, leave out these "
                "walls, for they send light astray and back"
            )

    def _copies(self, extent: Floats, cell: Floats, wide: Flags) -> Floats:
        """Shifts of the copies of the geometry that reach into or touch the cell."""
        if not all(medium.is_homogeneous() for medium in self.media):
            raise SpecimenError(
                "period must hold the geometry of a medium that varies, which is "
                f"{extent[0]:g} x {extent[1]:g}, got {cell[0]:g} x {cell[1]:g}"
            )
        most = np.where(wide, np.floor((extent / cell + 1 + 2.0**-12) / 2), 0)
        n = int(np.prod(2 * most + 1))
        if n > MAX_COPIES:
            raise SpecimenError(
                f"period must be so large that at most {MAX_COPIES} copies of the "
                f"geometry, which is {extent[0]:g} x {extent[1]:g}, reach into a cell, "
                f"got {cell[0]:g} x {cell[1]:g} and {n} copies"
            )
        x, y = (size * np.arange(-k, k + 1) for size, k in zip(cell, most))
        return np.array([(a, b, 0.0) for a in x for b in y])


def _number(shapes: mi.ShapePtr) -> Integers:
    """Numbers that identify shapes."""
    return dr.reinterpret_array(mi.UInt32, shapes).numpy()


def _describe(shape: mi.Shape) -> str:
    """Describe a shape and its BSDF in one line, without large arrays."""
    # of a mesh, its file or what a height field has to say
    name = re.search(r'\bname = "([^"]*)"', _text(shape)) if shape.is_mesh() else None
    label = f"{shape.class_name()} {name[1]}" if name else shape.class_name()
    return f"{label} with {abridged(_text(shape.bsdf()), MAX_DESCRIPTION)}"


def _text(thing: Any) -> str:
    """Mitsuba's text of a shape or BSDF on one line, or the name of its class."""
    try:
        return " ".join(str(thing).split())
    except Exception:  # one of them is a plugin in Python, which may raise anything
        return type(thing).__name__
