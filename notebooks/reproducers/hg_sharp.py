# hg: sharp lobes lose the angles that single precision has no cosine for.
# The part of the samples within 3e-5 of straight on, and that of the law.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
g = 0.999
phase = mi.load_dict({"type": "hg", "g": g})
n, rng = 2**18, np.random.default_rng(0)
ctx, mei = mi.PhaseFunctionContext(None), dr.zeros(mi.MediumInteraction3f, n)
mei.wi = mi.Vector3f(0, 0, 1)
mei.sh_frame = mi.Frame3f(mei.wi)
dr.make_opaque(mei)
u = rng.random((3, n), dtype=np.float32)
wo, weight, pdf = phase.sample(ctx, mei, mi.Float(u[0]), mi.Point2f(u[1:]))
sine2 = np.array(wo.x, float) ** 2 + np.array(wo.y, float) ** 2
a, x = np.mean((sine2 < 1e-9) & (np.array(wo.z) < 0)), 0.5e-9
b = (1 - g**2) / (2 * g) * (1 / (1 - g) - ((1 - g) ** 2 + 2 * g * x) ** -0.5)
error = np.sqrt(b * (1 - b) / n)
print(f"{a:.6g} and {b:.6g}: {abs(a - b) / error:.3g} standard errors")
