# blendbsdf of two mirrors: weights have no gradient by the share of each.
# Central differences of the mean weight of the mirror lobe, and its gradient.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
a, b = ({"type": "conductor", "specular_reflectance": x} for x in (0.9, 0.4))
bsdf = mi.load_dict({"type": "blendbsdf", "weight": 0.3, "a": a, "b": b})
ctx, n = mi.BSDFContext(mi.TransportMode.Importance), 2**20
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0.48, 0, 0.8772685), mi.Frame3f([0, 0, 1])
u, name = (dr.arange(mi.Float, n) + 0.5) / n, "weight.value"
params = mi.traverse(bsdf)
x = mi.Float(params[name])


def mirrored(change):
    params.update({name: x + change})
    bs, weight = bsdf.sample(ctx, si, u, mi.Point2f(0.3, 0.6))
    own = mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaReflection)
    return dr.select(own, weight[0], 0)


a = np.mean(np.array(mirrored(0.02) - mirrored(-0.02), float)) / 0.04
dr.enable_grad(x)
dr.set_grad(x, 1)
b = np.mean(dr.forward_to(mirrored(0), flags=dr.ADFlag.AllowNoGrad))
print(f"{a:.6g} and {b:.6g}: {abs(a - b) / abs(a) / 6.1e-05:.3g} roundings")
