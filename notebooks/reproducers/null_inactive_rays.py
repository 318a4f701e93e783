# null: `sample` ignores `active`.
# The weight of an inactive ray, and what is due.
import drjit as dr
import mitsuba as mi

mi.set_variant("llvm_ad_mono")
bsdf = mi.load_dict({"type": "null"})
ctx, n = mi.BSDFContext(), 1
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0.48, 0, 0.8772685), mi.Frame3f([0, 0, 1])
dr.make_opaque(si)  # a literal would be another kernel
bs, weight = bsdf.sample(ctx, si, mi.Float(0.9), mi.Point2f(0.3, 0.6), False)
a, b = weight[0][0], 0
print(f"{a} and {b}, which must be equal: {a == b}")
