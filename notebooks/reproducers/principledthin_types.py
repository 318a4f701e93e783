# principledthin: `sample` ignores ctx.type_mask.
# The number of samples of diffuse reflection where all else is asked for, and 0.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
bsdf = mi.load_dict({"type": "principledthin"})
ctx, n = mi.BSDFContext(), 2**10
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0.48, 0, 0.8772685), mi.Frame3f([0, 0, 1])
dr.make_opaque(si)  # a literal would be another kernel
diffuse = mi.BSDFFlags.DiffuseReflection
ctx.type_mask = int(mi.BSDFFlags.All) & ~int(diffuse)
u = np.random.default_rng(0).random((3, n), dtype=np.float32)
bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]))
drawn = dr.any(weight > 0) & mi.has_flag(bs.sampled_type, diffuse)
a, b = np.count_nonzero(np.array(drawn)), 0
print(f"{a} and {b}, which must be equal: {a == b}")
