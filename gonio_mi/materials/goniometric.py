"""BSDF `goniometric`: a measured record as a material."""

from __future__ import annotations

import functools
import operator
from collections.abc import Iterator, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gonio_mi import files
from gonio_mi.annexes import ask
from gonio_mi.array_types import Floats
from gonio_mi.errors import SettingError, abridged
from gonio_mi.materials.interpolation.interpolated_bsdf import (
    InterpolatedBSDF,
    half_vector_segments,
)
from gonio_mi.materials.interpolation.lobes import MeasuredLobes
from gonio_mi.materials.interpolation.radiance_guide import (
    RadianceGuide,
    radiance_guide,
)
from gonio_mi.plugins import bsdf_functions
from gonio_mi.results.record import XYZ, Record, wavelengths_nm

# Signs of z on the front and the back.
SIDES = (1, -1)

# Kinds of the components: reflection and transmission.
KINDS = (mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.GlossyTransmission)

# Warnings that were given.
_told: set[str] = set()

# Samples drawn by the cosine in radiance mode, if not of a guide.
EVEN = 0.1


class Goniometric(mi.BSDF):
    r"""Material that was measured with the instrument (:monosp:`goniometric`).

    .. pluginparameters::

     * - filename
       - |string|
       - Record of the front face, ``.npz`` or ``.exr``: a stack over polar angles of
         incidence at one azimuth (isotropic), or at each of several azimuths that go
         all around (anisotropic); azimuths that are whole sectors apart may be missing
         at some polar angles. Or a Radiance ``.xml``, lit from +z, or the scatter
         data of another program: ``.bsdf`` of Zemax, ``.brdf`` or ``.anisotropicbsdf``
         of Speos, ``.json`` of OpenMATERIAL, ``.binary`` of the MERL database.

     * - back_filename
       - |string|
       - Record of light that meets the other face, measured with ``side="back"``. For a
         specimen with two equal faces it may be the same file. Of an ``.xml`` the side
         lit from -z counts. (Default: `filename`, if it holds both sides itself, as a
         campaign with a ``tolerance`` and an ``.xml`` do; else none, and that face is
         black)

    Component 0 is reflection; of a record with light in the lower hemisphere, component
    1 is transmission. A matrix of patches (Klems) holds means over incident patches:
    for light of any direction in one of them the BSDF is that patch's, constant in each
    patch of exit, as in Radiance. Of other records, at an incident direction of the
    record, the BSDF is the record: its means over patches are those measured, and
    within a patch it is linear, as the patches around suggest. Between two polar angles
    the lobes of both are mixed linearly in :math:`\sin\theta_i`, and so are
    reflectance and transmittance. On each of these segments, and for either hemisphere
    on its own, the lobes *move* to where the same micro-normals (half vectors) reflect
    to, or refract to with the refractive index that fits the records, if the record's
    nearest angle is better predicted so from the next smaller and the next larger one.
    Else those of isotropic records move by the quantiles of their light, along the
    plane of incidence and then across it, over the disk onto which the hemisphere
    projects; of anisotropic ones, of which this would slow pictures down threefold,
    they stay. A mirror lobe that moves stays at the mirror angle in both ways.
    Azimuths turn with that of incidence; between two measured azimuths both neighbours
    are mixed. First they are moved by their micro-normals, if this predicts records of
    four azimuths or more better from their neighbours. What would go beyond the horizon
    stays. Outside of the polar angles of the record, lobes of the nearest one move on
    by their micro-normals, or stay. How wrong all this is between the directions, a
    record of a campaign with a ``tolerance`` tells: its setting ``campaign`` holds the
    errors at directions that were never used.

    Of a Klems file, and of a record whose light filled all patches of a Klems basis,
    all directions of an incident patch have the lobe of the patch, which is a mean over
    them: as in Radiance, nothing is interpolated.

    In importance mode :math:`\omega_i` looks to the emitter, and the value is what was
    measured: flux per incident flux, in which nothing is divided by :math:`\eta^2`.
    Sampling is exact up to float32: each sample has the weight of the reflectance (in
    the record's colours), and ``pdf`` integrates to 1 unless the record is black.

    In radiance mode, that of Mitsuba's path tracers, the emitter is in the direction
    :math:`\omega_o`: the value is what was measured with light from there, on whichever
    face that is. A record is not reciprocal, be it only for its patches and its noise;
    with nothing to assume, a transmitting specimen between two media needs no
    :math:`\eta` either, but both faces. Of isotropic records, directions are drawn of a
    table that is coarse but of these very values: for each step of the camera's polar
    angle, as many as the record has rings of patches, what is seen from there in cells
    as large as patches. One in fifty is drawn uniformly, which bounds the weights.
    Weights vary as far as values do within a cell. Of anisotropic records, or if there
    are more than 16 million cells, directions are drawn as in importance mode and, for
    one sample in ten, by the cosine; weights vary as far as the record is not
    reciprocal.

    A record of one channel fits all variants; one of the channels R, G, B those of
    rgb, and by its luminance monochrome ones; one of several wavelengths spectral
    variants: it is linear in between and constant beyond them, where `measure` refuses
    it.

    .. tabs::
        .. code-tab:: xml

            <bsdf type="goniometric">
                <string name="filename" value="measured.npz"/>
            </bsdf>

        .. code-tab:: python

            'type': 'goniometric',
            'filename': 'measured.npz'
    """

    eval, pdf = bsdf_functions.evaluate, bsdf_functions.density

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.files = [props.get(name) for name in ("filename", "back_filename")]
        if self.files[0] is None:
            raise SettingError("goniometric.filename must name a record, got nothing")
        if mi.variant().startswith("scalar"):
            raise SettingError(
                "goniometric needs a variant that computes with arrays, such as "
                f"llvm_ad_rgb, got {mi.variant()}"
            )
        front, has_back = _face("goniometric.filename", self.files[0], "front")
        if self.files[1] is None and has_back:
            self.files[1] = self.files[0]
        back = None
        if self.files[1] is not None:
            back, _ = _face("goniometric.back_filename", self.files[1], "back")
        elif front.transmits:
            _warn_once(
                f"{self.files[0]} transmits, but holds no light that "
                "meets the other face, which is black: measure both with a tolerance "
                'and no side, or name a record measured with side="back", or of equal '
                "faces the same file, as back_filename",
            )
        self.faces = [front, back]
        #: patches in which the front and the back were measured
        self.patches = tuple(face and face.patches for face in self.faces)
        self._declare()
        #: sampling table of radiance mode; None if lobes are sampled there, too
        self.guide = radiance_guide(self.faces)

    def wavelength_range(self) -> tuple[float, float]:
        """Shortest and longest wavelength in nm of what the records hold.

        Without an end for records of one channel, which hold for all.
        """
        held: list[Any] = [face.wavelengths for face in self.faces if face is not None]
        held = [nm for nm in held if nm is not None and len(nm) > 1]
        low, high = max(map(min, held), default=0), min(map(max, held), default=np.inf)
        return float(low), float(high)

    def _declare(self) -> None:
        """Set the flags of both components."""
        sides = (mi.BSDFFlags.FrontSide, mi.BSDFFlags.BackSide)
        components = []
        for hemisphere, kind in enumerate(KINDS):
            flags = kind | mi.BSDFFlags.NonSymmetric
            having = [
                (face, side)
                for face, side in zip(self.faces, sides)
                if face is not None and face.n_hemispheres > hemisphere
            ]
            for face, side in having:
                # in radiance mode transmission is seen from the other side
                flags |= sides[0] | sides[1] if hemisphere else side
                if face.anisotropic:
                    flags |= mi.BSDFFlags.Anisotropic
            if having:
                components.append(flags)
        # Mitsuba hands out copies of its lists: set them whole
        self.m_components = components
        self.m_flags = functools.reduce(operator.or_, components)

    def sample(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        sample1: mi.Float,
        sample2: mi.Point2f,
        active: mi.Bool | bool = True,
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        """Pick a hemisphere by `sample1` and draw `wo` by `sample2`."""
        bs = dr.zeros(mi.BSDFSample3f)
        if (guide := self._guide(ctx)) is not None:
            bs.wo = guide.sample(si.wi, self._enabled(ctx), sample1, sample2)
        else:
            bs.wo = self._drawn_of_lobes(ctx, si.wi, sample1, sample2, active)
        value, bs.pdf = self.eval_pdf(ctx, si, bs.wo, active)
        below = bs.wo.z * si.wi.z < 0
        bsdf_functions.name_component(bs, below, *KINDS)
        return bs, dr.select(bs.pdf > 0, value / bs.pdf, 0)

    def eval_pdf(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        wo: mi.Vector3f,
        active: mi.Bool | bool = True,
    ) -> tuple[mi.Spectrum, mi.Float]:
        """Both of :meth:`eval` and :meth:`pdf`."""
        if ctx.mode == mi.TransportMode.Importance:
            value, pdf = self._from_emitter(ctx, si.wi, wo, si.wavelengths, active)
            return bsdf_functions.depolarised(value), pdf
        value, _ = self._from_emitter(ctx, wo, si.wi, si.wavelengths, active)
        value *= dr.select(si.wi.z == 0, 0, dr.abs(wo.z / si.wi.z))
        if (guide := self._guide(ctx)) is not None:
            pdf = guide.pdf(si.wi, wo, self._enabled(ctx), active)
        else:
            pdf = self._density_of_lobes(ctx, si, wo, active)
        return bsdf_functions.depolarised(value), pdf

    def _guide(self, ctx: mi.BSDFContext) -> RadianceGuide | None:
        """Sampling table of radiance mode; None if lobes are sampled instead."""
        return None if ctx.mode == mi.TransportMode.Importance else self.guide

    def _drawn_of_lobes(
        self,
        ctx: mi.BSDFContext,
        wi: mi.Vector3f,
        sample1: mi.Float,
        sample2: mi.Point2f,
        active: mi.Bool | bool,
    ) -> mi.Vector3f:
        """Sample of the lobes; in radiance mode a tenth by the cosine."""
        drawn = mi.Vector3f(0)
        for side, guide, hemispheres in self._guides(ctx):
            lit = active & (wi.z * side > 0)
            seen = _seen(wi, side)
            if ctx.mode == mi.TransportMode.Importance:
                wo = _drawn(guide, hemispheres, lit, seen, sample1, sample2)
            else:
                rest = (sample1 - EVEN) / (1 - EVEN)
                wo = _drawn(guide, hemispheres, lit, seen, rest, sample2)
                even = mi.warp.square_to_cosine_hemisphere(sample2)
                below = (sample1 > EVEN / 2) | ~mi.Bool(hemispheres[0])
                even.z = dr.select(below & hemispheres[1], -even.z, even.z)
                wo = dr.select(sample1 < EVEN, even, wo)
            drawn[lit] = _seen(wo, side)
        return drawn

    def _density_of_lobes(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        wo: mi.Vector3f,
        active: mi.Bool | bool,
    ) -> mi.Float:
        """Density of :meth:`_drawn_of_lobes` in radiance mode."""
        pdf = mi.Float(0)
        for side, guide, hemispheres in self._guides(ctx):
            lit = active & (si.wi.z * side > 0)
            seen = _seen(wo, side)
            directions = _seen(si.wi, side), seen
            _, density = _looked_up(
                guide, hemispheres, lit, *directions, si.wavelengths
            )
            wanted = dr.select(seen.z < 0, hemispheres[1], hemispheres[0])
            even = dr.select(wanted, dr.abs(wo.z) * dr.inv_pi / sum(hemispheres), 0)
            pdf += dr.select(lit, (1 - EVEN) * density + EVEN * even, 0)
        return pdf

    def _from_emitter(
        self,
        ctx: mi.BSDFContext,
        to_emitter: mi.Vector3f,
        detector: mi.Vector3f,
        wavelengths: mi.Spectrum,
        active: mi.Bool | bool,
    ) -> tuple[mi.Spectrum, mi.Float]:
        """Value and density of `detector` for light from the direction `to_emitter`."""
        value, pdf = mi.UnpolarizedSpectrum(0), mi.Float(0)
        for face, side in zip(self.faces, SIDES):
            if face is not None:
                lit = active & (to_emitter.z * side > 0)
                directions = _seen(to_emitter, side), _seen(detector, side)
                face_value, face_pdf = _looked_up(
                    face, self._enabled(ctx), lit, *directions, wavelengths
                )
                value += face_value & lit
                pdf += dr.select(lit, face_pdf, 0)
        return value, pdf

    def _guides(
        self, ctx: mi.BSDFContext
    ) -> Iterator[tuple[int, InterpolatedBSDF, tuple[bool, bool]]]:
        """Sides of `wi`, the face to sample there, and hemispheres that hold `wo`."""
        enabled = self._enabled(ctx)
        for number, side in enumerate(SIDES):
            own, other = self.faces[number], self.faces[1 - number]
            if ctx.mode == mi.TransportMode.Importance:
                hemispheres = enabled
                guide = own
            else:
                # light comes to the own face, or from behind to the other one
                through = other is not None and other.n_hemispheres == 2
                hemispheres = enabled[0] and own is not None, enabled[1] and through
                guide = own
                if own is None or (not hemispheres[0] and own.n_hemispheres == 1):
                    guide = other
            if guide is not None and any(hemispheres):
                yield side, guide, hemispheres

    def _enabled(self, ctx: mi.BSDFContext) -> tuple[bool, bool]:
        """Which hemispheres the context asks for."""
        return ctx.is_enabled(KINDS[0], 0), ctx.is_enabled(KINDS[1], 1)

    def to_string(self) -> str:
        """Return a readable description."""
        return f"Goniometric[filename={self.files[0]}, back_filename={self.files[1]}]"


def _looked_up(
    face: InterpolatedBSDF,
    hemispheres: tuple[bool, bool],
    lit: mi.Bool,
    wi: mi.Vector3f,
    wo: mi.Vector3f,
    wavelengths: mi.Spectrum,
) -> tuple[mi.Spectrum, mi.Float]:
    """Value and density of a face; where no lane of a vector is lit, none is asked."""
    lit = (
        lit & (dr.abs(wi.z) >= 0) & (dr.abs(wo.z) >= 0)
    )  # as wide as all that is asked for

    def asked(wi: Any, wo: Any, nm: Any) -> tuple[mi.Spectrum, mi.Float]:
        return face.eval_pdf(wi, wo, hemispheres, lit, nm)

    def nothing(*_: Any) -> tuple[mi.Spectrum, mi.Float]:
        return mi.UnpolarizedSpectrum(0), mi.Float(0)

    found: tuple[mi.Spectrum, mi.Float]
    found = dr.if_stmt((wi, wo, wavelengths), lit, asked, nothing)
    return found


def _drawn(
    face: InterpolatedBSDF,
    hemispheres: tuple[bool, bool],
    lit: mi.Bool,
    wi: mi.Vector3f,
    sample1: mi.Float,
    sample2: mi.Point2f,
) -> mi.Vector3f:
    """Direction drawn of a face; where no lane of a vector is lit, none is."""
    lit = lit & (dr.abs(sample1) >= 0) & (dr.abs(sample2.x) >= 0) & (dr.abs(wi.z) >= 0)

    def asked(wi: Any, sample1: Any, sample2: Any) -> mi.Vector3f:
        return face.sample(wi, hemispheres, sample1, sample2)

    found: mi.Vector3f
    found = dr.if_stmt((wi, sample1, sample2), lit, asked, lambda *_: mi.Vector3f(0))
    return found


def _seen(v: mi.Vector3f, side: int) -> mi.Vector3f:
    """Return `v` seen from the face on that side."""
    return mi.Vector3f(v.x, v.y, v.z * side)


def _warn_once(text: str) -> None:
    """Log a warning, unless it was given before."""
    if text not in _told:
        _told.add(text)
        mi.Log(mi.LogLevel.Warn, f"goniometric: {text}")


def _resolved(name: str) -> str:
    """Path of a file where Mitsuba looks for it."""
    return str(mi.file_resolver().resolve(name))


def _face(label: str, name: str, side: str) -> tuple[InterpolatedBSDF, bool]:
    """Face of the material in a file, in the variant's channels, and has it a back."""
    try:
        lobes, wavelengths, has_back = _lobes(_resolved(name), side)
        segments = half_vector_segments(lobes)
        table, patches = lobes.whole(), lobes.measured
        del lobes  # which would be kept until the table's arrays are made
        face = InterpolatedBSDF(table, wavelengths, segments, patches=patches)
        return face, has_back
    except (ValueError, OSError) as error:
        raise type(error)(f"{label}: {error}") from None


def _lobes(path: str, side: str) -> tuple[MeasuredLobes, Floats | None, bool]:
    """Lobes of a file, the wavelengths of their channels, and has it a back.

    A record itself is let go, whose batches need more memory than all that follows.
    """
    if path.lower().endswith(files.ENDINGS):
        material: Any = files.load_added_up(path)
        has_back = material.back is not None
        if side == "back" and has_back:
            material = material.back
    else:
        material = ask("exchange", "load_material")(path, side)
        has_back = ask("exchange", "has_back")(path)
    from_back = isinstance(material, Record) and material.asked.side == "back"
    if side == "front" and from_back:
        _warn_once(
            f"{path} was measured from the back, and is the front of this "
            "material: name it as back_filename if that is meant",
        )
    for note in getattr(material, "notes", ()):
        _warn_once(f"{path}: {note}")
    nm = wavelengths_nm(material.channels)
    lobes = MeasuredLobes(material, _mixture(material.channels, nm is not None))
    return lobes, nm, has_back


def _mixture(channels: Sequence[str], spectral: bool) -> Floats | None:
    """Weights that make one channel of three where the variant has one, or None."""
    said = abridged(", ".join(channels), 80)
    if spectral and len(channels) > 1 and not mi.is_spectral:
        raise SettingError(
            f"a record of {said} must be used in a spectral variant, got "
            f"{mi.variant()}: take llvm_ad_spectral"
        )
    if spectral or len(channels) == 1:
        return None
    if channels != ("R", "G", "B"):
        raise SettingError(
            f"the record must have one channel, R, G, B or wavelengths, got {said}"
        )
    if mi.is_spectral:
        raise SettingError(
            "a record of R, G, B must be used in an rgb or monochrome variant, "
            f"got {mi.variant()}: take llvm_ad_rgb"
        )
    return None if mi.is_rgb else XYZ[1]


PLUGIN = Goniometric
