# blendbsdf of one-sided BSDFs: a weight is NaN from behind where random numbers are 0.
# The number of such weights, and the number that there should be.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
a = {"type": "diffuse"}
b = {"type": "roughconductor", "alpha": 0.2}
bsdf = mi.load_dict({"type": "blendbsdf", "weight": 0.3, "a": a, "b": b})
ctx, n = mi.BSDFContext(), 2**16
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0.4794255, 0, -0.8775826), mi.Frame3f([0, 0, 1])
dr.make_opaque(si)  # a literal would be another kernel
u = np.random.default_rng(0).random((3, n), dtype=np.float32)
u[:2], u[2] = 0, 0.5
bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]))
a, b = np.count_nonzero(np.isnan(np.array(weight))), 0
print(f"{a} and {b}, which must be equal: {a == b}")
