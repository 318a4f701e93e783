# roughconductor of Beckmann's distribution: `pdf` is not the density of `sample`.
# At 80 degrees: the part of the samples that have a direction, and the integral.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
bsdf = mi.load_dict({"type": "roughconductor", "alpha": 0.3})
ctx, n = mi.BSDFContext(), 2**20
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0.9848078, 0, 0.1736482), mi.Frame3f([0, 0, 1])
dr.make_opaque(si)  # a literal would be another kernel
rng = np.random.default_rng(0)
u = rng.random((3, n), dtype=np.float32)
bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]))
flux = []
for points in (np.arange(n) * [[1 / n], [0.618034]] + rng.random((16, 2, 1))) % 1:
    wo = mi.warp.square_to_uniform_sphere(mi.Point2f(points))
    flux += [4 * np.pi * np.mean(bsdf.pdf(ctx, si, wo), dtype=float)]
a, b = np.mean(np.array(weight) > 0), np.mean(flux)
error = np.hypot(np.sqrt(a * (1 - a) / n), np.std(flux) / 4)
print(f"{a:.6g} and {b:.6g}: {abs(a - b) / error:.3g} standard errors")
