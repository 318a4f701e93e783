"""Kinds of findings, each with the lines of Mitsuba and NumPy that show one.

A script begins with `ctx`, `si` and samples `bs` and `weight` of them, of numbers `u`;
these lines compare what should be equal. Words in capitals are filled in by
:mod:`.reproducers`.
"""

from __future__ import annotations

from enum import Enum

# Which samples count: lit ones, and those of them that have a density.
LIT = "dr.any(weight != 0)"
SMOOTH = f"{LIT} & ~mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)"

# Last lines: of values `x` of which none should be negative or not finite, of numbers,
# of counts, and of numbers known to an error.
IMPROPER = """\
wrong = x[~(x >= 0) | ~np.isfinite(x)]
print(f"{wrong[:3]}: {wrong.size} and 0, which must be equal: {wrong.size == 0}")"""
EQUAL = """\
off = abs(a - b) / max(abs(a), abs(b), 1e-30)
print(f"{a:.6g} and {b:.6g}: {off / ROUNDING:.3g} roundings")"""
SAME = 'print(f"{a} and {b}, which must be equal: {a == b}")'
SCORED = 'print(f"{a:.6g} and {b:.6g}: {abs(a - b) / error:.3g} standard errors")'

# The same of 16 elements of Mueller matrices, arrays of (4, 4, channels, n).
ELEMENTS = """\
off = np.nan_to_num(np.abs(a - b) / np.fmax(np.fmax(a[0, 0], b[0, 0]), 1e-30))
at = np.unravel_index(np.argsort(off, axis=None)[-1 - off.size // 10000], off.shape)
a, b, off = (np.broadcast_to(x, off.shape)[at] for x in (a, b, off))
print(f"element {at[0]}{at[1]}: {a:.6g} and {b:.6g}: {off / ROUNDING:.3g} roundings")"""


def each(values: str) -> str:
    """Expression of one number per sample, the mean over channels."""
    return f"np.mean(np.atleast_2d({values}), axis=0)"


def channels(values: str) -> str:
    """Expression of numbers of each channel and sample."""
    return f"np.atleast_1d({values})"


def by_sample(a: str, b: str, which: str = SMOOTH) -> str:
    """Lines that compare two numbers of each sample, or of each channel of it."""
    given = [f"{name} = {x}\n" for name, x in (("a", a), ("b", b)) if name != x]
    return f"""\
{"".join(given)}counts = {which}
a, b, counts, _ = np.broadcast_arrays(a, b, counts, u[0])  # one of each sample
off = np.abs(np.where(counts, a - b, 0)) / np.fmax(np.fmax(abs(a), abs(b)), 1e-30)
k = np.unravel_index(np.argsort(off, axis=None)[-n // 1000], off.shape)  # of the worst
print(f"{{a[k]:.6g}} and {{b[k]:.6g}}: {{off[k] / ROUNDING:.3g}} roundings")"""


def integral(of: str, domain: str = "points") -> str:
    """Lines that add 16 integrals over a square of directions to the list `due`."""
    return f"""\
due = []
for points in (np.arange(n) * [[1 / n], [0.618034]] + rng.random((16, 2, 1))) % 1:
    wo = mi.warp.square_to_uniform_sphere(mi.Point2f({domain}))
    due += [4 * np.pi * {of}]
"""


def whole(of: str, due: str = "1") -> str:
    """Lines that compare an integral over all directions."""
    mean = f"np.mean({of}, dtype=float)"
    error = "np.std(due) / 4 + 1e-7"
    return f"{integral(mean)}a, b, error = np.mean(due), {due}, {error}\n{SCORED}"


def count(drawn: str, density: str) -> str:
    """Lines that compare the samples in a patch with an integral over it."""
    mean = f"np.prod(high - low) * np.mean({density}, dtype=float)"
    return f"""\
low, high = np.array(CORNERS)  # of a patch, in the unit square
square = np.array(mi.warp.uniform_sphere_to_square(bs.wo))
inside = np.all((low <= square) & (square < high), axis=0) & np.array(COUNTED)
{integral(mean, "low + (high - low) * points")}\
a, b = np.mean({drawn} * inside), np.mean(due)
error = np.hypot(np.std({drawn} * inside) / n**0.5, np.std(due) / 4) + 1e-7
{SCORED}"""


