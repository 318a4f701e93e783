"""``gonio-mi validate``: examine a BSDF plugin, and say which function is wrong.

Examine a BSDF plugin: consistency of `sample`, `pdf` and `eval`, energy, reciprocity,
transport modes, flags, masks, and the ends of its domain.

examples:
  gonio-mi validate roughconductor:alpha=0.2,distribution=ggx
  gonio-mi validate mybsdf:roughness=0.3 --plugin mybsdf.py --report mybsdf.html
  gonio-mi validate scene.xml -D alpha=0.3 --effort thorough --json
  gonio-mi validate cosinelobe --allow reciprocity
  gonio-mi validate hair:sigma_a=0 --variant llvm_ad_mono --reproducer bug.py
  gonio-mi validate pplastic --variant llvm_ad_mono_polarized

Exit code 3: something that --allow does not name biases images, by 1e-4 of the flux at
least, or breaks integrators (with --strict: anything that fails). Exit code 4:
undecided, because no light was scattered, no integral converged, or a polarised plugin
could not be loaded in the unpolarised variant.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ...commands.arguments import (
    DONE,
    FAILED,
    UNDECIDED,
    add_json,
    add_number,
    add_scene_options,
    add_specimen,
    add_text,
    sentence,
    set_variant,
    specimen_of,
    tell,
    tell_json,
)
from ...commands.parser import Parser
from ...errors import SettingError, SpecimenError
from ...start_up import is_program
from ...surfaces.meshes import is_mesh

if TYPE_CHECKING:
    from ..verdict import Verdict

USAGE = "%(prog)s SPECIMEN [options]"

# Where a plugin is judged: with colours, and with one channel.
VARIANTS = ("llvm_ad_rgb", "llvm_ad_mono")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_specimen(parser, surfaces="a height map (x3p, ...), ")
    text = "Effort: quick (seconds), normal, thorough (minutes). Default: normal."
    add_text(parser, "--effort", "E", text, default="normal")
    text = "Properties that the model knowingly lacks: energy,reciprocity."
    add_text(parser, "--allow", "NAMES", text, default="")
    text = "Exit with code 3 for any failure."
    parser.add_argument("--strict", action="store_true", help=text)
    add_number(parser, "--seed", "S", "Seed of the random numbers.", 0)
    text = "Probability with which a correct plugin fails."
    add_number(parser, "--alpha", "P", text, 1e-3)
    add_text(parser, "--report", "HTML", "Write a page with verdict and maps.")
    text = "Write the worst failure as a script of at most 40 lines, without gonio_mi."
    add_text(parser, "--reproducer", "PY", text)
    add_json(parser)
    add_scene_options(parser, VARIANTS)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    import drjit as dr

    from .. import check_report, save_report
    from ..conditions import Effort
    from ..reproducers import save_reproducer

    if options.report is not None:
        check_report(options.report)
    threads = Effort.named(options.effort).threads
    if threads and is_program():  # a script's threads are its own
        dr.set_thread_count(threads)
    # JSON is the only output, whatever a plugin prints
    to = contextlib.redirect_stdout(sys.stderr)
    with to if options.json else contextlib.nullcontext():
        verdicts, skipped = _verdicts(options)
    # FAILED before UNDECIDED before passed: the user has to know of failures first
    verdict = min(verdicts, key=lambda one: (one.passed, bool(one.undecided)))
    others = [one for one in verdicts if one is not verdict]
    if options.report is not None:
        save_report(verdict, options.report)
    if options.reproducer is not None and verdict.failures:
        save_reproducer(verdict, options.reproducer)
    if options.json:
        answer = verdict.to_dict()
        answer["others"] = [one.to_dict() for one in others]
        answer["skipped"] = skipped
        tell_json(answer)
    else:
        tell(told(verdict, others, skipped))
    if verdict.undecided:
        return UNDECIDED
    return DONE if verdict.passed else FAILED


def examined(words: Sequence[str]) -> list[Verdict]:
    """Verdicts in each variant, for the words of a command line after the command."""
    parser = Parser(prog="gonio-mi validate")
    add_options(parser)
    return _verdicts(parser.parse_args(list(words)))[0]


def _verdicts(options: argparse.Namespace) -> tuple[list[Verdict], dict[str, str]]:
    """Verdict in each variant that the plugin knows, and why it knows no others."""
    if options.variant is not None:
        return [_verdict(options, options.variant)], {}
    verdicts: list[Verdict] = []
    silent: list[Verdict] = []
    skipped: dict[str, str] = {}
    first_error: Any = None
    for variant in VARIANTS:
        try:
            verdict = _verdict(options, variant)
        except SpecimenError as error:
            first_error = first_error or error
            skipped[variant] = sentence(error)
            continue
        if verdict.settings["variant"] in {one.settings["variant"] for one in verdicts}:
            skipped[variant] = f"the plugin file sets {verdict.settings['variant']}"
        elif verdict.answered:
            verdicts.append(verdict)
        else:
            silent.append(verdict)
            skipped[variant] = verdict["answers"].statistic
    if not (verdicts or silent):
        raise first_error
    if not verdicts:
        verdicts = silent[:1]
        del skipped[verdicts[0].settings["variant"]]
    return verdicts, skipped


def _verdict(options: argparse.Namespace, variant: str) -> Verdict:
    from ...specimen.loading import load_plugin_file, load_specimen
    from ...variants import is_polarised, parallel_variants, unpolarised
    from ..examination import validate
    from ..reproducers import source_of

    options = argparse.Namespace(**(vars(options) | {"variant": variant}))
    if is_polarised(variant):
        # the unpolarised variant is asked for the first element, if it knows the plugin
        with contextlib.suppress(SettingError):
            set_variant(unpolarised(variant))
            for path in options.plugin:
                load_plugin_file(path)
    specimen, parameters = specimen_of(options.specimen, options, parallel_variants())
    if is_mesh(specimen):
        raise SettingError(
            "validate examines a BSDF, such as roughconductor:alpha=0.2, and not the "
            f"shape that it is on, got the mesh {specimen}"
        )
    source = source_of(specimen, parameters)
    if parameters:
        specimen = load_specimen(specimen, parameters)
    verdict = validate(
        specimen,
        effort=options.effort,
        seed=options.seed,
        alpha=options.alpha,
        allow=[name for name in options.allow.split(",") if name],
        strict=options.strict,
        progress=options.effort != "quick",
    )
    loading = [f"runpy.run_path({path!r})" for path in options.plugin]
    if loading:
        loading.insert(0, "import runpy")
    source = verdict.source or source
    return replace(verdict, source=source and "\n".join([*loading, source]))


def told(
    verdict: Verdict, others: Sequence[Verdict], skipped: Mapping[str, str]
) -> str:
    """One verdict in full, and of the others what differs."""
    lines = [f"not judged in {name}: {reason}" for name, reason in skipped.items()]
    no_more = []
    for other in others:
        variant = other.settings["variant"]
        if _failed(other) <= _failed(verdict):
            found = "no further failures"
            if not _failed(other):
                found = "nothing wrong was found"
                found += "" if _failed(verdict) else " either"
            no_more.append(f"in {variant}: {found}{other.near}")
        else:
            lines.append(f"in {variant}:\n{other}\n")
    return "\n".join([*lines, str(verdict), *no_more])


def _failed(verdict: Verdict) -> set[str]:
    return {one.name for one in verdict.failures}
