# pplastic: `sample` names a component that is not declared.
# The last component that is sampled, and the last that is declared.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
bsdf = mi.load_dict({"type": "pplastic", "alpha": 0.3})
ctx, n = mi.BSDFContext(), 2**16
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0.48, 0, 0.8772685), mi.Frame3f([0, 0, 1])
dr.make_opaque(si)  # a literal would be another kernel
rng = np.random.default_rng(0)
u = rng.random((3, n), dtype=np.float32)
bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]))
given = np.array(weight)[0] > 0
a = int(np.max(np.array(bs.sampled_component)[given]))
b = bsdf.component_count() - 1
print(f"{a} and {b}, which must be equal: {a == b}")
