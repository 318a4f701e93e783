# hair: late orders are drawn across the fibre only, though `pdf` spreads them.
# The number of samples with wo.y = 0 exactly, and that of a density.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
bsdf = mi.load_dict({"type": "hair", "sigma_a": 0.0})
ctx, n = mi.BSDFContext(), 2**16
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0.9396926, 0, 0.3420201), mi.Frame3f([0, 0, 1])
dr.make_opaque(si)  # a literal would be another kernel
rng = np.random.default_rng(0)
u = rng.random((3, n), dtype=np.float32)
bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]))
a, b = np.count_nonzero(np.array(bs.wo.y) == 0), 0
print(f"{a} and {b}, which must be equal: {a == b}")
