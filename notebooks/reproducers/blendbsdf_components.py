# blendbsdf: samples of both nested BSDFs name component 0.
# The types that are sampled as component 0, and those that its flags declare.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
a = {"type": "diffuse"}
b = {"type": "roughconductor", "alpha": 0.2}
bsdf = mi.load_dict({"type": "blendbsdf", "weight": 0.3, "a": a, "b": b})
ctx, n = mi.BSDFContext(), 2**16
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0.48, 0, 0.8772685), mi.Frame3f([0, 0, 1])
dr.make_opaque(si)  # a literal would be another kernel
rng = np.random.default_rng(0)
u = rng.random((3, n), dtype=np.float32)
bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]))
first = (np.array(bs.sampled_component) == 0) & (np.array(weight)[0] > 0)
a = int(np.bitwise_or.reduce(np.array(bs.sampled_type)[first]))
b = a & int(bsdf.flags(0))
print(f"{a} and {b}, which must be equal: {a == b}")
