"""``gonio-mi chart``: chart speed against accuracy for a specimen.

Measure a specimen by every method with increasing numbers of rays, and chart the error
against rays and CPU seconds.

examples:
  gonio-mi chart diffuse --theta-i 45
  gonio-mi chart roughplastic:alpha=0.2 --theta-i 45 -o chart.png chart.csv
  gonio-mi chart scenes/micro_geometry.xml --seconds 300 -o chart.png
  gonio-mi chart principled --theta-i 30 --sampler independent stratified sobol

The error is the root mean square over the patches, relative to the mean BSDF; the time
is that of the process, all threads together, without compilation. SPECIMEN comes first.
"""

import sys
from argparse import ArgumentParser, Namespace
from functools import partial
from pathlib import Path

from ... import files
from ...commands.arguments import (
    DONE,
    add_number,
    add_output,
    add_scene_options,
    add_setting,
    add_specimen,
    add_text,
    say,
    specimen_of,
    tell,
)
from ...commands.surface import add_surface_options, prepared_surface

USAGE = "%(prog)s SPECIMEN [--theta-i DEG] [options]"


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_specimen(parser)
    text = "Angle of incidence in [0, 90). Default: the scene's own emitter."
    add_number(parser, "--theta-i", "DEG", text)
    add_number(parser, "--phi-i", "DEG", "Azimuth of incidence.", 0)
    for name in ("side", "collector"):
        add_setting(parser, name)
    group = parser.add_argument_group("Methods")
    text = "Estimators to compare. Default: all that apply."
    add_text(group, "--estimator", "E", text, nargs="+")
    text = "Samplers to compare. Default: independent and sobol."
    add_text(group, "--sampler", "S", text, nargs="+")
    add_number(group, "--seconds", "T", "Approximate time for the whole chart.", 60)
    text = "Relative error for which costs are compared."
    add_number(group, "--target", "X", text, 0.01)
    text = "Measurements with different seeds for each point."
    add_number(group, "--repeats", "N", text, 4)
    for name in ("batches", "seed"):
        add_setting(group, name)
    add_surface_options(parser)
    add_scene_options(parser)
    text = "Write the chart to these .png, .pdf, .svg, .html or .csv files."
    add_output(parser.add_argument_group("Output"), text)


def run(options: Namespace) -> int:
    """Run the command and return the exit code."""
    from ...errors import checked_number
    from ...plots import check_picture
    from ...reports.page import check_page
    from ..charts import ESTIMATORS, SAMPLERS, Chart, chart
    from ..charts.figure import plot_chart, save_chart_page

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
    specimen = prepared_surface(specimen, options)
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
