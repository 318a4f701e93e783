# hair: `eval` in radiance mode is not that of importance mode, wi and wo exchanged.
# Both, over the cosine of wo.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
bsdf = mi.load_dict({"type": "hair", "sigma_a": 0.0})
one, other = mi.Vector3f(0.479, 0, 0.878), mi.Vector3f(0.890, 0.275, -0.362)
values = []
for mode, wi, wo in (("Radiance", one, other), ("Importance", other, one)):
    si = dr.zeros(mi.SurfaceInteraction3f, 1)
    si.wi, si.sh_frame = wi, mi.Frame3f([0, 0, 1])
    dr.make_opaque(si, wo)
    ctx = mi.BSDFContext(getattr(mi.TransportMode, mode))
    values += [float(np.ravel(bsdf.eval(ctx, si, wo))[0] / np.abs(wo.z)[0])]
a, b = values
off = abs(a - b) / max(abs(a), abs(b))
print(f"{a:.6g} and {b:.6g}: {off / 6.1e-05:.3g} roundings")
