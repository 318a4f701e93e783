# roughplastic: `pdf` is not 0 below the horizon.
# The integral of `pdf`, and the most that it may be.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
bsdf = mi.load_dict({"type": "roughplastic", "alpha": 0.3, "distribution": "ggx"})
ctx, n = mi.BSDFContext(), 2**20
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0.48, 0, 0.8772685), mi.Frame3f([0, 0, 1])
dr.make_opaque(si)  # a literal would be another kernel
rng = np.random.default_rng(0)
flux = []
for points in (np.arange(n) * [[1 / n], [0.618034]] + rng.random((16, 2, 1))) % 1:
    wo = mi.warp.square_to_uniform_sphere(mi.Point2f(points))
    flux += [4 * np.pi * np.mean(bsdf.pdf(ctx, si, wo), dtype=float)]
a, b, error = np.mean(flux), 1, np.std(flux) / 4
print(f"{a:.6g} and {b:.6g}: {abs(a - b) / error:.3g} standard errors")
