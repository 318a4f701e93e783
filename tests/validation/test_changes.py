"""Functions follow a change of parameters of any kind, each alone, in its range."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from plain_bsdf import changed
from reproduced import told

from gonio_mi.validation import reproducer, validate
from gonio_mi.validation.checks import parameters
from gonio_mi.validation.checks.parameters import MAX_ALONE

FLAGS = mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.FrontSide
FLAGS += (mi.BSDFFlags.NonSymmetric,)


class Mixed:
    """A matte lobe of share a and one of cos^k: right if `cached` follows `k`."""

    values = {"a": 0.4, "k": 3.0}
    albedo = 0.7

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self.m_flags = sum(map(int, FLAGS))
        self.m_components = [self.m_flags]
        for name, value in self.values.items():
            kind = mi.Vector3f if isinstance(value, list) else mi.Float
            setattr(self, name, kind(value))
        self.refresh()

    def share(self):
        return self.a

    def power(self):
        return self.k

    def refresh(self):
        self.cached = mi.Float(self.power())

    def traverse(self, callback):
        for name in self.values:
            callback.put(name, getattr(self, name), mi.ParamFlags.Differentiable)

    def parameters_changed(self, keys):  # noqa: ARG002
        self.refresh()

    def density(self, k, wo):
        glossy = dr.inv_two_pi * (k + 1) * dr.power(wo.z, k)
        return dr.lerp(glossy, dr.inv_pi * wo.z, self.share())

    def sample(self, ctx, si, sample1, sample2, active):
        k, phi = self.power(), dr.two_pi * sample2.y
        matte = sample1 < self.share()
        z = dr.select(matte, dr.sqrt(sample2.x), dr.power(sample2.x, 1 / (k + 1)))
        (sin, cos), r = dr.sincos(phi), dr.safe_sqrt(1 - z * z)
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo, bs.eta = mi.Vector3f(r * cos, r * sin, z), 1.0
        bs.sampled_type = mi.UInt32(int(FLAGS[0]))
        lit = active & (si.wi.z > 0) & (z > 0)
        bs.pdf = dr.select(lit, self.density(k, bs.wo), 0)
        value = self.eval(ctx, si, bs.wo, active)
        return bs, (value / bs.pdf) & (bs.pdf > 0)

    def eval(self, ctx, si, wo, active):  # noqa: ARG002
        lit = active & (si.wi.z > 0) & (wo.z > 0)
        return mi.Spectrum(self.albedo * self.density(self.power(), wo)) & lit

    def pdf(self, ctx, si, wo, active):  # noqa: ARG002
        lit = active & (si.wi.z > 0) & (wo.z > 0)
        return dr.select(lit, self.density(self.cached, wo), 0)

    def to_string(self):
        return "Mixed[]"


def verdict(base=Mixed, **changes):
    return validate(changed(base, **changes), effort="quick", strict=True)


def fixed(self, callback):
    """Parameters without gradients."""
    for name in self.values:
        callback.put(name, getattr(self, name), mi.ParamFlags.NonDifferentiable)


KINDS = {
    "positive": ({"k": 3.0}, lambda self: self.k),
    "negative": ({"k": -1.1}, lambda self: dr.exp(-self.k)),
    "zero": ({"k": 0.0}, lambda self: 3 + self.k),
    "vector": ({"k": [0.4, 3.0, 0.0]}, lambda self: self.k.y),
    "axis": ({"k": [0.0, 0.6, 0.8]}, lambda self: 3 + self.k.y),
}


@pytest.mark.parametrize("follows", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_parameters_of_any_value_are_changed(kind, follows):
    values, power = KINDS[kind]

    def changed(self, keys):  # noqa: ARG001
        if follows:
            self.refresh()

    judged = verdict(
        values=values, power=power, share=lambda _: 0.4, parameters_changed=changed
    )
    found = judged["parameters"]
    assert (found.status == "holds") == follows, str(judged)
    if not follows:
        assert found.mistake == "`pdf` does not follow a change of k"
        assert told(reproducer(judged, "parameters")) > 1


def test_one_of_many_parameters_that_is_ignored_is_found():
    """Also if it is not among the few that are updated alone."""
    idle = {f"idle_{i}": 0.5 for i in range(MAX_ALONE)}
    values = {"a": 0.4, "k": 3.0} | idle
    assert "k" not in parameters.evenly_chosen(values)
    judged = verdict(values=values, parameters_changed=lambda *_: None)
    assert judged["parameters"].mistake == "`pdf` does not follow a change of k"


@pytest.mark.parametrize("asked", ["a", "k"])
def test_a_parameter_that_is_followed_beside_others_only(asked):
    """The twin asks for the key of the parameter that matters."""

    def changed(self, keys):
        if asked in keys:
            self.refresh()

    judged = verdict(parameters_changed=changed)
    found = judged["parameters"]
    assert (found.status == "holds") == (asked == "k"), str(judged)
    if found.status == "fails":
        assert found.mistake == "`pdf` does not follow a change of k alone"
        assert told(reproducer(judged, "parameters")) > 1


@pytest.mark.parametrize("factor", [1.0, 0.9])
def test_an_update_of_what_is_the_same_changes_nothing(factor):
    def changed(self, keys):  # noqa: ARG001
        self.refresh()
        self.albedo = self.albedo * factor

    judged = verdict(parameters_changed=changed)
    found = judged["parameters"]
    assert (found.status == "holds") == (factor == 1)
    if found.status == "fails":
        who = "`parameters_changed` changes `eval` and `sample`"
        assert found.mistake == f"{who} where no parameter has changed"
        assert told(reproducer(judged, "parameters")) > 1


@pytest.mark.parametrize("refused", ["all", "other"])
def test_an_update_that_is_refused_always(refused):
    """The twin refuses other values only, as it may."""

    def changed(self, keys):
        if refused == "all" or self.k.numpy()[0] != 3:
            raise ValueError(sorted(keys))
        self.refresh()

    judged = verdict(parameters_changed=changed, traverse=fixed)
    found = judged["parameters"]
    assert judged["answers"].status == "holds"
    assert (found.status == "fails") == (refused == "all"), str(judged)
    if refused == "all":
        assert "`parameters_changed` raised ValueError" in found.mistake


def test_of_many_parameters_some_are_changed_alone():
    """Each of few; of many no more than the bound."""
    for n in (2, MAX_ALONE, MAX_ALONE + 1, 10 * MAX_ALONE):
        few = parameters.evenly_chosen({f"k{i}": 3.0 for i in range(n)})
        assert min(n, MAX_ALONE) / 2 <= len(few) <= MAX_ALONE
        assert len(few) == n or n > MAX_ALONE


class Half(Mixed):
    """Reflects 2 p - 1 for p from 0.5 to 1."""

    values = {"p": 0.8}
    stale = False

    def share(self):
        return 0.4

    def power(self):
        return 3.0

    def eval(self, *arguments):
        return Mixed.eval(self, *arguments) * (2 * self.p - 1)

    def sample(self, *arguments):
        bs, weight = Mixed.sample(self, *arguments)
        if self.stale:
            weight = mi.Spectrum(0.7 * 0.6) & (weight != 0)
        return bs, weight


class Linear(Mixed):
    """Its density is a mixture of share 1 - b/2, which is negative beyond b = 2."""

    values = {"b": 1.6}
    stale = False

    def share(self):
        return 1 - self.b / 2

    def power(self):
        return 2.0

    def pdf(self, ctx, si, wo, active):
        b = self.b
        if self.stale:
            self.b = mi.Float(1.6)
        found = Mixed.pdf(self, ctx, si, wo, active)
        self.b = b
        return found


@pytest.mark.parametrize("stale", [False, True])
@pytest.mark.parametrize("base", [Half, Linear])
def test_a_change_out_of_range_proves_nothing(base, stale):
    """The twin does not follow a change within the range either."""
    judged = verdict(base, stale=stale)
    found = judged["parameters"]
    assert (found.status == "holds") != stale, str(judged)
    if stale:
        assert "does not follow a change of" in found.mistake


@pytest.mark.parametrize("follows", [True, False])
def test_a_phase_function_follows_a_negative_parameter(follows):
    class Backward(mi.PhaseFunction):
        def __init__(self, props):
            mi.PhaseFunction.__init__(self, props)
            self.m_flags = mi.PhaseFunctionFlags.Anisotropic
            self.m_components = [self.m_flags]
            self.g = mi.Float(-0.6)
            self.inner = mi.load_dict({"type": "hg", "g": -0.6})
            self.stale = mi.load_dict({"type": "hg", "g": -0.6})

        def traverse(self, callback):
            callback.put("g", self.g, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys):  # noqa: ARG002
            for phase in (self.inner, self.stale)[: 1 + follows]:
                params = mi.traverse(phase)
                params["g"] = self.g
                params.update()

        def sample(self, *arguments):
            return self.stale.sample(*arguments)

        def eval_pdf(self, *arguments):
            return self.inner.eval_pdf(*arguments)

        def to_string(self):
            return "Backward[]"

    mi.register_phase("backward", Backward)
    found = validate({"type": "backward"}, effort="quick")["parameters"]
    assert (found.status == "holds") == follows


class Low(Mixed):
    """Its lobe is of the lowest power that there ever was."""

    def refresh(self):
        self.k = self.lowest = mi.Float(min(self.k[0], getattr(self, "low", 1e9)))
        self.low = self.lowest[0]
        Mixed.refresh(self)


@pytest.mark.parametrize("limit", [0.0, 0.05])
def test_tiny_values(limit):
    """The twin of `pdf` has a lower bound that single precision needs not."""

    def pdf(self, ctx, si, wo, active):
        a = self.a
        self.a = dr.maximum(self.a, limit)
        found = Mixed.pdf(self, ctx, si, wo, active)
        self.a = a
        return found

    judged = verdict(pdf=pdf)
    found = judged["parameters"]
    assert (found.status == "fails") == (limit > 0), str(judged)
    if limit:
        text = "`sample` or `pdf` does not follow a change of a to 0.001"
        assert found.mistake == text
        assert told(reproducer(judged, "parameters")) > 1


@pytest.mark.parametrize("base", [Mixed, Low])
def test_answers_return_with_parameters(base):
    judged = verdict(base)
    found = judged["parameters"]
    assert (found.status == "fails") == (base is Low), str(judged)
    if base is Low:
        assert "do not return when all parameters do" in found.mistake
        assert told(reproducer(judged, "parameters")) > 1


# ----------------------------------------------------------------------- gradients


class Factor(Mixed):
    """The mixture times a factor, found in a number, a table or a texture."""

    kinds = {
        "one": lambda: mi.Float(1.0),
        "colour": lambda: mi.Color3f(1.0, 0.5, 0.2),
        "table": lambda: mi.TensorXf(np.float32([0.3, 0.5, 0, 1])),
        "texture": lambda: mi.load_dict(
            {
                "type": "bitmap",
                "raw": True,
                "bitmap": mi.Bitmap(np.full((4, 4, 1), 0.5, np.float32)),
            }
        ),
    }
    wrong, kind = False, "one"

    def __init__(self, props):
        self.values = {}
        Mixed.__init__(self, props)
        self.values, self.t = {"t": None}, self.kinds[self.kind]()

    def share(self):
        return 0.4

    def power(self):
        return 3.0

    def factor(self, si, wo):
        if self.kind == "texture":
            return self.t.eval_1(si)
        if self.kind == "table":
            return dr.gather(mi.Float, self.t.array, mi.UInt32(wo.z > 0.5))
        return self.t

    def eval(self, ctx, si, wo, active):
        factor = self.factor(si, wo)
        if self.wrong and self.kind == "colour":
            factor = dr.replace_grad(factor, mi.Color3f(factor.z, factor.y, factor.x))
        elif self.wrong:
            factor = dr.detach(factor)
        return Mixed.eval(self, ctx, si, wo, active) * mi.Spectrum(factor)


@pytest.mark.parametrize("wrong", [False, True])
@pytest.mark.parametrize("kind", ["one", "colour", "table", "texture"])
def test_gradients_of_numbers_colours_and_tables(kind, wrong, request):
    """Detached ones, and those of red and blue exchanged."""
    request.getfixturevalue("rgb" if kind == "colour" else "mono")
    judged = verdict(Factor, kind=kind, wrong=wrong)
    found = judged["parameters"]
    assert (found.status == "fails") == wrong, str(judged)
    if wrong:
        name = "t.data" if kind == "texture" else "t"
        assert found.mistake == f"gradients of `eval` by {name} are not its changes"


@pytest.mark.parametrize("wrong", ["", "pdf", "eval_pdf", "backward"])
@pytest.mark.usefixtures("mono")
def test_gradients_of_all_functions_both_ways(wrong):
    """By one of two parameters; the density of `eval_pdf` alone may not be detached."""

    class Halved(dr.CustomOp):
        def eval(self, x):
            return mi.Float(x)

        def forward(self):
            self.set_grad_out(self.grad_in("x"))

        def backward(self):
            self.set_grad_in("x", 0.5 * self.grad_out())

    def pdf(self, *arguments):
        found = Mixed.pdf(self, *arguments)
        half = 0.5 * (found + dr.detach(found))
        return dr.replace_grad(found, half) if wrong == "pdf" else found

    def share(self):
        return dr.custom(Halved, self.a) if wrong == "backward" else self.a

    def eval_pdf(self, *arguments):
        value, density = self.eval(*arguments), self.pdf(*arguments)
        return value, dr.detach(density) if wrong == "eval_pdf" else density

    judged = verdict(pdf=pdf, share=share, eval_pdf=eval_pdf)
    found = judged["parameters"]
    assert (found.status == "fails") == bool(wrong), str(judged)
    if wrong:
        function = "eval" if wrong == "backward" else wrong
        way = "backward gradients" if wrong == "backward" else "gradients"
        assert found.mistake.startswith(f"{way} of `{function}` by ")
    if wrong in ("pdf", "backward"):
        assert told(reproducer(judged, "parameters")) > 1
