# blendbsdf of a diffuse BSDF and a mirror: a discrete lobe has the wrong probability.
# The part of the samples that are mirrored, and the pdf that `sample` gives them.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
a = {"type": "blendbsdf", "weight": 0.25, "diffuse": {"type": "diffuse"}}
bsdf = mi.load_dict(a | {"mirror": {"type": "conductor"}})
ctx, n = mi.BSDFContext(), 2**16
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0.48, 0, 0.8772685), mi.Frame3f([0, 0, 1])
dr.make_opaque(si)  # a literal would be another kernel
rng = np.random.default_rng(0)
u = rng.random((3, n), dtype=np.float32)
bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]))
mirrored = np.array(mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaReflection))
a, b = np.mean(mirrored), np.mean(np.array(bs.pdf)[mirrored])
error = np.sqrt(a * (1 - a) / n)
print(f"{a:.6g} and {b:.6g}: {abs(a - b) / error:.3g} standard errors")
