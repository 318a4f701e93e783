"""BSDF `cosinelobe`: an exponentiated cosine around the mirror direction."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from gonio_mi.plugins import bsdf_functions, exponentiated_cosine as lobe
from gonio_mi.plugins.bsdf_functions import Asked, reflectance


class CosineLobe(mi.BSDF):
    r"""Exponentiated-cosine lobe (:monosp:`cosinelobe`).

    .. pluginparameters::

     * - exponent
       - |float|
       - Exponent :math:`n` of the cosine, from 0 to 1e6. (Default: 16)
       - |exposed|, |differentiable|

     * - normalisation
       - |string|
       - ``unit`` or ``modified_phong``, see below. (Default: ``unit``)

     * - reflectance
       - |spectrum| or |texture|
       - Factor :math:`\rho` from 0 to 1. (Default: 1)
       - |exposed|, |differentiable|

    With :math:`\alpha` the angle between the outgoing direction and the mirror
    direction of the incident one, :math:`\theta` the angle to the normal, and both
    directions above the surface, the two forms are

    .. math::

        \mathtt{unit}: \quad f_r \cos\theta_o
        &= \rho\, \frac{n + 1}{2 \pi}\, \cos^n \alpha, \\
        \mathtt{modified\_phong}: \quad f_r
        &= \rho\, \frac{n + 2}{2 \pi}\, \cos^n \alpha,

    and zero for :math:`\alpha \ge 90^\circ`.

    ``unit`` is a distribution of *directions*: light leaves with the density of the
    exponentiated cosine, whatever the angle of incidence. The specular material of
    Krishnaswamy, Baranoski and Rokne (2004, section 5.2, Table 2) is this one with
    :math:`n = 16`. It is not reciprocal: :math:`f_r` has a factor
    :math:`1 / \cos\theta_o`. In radiance mode (paths from a camera) it acts as its
    adjoint, so that paths from either end agree.

    ``modified_phong`` is the reciprocal BRDF of Lafortune and Willems. Its albedo is
    close to :math:`\rho \cos\theta_i`.

    The part of the lobe below the horizon is absorbed. With the regularised incomplete
    beta function :math:`I`, ``unit`` reflects

    .. math::

        R(\theta_i) = \rho\, (1 - L_n), \qquad L_n(\theta_i)
        = \tfrac12 I_{\sin^2\theta_i}\!\left(\tfrac{n + 1}{2}, \tfrac12\right),

    and ``modified_phong``

    .. math::

        R(\theta_i) = \rho\, (1 - L_{n + 1}) \cos\theta_i + \rho\, \frac{n + 2}{n + 1}\,
        \frac{\Gamma(\frac{n + 3}{2})}{2 \sqrt\pi\, \Gamma(\frac{n + 4}{2})}\,
        \sin^{n + 2}\theta_i .

    In numbers, for :math:`\rho = 1`:

    =================== ====== ====== ====== ====== ====== ====== ======
    form, exponent      0°     30°    45°    60°    75°    85°    90°
    =================== ====== ====== ====== ====== ====== ====== ======
    unit, 1             1.0000 0.9330 0.8536 0.7500 0.6294 0.5436 0.5000
    unit, 16            1.0000 1.0000 0.9996 0.9854 0.8577 0.6386 0.5000
    unit, 100           1.0000 1.0000 1.0000 1.0000 0.9959 0.8093 0.5000
    modified_phong, 1   1.0000 0.8808 0.7554 0.6090 0.4584 0.3631 0.3183
    modified_phong, 16  1.0000 0.8660 0.7071 0.5012 0.2764 0.1477 0.0982
    modified_phong, 100 1.0000 0.8660 0.7071 0.5000 0.2589 0.0976 0.0398
    =================== ====== ====== ====== ====== ====== ====== ======

    :math:`n = 0` spreads light evenly over the hemisphere about the mirror direction,
    of which ``unit`` loses :math:`\theta_i / \pi`. At normal incidence ``unit`` with
    :math:`n = 1` and ``modified_phong`` with :math:`n = 0` are Lambertian.

    Only the front side reflects; :monosp:`twosided` makes both do.

    Source: E. P. Lafortune and Y. D. Willems, *Using the modified Phong reflectance
    model for physically based rendering*, report CW 197, K.U. Leuven, 1994.

    .. tabs::
        .. code-tab:: xml

            <bsdf type="cosinelobe">
                <float name="exponent" value="16.0"/>
                <string name="normalisation" value="unit"/>
            </bsdf>

        .. code-tab:: python

            'type': 'cosinelobe',
            'exponent': 16.0,
            'normalisation': 'unit'
    """

    sample, eval_pdf = bsdf_functions.sample, bsdf_functions.eval_pdf
    eval, pdf = bsdf_functions.evaluate, bsdf_functions.density

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.exponent = lobe.exponent(props, "exponent", 16.0)
        self.form = lobe.form(props)
        self.reflectance = reflectance(props, "reflectance", 1.0)
        self.m_flags = lobe.flags(self.form)
        self.m_components = [self.m_flags]

    def traverse(self, cb: mi.TraversalCallback) -> None:
        """Expose exponent and reflectance."""
        cb.put("exponent", self.exponent, mi.ParamFlags.Differentiable)
        cb.put("reflectance", self.reflectance, mi.ParamFlags.Differentiable)

    def draw(self, asked: Asked, u: mi.Point2f) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        """Draw from the whole lobe; what falls below the horizon has no weight."""
        ctx, si, on = asked.ctx, asked.si, asked.on
        if not bsdf_functions.glossy_enabled(ctx):
            return dr.zeros(mi.BSDFSample3f), mi.UnpolarizedSpectrum(0)
        mirror = mi.reflect(si.wi)
        wo = lobe.around(self.exponent, mirror, u)
        pdf = dr.select(on, lobe.density(self.exponent, mirror, wo), 0)
        above = on & (mi.Frame3f.cos_theta(wo) > 0)
        weight = lobe.throughput(self.form, self.exponent, ctx.mode, si.wi, wo)
        weight = (self.reflectance.eval(si, above) * weight) & above
        return bsdf_functions.glossy_sample(wo, pdf), weight

    def scattered(self, asked: Asked, wo: mi.Vector3f) -> tuple[mi.Spectrum, mi.Float]:
        """Lobe and its density."""
        ctx, si, on = asked.ctx, asked.si, asked.on
        if not bsdf_functions.glossy_enabled(ctx):
            return mi.UnpolarizedSpectrum(0), mi.Float(0)
        pdf = lobe.density(self.exponent, mi.reflect(si.wi), wo)
        weight = lobe.throughput(self.form, self.exponent, ctx.mode, si.wi, wo)
        return self.reflectance.eval(si, on) * (weight * pdf), pdf

    def to_string(self) -> str:
        """Return a readable description."""
        return (
            f"CosineLobe[exponent={self.exponent[0]:g}, normalisation={self.form}, "
            f"reflectance={self.reflectance}]"
        )


PLUGIN = CosineLobe
