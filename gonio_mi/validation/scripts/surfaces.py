"""Parts of the scripts that show what is wrong with a BSDF.

Each part begins with its name; after a colon stand the parts that follow it. A finding
takes the head and the part of its kind, with the definitions that this uses, and fills
in the words in capitals.
"""

# %% title
# TITLE (CONDITION)
# Two numbers that should be equal where QUESTION.
# A rounding is ROUNDING: 1024 operations in single precision.
# %% imports
import drjit as dr
import mitsuba as mi
import numpy as np

# %% words
ABOUT = ANSWER = AXES = COMPONENT = CORNERS = COUNT = DENSITY = DRAWN = EITHER = None
EXCLUDED = EXPECTED = FLUX = INDEX = NM = NORMAL = NUMBERS = OTHER = POSITION = None
QUANTITY = ROUNDING = SOURCE = SPECTRUM = STALE = TURNED = UV = VARIANT = None
VARIANTS = WI = None
values = []

# %% variant
mi.set_variant(VARIANT)
# %% interaction
bsdf = SOURCE
ctx, n = mi.BSDFContext(mi.TransportMode.MODE), COUNT
si = dr.zeros(mi.SurfaceInteraction3f, n)
si.wi, si.sh_frame = mi.Vector3f(np.tile(np.vstack(WI), n)), mi.Frame3f(AXES)
# %% component
ctx.component = COMPONENT
# %% texture
si.uv, si.dp_du, si.dp_dv = mi.Point2f(UV), 2 * si.sh_frame.s, 2 * si.sh_frame.t
# %% position
si.p = mi.Point3f(POSITION)
# %% field
si.FIELD = type(si.FIELD)(NUMBERS)
# %% differentials
si.duv_dx, si.duv_dy = mi.Vector2f(0.3, 0.1), mi.Vector2f(-0.1, 0.2)
# %% wavelengths
si.wavelengths = mi.UnpolarizedSpectrum(NM)
# %% random
u = (rng := np.random.default_rng(0)).random((3, n), dtype=np.float32)
# %% sample
bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]), True)


# %% define answer of sample
def answer(_, on=True):
    return np.atleast_2d(bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]), on)[1])


# %% define answer of eval
answer = lambda wo, on=True: np.atleast_2d(bsdf.eval(ctx, si, wo, on))
# %% define answer of pdf
answer = lambda wo, on=True: np.atleast_2d(bsdf.pdf(ctx, si, wo, on))
# %% define answer of eval_pdf
answer = lambda wo, on=True: np.atleast_2d(bsdf.eval_pdf(ctx, si, wo, on)[0])

# %% define value
value = lambda wo, at=si: np.atleast_2d(bsdf.eval(ctx, at, wo, True))
# %% define pdf
pdf = lambda wo: np.atleast_2d(bsdf.pdf(ctx, si, wo, True))
# %% define light
light = lambda: np.atleast_2d(weight).mean(axis=0)
# %% define lit
lit = lambda: dr.any(weight != 0)
# %% define smooth
smooth = lambda: dr.any(weight != 0) & ~mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
# %% define sphere
sphere = mi.warp.square_to_uniform_sphere(mi.Point2f(u[1:]))
# %% define awake
awake = mi.Bool(np.arange(n) % 2 == 0)
# %% define moments
moments = lambda wo: np.stack([x + np.zeros(n) for x in (1, *np.array(wo))])
# %% define back
back, back.wi = mi.SurfaceInteraction3f(si), bs.wo
# %% define eta
eta = np.where(bs.wo.z * si.wi.z < 0, bs.eta, 1)
# %% define other
other = bsdf.eval_pdf_sample(ctx, si, bs.wo, mi.Float(u[0]), mi.Point2f(u[1:]))
# %% define alike
discrete = np.array(mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta) & (bs.pdf > 0))
first = np.argmax(np.broadcast_to(discrete, n))
wos, pdfs = (np.array(one) + np.zeros(n) for one in (bs.wo, bs.pdf))
alike = discrete & np.all(np.abs(wos - wos[:, first, None]) < 1e-3, axis=0)
# %% define changed
params = mi.traverse(bsdf)
params["ABOUT"] = OTHER
params.update()
bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]), True)
changed = smooth()


