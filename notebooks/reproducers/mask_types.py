# mask: `sample` ignores ctx.type_mask.
# The weight of light that passes where diffuse reflection is asked for, and 0.
import drjit as dr
import mitsuba as mi

mi.set_variant("llvm_ad_mono")
bsdf = mi.load_dict({"type": "mask", "opacity": 0.4, "nested": {"type": "diffuse"}})
ctx, n = mi.BSDFContext(), 1
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0.48, 0, 0.8772685), mi.Frame3f([0, 0, 1])
dr.make_opaque(si)  # a literal would be another kernel
ctx.type_mask = int(mi.BSDFFlags.DiffuseReflection)
bs, weight = bsdf.sample(ctx, si, mi.Float(0.9), mi.Point2f(0.3, 0.6))
a, b = weight[0][0], 0
print(f"{a} and {b}, which must be equal: {a == b}")
