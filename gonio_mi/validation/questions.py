"""All questions that verdicts answer, in their order."""

from dataclasses import replace

from .checks.adjoint import ADJOINT
from .checks.answers import ANSWERS
from .checks.components import COMPONENTS
from .checks.continuity import CONTINUITY
from .checks.cost import CALLS
from .checks.delta import DELTA
from .checks.directions import DIRECTIONS
from .checks.ends import ENDS
from .checks.energy import ENERGY
from .checks.eval_pdf import EVAL_PDF, EVAL_PDF_SAMPLE
from .checks.first_element import FIRST_ELEMENT
from .checks.flags import DECLARED
from .checks.frames import FRAMES
from .checks.masks import MASKS
from .checks.parameters import PARAMETERS
from .checks.realisable import REALISABLE
from .checks.reciprocity import RECIPROCITY
from .checks.sampled_pdf import SAMPLED_PDF
from .checks.sampled_weight import SAMPLED_WEIGHT
from .checks.sampling import SAMPLING
from .checks.weights import WEIGHTS

# Integrators that ask a phase function.
VOLUMETRIC = "volpath, volpathmis, prbvolpath: all that follow rays through media"

QUESTIONS = (
    ANSWERS,
    FIRST_ELEMENT,
    DIRECTIONS,
    SAMPLING,
    WEIGHTS,
    SAMPLED_PDF,
    SAMPLED_WEIGHT,
    EVAL_PDF,
    EVAL_PDF_SAMPLE,
    REALISABLE,
    ENERGY,
    FRAMES,
    CONTINUITY,
    RECIPROCITY,
    ADJOINT,
    DELTA,
    DECLARED,
    COMPONENTS,
    MASKS,
    ENDS,
    PARAMETERS,
    CALLS,
)

# Those about a BSDF in unpolarised variants.
OF_SURFACES = tuple(one for one in QUESTIONS if not one.alone)

# In polarised ones, of Mueller matrices: nothing passes that is not all decided.
OF_MATRICES = tuple(
    replace(one, text=one.matrices or one.text, needed=True)
    for one in QUESTIONS
    if one.matrices is not None
)

# Of phase functions, whose `eval_pdf` answers what is called `eval` and `pdf`.
OF_VOLUMES = tuple(
    replace(one, text=one.volumes or one.text, integrators=VOLUMETRIC)
    for one in QUESTIONS
    if one.volumes is not None
)

PROPERTIES, POLARISED, PHASE = (
    {one.name: str(one.text) for one in questions}
    for questions in (OF_SURFACES, OF_MATRICES, OF_VOLUMES)
)
