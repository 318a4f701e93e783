"""``gonio-mi measure``: a specimen is measured, shown and saved."""

import signal
import sys
import warnings
from functools import partial

from .. import files
from ..campaign import campaign
from ..errors import checked_count
from ..goniophotometer import measure
from ..specimen import load_plugin_file, parse_specimen
from ..summary import summarize, summary_text
from .arguments import (
    DONE,
    INCOMPLETE,
    USER_ERROR,
    add_scene_options,
    number,
    number_or_word,
    pair,
    say,
    sentence,
    set_variant,
)

__all__ = ["add", "run"]

EXAMPLES = """\
examples:
  gonio-mi measure diffuse --theta-i 45
  gonio-mi measure roughconductor:alpha=0.2,distribution=ggx --theta-i 0 30 60 \\
      --rays 1e8 -o run.npz map.exr
  gonio-mi measure roughdielectric:alpha=0.1 --theta-i 45 --rel-err 0.01
  gonio-mi measure plastic:diffuse_reflectance=0.2/0.5/0.1 --theta-i 45 \\
      --variant llvm_ad_rgb
  gonio-mi measure mybsdf:roughness=0.3 --plugin mybsdf.py --theta-i 45
  gonio-mi measure scene.xml -D height=0.5 --theta-i 45 -o run.npz
  gonio-mi measure scene.xml -D height=0.5 --theta-i 45 -o run.npz --resume run.npz

Options take their defaults from the scene file if that is a complete measurement
(integrator `goniophotometer`, sensor `collector`). SPECIMEN comes first.
"""


def add(commands):
    """Add the parser of the command."""
    parser = commands.add_parser(
        "measure",
        help="measure how a specimen scatters light",
        usage="%(prog)s SPECIMEN [--theta-i DEG ...] [options]",
        description="Measure how a specimen scatters light, and show the numbers.",
        epilog=EXAMPLES,
    )
    parser.set_defaults(run=run)
    parser.add_argument(
        "specimen",
        metavar="SPECIMEN",
        help="a Mitsuba scene file, or a BSDF in one word such as "
        "roughconductor:alpha=0.2,distribution=ggx",
    )

    light = parser.add_argument_group(
        "light", "a collimated beam, or the scene's own emitter if no angle is given"
    )
    light.add_argument(
        "--theta-i",
        nargs="+",
        type=number,
        metavar="DEG",
        help="angles of incidence from the normal, in degrees in [0, 90)",
    )
    light.add_argument(
        "--phi-i",
        nargs="+",
        type=number,
        default=[0],
        metavar="DEG",
        help="azimuths of incidence in degrees, from +x counter-clockwise; each is "
        "combined with each --theta-i (default: 0)",
    )
    light.add_argument(
        "--side", default="front", help="lit face: front (default) or back"
    )
    light.add_argument(
        "--footprint",
        type=number_or_word,
        metavar="full|point|R",
        help="where light lands: all over the specimen, in its middle, or in a disk of "
        "radius R (default: full)",
    )
    light.add_argument(
        "--emission",
        metavar="E",
        help="weights of the rays of an emitter of finite size: radiometric (default) "
        "or equal_power",
    )
    light.add_argument(
        "--wavelengths",
        nargs="+",
        type=number,
        metavar="NM",
        help="channels of a spectral variant, in nm (default: 550)",
    )

    collector = parser.add_argument_group("collector")
    collector.add_argument(
        "--collector",
        metavar="KIND:NTxNP",
        help="patches of equal solid angle (solid), projected solid angle (projected) "
        "or steps of angle (angle), rings x sectors of each hemisphere (default: "
        "projected:30x30)",
    )
    collector.add_argument(
        "--collector-radius",
        type=number,
        metavar="R",
        help="radius of the collector in scene units (default: 0, the far field)",
    )
    collector.add_argument(
        "--hemispheres",
        metavar="H",
        help="auto (default: the lower one if the specimen transmits), upper or both",
    )

    method = parser.add_argument_group("method")
    method.add_argument(
        "--rays",
        type=number,
        metavar="N",
        help="rays for each incident direction (default: 1e6)",
    )
    method.add_argument(
        "--rel-err",
        type=number,
        metavar="X",
        help="instead of --rays: go on until every patch worth reporting has this "
        "relative standard error; for quadrature the error of every patch (default "
        "there: 1e-4)",
    )
    method.add_argument(
        "--max-rays",
        type=number,
        metavar="N",
        help="where to stop then at the latest (default: 1e9)",
    )
    method.add_argument(
        "--estimator",
        metavar="E",
        help="weighted (default) sums the rays' power, analog counts rays, quadrature "
        "integrates the BSDF of a flat specimen without rays, next_event evaluates it "
        "on geometry towards points in random patches",
    )
    method.add_argument(
        "--points",
        type=number,
        metavar="N",
        help="points for each event, of the estimator next_event (default: 1)",
    )
    method.add_argument(
        "--sampler", metavar="S", help="Mitsuba sampler (default: sobol)"
    )
    method.add_argument(
        "--seed",
        type=number,
        default=0,
        metavar="S",
        help="same seed, same result, to the last bit (default: 0)",
    )
    method.add_argument(
        "--batches",
        type=number,
        metavar="N",
        help="independent batches, from which error bars come (default: 16)",
    )
    method.add_argument(
        "--max-depth",
        type=number,
        metavar="N",
        help="surface events before a ray is truncated (default: 1000)",
    )
    method.add_argument(
        "--period",
        metavar="box|PX,PY",
        help="the specimen is one cell of an infinite surface: its bounding box, or of "
        "these extents in x and y (default: none)",
    )
    method.add_argument(
        "--order",
        metavar="N|N+",
        help="collect rays with so many surface events, or at least so many "
        "(default: all)",
    )
    method.add_argument(
        "--rr-depth",
        type=number,
        metavar="N",
        help="surface events before Russian roulette (default: -1, never)",
    )
    method.add_argument(
        "--trace",
        action="store_true",
        default=None,
        help="trace rays even where a flat specimen does not need it",
    )

    scene = parser.add_argument_group("scene")
    add_scene_options(scene)
    scene.add_argument(
        "-D",
        nargs="+",
        action="extend",
        default=[],
        type=pair,
        dest="parameters",
        metavar="KEY=VALUE",
        help="values of the $KEY parameters of the scene file",
    )

    output = parser.add_argument_group("output")
    output.add_argument(
        "-o",
        "--output",
        nargs="+",
        action="extend",
        default=[],
        metavar="FILE",
        help="write the record to these .exr or .npz files; both keep everything",
    )
    output.add_argument(
        "--resume",
        metavar="RECORD",
        help="carry on this interrupted record of the very same measurement",
    )
    output.add_argument(
        "--workers",
        type=number,
        metavar="N",
        help="measure the incident directions in that many processes",
    )
    output.add_argument(
        "--folder",
        metavar="DIR",
        help="keep finished incident directions there: the same command carries on, "
        "also after a crash",
    )
    output.add_argument(
        "-q", "--quiet", action="store_true", help="no numbers and no progress bar"
    )


