# roughplastic: gradients by `alpha` know nothing of the tables that it changes.
# Central differences of `eval` far from the mirror direction, and the gradient.
import drjit as dr
import mitsuba as mi

mi.set_variant("llvm_ad_mono")
bsdf = mi.load_dict({"type": "roughplastic", "alpha": 0.3, "distribution": "ggx"})
ctx, n = mi.BSDFContext(), 1
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0.48, 0, 0.8772685), mi.Frame3f([0, 0, 1])
dr.make_opaque(si)  # a literal would be another kernel
wo, params = mi.Vector3f(0.6, 0, 0.8), mi.traverse(bsdf)
alpha = mi.Float(params["alpha"])


def value(change):
    params["alpha"] = alpha + change
    params.update()
    return bsdf.eval(ctx, si, wo)[0]


a = (value(3e-3) - value(-3e-3))[0] / 6e-3
dr.enable_grad(alpha)
answer = value(0)
dr.forward(alpha)
b = dr.grad(answer)[0]
off = abs(a - b) / max(abs(a), abs(b))
print(f"{a:.6g} and {b:.6g}: {off / 6.1e-05:.3g} roundings")
