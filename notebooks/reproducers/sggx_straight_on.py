# sggx: `eval_pdf` is NaN for light that flies straight on.
# The number of such values, and the number that there should be.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
values = np.array([1, 1, 1, 0, 0, 0], np.float32)
grid = mi.VolumeGrid(values.reshape(1, 1, 1, 6))
volume = {"type": "gridvolume", "grid": grid, "filter_type": "nearest"}
phase = mi.load_dict({"type": "sggx", "S": volume})
ctx, mei = mi.PhaseFunctionContext(None), dr.zeros(mi.MediumInteraction3f, 1)
mei.wi = mi.Vector3f(1, 0, 0)
mei.sh_frame = mi.Frame3f(mei.wi)
dr.make_opaque(mei)
a, b = np.sum(np.isnan(phase.eval_pdf(ctx, mei, -mei.wi)[1])), 0
print(f"{a} and {b}, which must be equal: {a == b}")
