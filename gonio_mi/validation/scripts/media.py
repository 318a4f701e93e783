"""Parts of the scripts on phase functions that differ from those on a BSDF.

A sample's direction and density are kept as those of a BSDF are. What is a Mueller
matrix in polarised variants is asked for its first element.
"""

# %% words for phase functions
import drjit as dr
import mitsuba as mi
import numpy as np

COUNT = POSITION = SOURCE = WI = None
u = np.random.default_rng(0).random((3, 1), dtype=np.float32)

# %% medium interaction
phase = SOURCE
ctx, n = mi.PhaseFunctionContext(None, mi.TransportMode.MODE), COUNT
mei, bs = dr.zeros(mi.MediumInteraction3f, n), dr.zeros(mi.BSDFSample3f, n)
mei.wi, mei.p = mi.Vector3f(np.tile(np.vstack(WI), n)), mi.Point3f(POSITION)
mei.sh_frame = mi.Frame3f(mei.wi)
# %% medium sample
bs.wo, weight, bs.pdf = phase.sample(ctx, mei, mi.Float(u[0]), mi.Point2f(u[1:]), True)
weight = mi.unpolarized_spectrum(weight)


# %% medium define answer of eval
def answer(wo, on=True):
    return np.array(mi.unpolarized_spectrum(phase.eval_pdf(ctx, mei, wo, on)[0]))


# %% medium define answer of pdf
answer = lambda wo, on=True: np.atleast_2d(phase.eval_pdf(ctx, mei, wo, on)[1])
# %% medium define value
value = lambda w, m=mei: np.array(mi.unpolarized_spectrum(phase.eval_pdf(ctx, m, w)[0]))
# %% medium define pdf
pdf = lambda wo: np.atleast_2d(phase.eval_pdf(ctx, mei, wo, True)[1])
# %% medium define smooth
smooth = lambda: dr.any(weight != 0)
# %% medium define back
back, back.wi, back.sh_frame = mi.MediumInteraction3f(mei), bs.wo, mi.Frame3f(bs.wo)
# %% medium variants interaction
ctx, mei, answers = mi.PhaseFunctionContext(None), dr.zeros(mi.MediumInteraction3f), []
bs = dr.zeros(mi.BSDFSample3f)
