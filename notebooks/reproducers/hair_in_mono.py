# hair: with its default parameters (pigments) it raises in mono variants.
# The numbers of variants in which `eval` answers, and of those that are asked.
import drjit as dr
import mitsuba as mi

variants = ("llvm_ad_mono", "llvm_ad_rgb", "llvm_ad_spectral")
answers = []
for variant in variants:
    mi.set_variant(variant)
    bsdf = mi.load_dict({"type": "hair"})
    si = dr.zeros(mi.SurfaceInteraction3f, 1)
    si.wi, si.sh_frame = mi.Vector3f(0.48, 0, 0.8772685), mi.Frame3f([0, 0, 1])
    try:
        value = bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(0.36, 0.48, 0.8))
        answers += [dr.mean(value, axis=None)]
    except RuntimeError as error:
        print(f"{variant}: {error}")
a, b = len(answers), len(variants)
print(f"{a} and {b}, which must be equal: {a == b}")