def moments(drawn: str, density: str) -> str:
    """Lines that compare, over all directions, the moment that is farthest off."""
    return f"""\
moments = lambda wo: np.stack([x + np.zeros(n) for x in (1, *np.array(wo))])
drawn = np.where(np.array(COUNTED), {drawn} * moments(bs.wo), 0)
{integral(f"np.mean({each(density)} * moments(wo), axis=1)")}\
a, b = np.mean(drawn, axis=1), np.mean(due, axis=0)
error = np.hypot(np.std(drawn, axis=1) / n**0.5, np.std(due, axis=0) / 4) + 1e-7
a, b, error = np.transpose([a, b, error])[np.argmax(np.abs(a - b) / error)]
{SCORED}"""


VALUE = channels("bsdf.eval(ctx, si, bs.wo, True)")
PDF = "bsdf.pdf(ctx, si, bs.wo, True)"
PRODUCT = f"{channels('weight')} * {PDF}"

# The way back.
BACK = """\
back = dr.zeros(mi.SurfaceInteraction3f, n)
back.wi, back.sh_frame, back.uv, back.p = bs.wo, si.sh_frame, si.uv, si.p
"""
BACK_IN_A_MEDIUM = """\
back = dr.zeros(mi.SurfaceInteraction3f, n)
back.wi, back.sh_frame, back.p = bs.wo, mi.Frame3f(bs.wo), si.p
"""
THERE = f"{VALUE} / np.abs(bs.wo.z)"
AGAIN = f"{channels('bsdf.eval(ctx, back, si.wi, True)')} / np.abs(si.wi.z)"
STEEP = f"{SMOOTH} & (dr.abs(bs.wo.z) > 1e-3)"
RELATIVE_ETA = "eta = np.where(bs.wo.z * si.wi.z < 0, bs.eta, 1)\n"

# Which samples go the way of the first in a discrete direction.
LOBE = """\
discrete = np.array(mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta) & (bs.pdf > 0))
first = np.argmax(np.broadcast_to(discrete, n))
wo, pdf = (np.array(one) + np.zeros(n) for one in (bs.wo, bs.pdf))
same = discrete & np.all(np.abs(wo - wo[:, first, None]) < 1e-3, axis=0)
"""

# Angles of the ends, and all corners of the random numbers.
AT_ENDS = """\
ends = np.array([0, 0.5, np.nextafter(np.float32(1), np.float32(0))], np.float32)
u, x = np.array(np.meshgrid(ends, ends, ends)).reshape(3, -1), []
for theta in np.radians([0, 1e-3, 89.99, 90, 90.01, 120, 179.999, 180]):
    wi = np.round([np.sin(theta), 0, np.cos(theta)], 9).tolist()
    si.wi = dr.opaque(mi.Vector3f, wi, n)
    bs, weight = bsdf.sample(ctx, si, RANDOM, True)
    for wo in (bs.wo, si.wi, -si.wi, mi.reflect(si.wi), -mi.reflect(si.wi)):
        x += [np.ravel(dr.select(dr.squared_norm(wo) > 0.5, WHAT, 0))]
x = np.concatenate(x)
"""

# A Mueller matrix over its first element, in frames of k x normal of both beams k.
IN_PLANE = """\
def in_plane(wi, wo):  # light arrives along -wi
    si.wi, own = wi, mi.mueller.stokes_basis
    s, t = (dr.normalize(dr.cross(k, mi.Vector3f(NORMAL))) for k in (-wi, wo))
    m = mi.mueller.rotate_mueller_basis(ANSWER, -wi, own(-wi), s, wo, own(wo), t)
    return (m := np.array(m)) / np.fmax(m[0, 0], 1e-30)
"""


