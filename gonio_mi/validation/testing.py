"""For the test suites of those who write Mitsuba plugins."""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import mitsuba as mi
from mitsuba import chi2

from ..specimen.specimen_text import SpecimenLike
from ..variants import is_parallel
from .examination import validate
from .verdict import Verdict


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

    Parameters and further errors as of :func:`gonio_mi.validate`.

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


# -------------------------------------------- in the place of those of mitsuba.chi2

SphericalDomain = chi2.SphericalDomain
_Functions: TypeAlias = "tuple[Callable[..., Any], Callable[..., Any]]"


def BSDFAdapter(  # noqa: N802 (as Mitsuba has it)
    bsdf_type: str, extra: Any, *args: Any, **kwargs: Any
) -> _Functions:
    """Return the functions of ``mitsuba.chi2.BSDFAdapter``, which know their BSDF.

    Parameters as there. :class:`ChiSquareTest` judges the whole BSDF by them.
    """
    functions = chi2.BSDFAdapter(bsdf_type, extra, *args, **kwargs)
    return _known(functions, "bsdf", bsdf_type, extra)


def PhaseFunctionAdapter(  # noqa: N802
    phase_type: str, extra: Any, *args: Any, **kwargs: Any
) -> _Functions:
    """Return the functions of ``mitsuba.chi2.PhaseFunctionAdapter``, likewise."""
    functions = chi2.PhaseFunctionAdapter(phase_type, extra, *args, **kwargs)
    return _known(functions, "phase", phase_type, extra)


def _known(functions: Any, tag: str, name: str, extra: Any) -> _Functions:
    """Functions of an adapter, with what they ask as an attribute."""
    text = f'<{tag} version="3.0.0" type="{name}">{extra}</{tag}>'
    for function in functions:
        function.specimen = extra if isinstance(extra, dict) else text
    return functions


class ChiSquareTest(chi2.ChiSquareTest):
    """Mitsuba's test, and :func:`gonio_mi.validate` after it.

    A test of a plugin that has ``from mitsuba.chi2 import ...`` becomes one of all its
    functions, at all directions, by ``from gonio_mi.testing import ...``. Whatever does
    not come from an adapter of this module, and scalar variants, get Mitsuba's test
    alone. Only the validation decides where it is made, for Mitsuba's test has false
    alarms; its p-value is `p_value`, and `messages` has both results.

    Attributes
    ----------
    verdict : Verdict or None
        After :meth:`run`.
    effort : str
        Of the validation.
    """

    effort = "quick"
    verdict: Verdict | None = None

    def run(
        self, significance_level: float = 0.01, test_count: int = 1, quiet: bool = False
    ) -> bool:
        """Whether nothing wrong was found, with the false-alarm probability given.

        Parameters as of Mitsuba's ``ChiSquareTest.run``.
        """
        passed = super().run(significance_level, test_count, quiet=True)
        specimen = getattr(self.sample_func, "specimen", None)
        if specimen is not None and is_parallel(mi.variant()):
            if isinstance(specimen, str):
                specimen = mi.load_string(specimen, parallel=False)
            alpha = -((1 - significance_level) ** (1 / test_count) - 1)
            self.verdict = validate(
                specimen, effort=self.effort, seed=self.seed, alpha=alpha
            )
            self._log(str(self.verdict))
            passed = self.verdict.passed
        if not quiet:
            print(self.messages)
        return passed