# %% define in_plane
# a Mueller matrix over its first element, in frames of k x normal of both beams k
def in_plane(wi, wo):  # light arrives along -wi
    si.wi, own = wi, mi.mueller.stokes_basis
    s, t = (dr.normalize(dr.cross(k, mi.Vector3f(NORMAL))) for k in (-wi, wo))
    m = mi.mueller.rotate_mueller_basis(ANSWER, -wi, own(-wi), s, wo, own(wo), t)
    return (m := np.array(m)) / np.fmax(m[0, 0], 1e-30)


# %% ANSWERS: improper
x = np.concatenate([np.ravel(QUANTITY) for wo in (bs.wo, sphere)])
# %% RAISES
print(answer(bs.wo), mi.traverse(bsdf))
# %% OTHER_WHEN_CALLED_AGAIN: by_sample
a, counts = answer(bs.wo), smooth()
others, _ = bsdf.sample(ctx, si, mi.Float(u[1]), mi.Point2f(u[:2]), True)
value(others.wo)
b = answer(bs.wo)
# %% OTHER_IN_ANOTHER_PLACE: by_sample
si.wi = dr.mulsign(mi.warp.square_to_cosine_hemisphere(mi.Point2f(u[1:])), si.wi.z)
a, i, counts = answer(bs.wo), n - 1 - dr.arange(mi.UInt32, n), smooth()
u, si.wi, bs.wo = u[:, ::-1], *(dr.gather(mi.Vector3f, x, i) for x in (si.wi, bs.wo))
b = answer(bs.wo)[..., ::-1]
# %% OTHER_IN_ANOTHER_NUMBER: by_sample
i = np.arange(ABOUT) % 1024  # in a call of so many
last = i[-1024:]
a, counts = answer(bs.wo)[..., last], np.array(smooth())[last]
u, (si, bs.wo) = u[:, i], (dr.gather(type(x), x, mi.UInt32(i)) for x in (si, bs.wo))
b, u, n = answer(bs.wo)[..., -1024:], u[:, -1024:], len(last)
# %% OTHER_IN_THE_WORLD: by_sample
a, counts = np.atleast_2d(TURNED), smooth()
si.sh_frame = mi.Frame3f([0, 0, 1])
b = np.atleast_2d(TURNED)
# %% ALBEDO: by_sample
a = np.atleast_2d(bsdf.eval_diffuse_reflectance(si, True))
b, counts = np.pi * value(bs.wo) / np.abs(bs.wo.z), smooth() & (dr.abs(bs.wo.z) > 1e-3)
# %% DIRECTIONS: same
through = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Transmission) & lit()
a, b = np.sum(through), np.sum((bs.wo.z * si.wi.z < 0) & lit())
# %% LENGTH: by_sample
a, b, counts = dr.norm(bs.wo), 1, lit()
# %% ETA_OF_REFLECTION: by_sample
a, b, counts = bs.eta, 1, lit() & (bs.wo.z * si.wi.z > 0)
# %% SAMPLING: box apart
drawn, density = DRAWN, lambda wo: DENSITY
# %% WEIGHTS: SAMPLING box apart
# %% moments_apart: apart
drawn, due = DRAWN * np.nan_to_num(moments(bs.wo)), []
for points in (np.arange(n) * [[1 / n], [0.618034]] + rng.random((16, 2, 1))) % 1:
    wo = mi.warp.square_to_uniform_sphere(mi.Point2f(points))
    due += [4 * np.pi * np.mean(DENSITY * moments(wo), axis=1)]
