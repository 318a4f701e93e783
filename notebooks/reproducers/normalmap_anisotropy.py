# normalmap: `eval` changes as both directions turn, and no flag says Anisotropic.
# `eval` before and after such a turn.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
bitmap = mi.Bitmap(np.tile(np.array([0.55, 0.5, 0.99], np.float32), (2, 2, 1)))
texture = {"type": "bitmap", "bitmap": bitmap, "raw": True}
nested = {"type": "diffuse"}
bsdf = mi.load_dict({"type": "normalmap", "normalmap": texture, "nested": nested})
assert not mi.has_flag(bsdf.flags(), mi.BSDFFlags.Anisotropic)
turn, values = mi.Matrix3f([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]]), []
wi, wo = mi.Vector3f(0.48, 0, 0.8772685), mi.Vector3f(-0.36, 0.48, 0.8)
for directions in ((wi, wo), (turn @ wi, turn @ wo)):
    si = dr.zeros(mi.SurfaceInteraction3f, 1)
    si.wi, si.n, si.sh_frame = directions[0], [0, 0, 1], mi.Frame3f([0, 0, 1])
    si.uv, si.dp_du, si.dp_dv = mi.Point2f(0.5), [2, 0, 0], [0, 2, 0]
    dr.make_opaque(si)
    values += [bsdf.eval(mi.BSDFContext(), si, directions[1])[0][0]]
a, b = values
off = abs(a - b) / max(abs(a), abs(b))
print(f"{a:.6g} and {b:.6g}: {off / 6.1e-05:.3g} roundings")
