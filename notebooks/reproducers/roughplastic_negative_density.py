# roughplastic: `pdf` of the diffuse component is negative below the horizon.
# The density there, and the least that it may be.
import drjit as dr
import mitsuba as mi

mi.set_variant("llvm_ad_mono")
bsdf = mi.load_dict({"type": "roughplastic", "alpha": 0.3, "distribution": "ggx"})
ctx, n = mi.BSDFContext(), 1
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0.48, 0, 0.8772685), mi.Frame3f([0, 0, 1])
dr.make_opaque(si)  # a literal would be another kernel
ctx.component = 1
a, b = bsdf.pdf(ctx, si, mi.Vector3f(0.6, 0, -0.8))[0], 0
print(f"{a} and {b}, which must be equal: {a == b}")
