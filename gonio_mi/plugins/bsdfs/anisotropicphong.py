"""BSDF `anisotropicphong`: microfacets with an anisotropic Phong distribution."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from gonio_mi.plugins import bsdf_functions, exponentiated_cosine as lobe, phong_facets
from gonio_mi.plugins.bsdf_functions import Asked, reflectance


class AnisotropicPhong(mi.BSDF):
    r"""Microfacets with anisotropic Phong normals (:monosp:`anisotropicphong`).

    .. pluginparameters::

     * - exponent_u, exponent_v
       - |float|
       - Phong exponents :math:`e_u` along the tangent (x) and :math:`e_v` across it
         (y), from 0 to 1e6: the larger, the narrower the highlight in that direction.
         (Default: 50 and 1000)
       - |exposed|

     * - f0
       - |spectrum| or |texture|
       - Reflectance :math:`f_0` of a facet at normal incidence, from 0 to 1; 1 for an
         ideal mirror at all angles. (Default: 1)
       - |exposed|, |differentiable|

    The BRDF generator of Ashikhmin, Premože and Shirley (2000), with uncorrelated
    shadowing. The normals of the facets have the density, per unit area of *facets*,

    .. math::

        p(h) = \frac{\sqrt{(e_u + 1)(e_v + 1)}}{2 \pi}\,
        (h \cdot n)^{e_u \cos^2\phi_h + e_v \sin^2\phi_h},

    and with the half vector :math:`h` of :math:`i` and :math:`o`,

    .. math::

        f_r = \frac{\langle h \cdot n \rangle\, p(h)\, F(h \cdot i)}{4\, g(i)\, g(o)},
        \qquad g(k) = \int_{h \cdot k > 0} (h \cdot k)\, p(h)\, d\omega_h, \qquad
        \langle h \cdot n \rangle
        = \sqrt{\frac{(e_u + 1)(e_v + 1)}{(e_u + 2)(e_v + 2)}} .

    It follows from three assumptions.

    1. The facets seen from :math:`k` fill the projected area of the surface: with their
       visible fraction :math:`P(k, h)`, :math:`\int_{h \cdot k > 0} P(k, h)\,
       (h \cdot k)\, p(h)\, d\omega_h = \langle h \cdot n \rangle\, (k \cdot n)`.
    2. That fraction is the same for all facets that face :math:`k`, so that
       :math:`P(k) = \langle h \cdot n \rangle (k \cdot n) / g(k)`.
    3. Shadowing and masking are independent, :math:`P(i, o) = P(i) P(o)`, in
       :math:`f_r = p(h)\, P(i, o)\, F / (4\, (i \cdot n) (o \cdot n)\,
       \langle h \cdot n \rangle)`.

    The factor :math:`\langle h \cdot n \rangle` converts facet area to surface area: it
    is 1 for a flat surface, 0.9898 for the default exponents and 1/2 for
    :math:`e_u = e_v = 0`; without it the BRDF would gain energy. The variant with
    correlated shadowing is not implemented. The "anisotropic Phong BRDF model" of
    Ashikhmin and Shirley is another one: it has :math:`(h \cdot i)
    \max(i \cdot n, o \cdot n)` in the place of :math:`g(i)\, g(o)` and no
    :math:`\langle h \cdot n \rangle`.

    :math:`F` is Schlick's approximation :math:`f_0 + (1 - f_0)(1 - h \cdot i)^5`.

    The BRDF is reciprocal. It conserves energy, for :math:`P \le 1`:

    .. math::

        \int f_r \cos\theta_o\, d\omega_o
        = \int F\, P(o)\, \frac{(h \cdot i)\, p(h)}{g(i)}\, d\omega_h \le 1 .

    What would be scattered again is absorbed. :math:`g` is interpolated in a table that
    makes it at most 2e-5 of its value too large and 5e-7 too small, so that the table
    adds no more energy than rounding does. Reflected fraction for :math:`f_0 = 1` and
    the default exponents, for incidence in the planes of x and of y:

    ====== ====== ====== ====== ====== ====== ====== ======
    plane  0°     30°    45°    60°    75°    85°    89°
    ====== ====== ====== ====== ====== ====== ====== ======
    x      1.0000 0.9999 0.9972 0.9758 0.9193 0.9281 0.9580
    y      1.0000 1.0000 1.0000 1.0000 0.9999 0.9445 0.9297
    ====== ====== ====== ====== ====== ====== ====== ======

    A half vector is drawn from :math:`p(h)`, hence :math:`o` with the density
    :math:`p(h) / (4\, h \cdot o)`. Facets that face away from :math:`i` give no
    direction, nearly a half of all at grazing incidence; a sample's weight there
    exceeds 1.

    Only the front side reflects; :monosp:`twosided` makes both do.

    Source: M. Ashikhmin, S. Premože and P. Shirley, *A microfacet-based BRDF
    generator*, SIGGRAPH 2000, `doi:10.1145/344779.344814
    <https://doi.org/10.1145/344779.344814>`_. The exponents 50 and 1000 are those of
    Krishnaswamy, Baranoski and Rokne (2004, Figure 12). The distribution and its
    sampling are also in M. Ashikhmin and P. Shirley, *An anisotropic Phong BRDF model*,
    Journal of Graphics Tools 5 (2), 2000, `doi:10.1080/10867651.2000.10487522
    <https://doi.org/10.1080/10867651.2000.10487522>`_.

    .. tabs::
        .. code-tab:: xml

            <bsdf type="anisotropicphong">
                <float name="exponent_u" value="50.0"/>
                <float name="exponent_v" value="1000.0"/>
                <float name="f0" value="1.0"/>
            </bsdf>

        .. code-tab:: python

            'type': 'anisotropicphong',
            'exponent_u': 50.0,
            'exponent_v': 1000.0,
            'f0': 1.0
    """

    sample, eval_pdf = bsdf_functions.sample, bsdf_functions.eval_pdf
    eval, pdf = bsdf_functions.evaluate, bsdf_functions.density

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.exponent_u = lobe.exponent(props, "exponent_u", 50.0)
        self.exponent_v = lobe.exponent(props, "exponent_v", 1000.0)
        self.f0 = reflectance(props, "f0", 1.0)
        self.parameters_changed([])

    def traverse(self, cb: mi.TraversalCallback) -> None:
        """Expose exponents and reflectance."""
        cb.put("exponent_u", self.exponent_u, mi.ParamFlags.NonDifferentiable)
        cb.put("exponent_v", self.exponent_v, mi.ParamFlags.NonDifferentiable)
        cb.put("f0", self.f0, mi.ParamFlags.Differentiable)

    def parameters_changed(self, keys: Any) -> None:
        """Compute what depends on the exponents."""
        if keys and not {"exponent_u", "exponent_v"} & set(keys):
            return
        # variables that kernels read, so that other values give the same kernel
        dr.make_opaque(self.exponent_u, self.exponent_v)
        e_u, e_v = self.exponent_u[0], self.exponent_v[0]
        anisotropic = mi.BSDFFlags.Anisotropic if e_u != e_v else mi.BSDFFlags.Empty
        self.m_flags = bsdf_functions.GLOSSY | anisotropic
        self.m_components = [self.m_flags]
        table = phong_facets.averted_area_table(e_u, e_v)
        # hardware interpolation would round to 8 bits
        self.averted_area = mi.Texture2f(mi.TensorXf(table[..., None]), use_accel=False)
        self.mean_cosine = mi.Float(float(phong_facets.mean_cosine(e_u, e_v)))
        dr.make_opaque(self.mean_cosine)

    def draw(self, asked: Asked, u: mi.Point2f) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        """Draw a facet and reflect at it."""
        ctx, si, on = asked.ctx, asked.si, asked.on
        if not bsdf_functions.glossy_enabled(ctx):
            return dr.zeros(mi.BSDFSample3f), mi.UnpolarizedSpectrum(0)
        h = self._sample_facet(u)
        facing = dr.dot(h, si.wi) > 0
        wo = dr.normalize(mi.reflect(si.wi, h))
        h, cos_d = _half_vector(si.wi, wo)
        pdf = dr.select(on & facing, self._density(h) / (4 * cos_d), 0)
        above = on & (pdf > 0) & (mi.Frame3f.cos_theta(wo) > 0)
        weight = self._fresnel(si, cos_d, above) * (
            self._shadowing(si.wi, wo) * 4 * cos_d * mi.Frame3f.cos_theta(wo)
        )
        return bsdf_functions.glossy_sample(wo, pdf), weight & above

    def scattered(self, asked: Asked, wo: mi.Vector3f) -> tuple[mi.Spectrum, mi.Float]:
        """Reflect at the facets along the half vector; the density misses some."""
        ctx, si, on = asked.ctx, asked.si, asked.on
        if not bsdf_functions.glossy_enabled(ctx):
            return mi.UnpolarizedSpectrum(0), mi.Float(0)
        h, cos_d = _half_vector(si.wi, wo)
        density = self._density(h)
        value = self._fresnel(si, cos_d, on) * (
            density * self._shadowing(si.wi, wo) * mi.Frame3f.cos_theta(wo)
        )
        return value, density / (4 * cos_d)

    def _sample_facet(self, sample: mi.Point2f) -> mi.Vector3f:
        """Facet normal with the density p(h)."""
        sin, cos = dr.sincos(dr.two_pi * sample.x)
        cos *= dr.sqrt(self.exponent_v + 1)
        sin *= dr.sqrt(self.exponent_u + 1)
        norm = dr.rsqrt(dr.square(cos) + dr.square(sin))
        cos, sin = cos * norm, sin * norm
        exponent = self.exponent_u * dr.square(cos) + self.exponent_v * dr.square(sin)
        sin_theta, cos_theta = lobe.polar(exponent, sample.y)
        return mi.Vector3f(sin_theta * cos, sin_theta * sin, cos_theta)

    def _density(self, h: mi.Vector3f) -> mi.Float:
        """Density p(h) of facet normals."""
        x2, y2 = dr.square(h.x), dr.square(h.y)
        # at the pole, where any exponent will do, it is 0
        sin2 = dr.maximum(x2 + y2, dr.smallest(mi.Float))
        exponent = (self.exponent_u * x2 + self.exponent_v * y2) / sin2
        c = dr.sqrt((self.exponent_u + 1) * (self.exponent_v + 1)) * dr.inv_two_pi
        return c * lobe.cosine_power(exponent, mi.Vector3f(0, 0, 1), h)

    def _shadowing(self, wi: mi.Vector3f, wo: mi.Vector3f) -> mi.Float:
        """Mean cosine over 4 g(i) g(o)."""
        return self.mean_cosine / (4 * (self._facing_area(wi) * self._facing_area(wo)))

    def _facing_area(self, k: mi.Vector3f) -> mi.Float:
        """Projected area g(k) of the facets that face `k`, for k above the horizon."""
        x = dr.abs(k.x) * dr.rsqrt(self.exponent_u + 1)
        y = dr.abs(k.y) * dr.rsqrt(self.exponent_v + 1)
        z = mi.Frame3f.cos_theta(k)
        a = z / (x + y + z)
        q = y / dr.maximum(x + y, dr.smallest(mi.Float))
        rows, columns = self.averted_area.shape[:2]
        node = mi.Point2f(a * (columns - 1) + 0.5, q * (rows - 1) + 0.5)
        averted = self.averted_area.eval(node / mi.Point2f(columns, rows))[0]
        # facing minus averted area is that of the flat surface
        return z * self.mean_cosine + (x + y + z) * averted

    def _fresnel(
        self, si: mi.SurfaceInteraction3f, cos_d: mi.Float, active: mi.Bool | bool
    ) -> mi.Spectrum:
        """Schlick's reflectance of a facet."""
        f0 = self.f0.eval(si, active)
        return f0 + (1 - f0) * dr.maximum(1 - cos_d, 0) ** 5

    def to_string(self) -> str:
        """Return a readable description."""
        return (
            f"AnisotropicPhong[exponent_u={self.exponent_u[0]:g}, "
            f"exponent_v={self.exponent_v[0]:g}, f0={self.f0}]"
        )


def _half_vector(wi: mi.Vector3f, wo: mi.Vector3f) -> tuple[mi.Vector3f, mi.Float]:
    """Half vector, and its cosine to either direction, without cancellation."""
    half = wi + wo
    length = dr.norm(half)
    return half / length, length / 2


PLUGIN = AnisotropicPhong
