# roughconductor with sample_visible=false: small angles are drawn as 0.
# At normal incidence: the part of the samples with a half vector of tan^2 below 1e-9,
# and that of Beckmann's distribution.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
bsdf = mi.load_dict({"type": "roughconductor", "alpha": 0.002, "sample_visible": False})
ctx, n = mi.BSDFContext(), 2**20
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0, 0, 1), mi.Frame3f([0, 0, 1])
dr.make_opaque(si)  # a literal would be another kernel
rng = np.random.default_rng(0)
u = rng.random((3, n), dtype=np.float32)
bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]))
sine = np.hypot(*np.array(bs.wo)[:2].astype(float))
tangent = sine / (1 + np.sqrt(1 - sine**2))
a, b = np.mean(tangent**2 < 1e-9), -np.expm1(-1e-9 / 0.002**2)
error = np.sqrt(b * (1 - b) / n)
print(f"{a:.6g} and {b:.6g}: {abs(a - b) / error:.3g} standard errors")
