"""BSDF `glossymixture`: a Lambertian and an exponentiated-cosine lobe."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from gonio_mi.errors import SettingError
from gonio_mi.plugins import bsdf_functions, exponentiated_cosine as lobe
from gonio_mi.plugins.bsdf_functions import Asked, mean, reflectance

DIFFUSE = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide


class GlossyMixture(mi.BSDF):
    r"""Mixture of a diffuse and an exponentiated-cosine lobe (:monosp:`glossymixture`).

    .. pluginparameters::

     * - diffuse_reflectance
       - |spectrum| or |texture|
       - Weight :math:`\rho_d` of the cosine (Lambertian) distribution. (Default: 0.8)
       - |exposed|, |differentiable|

     * - specular_reflectance
       - |spectrum| or |texture|
       - Weight :math:`\rho_s` of the exponentiated cosine; the sum of both must be at
         most 1. (Default: 0.2)
       - |exposed|, |differentiable|

     * - exponent
       - |float|
       - Exponent :math:`n` of the cosine, from 0 to 1e6. (Default: 16)
       - |exposed|, |differentiable|

     * - normalisation
       - |string|
       - Form of the exponentiated cosine, ``unit`` or ``modified_phong``: see
         :monosp:`cosinelobe`. (Default: ``unit``)

    The defaults are the glossy material of Krishnaswamy, Baranoski and Rokne (2004,
    section 5.2 and Figure 11). In the form ``unit``,

    .. math::

        f_r \cos\theta_o = \rho_d\, \frac{\cos\theta_o}{\pi} + \rho_s\,
        \frac{n + 1}{2 \pi} \cos^n \alpha ,

    in the form ``modified_phong`` the second term is
    :math:`\rho_s \frac{n + 2}{2 \pi} \cos^n\alpha \cos\theta_o`. Component 0 is the
    diffuse lobe, component 1 the glossy one. What of the glossy lobe falls below the
    horizon is absorbed: the albedo is :math:`\rho_d + \rho_s R(\theta_i)`, with
    :math:`R` of :monosp:`cosinelobe` for :math:`\rho = 1`. At 30°, 45° and 60° the
    defaults reflect 1.0000, 0.9999 and 0.9971.

    A lobe is picked with probability proportional to its mean weight, and the sample's
    weight is the whole :math:`f_r \cos\theta_o` over the whole density.

    Only the front side reflects; :monosp:`twosided` makes both do.

    Source: E. P. Lafortune and Y. D. Willems, *Using the modified Phong reflectance
    model for physically based rendering*, report CW 197, K.U. Leuven, 1994.

    .. tabs::
        .. code-tab:: xml

            <bsdf type="glossymixture">
                <float name="diffuse_reflectance" value="0.8"/>
                <float name="specular_reflectance" value="0.2"/>
                <float name="exponent" value="16.0"/>
            </bsdf>

        .. code-tab:: python

            'type': 'glossymixture',
            'diffuse_reflectance': 0.8,
            'specular_reflectance': 0.2,
            'exponent': 16.0
    """

    sample, eval_pdf = bsdf_functions.sample, bsdf_functions.eval_pdf
    eval, pdf = bsdf_functions.evaluate, bsdf_functions.density

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.diffuse = reflectance(props, "diffuse_reflectance", 0.8)
        self.specular = reflectance(props, "specular_reflectance", 0.2)
        self.exponent = lobe.exponent(props, "exponent", 16.0)
        self.form = lobe.form(props)
        total = mean(self.diffuse) + mean(self.specular)
        # 0.8 + 0.2 in float32 may exceed 1 by a rounding error
        if total > 1 + 2.0**-22:
            raise SettingError(
                "glossymixture: diffuse_reflectance + specular_reflectance must be at "
                f"most 1, got {total:g}"
            )
        self.m_components = [DIFFUSE, lobe.flags(self.form)]
        self.m_flags = DIFFUSE | lobe.flags(self.form)
        self.parameters_changed([])

    def traverse(self, cb: mi.TraversalCallback) -> None:
        """Expose weights and exponent."""
        cb.put("diffuse_reflectance", self.diffuse, mi.ParamFlags.Differentiable)
        cb.put("specular_reflectance", self.specular, mi.ParamFlags.Differentiable)
        cb.put("exponent", self.exponent, mi.ParamFlags.Differentiable)

    def parameters_changed(self, keys: Any) -> None:
        """Set the probability of picking the glossy lobe anew."""
        del keys
        diffuse, specular = mean(self.diffuse), mean(self.specular)
        total = diffuse + specular
        self.glossy_share = mi.Float(specular / total if total > 0 else 0.5)
        dr.make_opaque(self.glossy_share, self.exponent)

    def draw(self, asked: Asked, u: mi.Point2f) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        """Pick a lobe by the first of `u` and draw `wo` from what is left of it."""
        ctx, si, on = asked.ctx, asked.si, asked.on
        bs = dr.zeros(mi.BSDFSample3f)
        share = self._enabled_share(ctx)
        if share is None:
            return bs, mi.UnpolarizedSpectrum(0)
        glossy = u.x < share
        rest = dr.select(glossy, u.x / share, (u.x - share) / (1 - share))
        u = mi.Point2f(rest, u.y)
        mirror = mi.reflect(si.wi)
        bs.wo = dr.select(
            glossy,
            lobe.around(self.exponent, mirror, u),
            mi.warp.square_to_cosine_hemisphere(u),
        )
        kinds = mi.BSDFFlags.DiffuseReflection, mi.BSDFFlags.GlossyReflection
        bsdf_functions.name_component(bs, glossy, *kinds)
        value, pdf = self.eval_pdf(ctx, si, bs.wo, on)
        # lost below the horizon: drawn, with a density, but without weight
        lost = glossy & (mi.Frame3f.cos_theta(bs.wo) <= 0)
        drawn = share * lobe.density(self.exponent, mirror, bs.wo)
        bs.pdf = dr.select(on & lost, drawn, pdf)
        return bs, dr.select(pdf > 0, value / pdf, 0)

    def scattered(self, asked: Asked, wo: mi.Vector3f) -> tuple[mi.Spectrum, mi.Float]:
        """Sum of the enabled lobes, and the density with which one is picked."""
        ctx, si, on = asked.ctx, asked.si, asked.on
        share = self._enabled_share(ctx)
        if share is None:
            return mi.UnpolarizedSpectrum(0), mi.Float(0)
        cosine, glossy = self._densities(si, wo)
        pdf = (1 - share) * cosine + share * glossy
        value = mi.UnpolarizedSpectrum(0)
        if ctx.is_enabled(mi.BSDFFlags.DiffuseReflection, 0):
            value += self.diffuse.eval(si, on) * cosine
        if bsdf_functions.glossy_enabled(ctx, 1):
            glossy *= lobe.throughput(self.form, self.exponent, ctx.mode, si.wi, wo)
            value += self.specular.eval(si, on) * glossy
        return value, pdf

    def _densities(
        self, si: mi.SurfaceInteraction3f, wo: mi.Vector3f
    ) -> tuple[mi.Float, mi.Float]:
        """Densities of the two lobes at `wo`."""
        return (
            mi.Frame3f.cos_theta(wo) * dr.inv_pi,
            lobe.density(self.exponent, mi.reflect(si.wi), wo),
        )

    def _enabled_share(self, ctx: mi.BSDFContext) -> Any:
        """Probability of the glossy lobe among the enabled ones; None without any."""
        diffuse = ctx.is_enabled(mi.BSDFFlags.DiffuseReflection, 0)
        glossy = bsdf_functions.glossy_enabled(ctx, 1)
        if diffuse and glossy:
            return self.glossy_share
        if diffuse or glossy:
            return mi.Float(float(glossy))
        return None

    def to_string(self) -> str:
        """Return a readable description."""
        return (
            f"GlossyMixture[diffuse_reflectance={self.diffuse}, "
            f"specular_reflectance={self.specular}, exponent={self.exponent[0]:g}, "
            f"normalisation={self.form}]"
        )


PLUGIN = GlossyMixture
