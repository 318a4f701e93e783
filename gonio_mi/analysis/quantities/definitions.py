"""Quantities as standards define them: the apertures of each, and its reference.

Of windows the azimuth counts from the plane of incidence: 0 is the side of the source,
180 that of the mirror direction, in the lower hemisphere that of light straight on.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, NamedTuple

import numpy as np

from ...array_types import Floats
from ...collector import Borders, Subdivision
from ...collector.receptors import MAX_WIDTH, MIN_WIDTH, Receptors, Window
from ...errors import SettingError

# Refractive index of the black glass whose gloss is 100 (ISO 2813:2014, 3.3).
BLACK_GLASS = 1.567

# Nodes of the Gauss-Legendre rule along each side of a source.
N_NODES = 16


class Range(NamedTuple):
    """Range of a parameter in degrees, ``[low, high)``."""

    low: float
    high: float

    def __str__(self) -> str:
        return f"a number of degrees in [{self.low:g}, {self.high:g})"


# Parameters of quantities: polar angles and azimuths, those of cones about the normal,
# full widths of windows, and of sources and traps, of which 0 is none.
Polar = Annotated[float, Range(0, 90)]
Azimuth = Annotated[float, Range(-360, 360)]
HalfWidth = Annotated[float, Range(MIN_WIDTH / 2, MAX_WIDTH / 2)]
Width = Annotated[float, Range(MIN_WIDTH, MAX_WIDTH)]
WidthOrNone = Annotated[float, Range(0, MAX_WIDTH)]
Entrance = Annotated[float, Range(-89.99, 90)]
Step = Annotated[float, Range(0.05, 15)]


@dataclass(frozen=True)
class Definition:
    """One quantity: source, receptors and reference.

    Its value is ``scale`` times the flux in the receptors, over the incident flux or
    over that of other receptors, less what another quantity is.

    Attributes
    ----------
    title, unit : str
    source : str
        Where it is defined, and which of its angles could not be checked there.
    theta_i : float
        Angle of incidence in degrees.
    beam : tuple of float
        Full angles of the source in degrees: none of a collimated beam, one of a round
        source of uniform radiance, or two of a rectangular one, in the plane of
        incidence and across, each of whose points sends the same flux.
    diffuse : bool
        Whether light of uniform radiance comes from the whole hemisphere instead.
    lower : bool
        Whether transmitted light is collected.
    receptors, without : tuple of Window
        Windows whose light is collected, the whole hemisphere if there are none, and
        those whose light is not. See :class:`~gonio_mi.collector.receptors.Receptors`.
    over : tuple of Window, optional
        What the light is divided by, in the same hemisphere: by what came if None.
    scale : float
    illuminant : str
        D65 or A, by which wavelengths are weighted.
    minus : Definition, optional
    patches : Subdivision, optional
        The collector instead of windows, on which `curve` depends.
    curve : callable, optional
        Function of the map of reflected flux fractions, instead of a sum. It raises
        SettingError where it has no value.
    words : str
        Light and hemispheres, where a record decides them.
    """

    title: str
    source: str
    unit: str = ""
    theta_i: float = 0.0
    beam: tuple[float, ...] = ()
    receptors: tuple[Window, ...] = ()
    diffuse: bool = False
    lower: bool = False
    without: tuple[Window, ...] = ()
    over: tuple[Window, ...] | None = None
    scale: float = 1.0
    illuminant: str = "D65"
    minus: "Definition | None" = None
    patches: Subdivision | None = None
    curve: Callable[[Floats], float] | None = None
    words: str = ""

    @property
    def light(self) -> str:
        """Incident light in words: quantities of the same may share rays."""
        size = " x ".join(f"{angle:.3g}" for angle in self.beam)
        beam = f"light from {self.theta_i:g} degrees{size and f', a source of {size}'}"
        return "diffuse light" if self.diffuse else beam

    @property
    def geometry(self) -> str:
        """Light and receptors in words."""
        side = "transmitted" if self.lower else "reflected"
        text = self.words or f"{self.light}, {side}"
        for word, windows in (("into", self.receptors), ("outside of", self.without)):
            for theta, phi, *size in windows[:2]:
                wide = " x ".join(f"{angle:.3g}" for angle in size)
                text += f", {word} {wide} about ({theta:g}, {phi:g})"
        return text


def fresnel(cosine: Floats, index: float) -> Floats:
    """Reflectance of a smooth dielectric in air for unpolarised light."""
    inside = np.sqrt(index**2 - 1 + cosine**2)
    s = (cosine - inside) / (cosine + inside)
    p = (index**2 * cosine - inside) / (index**2 * cosine + inside)
    return np.asarray((s**2 + p**2) / 2)


def black_glass(theta_i: float, beam: tuple[float, float]) -> float:
    """Mean reflectance of black glass over the points of a rectangular source."""
    nodes, weights = np.polynomial.legendre.leggauss(N_NODES)
    along, across = (np.tan(np.radians(side) / 2) * nodes for side in beam)
    theta, u = np.radians(theta_i), along[:, None]
    cosine = (np.cos(theta) - u * np.sin(theta)) / np.sqrt(1 + u**2 + across**2)
    return float(weights @ fresnel(cosine, BLACK_GLASS) @ weights / 4)


# ------------------------------------------------------------------- gloss and haze


def gloss(title: str, unit: str, source: str, *receptors: Window) -> Definition:
    """Light of a source of 0.75 x 2.5 degrees in receptors; black glass has 100.

    The angle of incidence is the mean of those of the receptors.
    """
    beam, windows = (0.75, 2.5), tuple((w[0], 180.0, *w[1:]) for w in receptors)
    theta_i = float(np.mean([window[0] for window in windows]))
    own = Definition(title, source, unit, theta_i, receptors=windows, beam=beam)
    return replace(own, scale=100 / black_glass(theta_i, beam))


def haze(angle: HalfWidth = 2.5) -> Definition:
    """Transmitted light that leaves by more than an angle, in per cent of all of it."""
    title, source = f"haze, beyond {angle:g} degrees", "ASTM D1003; angle unverified"
    own = Definition(title, source, "%", without=((0.0, 180.0, 2 * angle),), over=())
    return replace(own, lower=True, scale=100.0)


def tis(inner: HalfWidth = 2.5, outer: HalfWidth = 70.0) -> Definition:
    """Reflected light between two cones about the normal, of all within the outer."""
    if inner >= outer:
        raise SettingError(
            f"inner of tis must be less than outer, got {inner:g} and {outer:g}"
        )
    title = f"total integrated scatter from {inner:g} to {outer:g} degrees"
    near, far = (((0.0, 180.0, 2 * angle),) for angle in (inner, outer))
    own = Definition(title, "SEMI MF1048: about 2.5 and 70 degrees", receptors=far)
    return replace(own, without=near, over=far)


# --------------------------------------------------------------- reflectance factors

_CIE = "CIE 15; full angles of source, receptor and trap unverified"


def factor(
    theta_i: Polar = 45.0,
    theta_o: Polar = 0.0,
    phi_o: Azimuth = 180.0,
    receptor: Width = 2.0,
    source: WidthOrNone = 0.0,
) -> Definition:
    """Reflectance factor: relative to a perfect diffuser in the same receptor."""
    _check_source(theta_i, source)
    title, window = (
        f"reflectance factor {theta_i:g}:{theta_o:g}",
        (theta_o, phi_o, receptor),
    )
    solid = float(Receptors((window,)).projected_solid_angles[0, 0])
    own = Definition(title, _CIE, theta_i=theta_i, receptors=(window,))
    return replace(own, beam=(source,) if source else (), scale=np.pi / solid)


def _check_source(theta_i: float, source: float) -> None:
    """Raise ValueError for a source that reaches below the horizon."""
    if theta_i + source / 2 >= 90:
        raise SettingError(
            f"source must lie above the horizon, got {source:g} degrees about an angle "
            f"of incidence of {theta_i:g}"
        )


def to_sphere(trap: WidthOrNone = 0.0) -> Definition:
    """8:di, or 8:de with a gloss trap of a full angle in degrees."""
    title = f"reflectance factor 8:d{'e' if trap else 'i'}"
    without = ((8.0, 180.0, trap),) if trap else ()
    return Definition(title, _CIE, theta_i=8.0, without=without)


def from_sphere(receptor: Width = 10.0, trap: WidthOrNone = 0.0) -> Definition:
    """di:8, or de:8 with a gloss trap, whose light is taken off all diffuse light."""
    title = f"reflectance factor d{'e' if trap else 'i'}:8"
    one, minus = factor(8.0, 8.0, 180.0, receptor, trap), None
    if trap:
        window = Receptors(((8.0, 180.0, trap),))
        part = float(window.projected_solid_angles[0, 0] / np.pi)
        minus = replace(one, scale=one.scale * part)
    return replace(one, title=title, theta_i=0.0, beam=(), diffuse=True, minus=minus)


# ------------------------------------------------------ retroreflection, transmission


def retroreflection(
    luminance: bool = False,
    observation: Polar = 0.2,
    entrance: Entrance = -4.0,
    source: WidthOrNone = 1 / 6,
    receptor: Width = 1 / 6,
) -> Definition:
    """R_A, or R_L, in the coplanar geometry; the rotation angle is ``phi_i``.

    A negative entrance angle has the receptor on the other side of the source than the
    normal.
    """
    name = "luminance R_L" if luminance else "retroreflection R_A"
    unit = "cd/(m2 lx)" if luminance else "cd/(lx m2)"
    _check_source(abs(entrance), source)
    angles = f"observation {observation:g}, entrance {entrance:g} degrees"
    words = "CIE 54.2, ASTM E808 to E810; apertures of 10 minutes unverified", unit
    there = entrance - observation
    window = (abs(there), 0.0 if there * entrance > 0 else 180.0, receptor)
    scale = np.cos(np.radians(entrance)) / Receptors((window,)).solid_angles[0, 0]
    scale = float(scale / (np.cos(np.radians(there)) if luminance else 1))
    own = Definition(f"coefficient of {name}, {angles}", *words, abs(entrance))
    beam = (source,) if source else ()
    own = replace(own, beam=beam, receptors=(window,), illuminant="A")
    return replace(own, scale=scale)


def reflectance(theta_i: Polar = 0.0) -> Definition:
    """Directional-hemispherical reflectance."""
    return Definition("total reflectance", "CIE 130", "", theta_i)


def transmittance(theta_i: Polar = 0.0) -> Definition:
    """Total transmittance."""
    return Definition("total transmittance", "ISO 13468", "", theta_i, lower=True)


def transmitted(
    title: str, beyond: bool = False, theta_i: Polar = 0.0, cone: Width = 5.0
) -> Definition:
    """Part of the transmittance within a cone straight on, or beyond."""
    own = Definition(title, "EN 14500, EN 14501; the cone is ours", "", theta_i)
    window = ((theta_i, 180.0, cone),)
    own = replace(own, lower=True)
    return replace(own, without=window) if beyond else replace(own, receptors=window)


# --------------------------------------------------------------------------- lobes


def lobe(what: str, theta_i: Polar = 45.0, step: Step = 1.0) -> Definition:
    """Half width at half maximum on one side of the mirror direction, or asymmetry.

    Of the mean BRDF in patches of `step` x 2 `step` degrees about the plane of
    incidence. The maximum is that of a parabola through patches above 0.85 of the
    largest, and half of it that of one through those within half of it to either side:
    a single patch is noise, whose largest is too large.
    """
    first = theta_i + step * (0.5 - np.ceil(theta_i / step))
    edges = np.arange(first if first > step / 4 else first + step, 90.0, step)
    middles = np.convolve(edges, [0.5, 0.5], "valid")
    side = np.degrees(np.radians(step) / np.sin(np.radians(max(theta_i, step))))
    patches = Borders((0, *edges, 90), (0, 180 - side, 180 + side, 360))
    solid = patches.projected_solid_angles

    def curve(fractions: Floats) -> float:
        """Half width or asymmetry of the radiance in the plane of incidence."""
        radiance, ends = (fractions / solid)[1:-1, 1], {}
        # parabolas through noise: one of the top, and one of each slope
        top = middles[radiance > 0.85 * radiance.max()]
        near = np.abs(middles - np.median(top)) <= max(np.ptp(top) / 2, 1.5 * step)
        text = "step must resolve a lobe that falls to half above the horizon"
        text += ", and rays must be enough to show it"
        if near.sum() < 3:
            raise SettingError(f"{text}, got {step:g} degrees")
        a, b, c = np.polyfit(middles[near], radiance[near], 2)
        peak, half = -b / (2 * a), c / 2 - b**2 / (8 * a)
        for sign in {"inner": (-1,), "outer": (1,)}.get(what, (-1, 1)):
            side = sign * (middles - peak) > 0
            slope = side & (np.abs(radiance / half - 1) < 0.5)
            if a >= 0 or slope.sum() < 3 or radiance[side].min() > half:
                raise SettingError(f"{text}, got {step:g} degrees")
            x = middles[slope]
            roots = np.roots(np.polyfit(x, radiance[slope], 2) - [0, 0, half]).real
            end = roots[np.abs(roots - np.median(x)).argmin()]
            ends[sign] = float(sign * (end - theta_i))
        if len(ends) == 1:
            return ends.popitem()[1]
        return (ends[1] - ends[-1]) / (ends[1] + ends[-1])

    unit, source = "" if what == "asymmetry" else "degrees", "half of the largest BRDF"
    own = Definition(f"lobe about the mirror direction, {what}", source, unit, theta_i)
    return replace(own, patches=patches, curve=curve)


_GLOSS = "GU", "ISO 2813, ASTM D523; apertures unverified"
_BESIDE = "ASTM E430 B, ISO 13803; 18.1 and 21.9 degrees unverified"
_HAZE = "HU", _BESIDE, (18.1, 1.8, 3.6), (21.9, 1.8, 3.6)

DEFINITIONS: dict[str, Callable[..., Definition]] = {
    "gloss20": partial(gloss, "gloss at 20 degrees", *_GLOSS, (20.0, 1.8, 3.6)),
    "gloss60": partial(gloss, "gloss at 60 degrees", *_GLOSS, (60.0, 4.4, 11.7)),
    "gloss85": partial(gloss, "gloss at 85 degrees", *_GLOSS, (85.0, 4.0, 6.0)),
    "reflection_haze": partial(gloss, "reflection haze", *_HAZE),
    "haze": haze,
    "transmittance": transmittance,
    "direct": partial(transmitted, "direct transmittance"),
    "diffuse": partial(transmitted, "diffuse transmittance", beyond=True),
    "openness": partial(transmitted, "openness"),
    "tis": tis,
    "dhr": reflectance,
    "brf": factor,
    "45/0": partial(factor, receptor=10.0, source=10.0),
    "0/45": partial(factor, theta_i=0.0, theta_o=45.0, receptor=10.0, source=10.0),
    "8/di": to_sphere,
    "8/de": partial(to_sphere, trap=10.0),
    "di/8": from_sphere,
    "de/8": partial(from_sphere, trap=10.0),
    "R_A": retroreflection,
    "R_L": partial(retroreflection, luminance=True),
    **{f"lobe_{what}": partial(lobe, what) for what in ("inner", "outer", "asymmetry")},
}

# Names that stand for several.
GROUPS = {
    name: tuple(one for one in DEFINITIONS if one.startswith(name))
    for name in ("gloss", "lobe")
}