class Kind(Enum):
    """What a finding is about: a property, or one aspect of it."""

    ANSWERS = f"""\
x = np.concatenate([np.ravel(ABOUT) for wo in (bs.wo, SPHERE)])
{IMPROPER}"""
    RAISES = "answer = FUNCTION\nprint(type(answer), answer, mi.traverse(bsdf))"
    OTHER_WHEN_CALLED_AGAIN = (
        f"a = {channels('FUNCTION')}\n"
        "dr.eval(bsdf.sample(ctx, si, mi.Float(u[1]), mi.Point2f(u[:2]), True))\n"
        "dr.eval(bsdf.eval(ctx, si, SPHERE, True))\n"
        + by_sample("a", channels("FUNCTION"))
    )
    OTHER_IN_ANOTHER_PLACE = f"""\
si.wi = dr.mulsign(mi.warp.square_to_cosine_hemisphere(mi.Point2f(u[1:])), si.wi.z)
a, i = {channels("FUNCTION")}, n - 1 - dr.arange(mi.UInt32, n)
u, si.wi, bs.wo = u[:, ::-1], *(dr.gather(mi.Vector3f, x, i) for x in (si.wi, bs.wo))
{by_sample("a", channels("FUNCTION") + "[..., ::-1]")}"""
    OTHER_IN_THE_WORLD = f"""\
a = {channels("TURNED")}
si.sh_frame = mi.Frame3f([0, 0, 1])
{by_sample("a", channels("TURNED"))}"""
    ALBEDO = by_sample(
        channels("bsdf.eval_diffuse_reflectance(si, True)"), f"np.pi * {THERE}", STEEP
    )
    DIRECTIONS = f"""\
through = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Transmission) & {LIT}
a, b = np.sum(through), np.sum((bs.wo.z * si.wi.z < 0) & {LIT})
{SAME}"""
    LENGTH = by_sample("dr.norm(bs.wo)", "1", LIT)
    ETA_OF_REFLECTION = by_sample("bs.eta", "1", f"{LIT} & (bs.wo.z * si.wi.z > 0)")
    SAMPLING = count("1", "DENSITY")
    MOMENTS = moments("1", "DENSITY")
    WEIGHTS = count(each("weight"), "bsdf.eval(ctx, si, wo, True)")
    MOMENTS_OF_WEIGHTS = moments(each("weight"), "bsdf.eval(ctx, si, wo, True)")
    MASS = whole("bsdf.pdf(ctx, si, wo, True)")
    MASS_OF_A_DARK_SIDE = whole("bsdf.pdf(ctx, si, wo, True)", "0")
    LIGHT_OF_A_DARK_SIDE = whole("np.array(bsdf.eval(ctx, si, wo, True)).max(0)", "0")
    ENERGY = whole("np.array(bsdf.eval(ctx, si, wo, True)).max(0)")
    SAMPLED_PDF = by_sample("bs.pdf", PDF)
    SAMPLED_WEIGHT = by_sample(PRODUCT, VALUE)
    EVAL_PDF = "wo = bs.wo\n" + by_sample(
        channels("bsdf.eval_pdf(ctx, si, wo, True)[INDEX]"),
        channels("bsdf.ABOUT(ctx, si, wo, True)"),
    )
    EVAL_PDF_ANYWHERE = "wo = SPHERE\n" + by_sample(
        channels("bsdf.eval_pdf(ctx, si, wo, True)[INDEX]"),
        channels("bsdf.ABOUT(ctx, si, wo, True)"),
        "a + b > 0",
    )
    EVAL_PDF_SAMPLE = "wo = bs.wo\n" + by_sample(
        channels("bsdf.eval_pdf_sample(ctx, si, wo, RANDOM)[INDEX]"),
        channels("bsdf.ABOUT(ctx, si, wo, True)"),
    )
    OTHER_SAMPLES = "other = bsdf.eval_pdf_sample(ctx, si, bs.wo, RANDOM)[3]\n" + (
        by_sample(channels("other"), channels("weight"), LIT)
    )
    # by which light passes each way
    ETA = BACK + by_sample(
        "bs.eta**2",
        f"{each(THERE)} / {each(AGAIN)}",
        f"{STEEP} & (bs.wo.z * si.wi.z < 0)",
    )
    CONTINUITY = f"""\
shares = []
for cosine in (0.5, 1e-3):
    ring = mi.Vector3f((1 - cosine**2) ** 0.5, 0, cosine)
    si.wi = ring * dr.sign(si.wi.z) + dr.zeros(mi.Vector3f, n)
    shares += [np.mean(np.array(bsdf.eval(ctx, si, SPHERE, True)) > 0)]
a, b = shares
{EQUAL}"""
    JUMP_AT_NORMAL = f"""\
a = {channels("FUNCTION")}
si.wi = si.wi + mi.Vector3f(2**-16, 0, 0)
{by_sample("a", channels("FUNCTION"))}"""
    RECIPROCITY = BACK + RELATIVE_ETA + by_sample(THERE, f"{AGAIN} * eta**2", STEEP)
    SYMMETRY = BACK_IN_A_MEDIUM + by_sample(
        VALUE, channels("bsdf.eval(ctx, back, si.wi, True)")
    )
    SYMMETRY_OF_MICROFLAKES = BACK_IN_A_MEDIUM + by_sample(
        f"{VALUE} * bsdf.projected_area(si, True)",
        f"{channels('bsdf.eval(ctx, back, si.wi, True)')} * "
        "bsdf.projected_area(back, True)",
    )
    RECIPROCITY_OF_A_LOBE = f"""\
{LOBE}back = dr.zeros(mi.SurfaceInteraction3f, n)
back.wi, back.sh_frame = mi.Vector3f(wo[:, first].tolist()), si.sh_frame
there, returned = bsdf.sample(ctx, back, RANDOM, True)
home = np.all(np.abs(np.array(there.wo) - np.array(si.wi)) < 1e-3, axis=0)
x, y = {each("weight")} * same, {each("returned")} * home
a, b, error = np.mean(x), np.mean(y), np.std(x - y) / n**0.5 + 1e-7
{SCORED}"""
    ADJOINT = (
        f"{BACK}there = {THERE}\nctx = mi.BSDFContext(mi.TransportMode.Radiance)\n"
        + by_sample("there", AGAIN, STEEP)
    )
    ADJOINT_OF_A_LOBE = (
        f"radiance = mi.BSDFContext(mi.TransportMode.Radiance)\n{RELATIVE_ETA}"
        + by_sample(
            channels("weight"),
            channels("bsdf.sample(radiance, si, RANDOM, True)[1]") + " * eta**2",
            LIT,
        )
    )
    DELTA = f"""\
{LOBE}a, b, error = np.mean(same), pdf[first], np.std(same) / n**0.5 + 1e-7
{SCORED}"""
    NULL_TRANSMISSION = f"""\
straight = np.array(mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null))
a = np.mean(({each("weight")} * np.array(bs.pdf))[straight])
b = np.mean(bsdf.eval_null_transmission(si, True))
{EQUAL}"""
    DIRECTION_OF_A_LOBE = LOBE + by_sample("bs.wo.x", "mi.reflect(si.wi).x", "same")
    WEIGHTS_OF_A_LOBE = f"""\
{LOBE}a, b = np.min({each("weight")}[same]), np.max({each("weight")}[same])
{EQUAL}"""
    TYPE_OF_A_COMPONENT = f"""\
a = b = 0  # types that are sampled as a component, and of these what it declares
for i in range(bsdf.component_count()):
    own = np.array({LIT}) & (np.array(bs.sampled_component) == i)
    sampled = int(np.bitwise_or.reduce(np.array(bs.sampled_type) * own))
    if sampled & ~int(bsdf.flags(i)):
        a, b = sampled, sampled & int(bsdf.flags(i))
{SAME}"""
    DIFFERENTIALS = f"""\
a = {channels("FUNCTION")}
si.duv_dx, si.duv_dy = mi.Vector2f(0.3, 0.1), mi.Vector2f(-0.1, 0.2)
{by_sample("a", channels("FUNCTION"))}"""
    FLAGS = f"""\
a = int(np.bitwise_or.reduce(np.array(bs.sampled_type) * np.array({LIT})))
b = a & int(bsdf.flags())  # what is sampled, and of that is declared
last = int(np.max(np.array(bs.sampled_component) * np.array({LIT})))
if a == b and last >= bsdf.component_count():
    a, b = last + 1, bsdf.component_count()
{SAME}"""
    UNDECLARED_SIDE = f"a, b = np.mean({VALUE} > 0), 0\n{SAME}"
    TYPE_MASK = f"""\
a, b = 0, 0  # answers that a mask excludes
for i in range(bsdf.component_count()):
    ctx.type_mask = int(mi.BSDFFlags.All) & ~int(bsdf.flags(i))
    bs, weight = bsdf.sample(ctx, si, RANDOM, True)
    a += np.sum(np.array(EXCLUDED & dr.any(FUNCTION != 0)))
{SAME}"""
    ANISOTROPIC = f"""\
a = {channels("FUNCTION")}
turn = mi.Matrix3f([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
si.wi, bs.wo = turn @ si.wi, turn @ bs.wo
{by_sample("a", channels("FUNCTION"))}"""
    COMPONENTS = f"""\
a, b = {channels("FUNCTION")}, 0
for i in range(bsdf.component_count()):
    ctx.component = i
    b = b + {channels("FUNCTION")}
{by_sample("a", "b")}"""
    LOBE_OF_A_COMPONENT = f"""\
own = (np.array(bs.sampled_component) == ABOUT) & np.array({LIT})
ctx.component = ABOUT
alone, weight_alone = bsdf.sample(ctx, si, RANDOM, True)
a = np.median(({each("weight")} * np.array(bs.pdf))[own])
b = np.median({each("weight_alone")} * np.array(alone.pdf))
{EQUAL}"""
    MASKS = f"""\
awake = mi.Bool(np.arange(n) % 2 == 0)
a, b = np.max(np.abs(np.array(MASKED)) * np.array(~awake)), 0
{SAME}"""
    MASKS_OF_OTHERS = "awake = mi.Bool(np.arange(n) % 2 == 0)\n" + by_sample(
        channels("MASKED"), channels("FUNCTION"), "awake"
    )
    ENDS = AT_ENDS.replace("WHAT", "ABOUT") + IMPROPER
    LENGTH_AT_AN_END = (
        AT_ENDS.replace("WHAT", "1e-3 - abs(dr.norm(bs.wo) - 1)") + IMPROPER
    )
    GRADIENT = f"""\
params = mi.traverse(bsdf)
def total(x):
    params["ABOUT"] = x
    params.update()
    return dr.sum(bsdf.eval(ctx, si, bs.wo, True), axis=None)
x = type(params["ABOUT"])(params["ABOUT"])
a = np.ravel(total(x + 1e-3) - total(x - 1e-3))[0] / 2e-3
dr.enable_grad(x)
b = np.ravel(dr.forward_to(total(x), flags=dr.ADFlag.AllowNoGrad))[0]
{EQUAL}"""
    UPDATE = f"""\
a, params = {channels("FUNCTION")}, mi.traverse(bsdf)
for name in params.keys():
    params.set_dirty(name)
params.update()
{by_sample("a", channels("FUNCTION"))}"""
    PARAMETERS = """\
params = mi.traverse(bsdf)
params["ABOUT"] = dr.select(params["ABOUT"] == 0, 0.5, params["ABOUT"] / 2)
params.update()
bs, weight = bsdf.sample(ctx, si, RANDOM, True)
""" + by_sample("STALE", "DUE")
    # over directions of the density p, the mean of u / (p + u) is that of p / (p + u)
    # over directions of the density u
    DENSITY_AFTER_A_CHANGE = f"""\
params = mi.traverse(bsdf)
params["ABOUT"] = dr.select(params["ABOUT"] == 0, 0.5, params["ABOUT"] / 2)
params.update()
bs, weight = bsdf.sample(ctx, si, RANDOM, True)
p, q = (4 * np.pi * np.array(bsdf.pdf(ctx, si, wo, True)) for wo in (bs.wo, SPHERE))
x, y = 1 / (1 + p) * np.array({SMOOTH}), q / (1 + q)  # of one mean if p is the density
a, b, error = np.mean(x), np.mean(y), np.std(x - y) / n**0.5 + 1e-7
{SCORED}"""


