# twosided: from behind, its Mueller matrix is in frames of the front.
# The part of s-polarised light that black glass mirrors, from either side.
import drjit as dr
import mitsuba as mi

mi.set_variant("llvm_ad_mono_polarized")
glass = {"type": "conductor", "eta": 1.5, "k": 0.0}
bsdf = mi.load_dict({"type": "twosided", "nested": glass})
ctx = mi.BSDFContext(mi.TransportMode.Importance)  # light arrives along -wi
values = []
for z in (0.6, -0.6):
    si = dr.zeros(mi.SurfaceInteraction3f, 1)
    si.wi, si.sh_frame = mi.Vector3f(0.64, 0.48, z), mi.Frame3f([0, 0, 1])
    dr.make_opaque(si)
    matrix = bsdf.sample(ctx, si, mi.Float(0.5), mi.Point2f(0.3, 0.4))[1]
    s = mi.Vector3f(0.6, -0.8, 0)  # perpendicular to the plane of incidence
    turn = mi.mueller.rotate_stokes_basis(-si.wi, s, mi.mueller.stokes_basis(-si.wi))
    values += [(matrix @ turn @ mi.Vector4f(1, 1, 0, 0)).x[0][0]]
a, b = values
off = abs(a - b) / max(abs(a), abs(b))
print(f"{a:.6g} and {b:.6g}: {off / 6.1e-05:.3g} roundings")