a, b = np.mean(drawn, axis=1), np.mean(due, axis=0)
error = np.hypot(np.std(drawn, axis=1) / n**0.5, np.std(due, axis=0) / 4)
# of the means of 1, wo.x, wo.y and wo.z over all directions, the one that is most off
a, b, error = np.transpose([a, b, error])[np.argmax(np.abs(a - b) / error)]
# %% MASS: whole apart
density, b = pdf, 1
# %% MASS_OF_A_DARK_SIDE: whole apart
density, b = pdf, 0
# %% LIGHT_OF_A_DARK_SIDE: whole apart
density, b = lambda wo: value(wo).max(axis=0), 0
# %% ENERGY: whole apart
density, b = lambda wo: value(wo).max(axis=0), 1
# %% SAMPLED_PDF: by_sample
a, b, counts = bs.pdf, pdf(bs.wo), smooth()
# %% SAMPLED_WEIGHT: by_sample
a, b, counts = np.atleast_2d(weight) * pdf(bs.wo), value(bs.wo), smooth()
# %% EVAL_PDF: by_sample
a = np.atleast_2d(bsdf.eval_pdf(ctx, si, bs.wo, True)[INDEX])
b, counts = EITHER(bs.wo), smooth()
# %% EVAL_PDF_ANYWHERE: by_sample
a = np.atleast_2d(bsdf.eval_pdf(ctx, si, sphere, True)[INDEX])
b = EITHER(sphere)
counts = a + b > 0
# %% EVAL_PDF_SAMPLE: by_sample
a, b, counts = np.atleast_2d(other[INDEX]), EITHER(bs.wo), smooth()
# %% OTHER_SAMPLES: by_sample
a, b, counts = np.atleast_2d(other[3]), np.atleast_2d(weight), lit()
# %% ETA: by_sample
b = value(bs.wo).mean(0) / np.abs(bs.wo.z)
b /= value(si.wi, back).mean(0) / np.abs(si.wi.z)  # by which light passes each way
through = (dr.abs(bs.wo.z) > 1e-3) & (bs.wo.z * si.wi.z < 0)
a, counts = bs.eta**2, smooth() & through
# %% CONTINUITY: equal
shares = []
for cosine in (0.5, 1e-3):
    ring = mi.Vector3f((1 - cosine**2) ** 0.5, 0, cosine)
    si.wi = ring * dr.sign(si.wi.z) + dr.zeros(mi.Vector3f, n)
    shares += [np.mean(value(sphere) > 0)]
a, b = shares
# %% JUMP_AT_NORMAL: by_sample
a, counts = answer(bs.wo), smooth()
si.wi = si.wi + mi.Vector3f(2**-16, 0, 0)
b = answer(bs.wo)
# %% RECIPROCITY: by_sample
a, counts = value(bs.wo) / np.abs(bs.wo.z), smooth() & (dr.abs(bs.wo.z) > 1e-3)
b = value(si.wi, back) / np.abs(si.wi.z) * eta**2
# %% SYMMETRY: by_sample
a, b, counts = value(bs.wo), value(si.wi, back), smooth()
# %% SYMMETRY_OF_MICROFLAKES: by_sample
a = value(bs.wo) * np.array(bsdf.projected_area(si, True))
b = value(si.wi, back) * np.array(bsdf.projected_area(back, True))
counts = smooth()
# %% RECIPROCITY_OF_A_LOBE: apart
way = dr.zeros(mi.SurfaceInteraction3f, n)
way.wi, way.sh_frame, x = mi.Vector3f(wos[:, first]), si.sh_frame, light() * alike
bs, weight = bsdf.sample(ctx, way, mi.Float(u[0]), mi.Point2f(u[1:]), True)
y = light() * np.all(np.abs(np.array(bs.wo) - np.array(si.wi)) < 1e-3, axis=0)
a, b, error = np.mean(x), np.mean(y), np.std(x - y) / n**0.5
# %% ADJOINT: by_sample
a, counts = value(bs.wo) / np.abs(bs.wo.z), smooth() & (dr.abs(bs.wo.z) > 1e-3)
ctx = mi.BSDFContext(mi.TransportMode.Radiance)
b = value(si.wi, back) / np.abs(si.wi.z)
# %% ADJOINT_OF_A_LOBE: by_sample
a, counts = np.atleast_2d(weight), lit()
ctx = mi.BSDFContext(mi.TransportMode.Radiance)
bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]), True)
b = np.atleast_2d(weight) * eta**2
# %% DELTA: apart
a, b, error = np.mean(alike), pdfs[first], np.std(alike) / n**0.5
# %% NULL_TRANSMISSION: equal
straight = np.array(mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null))
a = np.mean((light() * np.array(bs.pdf))[straight])
b = np.mean(bsdf.eval_null_transmission(si, True))
# %% DIRECTION_OF_A_LOBE: by_sample
# x of its direction, and of the mirror's
a, b, counts = bs.wo.x, mi.reflect(si.wi).x, alike
# %% WEIGHTS_OF_A_LOBE: equal
a, b = np.min(light()[alike]), np.max(light()[alike])
# %% TYPE_OF_A_COMPONENT: same
a = b = 0  # types that are sampled as a component, and of these what it declares
for i in range(bsdf.component_count()):
    own = np.array(lit() & (bs.sampled_component == i))
    sampled = int(np.bitwise_or.reduce(np.array(bs.sampled_type) * own))
    if sampled & ~int(bsdf.flags(i)):
        a, b = sampled, sampled & int(bsdf.flags(i))
