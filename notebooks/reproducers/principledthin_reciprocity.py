# principledthin: transmission is not reciprocal.
# `eval` over the cosine, one way and the other.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
a = {"type": "principledthin", "spec_trans": 0.5, "diff_trans": 1.0}
bsdf = mi.load_dict(a | {"roughness": 0.4})
one, other = mi.Vector3f(0.479, 0, 0.878), mi.Vector3f(0.932, 0, -0.362)
values = []
for wi, wo in ((one, other), (other, one)):
    si = dr.zeros(mi.SurfaceInteraction3f, 1)
    si.wi, si.sh_frame = wi, mi.Frame3f([0, 0, 1])
    dr.make_opaque(si, wo)
    value = bsdf.eval(mi.BSDFContext(), si, wo)
    values += [float(np.ravel(value)[0] / np.abs(wo.z)[0])]
a, b = values
off = abs(a - b) / max(abs(a), abs(b))
print(f"{a:.6g} and {b:.6g}: {off / 6.1e-05:.3g} roundings")
