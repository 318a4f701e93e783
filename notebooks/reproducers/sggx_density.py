# sggx: off its axes, `sample` draws another density than `pdf` (mitsuba3 issue 1728).
# The mean of wo.x of samples, and that of the density.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
values = np.array([0.05, 1, 0.3, 0.1, 0, 0], np.float32)
grid = mi.VolumeGrid(values.reshape(1, 1, 1, 6))
volume = {"type": "gridvolume", "grid": grid, "filter_type": "nearest"}
phase = mi.load_dict({"type": "sggx", "S": volume})
n, rng = 2**18, np.random.default_rng(0)
ctx, mei = mi.PhaseFunctionContext(None), dr.zeros(mi.MediumInteraction3f, n)
mei.wi = mi.Vector3f(0.48, 0.36, 0.8)
mei.sh_frame = mi.Frame3f(mei.wi)
dr.make_opaque(mei)
u = rng.random((3, n), dtype=np.float32)
wo, weight, pdf = phase.sample(ctx, mei, mi.Float(u[0]), mi.Point2f(u[1:]))
a, error = np.mean(wo.x, dtype=float), np.std(wo.x) / n**0.5
even = mi.warp.square_to_uniform_sphere(mi.Point2f(u[1:]))
term = 4 * np.pi * np.array(phase.eval_pdf(ctx, mei, even)[1] * even.x)
b, error = np.mean(term, dtype=float), np.hypot(error, np.std(term) / n**0.5)
print(f"{a:.6g} and {b:.6g}: {abs(a - b) / error:.3g} standard errors")