# %% DIFFERENTIALS: by_sample
a, counts = answer(bs.wo), smooth()
si.duv_dx, si.duv_dy = mi.Vector2f(0.3, 0.1), mi.Vector2f(-0.1, 0.2)
b = answer(bs.wo)
# %% FLAGS: same
a = int(np.bitwise_or.reduce(np.array(bs.sampled_type) * np.array(lit())))
b = a & int(bsdf.flags())  # what is sampled, and of that is declared
last = int(np.max(np.array(bs.sampled_component) * np.array(lit())))
if a == b and last >= bsdf.component_count():
    a, b = last + 1, bsdf.component_count()
# %% UNDECLARED_SIDE: same
a, b = np.mean(value(bs.wo) > 0), 0
# %% TYPE_MASK: same
a, b = 0, 0  # answers that a mask excludes
for i in range(bsdf.component_count()):
    ctx.type_mask = int(mi.BSDFFlags.All) & ~int(bsdf.flags(i))
    bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]), True)
    a += np.sum(np.array(EXCLUDED) & np.any(answer(bs.wo) != 0, axis=0))
# %% ANISOTROPIC: by_sample
a, counts = answer(bs.wo), smooth()
turn = mi.Matrix3f([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
si.wi, bs.wo = turn @ si.wi, turn @ bs.wo
b = answer(bs.wo)
# %% COMPONENTS: by_sample
a, b, counts = answer(bs.wo), 0, smooth()
for i in range(bsdf.component_count()):
    ctx.component = i
    b = b + answer(bs.wo)
# %% LOBE_OF_A_COMPONENT: equal
own = np.array(lit() & (bs.sampled_component == ABOUT))
a = np.median((light() * np.array(bs.pdf))[own])
ctx.component = ABOUT
bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]), True)
b = np.median(light() * np.array(bs.pdf))
# %% MASKS: same
a, b = np.max(np.abs(answer(bs.wo, awake)) * np.array(~awake)), 0
# %% MASKS_OF_OTHERS: by_sample
a, b, counts = answer(bs.wo, awake), answer(bs.wo), awake
# %% LENGTH_AT_AN_END: ENDS improper
# %% ENDS: improper
ends = np.array([0, 0.5, np.nextafter(np.float32(1), np.float32(0))], np.float32)
u, x = np.array(np.meshgrid(ends, ends, ends)).reshape(3, -1), []
for theta in np.radians([0, 1e-3, 89.99, 90, 90.01, 120, 179.999, 180]):
    wi = np.round([np.sin(theta), 0, np.cos(theta)], 9).tolist()
    si.wi = mi.Vector3f(np.tile(np.vstack(wi), n))
    bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]), True)
    for wo in (bs.wo, si.wi, -si.wi, mi.reflect(si.wi), -mi.reflect(si.wi)):
        x += [np.ravel(np.where(dr.squared_norm(wo) > 0.5, QUANTITY, 0))]
