# retarder: at normal incidence its matrix depends on the transport mode.
# Element 12 in importance mode, and for the same light in radiance mode.
import drjit as dr
import mitsuba as mi

mi.set_variant("llvm_ad_mono_polarized")
bsdf = mi.load_dict({"type": "retarder", "delta": 90.0, "theta": 20.0})
values = []
for mode, z in (("Importance", 1.0), ("Radiance", -1.0)):
    si = dr.zeros(mi.SurfaceInteraction3f, 1)
    si.wi, si.sh_frame = mi.Vector3f(0, 0, z), mi.Frame3f([0, 0, 1])
    dr.make_opaque(si)
    ctx = mi.BSDFContext(getattr(mi.TransportMode, mode))
    values += [bsdf.sample(ctx, si, mi.Float(0.5), mi.Point2f(0.3, 0.4))[1][1, 2][0][0]]
a, b = values
off = abs(a - b) / max(abs(a), abs(b))
print(f"{a:.6g} and {b:.6g}: {off / 6.1e-05:.3g} roundings")
