"""A test with Mitsuba's chi2 becomes ours by its import."""

import mitsuba as mi
import mitsuba.chi2
import pytest

import gonio_mi.testing

MODULES = {"mitsuba": mitsuba.chi2, "gonio_mi": gonio_mi.testing}


def outcome(module, adapter, *specimen, **more):
    """As a plugin's test is written, but for the import."""
    functions = getattr(module, adapter)(*specimen, wi=[0.6, 0.0, 0.8])
    test = module.ChiSquareTest(
        domain=module.SphericalDomain(),
        sample_func=functions[0],
        pdf_func=functions[1],
        sample_dim=3,
        **more,
    )
    return test, test.run(quiet=True)


XML = '<float name="alpha" value="0.3"/><boolean name="sample_visible" value="{}"/>'
XML += '<string name="distribution" value="ggx"/>'


@pytest.mark.parametrize(
    ("plugin", "extra", "by_chi2", "by_us", "function"),
    [
        ("roughconductor", XML.format("true"), True, True, None),
        ("roughdielectric", XML.format("false"), True, False, "sample"),
    ],
)
def test_of_a_bsdf(plugin, extra, by_chi2, by_us, function):
    """What chi2 cannot see: another weight."""
    assert outcome(MODULES["mitsuba"], "BSDFAdapter", plugin, extra)[1] == by_chi2
    test, passed = outcome(MODULES["gonio_mi"], "BSDFAdapter", plugin, extra)
    assert passed == by_us
    assert (function or "None") in str(test.verdict.function)
    assert "Chi^2 statistic" in test.messages
    assert test.verdict.headline in test.messages


def test_of_a_phase_function():
    specimen = {"type": "hg", "g": 0.5}
    for module in MODULES.values():
        assert outcome(module, "PhaseFunctionAdapter", "hg", specimen)[1]


def test_of_anything_else_stays_as_it_is():
    test = gonio_mi.testing.ChiSquareTest(
        domain=gonio_mi.testing.SphericalDomain(),
        sample_func=mi.warp.square_to_uniform_sphere,
        pdf_func=mi.warp.square_to_uniform_sphere_pdf,
    )
    assert test.run(quiet=True)
    assert test.verdict is None
