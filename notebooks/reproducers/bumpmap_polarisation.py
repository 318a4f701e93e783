# bumpmap: the Mueller matrix is in frames of the nested BSDF.
# The part of s-polarised light that black glass mirrors: Fresnel's, and on a slope.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono_polarized")
y, x = np.mgrid[:8, :8, :1][:2].reshape(2, 8, 8, 1) / 8  # of the texture, in uv
heights = {"type": "bitmap", "bitmap": mi.Bitmap(np.float32(0.3 * x + 0.2 * y))}
glass = {"type": "conductor", "eta": 1.5, "k": 0.0}
bsdf = mi.load_dict(
    {"type": "bumpmap", "map": heights | {"raw": True}, "nested": glass}
)
ctx = mi.BSDFContext(mi.TransportMode.Importance)  # light arrives along -wi
si = dr.zeros(mi.SurfaceInteraction3f, 1)
si.wi, si.sh_frame = mi.Vector3f(-0.48, 0.64, 0.6), mi.Frame3f([0, 0, 1])
si.uv, si.dp_du, si.dp_dv = mi.Point2f(0.5), mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
dr.make_opaque(si)
bs, matrix = bsdf.sample(ctx, si, mi.Float(0.5), mi.Point2f(0.3, 0.4))
normal = dr.normalize(si.wi + bs.wo)  # as a mirror has it
s = dr.normalize(dr.cross(si.wi, normal))  # perpendicular to the plane of incidence
turn = mi.mueller.rotate_stokes_basis(-si.wi, s, mi.mueller.stokes_basis(-si.wi))
a = dr.squared_norm(mi.fresnel_polarized(dr.dot(si.wi, normal), 1.5)[0])[0]
b = (matrix @ turn @ mi.Vector4f(1, 1, 0, 0)).x[0][0]
print(f"{a:.6g} and {b:.6g}: {abs(a - b) / max(a, b) / 6.1e-05:.3g} roundings")