x = np.concatenate(x)
# %% GRADIENT: equal
# by how much the sum of all answers changes with the parameter
params = mi.traverse(bsdf)


def total(x):
    params.update({"ABOUT": x})
    return dr.sum(SPECTRUM, axis=None)


x = type(params["ABOUT"])(params["ABOUT"])
a = np.ravel(total(x + 1e-3) - total(x - 1e-3))[0] / 2e-3
dr.enable_grad(x)
forward = np.sum(dr.forward_to(total(x), flags=dr.ADFlag.AllowNoGrad))
dr.backward(total(x), flags=dr.ADFlag.AllowNoGrad)
b = max([forward, np.sum(dr.grad(x))], key=lambda one: abs(one - a))
# %% UPDATE: by_sample
a, counts, params = answer(bs.wo), smooth(), mi.traverse(bsdf)
for factor in (0.5, 2):  # there and back
    for name in [name for name, x in params if dr.is_array_v(x) and dr.is_float_v(x)]:
        params[name] = factor * params[name]
    params.update()
b = answer(bs.wo)
# %% PARAMETERS: by_sample
a, b, counts = STALE, EXPECTED, changed
# %% DENSITY_AFTER_A_CHANGE: apart
# over directions of the density p, the mean of u / (p + u) is that of p / (p + u)
# over directions of the density u
p, q = (4 * np.pi * pdf(wo)[0] for wo in (bs.wo, sphere))
x, y = np.array(changed) / (1 + p), q / (1 + q)  # of one mean if p is the density
a, b, error = np.mean(x), np.mean(y), np.std(x - y) / n**0.5

# %% matrix ANSWERS: same
m = answer(bs.wo)
a, b = np.count_nonzero(~np.isfinite(m)) + np.count_nonzero(m[0, 0] < 0), 0
# %% matrix FIRST_ELEMENT: by_sample
(a, b), counts = values, lit()  # of both variants
# %% matrix SAMPLED_WEIGHT: elements
a, b = np.array(weight) * np.array(bs.pdf), np.array(bsdf.eval(ctx, si, bs.wo, True))
# %% matrix EVAL_PDF: elements
a = np.array(bsdf.eval_pdf(ctx, si, bs.wo, True)[0])
b = np.array(bsdf.eval(ctx, si, bs.wo, True))
# %% matrix REALISABLE: same
# Cloude's coherency matrix, which is a sum of those of Jones matrices
m = np.nan_to_num(answer(bs.wo)).reshape(4, 4, -1)
m = m / np.fmax(m[0, 0], 1e-30)
pauli = np.array([[1, 0, 0, 1], [1, 0, 0, -1], [0, 1, 1, 0], [0, -1j, 1j, 0]])
pauli = pauli.reshape(4, 2, 2)
coherency = np.einsum("ijk,iab,jcd->kacbd", m, pauli, pauli.conj()) / 4
least = np.linalg.eigvalsh(coherency.reshape(-1, 4, 4))[:, 0]
a, b = np.count_nonzero(least < -5e-4), 0  # no surface has negative ones
# %% matrix ENERGY: apart
# of the polarisation that half of the samples scatter best
rows = np.array(weight)[0].mean(axis=1) + 0 * u[0]  # flux of a Stokes vector
stokes = np.append(1, np.mean(rows[1:, ::2], axis=1))
stokes[1:] /= np.linalg.norm(stokes[1:]) + 1e-30
x = stokes @ rows[:, 1::2]
a, b, error = np.mean(x), 1, np.std(x) / len(x) ** 0.5
# %% matrix FRAMES: elements
turn = mi.Transform4f().rotate(NORMAL, 37)  # both about the normal
a, b = in_plane(si.wi, bs.wo), in_plane(turn @ si.wi, turn @ bs.wo)
# %% matrix JUMP: elements
values = []
for wi, wo in ABOUT:  # two pairs of directions, next to each other
    si.wi, wo = (mi.Vector3f(np.tile(np.vstack(x), n)) for x in (wi, wo))
    m = answer(wo)
    values += [m / np.fmax(m[0, 0], 1e-30)]
