"""BSDF `goniometric`: a measured record as a material."""

import functools
import operator

import drjit as dr
import mitsuba as mi

from gonio_mi import files
from gonio_mi.lobes import LobeTable
from gonio_mi.plugins import properties
from gonio_mi.plugins.lit_face import LitFace

LUMINANCE = (0.212671, 0.715160, 0.072169)


class Goniometric(mi.BSDF):
    r"""Material that was measured with the instrument (:monosp:`goniometric`).

    .. pluginparameters::

     * - filename
       - |string|
       - Record of the front face, ``.npz`` or ``.exr``: a stack over polar angles of
         incidence at one azimuth (isotropic), or at each of several azimuths that go
         all around (anisotropic).

     * - back_filename
       - |string|
       - Record of light that meets the other face, measured with ``side="back"``. For a
         specimen with two equal faces it may be the same file. (Default: none, that
         face is black)

     * - eta
       - |float|
       - Refractive index below the specimen over that above it, for pictures of a bare
         interface: see below. (Default: 1)

    With a lower hemisphere in the record, component 0 is reflection and component 1
    transmission. At an incident direction of the record, the BSDF is the record: the
    patch means, constant over each patch. Between two polar angles lobes *move*: both
    are shifted over the disk onto which the hemisphere projects, towards the place that
    lies between them by :math:`\sin\theta_i` (of quantiles of their light, along the
    plane of incidence and then across it), and mixed. A mirror lobe stays at the mirror
    angle, a diffuse lobe where it is, and reflectance and transmittance are linear in
    :math:`\sin\theta_i`, never above the greater of the two. Azimuths turn with that of
    incidence; between two measured azimuths the two lobes are mixed. Outside of the
    polar angles of the record, the nearest counts.

    Sampling is exact, up to float32: each sample has the weight of the reflectance (in
    the record's colours), and ``pdf`` integrates to 1 unless the record is black.

    A record of one channel fits all variants; one of the channels R, G, B those of
    rgb, and by its luminance monochrome ones.

    In importance mode this is the measured quantity, flux per incident flux, and
    nothing is divided by :math:`\eta^2`. In radiance mode, :math:`\omega_i` looks to
    the camera, and the same value stands for light in the opposite direction, as if the
    specimen were reciprocal; with the same medium on both sides, as around any finite
    specimen, nothing else is needed. If the record is of a bare interface between two
    media, `eta` scales transmitted radiance by :math:`1/\eta^2` from above and
    :math:`\eta^2` from below. Mitsuba's path tracers work in this mode.

    .. tabs::
        .. code-tab:: xml

            <bsdf type="goniometric">
                <string name="filename" value="measured.npz"/>
            </bsdf>

        .. code-tab:: python

            'type': 'goniometric',
            'filename': 'measured.npz'
    """

    def __init__(self, props):
        super().__init__(props)
        self.eta = mi.Float(
            properties.number(props, "eta", 1.0, 0.01, 100, "a number from 0.01 to 100")
        )
        dr.make_opaque(self.eta)
        self.files = [props.get(name) for name in ("filename", "back_filename")]
        if self.files[0] is None:
            raise ValueError("goniometric.filename must name a record, got nothing")
        self.faces = [
            None if name is None else LitFace(_table(f"goniometric.{key}", name))
            for key, name in zip(("filename", "back_filename"), self.files)
        ]
        self._declare()

    def _declare(self):
        """Set the flags of both components."""
        kinds = (mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.GlossyTransmission)
        sides = (mi.BSDFFlags.FrontSide, mi.BSDFFlags.BackSide)
        components = []
        for hemisphere, kind in enumerate(kinds):
            flags = kind | mi.BSDFFlags.NonSymmetric
            having = [
                (face, side)
                for face, side in zip(self.faces, sides)
                if face is not None and face.n_hemispheres > hemisphere
            ]
            for face, side in having:
                flags |= side
                if face.n_azimuths > 1:
                    flags |= mi.BSDFFlags.Anisotropic
            if having:
                components.append(flags)
        # Mitsuba hands out copies of its lists: set them whole
        self.m_components = components
        self.m_flags = functools.reduce(operator.or_, components)

    def sample(self, ctx, si, sample1, sample2, active=True):
        """Pick a hemisphere by `sample1` and draw `wo` by `sample2`."""
        bs = dr.zeros(mi.BSDFSample3f)
        value = mi.Spectrum(0)
        for face, side, wi, lit in self._lit(si.wi, active):
            wo = face.sample(wi, self._enabled(ctx), sample1, sample2)
            bs.wo[lit] = mi.Vector3f(wo.x, wo.y, wo.z * side)
            face_value, face_pdf = self._of_face(ctx, face, side, wi, wo, lit)
            value[lit] = face_value
            bs.pdf[lit] = face_pdf
        below = bs.wo.z * si.wi.z < 0
        bs.eta = dr.select(below, self._relative_eta(si.wi.z), 1.0)
        bs.sampled_type = dr.select(
            below,
            mi.UInt32(+mi.BSDFFlags.GlossyTransmission),
            mi.UInt32(+mi.BSDFFlags.GlossyReflection),
        )
        bs.sampled_component = dr.select(below, mi.UInt32(1), mi.UInt32(0))
        return bs, dr.select(bs.pdf > 0, value / bs.pdf, 0)

    def eval(self, ctx, si, wo, active=True):
        """BRDF or BTDF times the cosine of `wo`, of the enabled components."""
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(self, ctx, si, wo, active=True):
        """Density of `wo` in 1/sr."""
        return self.eval_pdf(ctx, si, wo, active)[1]

    def eval_pdf(self, ctx, si, wo, active=True):
        """Both of :meth:`eval` and :meth:`pdf`."""
        value, pdf = mi.Spectrum(0), mi.Float(0)
        for face, side, wi, lit in self._lit(si.wi, active):
            seen = mi.Vector3f(wo.x, wo.y, wo.z * side)
            face_value, face_pdf = self._of_face(ctx, face, side, wi, seen, lit)
            value += face_value & lit
            pdf += dr.select(lit, face_pdf, 0)
        return value, pdf

    def _lit(self, wi, active):
        """Faces, their side, `wi` seen from them, and where that is the lit one."""
        for face, side in zip(self.faces, (1, -1)):
            if face is not None:
                yield (
                    face,
                    side,
                    mi.Vector3f(wi.x, wi.y, dr.abs(wi.z)),
                    (active & (wi.z * side > 0)),
                )

    def _of_face(self, ctx, face, side, wi, wo, active):
        """Value and density for light on one face, seen from it."""
        value, pdf = face.eval_pdf(wi, wo, self._enabled(ctx), active)
        if ctx.mode == mi.TransportMode.Radiance:
            eta = self._relative_eta(side)
            value *= dr.select(wo.z < 0, 1 / dr.square(eta), 1.0)
        return value, pdf

    def _relative_eta(self, side):
        """Refractive index on the side of transmission over that of incidence."""
        return dr.select(side > 0, self.eta, 1 / self.eta)

    def _enabled(self, ctx):
        """Which hemispheres the context asks for."""
        return (
            ctx.is_enabled(mi.BSDFFlags.GlossyReflection, 0),
            ctx.is_enabled(mi.BSDFFlags.GlossyTransmission, 1),
        )

    def to_string(self):
        """Return a readable description."""
        return (
            f"Goniometric[filename={self.files[0]}, back_filename={self.files[1]}, "
            f"eta={self.eta[0]:g}]"
        )


def _table(label, name):
    """Lobes of the record in a file, in the variant's channels."""
    try:
        record = files.load(str(mi.file_resolver().resolve(name)))
        mixture = None
        if len(record.channels) > 1 and record.channels != ("R", "G", "B"):
            raise ValueError(
                "the record must have one channel or R, G, B, got "
                f"{', '.join(record.channels)[:80]}"
            )
        if len(record.channels) == 3 and not mi.is_rgb:
            if mi.is_spectral:
                raise ValueError(
                    "a record of R, G, B must be used in an rgb or monochrome variant, "
                    f"got {mi.variant()}"
                )
            mixture = LUMINANCE
        return LobeTable.of(record, mixture)
    except (ValueError, OSError) as error:
        raise type(error)(f"{label}: {error}") from None


mi.register_bsdf("goniometric", Goniometric)