def run(options):
    """Measure; what goes wrong with files does so before."""
    for path in options.output:
        files.check_output(path)
    set_variant(options.variant)
    for path in options.plugin:
        load_plugin_file(path)
    specimen = parse_specimen(options.specimen)
    if options.parameters and isinstance(specimen, dict):
        raise ValueError(f"-D goes with a scene file, got {options.specimen!r}")

    with _CtrlC() as ctrl_c:
        # said below, with the files' names
        warnings.filterwarnings("ignore", "interrupted: ", RuntimeWarning)
        record = _measure(options)(
            specimen,
            _one_or_many(options.theta_i),
            _one_or_many(options.phi_i),
            collector=options.collector,
            rays=options.rays,
            rel_err=options.rel_err,
            max_rays=options.max_rays,
            sampler=options.sampler,
            estimator=options.estimator,
            points=options.points,
            seed=options.seed,
            side=options.side,
            footprint=options.footprint,
            emission=options.emission,
            collector_radius=options.collector_radius,
            hemispheres=options.hemispheres,
            max_depth=options.max_depth,
            period=options.period,
            order=options.order,
            rr_depth=options.rr_depth,
            trace=options.trace,
            wavelengths=options.wavelengths,
            batches=options.batches,
            parameters=dict(options.parameters),
            progress=not options.quiet and sys.stderr.isatty(),
        )
        ctrl_c.ignored = True
        unsaved = _save(record, options.output)
        if not options.quiet:
            print(summary_text(summarize(record)))
        if ctrl_c.pressed:
            say(f"interrupted: {_remains(options, record)}")
    if unsaved:
        return USER_ERROR
    return INCOMPLETE if ctrl_c.pressed or _is_imprecise(record) else DONE


def _measure(options):
    """Function that measures here and at once, or in a campaign."""
    if options.workers is None and options.folder is None:
        resume = None if options.resume is None else files.load(options.resume)
        return partial(measure, resume=resume)
    if options.resume is not None:
        raise ValueError("--resume goes without --workers and --folder")
    workers = options.workers and checked_count("workers", options.workers)

    def by_campaign(specimen, theta_i, phi_i, **settings):
        try:
            record = campaign(
                {options.specimen: specimen},
                theta_i,
                phi_i,
                executor=workers,
                folder=options.folder,
                plugins=options.plugin,
                **settings,
            )[options.specimen]
        except KeyboardInterrupt:
            if options.folder is None:
                raise
            say(
                f"interrupted: {options.folder} holds what was finished; the same "
                "command carries on"
            )
            raise SystemExit(INCOMPLETE) from None
        return record if len(record) > 1 else record[0]

    return by_campaign


def _save(record, paths):
    """Write the record to every path that it can be written to; return the others."""
    unsaved = []
    for path in paths:
        try:
            record.save(path)
        except OSError as error:
            unsaved.append(path)
            say(sentence(error))
    return unsaved


def _is_imprecise(record):
    """Whether a precision was asked for and not reached."""
    asked = record.settings.get("rel_err")
    return asked is not None and record.settings.get("reached", 0) > asked


def _one_or_many(values):
    """The value of a list of one: it asks for a record, not for a stack."""
    return values[0] if values is not None and len(values) == 1 else values


def _remains(options, record):
    """What is left of an interrupted measurement."""
    rays = f"{record.ledger.emitted:,}".replace(",", " ")
    if not options.output:
        return f"{rays} rays were measured and nothing was saved, for want of -o"
    kept = f"{' and '.join(options.output)} holds {rays} rays"
    if options.rel_err is not None:
        return kept
    return f"{kept}; --resume {options.output[0]} carries it on"


class _CtrlC:
    """Ctrl-C while measuring: the first ends it; later ones are ignored to the end.

    Attributes
    ----------
    pressed : bool
        Whether the measurement was ended by it.
    ignored : bool
        To be set when nothing is to be ended any more.
    """

    def __init__(self):
        self.pressed = self.ignored = False

    def __enter__(self):
        self._previous = signal.signal(signal.SIGINT, self._press)
        return self

    def __exit__(self, *_):
        after = signal.SIG_IGN if self.pressed else self._previous
        signal.signal(signal.SIGINT, after)

    def _press(self, *_):
        if not (self.ignored or self.pressed):
            self.pressed = True
            raise KeyboardInterrupt