a, b = values
# %% matrix WORLD: elements
values = []
for normal in ([0, 0, 1], [0.6, 0, 0.8]):  # of the surface, in the world
    si.sh_frame = mi.Frame3f(normal)
    m = answer(bs.wo)
    values += [m / np.fmax(m[0, 0], 1e-30)]
a, b = values
# %% matrix RECIPROCITY: elements
a, b = in_plane(si.wi, bs.wo), in_plane(bs.wo, mi.Vector3f(si.wi))
b = np.einsum("jick,i,j->ijck", b, [1, 1, -1, 1], [1, 1, -1, 1])  # the way back
# %% matrix ADJOINT: elements
values, there = [], mi.Vector3f(si.wi)
for mode, si.wi, wo in (("Radiance", there, bs.wo), ("Importance", bs.wo, there)):
    ctx = mi.BSDFContext(getattr(mi.TransportMode, mode))
    m = answer(wo)
    values += [m / np.fmax(m[0, 0], 1e-30)]
a, b = values

# %% polarised sample
bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]), True)
weight = mi.unpolarized_spectrum(weight)
# %% polarised define value
value = lambda wo, at=si: np.array(mi.unpolarized_spectrum(bsdf.eval(ctx, at, wo)))
# %% polarised define answer of eval
answer = lambda w, on=True: np.array(mi.unpolarized_spectrum(bsdf.eval(ctx, si, w, on)))

# %% first element
values += [np.atleast_2d(mi.unpolarized_spectrum(FLUX)).mean(axis=0)]

# %% variants interaction
ctx, si, answers = mi.BSDFContext(), dr.zeros(mi.SurfaceInteraction3f), []
si.uv, si.dp_du, si.dp_dv = mi.Point2f(0.35, 0.6), [2, 0, 0], [0, 2, 0]

# %% lattices: apart
# The total and the mean direction of samples, and of what they should follow, by 16
# randomly shifted lattices: far sharper than independent samples, so that 2^16 points
# do. An error of 2^-17 is that of which the limit of 8 is a thousand roundings.
rng, both, steps = np.random.default_rng(0), [], [[1 / n], [0.618034], [0.754878]]
for u in (np.arange(n) * steps + rng.random((16, 3, 1))) % 1 * (1 - 2**-24):
    bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]), True)
    drawn = DRAWN * np.nan_to_num(moments(bs.wo))
    wo = mi.warp.square_to_uniform_sphere(mi.Point2f(u[:2]))
    both += [np.mean([drawn, 4 * np.pi * DENSITY * moments(wo)], axis=2)]
error = np.hypot(np.std(np.diff(both, axis=1)[:, 0], axis=0) / 15**0.5, 2**-17)
a, b, error = max(zip(*np.mean(both, 0), error), key=lambda x: abs(x[0] - x[1]) / x[2])

