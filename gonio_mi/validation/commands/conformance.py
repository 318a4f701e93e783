"""``gonio-mi conformance``: Mitsuba's own plugins under several versions, as a page.

Check the functions of Mitsuba's own BSDFs and phase functions for consistency under
several installed versions, and write a page: a row for each set of parameters, a column
for each version, and for each inconsistency a script of at most 40 lines.

examples:
  python3 -m venv old && old/bin/pip install mitsuba==3.8.0 numpy
  gonio-mi conformance --against old -o table.html
  gonio-mi conformance --variants llvm_ad_mono llvm_ad_spectral -o table.html

The other environments need Mitsuba and NumPy, nothing of this package.
Exit code 3: something is inconsistent.
"""

from argparse import ArgumentParser, Namespace

from ...commands.arguments import DONE, FAILED, INCOMPLETE, add_text, say, tell

USAGE = "%(prog)s -o PAGE.html [--against VENV ...] [options]"


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    text = "Other virtual environments, or their Pythons, beside this one."
    add_text(parser, "--against", "VENV", text, nargs="+", default=[])
    text = "Variants of Mitsuba. Default: llvm_ad_mono."
    add_text(parser, "--variants", "V", text, nargs="+", default=["llvm_ad_mono"])
    add_text(parser, "-o", "HTML", "The page.", dest="output", required=True)


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    import sys

    import mitsuba as mi

    from ...errors import SettingError
    from ...reports.page import check_page
    from ..versions.asking import interpreter
    from ..versions.conformance import Answer, ask_versions, save_table

    check_page(options.output)
    # scalar and polarised ones too, which are asked and not measured in
    for variant in options.variants:
        if variant not in mi.variants():
            known = ", ".join(mi.variants())
            raise SettingError(f"--variants must be of {known}, got {variant!r}")
    pythons = [interpreter(venv) for venv in options.against]
    answers: list[Answer] = []
    try:
        for one in ask_versions([sys.executable, *pythons], options.variants, True):
            answers.append(one)
    except KeyboardInterrupt:
        if not answers:
            raise
        save_table(answers, options.output)
        say(f"interrupted: {options.output} has the {len(answers)} answers so far")
        return INCOMPLETE
    save_table(answers, options.output)
    wrong = [one for one in answers if one.wrong]
    for one in wrong:
        asked = one.question
        tell(f"{one.version}, {one.variant}: {asked.word}: {asked.name}: {one.text}")
    silent = sum(one.raised for one in answers)
    tell(f"{len(answers)} questions: {len(wrong)} wrong, {silent} without an answer")
    return FAILED if wrong else DONE