class MatrixKind(Enum):
    """What a finding on Mueller matrices is about."""

    ANSWERS = f"""\
m = np.array(FUNCTION)
a, b = np.count_nonzero(~np.isfinite(m)) + np.count_nonzero(m[0, 0] < 0), 0
{SAME}"""
    # of both variants
    FIRST_ELEMENT = by_sample("values[0]", "values[1]", LIT)
    SAMPLED_WEIGHT = f"""\
a, b = np.array(weight) * np.array(bs.pdf), np.array(bsdf.eval(ctx, si, bs.wo, True))
{ELEMENTS}"""
    EVAL_PDF = f"""\
a = np.array(bsdf.eval_pdf(ctx, si, bs.wo, True)[0])
b = np.array(bsdf.eval(ctx, si, bs.wo, True))
{ELEMENTS}"""
    # Cloude's coherency matrix, which is a sum of those of Jones matrices
    REALISABLE = f"""\
m = np.nan_to_num(np.array(FUNCTION)).reshape(4, 4, -1)
m = m / np.fmax(m[0, 0], 1e-30)
pauli = np.array([[1, 0, 0, 1], [1, 0, 0, -1], [0, 1, 1, 0], [0, -1j, 1j, 0]])
pauli = pauli.reshape(4, 2, 2)
coherency = np.einsum("ijk,iab,jcd->kacbd", m, pauli, pauli.conj()) / 4
least = np.linalg.eigvalsh(coherency.reshape(-1, 4, 4))[:, 0]
a, b = np.count_nonzero(least < -5e-4), 0  # no surface has negative ones
{SAME}"""
    # of the polarisation that half of the samples scatter best
    ENERGY = f"""\
rows = np.array(weight)[0].mean(axis=1) + 0 * u[0]  # flux of a Stokes vector
stokes = np.append(1, np.mean(rows[1:, ::2], axis=1))
stokes[1:] /= np.linalg.norm(stokes[1:]) + 1e-30
x = stokes @ rows[:, 1::2]
a, b, error = np.mean(x), 1, np.std(x) / len(x) ** 0.5 + 1e-7
{SCORED}"""
    FRAMES = f"""\
{IN_PLANE}turn = mi.Transform4f().rotate(NORMAL, 37)  # both about the normal
a, b = in_plane(si.wi, bs.wo), in_plane(turn @ si.wi, turn @ bs.wo)
{ELEMENTS}"""
    JUMP = f"""\
values = []
for wi, wo in ABOUT:  # two pairs of directions, next to each other
    si.wi, wo = (dr.opaque(mi.Vector3f, x, n) for x in (wi, wo))
    m = np.array(ANSWER)
    values += [m / np.fmax(m[0, 0], 1e-30)]
a, b = values
{ELEMENTS}"""
    WORLD = f"""\
values = []
for normal in ([0, 0, 1], [0.6, 0, 0.8]):  # of the surface, in the world
    si.sh_frame = mi.Frame3f(normal)
    m = np.array(FUNCTION)
    values += [m / np.fmax(m[0, 0], 1e-30)]
a, b = values
{ELEMENTS}"""
    RECIPROCITY = f"""\
{IN_PLANE}a, b = in_plane(si.wi, bs.wo), in_plane(bs.wo, mi.Vector3f(si.wi))
b = np.einsum("jick,i,j->ijck", b, [1, 1, -1, 1], [1, 1, -1, 1])  # the way back
{ELEMENTS}"""
    ADJOINT = f"""\
values = []
there = mi.Vector3f(si.wi)
for mode, si.wi, wo in (("Radiance", there, bs.wo), ("Importance", bs.wo, there)):
    ctx = mi.BSDFContext(getattr(mi.TransportMode, mode))
    m = np.array(ANSWER)
    values += [m / np.fmax(m[0, 0], 1e-30)]
a, b = values
{ELEMENTS}"""
