"""Loops that are made for Dr.Jit when they are first called. All is exact."""

import sys

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from drjit.ast import syntax

from gonio_mi.loops import mitsubas_made_late

VARIANT = "llvm_ad_mono"


@pytest.fixture
def made(monkeypatch):
    """Names of functions of Mitsuba that have been transformed, in order."""
    names = []

    def transform(function):
        names.append(function.__qualname__)
        return syntax(function)

    monkeypatch.setattr("gonio_mi.loops.transform", transform)
    return names


def image():
    """Picture of Mitsuba's own integrator in Python."""
    scene = mi.load_dict(
        {
            "type": "scene",
            "sensor": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at((0, 0, 4), 0, (0, 1, 0)),
                "film": {"type": "hdrfilm", "width": 4, "height": 4},
            },
            "light": {"type": "constant"},
            "shape": {"type": "sphere"},
        }
    )
    integrator = mi.load_dict({"type": "prb", "max_depth": 3})
    return np.array(mi.render(scene, integrator=integrator, spp=4, seed=1))


def of_new_variant():
    """Picture after a change of variant, which imports Mitsuba's integrators anew."""
    mi.set_variant("scalar_rgb")
    with mitsubas_made_late():
        mi.set_variant(VARIANT)
    return image()


@pytest.mark.parametrize("program", ["gonio-mi", "mine.py"])
def test_mitsubas_loops_are_made_by_the_program_when_called(monkeypatch, made, program):
    """With the same picture; a host's are made when they are imported, as ever."""
    before, own = mi.variant(), dr.syntax
    mi.set_variant(VARIANT)
    expected = image()
    monkeypatch.setattr(sys, "argv", [program])
    assert np.array_equal(of_new_variant(), expected)
    late = ["PRBIntegrator.sample"] if program == "gonio-mi" else []
    assert made == late
    assert dr.syntax is own
    mi.set_variant(before or VARIANT)


def test_loops_of_others_are_made_at_once(monkeypatch):
    """Of a plugin that follows the variant, such as a user's, with any arguments."""
    monkeypatch.setattr(sys, "argv", ["gonio-mi"])
    with mitsubas_made_late():
        made = dr.syntax(loop), dr.syntax(recursive=True)(loop)
    assert [hasattr(one, "__wrapped__") for one in made] == [False, False]
    assert [one(0) for one in made] == [3, 3]
    assert made[0].__code__ != loop.__code__


def loop(x):
    while x < 3:
        x += 1
    return x
