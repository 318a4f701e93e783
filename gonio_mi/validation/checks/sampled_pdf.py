"""The pdf that `sample` returns is that of `pdf`."""

from typing import Any

from ..arrays import Sides, density, drawn, rows, smooth
from ..evidence import BIAS, COMBINED, SAME, Evidence, Question
from ..judgements import by_sample
from ..mistakes import PDF, SAMPLE, Claim, Mistake
from ..samples import Samples, ratio_of, unequal


def sampled_pdf(bsdf: Any, ctx: Any, si: Any, u: Any) -> Sides:
    """The pdf that `sample` returns is that of `pdf`."""
    bs, weight = drawn(bsdf, ctx, si, u)
    return rows(bs.pdf), density(bsdf, ctx, si, bs.wo), smooth(bs, weight)


SAMPLED_PDF = Question(
    "sampled_pdf",
    __doc__,
    BIAS,
    COMBINED,
    volumes=SAME,
    identity=True,
    matrices=SAME,
    shown=Claim(sampled_pdf, by_sample),
)


class SampledPdf(Mistake):
    """Mistakes in a sampled pdf."""

    OTHER = "{who} returns another pdf than `pdf`"
    DIFFER = "{who}: their densities differ"


@SAMPLED_PDF.asks("samples")
def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Check that both densities are equal, sample by sample, where there is light."""
    lit = samples.usable & (samples.eval != 0).any(axis=1)
    if not lit.any():
        return
    own, due, _ = samples.hold(sampled_pdf)
    wrong = unequal(own, due, samples.pdf_slack[:, None]) & lit
    found = ratio_of(own, due), "its pdf over `pdf`"
    # of matrices no counts of directions tell which of both is wrong
    either = SampledPdf.DIFFER(SAMPLE | PDF)
    guess = either if samples.matrices else SampledPdf.OTHER(SAMPLE)
    evidence.breach_of_ratio(SAMPLED_PDF, guess, samples, wrong, *found)
