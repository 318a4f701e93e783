"""``gonio-mi measure``: a specimen is measured, shown and saved."""

import signal
import sys
import warnings
from functools import partial

from .. import files
from ..errors import checked_count
from ..instrument.campaigns import campaign
from ..instrument.measurement import measure
from ..results.summary import summarize, summary_text
from .arguments import (
    DONE,
    INCOMPLETE,
    USER_ERROR,
    add_scene_options,
    add_specimen,
    number,
    number_or_word,
    say,
    sentence,
    specimen_of,
    tell,
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


# Options that are arguments of `gonio_mi.measure`.
SETTINGS = (
    "collector",
    "rays",
    "rel_err",
    "max_rays",
    "sampler",
    "estimator",
    "points",
    "seed",
    "side",
    "footprint",
    "emission",
    "collector_radius",
    "hemispheres",
    "max_depth",
    "period",
    "order",
    "rr_depth",
    "trace",
    "wavelengths",
    "batches",
)


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
    add_specimen(parser)

    light = parser.add_argument_group(
        "light", "a collimated beam, or the scene's own emitter if no angle is given"
    )
    _add_light(light)
    _add_collector(parser.add_argument_group("collector"))
    _add_method(parser.add_argument_group("method"))
    _add_events(parser.add_argument_group("events on the surface"))
    add_scene_options(parser.add_argument_group("scene"))
    _add_output(parser.add_argument_group("output"))


def _add_light(group):
    """Add the options of the beam."""
    group.add_argument(
        "--theta-i",
        nargs="+",
        type=number,
        metavar="DEG",
        help="angles of incidence from the normal, in degrees in [0, 90)",
    )
    group.add_argument(
        "--phi-i",
        nargs="+",
        type=number,
        default=[0],
        metavar="DEG",
        help="azimuths of incidence in degrees, from +x counter-clockwise; each is "
        "combined with each --theta-i (default: 0)",
    )
    group.add_argument(
        "--side", default="front", help="lit face: front (default) or back"
    )
    group.add_argument(
        "--footprint",
        type=number_or_word,
        metavar="full|point|R",
        help="where light lands: all over the specimen, in its middle, or in a disk of "
        "radius R (default: full)",
    )
    group.add_argument(
        "--emission",
        metavar="E",
        help="weights of the rays of an emitter of finite size: radiometric (default) "
        "or equal_power",
    )
    group.add_argument(
        "--wavelengths",
        nargs="+",
        type=number,
        metavar="NM",
        help="channels of a spectral variant, in nm (default: 550)",
    )


def _add_collector(group):
    """Add the options of the collector."""
    group.add_argument(
        "--collector",
        metavar="KIND:NTxNP",
        help="patches of equal solid angle (solid), projected solid angle (projected), "
        "steps of angle (angle) or of its sine (sine), rings x sectors of each "
        "hemisphere (default: projected:30x30); or klems, "
        "borders:0,30,90x0,180,360 or apertures:HALF_ANGLE@THETA/PHI,...",
    )
    group.add_argument(
        "--collector-radius",
        type=number,
        metavar="R",
        help="radius of the collector in scene units (default: 0, the far field)",
    )
    group.add_argument(
        "--hemispheres",
        metavar="H",
        help="auto (default: the lower one if the specimen transmits), upper or both",
    )


def _add_method(group):
    """Add the options of estimator and sampler, and of how long to go on."""
    group.add_argument(
        "--rays",
        type=number,
        metavar="N",
        help="rays for each incident direction (default: 1e6)",
    )
    group.add_argument(
        "--rel-err",
        type=number,
        metavar="X",
        help="instead of --rays: go on until every patch worth reporting has this "
        "relative standard error; for quadrature the error of every patch (default "
        "there: 1e-4)",
    )
    group.add_argument(
        "--max-rays",
        type=number,
        metavar="N",
        help="where to stop then at the latest (default: 1e9)",
    )
    group.add_argument(
        "--estimator",
        metavar="E",
        help="weighted (default) sums the rays' power, analog counts rays, quadrature "
        "integrates the BSDF of a flat specimen without rays, next_event evaluates it "
        "on geometry towards points in random patches",
    )
    group.add_argument(
        "--points",
        type=number,
        metavar="N",
        help="points for each event, of the estimator next_event (default: 1)",
    )
    group.add_argument(
        "--sampler", metavar="S", help="Mitsuba sampler (default: sobol)"
    )
    group.add_argument(
        "--seed",
        type=number,
        default=0,
        metavar="S",
        help="same seed, same result, to the last bit (default: 0)",
    )
    group.add_argument(
        "--batches",
        type=number,
        metavar="N",
        help="independent batches, from which error bars come (default: 16)",
    )


def _add_events(group):
    """Add the options of what a ray may meet."""
    group.add_argument(
        "--max-depth",
        type=number,
        metavar="N",
        help="surface events before a ray is truncated (default: 1000)",
    )
    group.add_argument(
        "--period",
        metavar="box|PX,PY",
        help="the specimen is one cell of an infinite surface: its bounding box, or of "
        "these extents in x and y; what passes its openings is transmitted (default: "
        "none)",
    )
    group.add_argument(
        "--order",
        metavar="N|N+",
        help="collect rays with so many surface events, or at least so many; 0 is the "
        "light that passes a periodic specimen straight on (default: all)",
    )
    group.add_argument(
        "--rr-depth",
        type=number,
        metavar="N",
        help="surface events before Russian roulette (default: -1, never)",
    )
    group.add_argument(
        "--trace",
        action="store_true",
        default=None,
        help="trace rays even where a flat specimen does not need it",
    )


def _add_output(group):
    """Add the options of what becomes of the record."""
    group.add_argument(
        "-o",
        "--output",
        nargs="+",
        action="extend",
        default=[],
        metavar="FILE",
        help="write the record to these .exr or .npz files; both keep everything",
    )
    group.add_argument(
        "--resume",
        metavar="RECORD",
        help="carry on this interrupted record of the very same measurement",
    )
    group.add_argument(
        "--workers",
        type=number,
        metavar="N",
        help="measure the incident directions in that many processes",
    )
    group.add_argument(
        "--folder",
        metavar="DIR",
        help="keep finished incident directions there: the same command carries on, "
        "also after a crash",
    )
    group.add_argument(
        "-q", "--quiet", action="store_true", help="no numbers and no progress bar"
    )


def run(options):
    """Measure; what goes wrong with files does so before."""
    for path in options.output:
        files.check_output(path, files.ENDINGS)
    specimen, parameters = specimen_of(options.specimen, options)

    with _CtrlC() as ctrl_c:
        # said below, with the files' names
        warnings.filterwarnings("ignore", "interrupted: ", RuntimeWarning)
        record = _measure(options)(
            specimen,
            _one_or_many(options.theta_i),
            _one_or_many(options.phi_i),
            **{name: getattr(options, name) for name in SETTINGS},
            parameters=parameters,
            progress=not options.quiet and sys.stderr.isatty(),
        )
        ctrl_c.ignored = True
        unsaved = _save(record, options.output)
        if not options.quiet:
            tell(summary_text(summarize(record)))
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
    workers = options.workers
    if workers is not None:
        workers = checked_count("workers", workers)

    def _by_campaign(specimen, theta_i, phi_i, **settings):
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
                kept = "nothing was kept, for want of --folder"
            else:
                kept = f"{options.folder} holds what was finished; the same command "
                kept += "carries on"
            say(f"interrupted: {kept}")
            raise SystemExit(INCOMPLETE) from None
        return record if len(record) > 1 else record[0]

    return _by_campaign


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
    if record.ledger.emitted:
        kept = f"{record.ledger.emitted:,} rays".replace(",", " ")
    else:
        asked = len(options.theta_i or [None]) * len(options.phi_i)
        kept = f"{len(record)} of {asked} incident directions"
    if not options.output:
        return f"{kept} were finished and nothing was saved, for want of -o"
    kept = f"{' and '.join(options.output)} holds {kept}"
    if record.settings["estimator"] == "quadrature" or options.rel_err is not None:
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
