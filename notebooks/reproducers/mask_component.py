# mask: component 0 passes light straight on, of which `pdf` knows nothing.
# The pdf of `sample`, and that of `pdf` in this direction.
import drjit as dr
import mitsuba as mi

mi.set_variant("llvm_ad_mono")
bsdf = mi.load_dict({"type": "mask", "opacity": 0.4, "nested": {"type": "diffuse"}})
ctx, n = mi.BSDFContext(), 1
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0.48, 0, 0.8772685), mi.Frame3f([0, 0, 1])
dr.make_opaque(si)  # a literal would be another kernel
ctx.component = 0
bs, weight = bsdf.sample(ctx, si, mi.Float(0.5), mi.Point2f(0.3, 0.6))
a, b = bs.pdf[0], bsdf.pdf(ctx, si, bs.wo)[0]
print(f"{a} and {b}, which must be equal: {a == b}")
