"""A collector of receptor windows of various sizes, such as field stops."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ..array_types import Flags, Floats, Singles
from ..errors import SettingError, shown
from .directions import direction
from .hemisphere import EDGE, Subdivision

# Full angles of windows, in degrees; single precision resolves none below the first.
MIN_WIDTH, MAX_WIDTH = 0.02, 179.99

Window = tuple[float, ...]


@dataclass(frozen=True)
class Receptors(Subdivision):
    r"""Round and rectangular windows about given axes, and the gap between them.

    A window may contain smaller ones, as a cone about the mirror direction contains the
    field stop of a gloss meter; windows must not overlap otherwise. Patch ``i`` is
    window ``i`` without the windows before it; the last patch is the rest of the
    hemisphere. A map has one row per patch and one column. A rim belongs to the
    outside.

    Parameters
    ----------
    windows : sequence of (float, ...)
        ``(theta, phi, diameter)`` of a round window: polar angle from the pole of the
        hemisphere, azimuth, and full angle of the cone, in degrees. ``(theta, phi,
        along, across)`` of a rectangular one: the full angles that it subtends in the
        plane of its axis and the pole, and across that plane. Its sides lie on great
        circles: it is a rectangle in the focal plane of a lens, of the sides
        ``2 tan(along / 2)`` and ``2 tan(across / 2)``. Smaller windows come first.

    Raises
    ------
    TypeError, ValueError
        If a window reaches below the horizon, two overlap, or there is none.
    """

    windows: tuple[Window, ...]

    name: ClassVar[str] = "receptors"

    def __post_init__(self) -> None:
        windows = tuple(tuple(map(float, window)) for window in self.windows)
        object.__setattr__(self, "windows", windows)
        if not windows:
            raise SettingError("windows must hold at least one window, got none")
        for i, window in enumerate(windows):
            if not _is_window(window):
                raise SettingError(
                    "a window must be three or four angles in degrees, theta, phi, and "
                    f"one or two widths of at least {MIN_WIDTH:g}, and lie above the "
                    f"horizon, got {shown(window)}"
                )
            for other in windows[:i]:
                if window == other or (
                    not holds(window, other) and _touch(window, other)
                ):
                    raise SettingError(
                        "windows must not overlap, unless a smaller one lies in a "
                        f"later one, got {other} and {window}"
                    )

    def __str__(self) -> str:
        return f"{self.name}:{','.join('/'.join(map(repr, w)) for w in self.windows)}"

    @classmethod
    def parse(cls, size: str) -> "Receptors":
        """Build from the text after the colon, such as ``60.0/180.0/4.4/11.7``."""
        words = [window.split("/") for window in size.split(",")]
        return cls(tuple(tuple(map(float, one)) for one in words))

    @property
    def shape(self) -> tuple[int, int]:
        """The windows and the gap between them, in one column."""
        return self.n_detectors + 1, 1

    @property
    def n_detectors(self) -> int:
        """Number of windows."""
        return len(self.windows)

    @property
    def middles(self) -> tuple[Floats, Floats]:
        """Polar angles and azimuths of the windows' axes in radians.

        Two arrays of the shape `shape`; NaN for the gap, and for a window whose axis
        lies in a smaller one.
        """
        middles = np.radians([window[:2] for window in self.windows])
        outside = self.patch(self.axes[:-1]) != np.arange(self.n_detectors)
        middles = np.vstack([np.where(outside[:, None], np.nan, middles), [np.nan] * 2])
        return middles[:, :1], middles[:, 1:]

    @property
    def axes(self) -> Floats:
        """Axes of the windows as unit vectors, shape ``(n_patches, 3)``; last +z."""
        return np.vstack([_rows(self.windows)[:, :3], [0, 0, 1]])

    @property
    def cells(self) -> Floats:
        """Bounding cone of each window about its axis; the hemisphere for the gap.

        Shape ``(n_patches, 4)``, in radians.
        """

        def reach(window: Window) -> float:
            return float(np.arccos(np.min(_rim(window) @ _frame(window)[2])))

        reaches = self._of_windows(self._half_widths.copy(), reach)
        return np.array([(0, r, 0, 2 * np.pi) for r in [*reaches, np.pi / 2]])

    @property
    def fills_cells(self) -> bool:
        """Whether all windows are round, and none lies in another."""
        apart = self._of_patches(np.ones(self.n_detectors), 0)[:-1] == 1
        return bool(apart.all()) and all(len(window) == 3 for window in self.windows)

    @property
    def solid_angles(self) -> Floats:
        """Exact solid angle of each patch in sr, sum 2 pi; of the shape `shape`.

        Of a cone ``4 pi sin^2(a / 2)`` for a half-angle ``a``, of a rectangle
        ``4 asin(sin(along / 2) sin(across / 2))``.
        """
        cones = 4 * np.pi * np.sin(self._half_widths / 2) ** 2
        whole = self._of_windows(cones, _solid_angle)
        return self._of_patches(whole, 2 * np.pi)[:, None]

    @property
    def projected_solid_angles(self) -> Floats:
        """Exact integral of cos(theta) over each patch in sr, sum pi.

        Of a cone ``pi sin^2(a) cos(theta)`` for a half-angle ``a`` around ``theta``; of
        a rectangle half the sum over its sides of their lengths times the heights of
        their normals (Lambert 1760, *Photometria*). Of the shape `shape`.
        """
        theta = np.radians([window[0] for window in self.windows])
        cones = np.pi * np.sin(self._half_widths) ** 2 * np.cos(theta)
        whole = self._of_windows(cones, _projected_solid_angle)
        return self._of_patches(whole, np.pi)[:, None]

    def patch_index(self, xp: Any, x: Any, y: Any, z: Any) -> Any:
        """Index of the window that holds each direction, or the number of windows.

        See :meth:`Subdivision.patch_index`.
        """
        index = x * 0 + float(self.n_detectors)
        for number, is_round in self._candidates(xp, x, y, z):
            # from a table, whose values may change without another kernel
            columns = self._table[:4] if is_round else self._table
            row = [xp.take(column, number) for column in columns]
            index = xp.where(_inside(is_round, row, x, y, z), number, index)
        return index

    def within(self, windows: Sequence[Window]) -> Flags | None:
        """Patches within the given windows; None if the collector lacks one of them."""
        if not {*windows} <= {*self.windows}:
            return None
        inside = [
            any(each == one or holds(one, each) for one in windows)
            for each in self.windows
        ]
        return np.array([*inside, False])

    def filled(self, n: int) -> tuple[Floats, Floats]:
        """Directions of ``n x n`` points in the last window, and their weights.

        Shapes ``(n * n, 3)`` and ``(n * n,)``. The weights are projected solid angles
        in sr, 0 below the horizon.
        """
        window = self.windows[-1]
        step = (np.arange(n) + 0.5) / n
        half = np.radians(window[2:]) / 2
        if len(half) == 1:
            area, turn = np.meshgrid(step, 2 * np.pi * step)
            height = 1 - 2 * np.sin(half[0] / 2) ** 2 * area
            sine = np.sqrt(1 - height**2)
            sides = sine * np.cos(turn), sine * np.sin(turn)
            local = np.stack([*sides, height], axis=-1)
            weight = np.full(n * n, 4 * np.pi * np.sin(half[0] / 2) ** 2 / n**2)
        else:
            u, v = np.meshgrid(*(np.tan(one) * (2 * step - 1) for one in half))
            norm = np.sqrt(1 + u**2 + v**2)
            local = np.stack([u, v, np.ones_like(u)], axis=-1) / norm[..., None]
            weight = (4 * np.prod(np.tan(half)) / n**2 / norm**3).ravel()
        wo = local.reshape(-1, 3) @ _frame(window)
        return wo, weight * np.maximum(wo[:, 2], 0)

    def _candidates(self, xp: Any, x: Any, y: Any, z: Any) -> list[tuple[Any, bool]]:  # noqa: ARG002
        """Numbers of the windows to test, and whether they are round.

        The last match counts, so that the first of nested windows comes last.
        """
        numbers = reversed(range(self.n_detectors))
        return [(x * 0 + float(i), len(self.windows[i]) == 3) for i in numbers]

    def _of_windows(
        self, cones: Floats, rectangle: Callable[[Window], float]
    ) -> Floats:
        """Values of all windows, with those of rectangles from a function."""
        for i, window in enumerate(self.windows):
            if len(window) == 4:
                cones[i] = rectangle(window)
        return cones

    def _of_patches(self, whole: Floats, hemisphere: float) -> Floats:
        """Integrals over patches, from integrals over windows and the hemisphere."""
        patches = np.append(whole, hemisphere)
        for i, window in enumerate(self.windows):
            # the smallest window around it, or the hemisphere
            later = range(i + 1, self.n_detectors)
            outer = next((j for j in later if holds(self.windows[j], window)), -1)
            patches[outer] -= whole[i]
        return patches

    @property
    def _half_widths(self) -> Floats:
        """Half of the first angular width of each window in radians."""
        return np.radians([window[2] for window in self.windows]) / 2

    @cached_property
    def _table(self) -> Singles:
        """Columns of `_rows` in single precision."""
        return _rows(self.windows).astype(np.float32).T.copy()


def holds(outer: Window, inner: Window) -> bool:
    """Whether the outer window contains a smaller one."""
    return outer != inner and bool(_within(outer, _rim(inner), 1 + EDGE).all())


def _touch(a: Window, b: Window) -> bool:
    """Whether the rim of either window enters the other."""
    return bool(np.any(_within(a, _rim(b))) or np.any(_within(b, _rim(a))))


def _within(window: Window, v: Floats, stretch: float = 1 - EDGE) -> Flags:
    """Whether directions lie in a window whose widths are scaled by a factor."""
    (row,) = _rows([(*window[:2], *(stretch * size for size in window[2:]))])
    return np.asarray(_inside(len(window) == 3, row, *v.T))


def _inside(is_round: bool, row: Sequence[Any], x: Any, y: Any, z: Any) -> Any:
    """Whether directions lie in the window of a row of the table."""
    if is_round:  # chords keep their precision for narrow cones
        u, v, w = x - row[0], y - row[1], z - row[2]
        return u * u + v * v + w * w < row[3]
    u, v, w = (x * row[i] + y * row[i + 1] + z * row[i + 2] for i in (4, 7, 0))
    return (u * u < row[3] * w * w) & (v * v < row[10] * w * w) & (w > 0)


def _is_window(window: Window) -> bool:
    """Whether the numbers describe a window above the horizon."""
    if len(window) not in (3, 4) or not np.isfinite(window).all():
        return False
    fits = min(window[2:]) >= MIN_WIDTH and max(window[2:]) <= MAX_WIDTH
    return bool(fits and 0 <= window[0] <= 90 and _rim(window)[:, 2].min() > -EDGE)


def _rows(windows: Sequence[Window]) -> Floats:
    """Table of the windows, shape ``(n, 11)``.

    Columns: axis, limit (of the squared chord, or of the squared tangent along), axes
    along and across, limit across. A round window needs the first four only.
    """
    theta, phi = np.radians([window[:2] for window in windows]).T
    half = np.radians([(window[2], window[-1]) for window in windows]) / 2
    is_round = np.array([len(window) == 3 for window in windows])[:, None]
    limits = np.where(is_round, 4 * np.sin(half / 2) ** 2, np.tan(half) ** 2)
    across = np.stack([-np.sin(phi), np.cos(phi), np.zeros_like(phi)], axis=-1)
    along, axis = direction(theta + np.pi / 2, phi), direction(theta, phi)
    return np.hstack([axis, limits[:, :1], along, across, limits[:, 1:]])


def _frame(window: Window) -> Floats:
    """Local frame of a window: axes along and across, and its own axis, as rows."""
    (row,) = _rows([window])
    return np.array([row[4:7], row[7:10], row[:3]])


def _solid_angle(rectangle: Window) -> float:
    """Solid angle of a rectangular window in sr."""
    return float(4 * np.arcsin(np.prod(np.sin(np.radians(rectangle[2:]) / 2))))


def _projected_solid_angle(rectangle: Window) -> float:
    """Projected solid angle of a rectangular window in sr."""
    corners = _rim(rectangle, 4)
    others = np.roll(corners, -1, axis=0)
    normals = np.cross(corners, others)
    sines = np.linalg.norm(normals, axis=1)
    sides = np.arctan2(sines, np.sum(corners * others, axis=1))
    return float(np.sum(sides * normals[:, 2] / sines) / 2)


def _rim(window: Window, n: int = 64) -> Floats:
    """`n` points of the rim as unit vectors, including the corners of a rectangle."""
    turn = (np.arange(n) + n / 8) * (2 * np.pi / n)
    x, y = np.cos(turn), np.sin(turn)
    if len(window) == 4:
        longer = np.maximum(np.abs(x), np.abs(y))
        x, y = x / longer, y / longer
    along, across = np.tan(np.radians([window[2], window[-1]]) / 2)
    local = np.stack([x * along, y * across, np.ones(n)], axis=-1)
    local /= np.linalg.norm(local, axis=1, keepdims=True)
    return np.asarray(local @ _frame(window))
