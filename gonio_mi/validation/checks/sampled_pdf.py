"""The pdf that `sample` returns is that of `pdf`."""

from ..evidence import BIAS, COMBINED, SAME, Evidence, Question
from ..mistakes import SAMPLE, Mistake
from ..samples import Samples, ratio_of, unequal

SAMPLED_PDF = Question(
    "sampled_pdf", __doc__, BIAS, COMBINED, volumes=SAME, identity=True, matrices=SAME
)


class SampledPdf(Mistake):
    """Mistakes in a sampled pdf."""

    OTHER = "{who} returns another pdf than `pdf`"


@SAMPLED_PDF.asks("samples")
def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Check that both densities are equal, sample by sample, where there is light."""
    lit = samples.usable & (samples.eval != 0).any(axis=1)
    if not lit.any():
        return
    wrong = unequal(samples.sampled_pdf, samples.pdf, samples.pdf_slack) & lit
    found = ratio_of(samples.sampled_pdf, samples.pdf), "its pdf over `pdf`"
    guess = SampledPdf.OTHER(SAMPLE)
    evidence.breach_of_ratio(SAMPLED_PDF, guess, samples, wrong, *found)
