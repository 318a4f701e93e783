"""``gonio-mi chart``: speed against accuracy for a specimen: what to use.

Measure a specimen by every method with more and more rays, and chart the error over
rays and over CPU seconds.
"""

import sys
from argparse import ArgumentParser, Namespace
from functools import partial
from pathlib import Path
from typing import Any

from .. import files
from .arguments import (
    DONE,
    add_number,
    add_output,
    add_scene_options,
    add_specimen,
    add_text,
    say,
    specimen_of,
    tell,
)
from .setting_options import add_setting

__all__ = ["add_options", "run"]

USAGE = "%(prog)s SPECIMEN [--theta-i DEG] [options]"

EXAMPLES = """\
examples:
  gonio-mi chart diffuse --theta-i 45
  gonio-mi chart roughplastic:alpha=0.2 --theta-i 45 -o chart.png chart.csv
  gonio-mi chart scenes/micro_geometry.xml --seconds 300 -o chart.png
  gonio-mi chart principled --theta-i 30 --sampler independent stratified sobol

The error is the root mean square over the patches, relative to the mean BSDF; the time
is that of the process, all threads together, without compilation. SPECIMEN comes first.
"""


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_specimen(parser)
    add_number(
        parser,
        "--theta-i",
        "DEG",
        "angle of incidence in degrees in [0, 90); the scene's own emitter if it is "
        "not given",
    )
    add_number(parser, "--phi-i", "DEG", "azimuth of incidence in degrees", 0)
    for name in ("side", "collector"):
        add_setting(parser, name)
    _add_methods(parser.add_argument_group("methods"))
    add_scene_options(parser.add_argument_group("scene"))
    output = parser.add_argument_group("output")
    add_output(output, "write the chart to these .png, .pdf, .svg, .html or .csv files")


def _add_methods(group: Any) -> None:
    """Add the options that say what is compared, and for how long."""
    add_text(
        group,
        "--estimator",
        "E",
        "estimators to compare (default: all that apply)",
        nargs="+",
    )
    add_text(
        group,
        "--sampler",
        "S",
        "samplers to compare (default: independent sobol)",
        nargs="+",
    )
    add_number(group, "--seconds", "T", "about how long all of it may take", 60)
    add_number(
        group, "--target", "X", "relative error for which costs are compared", 0.01
    )
    add_number(
        group, "--repeats", "N", "measurements of different seeds for each point", 4
    )
    for name in ("batches", "seed"):
        add_setting(group, name)


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    from ..charts import ESTIMATORS, SAMPLERS, Chart, chart
    from ..charts.figure import plot_chart, save_chart_page
    from ..errors import checked_number
    from ..plots import check_picture
    from ..reports.page import check_page

    writers = {}
    for path in options.output:
        ending = Path(path).suffix.lower()
        if ending == ".csv":
            files.check_output(path, (".csv",))
            writers[path] = Chart.save_csv
        elif ending == ".html":
            check_page(path)
            writers[path] = partial(save_chart_page, target=options.target)
        else:
            check_picture(path)
            writers[path] = partial(plot_chart, target=options.target)
    target = checked_number("target", options.target, 1e-9, 1, "a number in (0, 1)")
    specimen, parameters = specimen_of(options.specimen, options)
    result = chart(
        specimen,
        options.theta_i,
        options.phi_i,
        estimators=options.estimator or ESTIMATORS,
        samplers=options.sampler or SAMPLERS,
        seconds=options.seconds,
        repeats=options.repeats,
        seed=options.seed or 0,
        parameters=parameters,
        progress=not options.quiet and sys.stderr.isatty(),
        collector=options.collector,
        side=options.side or "front",
        batches=options.batches,
    )
    for path, write in writers.items():
        write(result, path)
    if not options.quiet:
        tell("\n".join([result.table(target), *result.findings(target)]))
    if not any(cost.measured for _, cost in result.ranking(target)):
        say(f"warning: no method reached {target:g}; take more --seconds")
    return DONE
