# retarder: its matrix jumps over wi.y = 0 (mitsuba3 issue 1963).
# The element that differs most, for two directions 0.1 degrees apart, one a side.
import drjit as dr
import mitsuba as mi

mi.set_variant("llvm_ad_mono_polarized")
bsdf = mi.load_dict({"type": "retarder", "delta": 90.0, "theta": 20.0})
values = []
for y in (1e-3, -1e-3):
    si = dr.zeros(mi.SurfaceInteraction3f, 1)
    si.wi, si.sh_frame = mi.Vector3f(0.6, y, 0.8), mi.Frame3f([0, 0, 1])
    dr.make_opaque(si)
    m = bsdf.sample(mi.BSDFContext(), si, mi.Float(0.5), mi.Point2f(0.3, 0.4))[1]
    values += [[m[i, j][0][0] for i in range(4) for j in range(4)]]
k = max(range(16), key=lambda k: abs(values[0][k] - values[1][k]))
a, b = values[0][k], values[1][k]
off = abs(a - b) / max(abs(a), abs(b))
print(f"{a:.6g} and {b:.6g}: {off / 6.1e-05:.3g} roundings")
