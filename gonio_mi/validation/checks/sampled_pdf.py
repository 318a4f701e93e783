"""The pdf that ``sample`` returns, against ``pdf``."""

from __future__ import annotations

from ..evidence import Evidence
from ..samples import Samples, ratio_of, unequal


def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Check that both densities are equal, sample by sample, where there is light."""
    lit = samples.usable & (samples.eval != 0).any(axis=1)
    if not lit.any():
        return
    wrong = unequal(samples.sampled_pdf, samples.pdf, samples.pdf_slack) & lit
    evidence.breach_of_ratio(
        "sampled_pdf",
        "sample",
        samples,
        wrong,
        ratio_of(samples.sampled_pdf, samples.pdf),
        "its pdf over `pdf`",
        "`sample` returns another pdf than `pdf`",
    )
