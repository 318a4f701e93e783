"""For the test suites of those who write Mitsuba plugins."""

from collections.abc import Sequence

from .instrument.specimen_text import SpecimenLike
from .validation import validate
from .validation.verdict import Verdict


def assert_bsdf_valid(
    specimen: SpecimenLike,
    *,
    effort: str = "normal",
    seed: int = 0,
    alpha: float = 1e-3,
    allow: Sequence[str] = (),
    strict: bool = False,
) -> Verdict:
    """Raise AssertionError with the verdict if a BSDF plugin is wrong.

    Parameters and further errors as of :func:`gonio_mi.validation.validate`.

    Returns
    -------
    Verdict
    """
    __tracebackhide__ = True  # pytest shows the caller's line
    verdict = validate(
        specimen, effort=effort, seed=seed, alpha=alpha, allow=allow, strict=strict
    )
    if not verdict.passed:
        # pytest's summary shows the first line only
        raise AssertionError(f"{verdict.headline}\n{verdict}")
    return verdict