# %% variants
# Scalar code is asked whether it answers as LLVM's, direction by direction: one number
# in a hundred may be another, as where rounding chooses another lobe.
x, told = np.split(np.random.default_rng(0).random((7, 1000)), [2, 4]), []
for variant, lanes, axis in VARIANTS:
    mi.set_variant(variant)
    bsdf = SOURCE
    ctx, si, answers = mi.BSDFContext(), dr.zeros(mi.SurfaceInteraction3f), []
    si.uv, si.dp_du, si.dp_dv = mi.Point2f(0.35, 0.6), [2, 0, 0], [0, 2, 0]
    value = lambda wo, at=si: np.atleast_2d(bsdf.eval(ctx, at, wo, True))
    pdf = lambda wo: np.atleast_2d(bsdf.pdf(ctx, si, wo, True))
    for *ends, u in lanes:
        si.wi, wo = (mi.warp.square_to_uniform_sphere(mi.Point2f(z)) for z in ends)
        si.sh_frame = mi.Frame3f(AXES)
        bs, weight = bsdf.sample(ctx, si, mi.Float(u[0]), mi.Point2f(u[1:]), True)
        drawn = [dr.select(dr.any(weight != 0), z, 0) for z in (*bs.wo, bs.pdf)]
        sums = [np.sum(np.array(z), axis) for z in (value(wo), weight, pdf(wo))]
        answers += [[np.array(z) + np.zeros(np.size(u[0])) for z in (*sums, *drawn)]]
    told += [np.hstack(answers)]
off = np.abs(np.subtract(*told)) / np.maximum(np.abs(told).max(axis=0), 1e-6)
k = np.unravel_index(np.argsort(off, axis=None)[-off.size // 100], off.shape)
print(f"{told[1][k]:.6g} and {told[0][k]:.6g}: {off[k] / ROUNDING:.3g} roundings")

# %% box
low, high, due = *np.array(CORNERS), []  # of a patch, in the unit square
square = np.array(mi.warp.uniform_sphere_to_square(bs.wo))
x = drawn * np.all((low <= square) & (square < high), axis=0)
for points in (np.arange(n) * [[1 / n], [0.618034]] + rng.random((16, 2, 1))) % 1:
    wo = mi.warp.square_to_uniform_sphere(mi.Point2f(low + (high - low) * points))
    due += [4 * np.pi * np.prod(high - low) * np.mean(density(wo), dtype=float)]
a, b, error = np.mean(x), np.mean(due), np.hypot(np.std(x) / n**0.5, np.std(due) / 4)
# %% whole
due = []
for points in (np.arange(n) * [[1 / n], [0.618034]] + rng.random((16, 2, 1))) % 1:
    wo = mi.warp.square_to_uniform_sphere(mi.Point2f(points))
    due += [4 * np.pi * np.mean(density(wo), dtype=float)]
a, error = np.mean(due), np.std(due) / 4

# %% improper
wrong = x[~(x >= 0) | ~np.isfinite(x)]
print(f"{wrong[:3]}: {wrong.size} and 0, which must be equal: {wrong.size == 0}")
# %% equal
off = abs(a - b) / max(abs(a), abs(b), 1e-30)
print(f"{a:.6g} and {b:.6g}: {off / ROUNDING:.3g} roundings")
# %% same
print(f"{a} and {b}, which must be equal: {a == b}")
# %% apart
print(f"{a:.6g} and {b:.6g}: {abs(a - b) / (error + 1e-7):.3g} standard errors")
# %% by_sample
a, b, counts, _ = np.broadcast_arrays(a, b, counts, u[0])  # one of each sample
off = np.abs(np.where(counts, a - b, 0)) / np.fmax(np.fmax(abs(a), abs(b)), 1e-30)
k = np.unravel_index(np.argsort(off, axis=None)[-n // 1000], off.shape)  # of the worst
print(f"{a[k]:.6g} and {b[k]:.6g}: {off[k] / ROUNDING:.3g} roundings")
# %% elements
# of 16 elements of Mueller matrices, arrays of (4, 4, channels, n)
off = np.nan_to_num(np.abs(a - b) / np.fmax(np.fmax(a[0, 0], b[0, 0]), 1e-30))
at = np.unravel_index(np.argsort(off, axis=None)[-1 - off.size // 10000], off.shape)
a, b, off = (np.broadcast_to(x, off.shape)[at] for x in (a, b, off))
print(f"element {at[0]}{at[1]}: {a:.6g} and {b:.6g}: {off / ROUNDING:.3g} roundings")
