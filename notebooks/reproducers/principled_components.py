# principled: `eval` ignores ctx.component.
# The whole, and the sum of its components.
import drjit as dr
import mitsuba as mi

mi.set_variant("llvm_ad_mono")
bsdf = mi.load_dict({"type": "principled"})
ctx, n = mi.BSDFContext(), 1
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(0.48, 0, 0.8772685), mi.Frame3f([0, 0, 1])
dr.make_opaque(si)  # a literal would be another kernel
values = []
for component in (0xFFFFFFFF, *range(bsdf.component_count())):
    ctx.component = component
    values += [bsdf.eval(ctx, si, mi.Vector3f(0, 0.6, 0.8))[0][0]]
a, b = values[0], sum(values[1:])
off = abs(a - b) / max(abs(a), abs(b))
print(f"{a:.6g} and {b:.6g}: {off / 6.1e-05:.3g} roundings")
