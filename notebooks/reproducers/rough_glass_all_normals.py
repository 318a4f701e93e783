# roughdielectric with sample_visible=false: weight times pdf is not `eval`.
# At 60 degrees: both, of the median sample.
import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
a = {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.3}
bsdf = mi.load_dict(a | {"sample_visible": False})
ctx, n = mi.BSDFContext(mi.TransportMode.Importance), 2**16
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0.8660254, 0, 0.5), mi.Frame3f([0, 0, 1])
dr.make_opaque(si)  # a literal would be another kernel
rng = np.random.default_rng(0)
u = rng.random((3, n), dtype=np.float32)
bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]))
value = np.array(bsdf.eval(ctx, si, bs.wo))[0]
product = np.array(weight)[0] * np.array(bs.pdf)
k = np.argsort(np.abs(product / np.maximum(value, 1e-30) - 1))[n // 2]
a, b = product[k], value[k]
off = abs(a - b) / max(abs(a), abs(b))
print(f"{a:.6g} and {b:.6g}: {off / 6.1e-05:.3g} roundings")
