"""The command line: ``gonio-mi COMMAND ...``.

Each command is a function that adds its parser, listed in `_COMMANDS`, beside one that
runs it and returns the exit code: 0 done, 1 the user's error, 2 the asked precision was
not reached or the measurement was interrupted, 3 a validation or comparison failed.
"""

import argparse
import json
import os
import re
import signal
import sys
import traceback
import warnings
from importlib import metadata
from pathlib import Path

import mitsuba as mi

from . import files, llvm
from .errors import FileFormatError, LLVMError, SpecimenError, VariantError
from .goniophotometer import measure
from .specimen import load_plugin_file, parse_specimen
from .summary import summarize, summary_text

__all__ = ["main"]

PROGRAM = "gonio-mi"
DONE, USER_ERROR, INCOMPLETE, FAILED = 0, 1, 2, 3

DEFAULT_VARIANT = "llvm_ad_mono"


def main(arguments=None):
    """Run the command line and return the exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Default: those of the process.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        warnings.showwarning = _show_warning
        options = None
        try:
            options = _parser().parse_args(arguments)
            return options.run(options)
        except KeyboardInterrupt:
            _say("interrupted: there is nothing to keep")
            return INCOMPLETE
        except BrokenPipeError:
            # the reader of our output has left; leave nothing to flush at exit
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return USER_ERROR
        except Exception as error:
            place = _place(error, getattr(options, "plugin", ()))
            if not (place or _is_the_users(error)):
                raise
            _say(place + _sentence(error))
            return USER_ERROR


# ------------------------------------------------------------------------- measure


def _add_measure(commands):
    parser = commands.add_parser(
        "measure",
        help="measure how a specimen scatters light",
        usage="%(prog)s SPECIMEN [--theta-i DEG ...] [options]",
        description="Measure how a specimen scatters light, and show the numbers.",
        epilog=MEASURE_EXAMPLES,
    )
    parser.set_defaults(run=_measure)
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
        type=_number,
        metavar="DEG",
        help="angles of incidence from the normal, in degrees in [0, 90)",
    )
    light.add_argument(
        "--phi-i",
        nargs="+",
        type=_number,
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
        type=_number_or_word,
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
        type=_number,
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
        type=_number,
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
        type=_number,
        metavar="N",
        help="rays for each incident direction (default: 1e6)",
    )
    method.add_argument(
        "--rel-err",
        type=_number,
        metavar="X",
        help="instead of --rays: go on until every patch worth reporting has this "
        "relative standard error",
    )
    method.add_argument(
        "--max-rays",
        type=_number,
        metavar="N",
        help="where to stop then at the latest (default: 1e9)",
    )
    method.add_argument(
        "--estimator",
        metavar="E",
        help="weighted (default) sums the rays' power, analog counts rays",
    )
    method.add_argument(
        "--sampler", metavar="S", help="Mitsuba sampler (default: sobol)"
    )
    method.add_argument(
        "--seed",
        type=_number,
        default=0,
        metavar="S",
        help="same seed, same result, to the last bit (default: 0)",
    )
    method.add_argument(
        "--batches",
        type=_number,
        metavar="N",
        help="independent batches, from which error bars come (default: 32)",
    )
    method.add_argument(
        "--max-depth",
        type=_number,
        metavar="N",
        help="surface events before a ray is truncated (default: 1000)",
    )
    method.add_argument(
        "--rr-depth",
        type=_number,
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
    scene.add_argument(
        "--variant",
        default=DEFAULT_VARIANT,
        metavar="V",
        help=f"Mitsuba variant (default: {DEFAULT_VARIANT})",
    )
    scene.add_argument(
        "--plugin",
        nargs="+",
        action="extend",
        default=[],
        metavar="FILE",
        help="Python files that register your own Mitsuba plugins; run first",
    )
    scene.add_argument(
        "-D",
        nargs="+",
        action="extend",
        default=[],
        type=_pair,
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
        "-q", "--quiet", action="store_true", help="no numbers and no progress bar"
    )


def _measure(options):
    """Measure; what goes wrong with files does so before."""
    for path in options.output:
        files.check_output(path)
    resume = None if options.resume is None else files.load(options.resume)
    _set_variant(options.variant)
    for path in options.plugin:
        load_plugin_file(path)
    specimen = parse_specimen(options.specimen)
    if options.parameters and isinstance(specimen, dict):
        raise ValueError(f"-D goes with a scene file, got {options.specimen!r}")

    with _CtrlC() as ctrl_c:
        # said below, with the files' names
        warnings.filterwarnings("ignore", "interrupted: ", RuntimeWarning)
        record = measure(
            specimen,
            _one_or_many(options.theta_i),
            _one_or_many(options.phi_i),
            collector=options.collector,
            rays=options.rays,
            rel_err=options.rel_err,
            max_rays=options.max_rays,
            sampler=options.sampler,
            estimator=options.estimator,
            seed=options.seed,
            side=options.side,
            footprint=options.footprint,
            emission=options.emission,
            collector_radius=options.collector_radius,
            hemispheres=options.hemispheres,
            max_depth=options.max_depth,
            rr_depth=options.rr_depth,
            trace=options.trace,
            wavelengths=options.wavelengths,
            batches=options.batches,
            parameters=dict(options.parameters),
            resume=resume,
            progress=not options.quiet and sys.stderr.isatty(),
        )
        ctrl_c.ignored = True
        unsaved = _save(record, options.output)
        if not options.quiet:
            print(summary_text(summarize(record)))
        if ctrl_c.pressed:
            _say(f"interrupted: {_remains(options, record)}")
    if unsaved:
        return USER_ERROR
    return INCOMPLETE if ctrl_c.pressed or _is_imprecise(record) else DONE


def _save(record, paths):
    """Write the record to every path that it can be written to; return the others."""
    unsaved = []
    for path in paths:
        try:
            record.save(path)
        except OSError as error:
            unsaved.append(path)
            _say(_sentence(error))
    return unsaved


def _is_imprecise(record):
    """Whether a precision was asked for and not reached."""
    asked = record.settings.get("rel_err")
    return asked is not None and record.settings["reached"] > asked


def _one_or_many(values):
    """The value of a list of one: it asks for a record, not for a stack."""
    return values[0] if values is not None and len(values) == 1 else values


def _set_variant(variant):
    """Set a Mitsuba variant that the instrument can use."""
    usable = [
        name
        for name in mi.variants()
        if not (name.startswith("scalar") or name.endswith("polarized"))
    ]
    if variant not in usable:
        raise ValueError(
            f"--variant must be one of {', '.join(usable)}, got {variant!r}"
        )
    if variant.startswith("llvm"):
        llvm.check()
    try:
        mi.set_variant(variant)
    except ImportError as error:
        raise VariantError(
            f"the variant {variant} does not work on this machine: {error}"
        ) from error


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


# ----------------------------------------------------------------- records and machine


def _add_show(commands):
    parser = commands.add_parser(
        "show",
        help="show the numbers of a record",
        description="Show the numbers of a record: reflectance and transmittance with "
        "their intervals, where every ray went, and the worst patches.",
        epilog="example:\n  gonio-mi show run.npz --json | jq .directions[0].dhr",
    )
    parser.set_defaults(run=_show)
    parser.add_argument("record", metavar="RECORD", help="an .exr or .npz file")
    parser.add_argument("--json", action="store_true", help="for machines")


def _show(options):
    numbers = summarize(files.load(options.record))
    if options.json:
        print(json.dumps(numbers, indent=2, allow_nan=False))
    else:
        print(summary_text(numbers))
    return DONE


def _add_plot(commands):
    parser = commands.add_parser(
        "plot",
        help="draw a record",
        description="Draw a record: polar map, and profile in the plane of incidence "
        "with error bars.",
        epilog="example:\n  gonio-mi plot run.npz -o run.png",
    )
    parser.set_defaults(run=_plot)
    parser.add_argument("record", metavar="RECORD", help="an .exr or .npz file")
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="FIG",
        help="a .png, .pdf or .svg file",
    )
    parser.add_argument(
        "--index",
        type=_number,
        default=0,
        metavar="J",
        help="number of the incident direction of a stack (default: 0, the first)",
    )


def _plot(options):
    record = files.load(options.record)
    from .plot import plot  # matplotlib is an extra, and slow to import

    plot(record, options.output, index=options.index)
    return DONE


def _add_compare(commands):
    parser = commands.add_parser(
        "compare",
        help="compare with another record or with measured values",
        usage="%(prog)s RECORD OTHER [options]",
        description="Compare a record with another record of the same collector, patch "
        "by patch, or with a\nCSV table of measured values, whose columns are theta_i, "
        "phi_i, theta_o, phi_o, value\nand, optional, sigma. A specimen in place of "
        "the record is measured at the solid\nangles of the table and under its "
        "emitter.",
        epilog=COMPARE_EXAMPLES,
    )
    parser.set_defaults(run=_compare)
    parser.add_argument(
        "record",
        metavar="RECORD",
        help="an .exr or .npz file; with a table also a specimen as of `measure`",
    )
    parser.add_argument(
        "other", metavar="OTHER", help="an .exr or .npz file, or a CSV table"
    )
    parser.add_argument(
        "--uncertainty",
        type=_number,
        metavar="X",
        help="relative standard uncertainty of each value of OTHER, 0.005 for 0.5 %%, "
        "independent between points (default: what the table says)",
    )
    parser.add_argument(
        "--scale-uncertainty",
        type=_number,
        metavar="X",
        help="the same of a factor common to all values: calibration",
    )
    parser.add_argument(
        "--alpha",
        type=_number,
        default=1e-3,
        metavar="P",
        help="probability with which a right model fails (default: 1e-3)",
    )
    parser.add_argument("--json", action="store_true", help="for machines")
    parser.add_argument(
        "-o", "--output", metavar="FIG", help="picture of both curves, such as a.png"
    )
    specimen = parser.add_argument_group("for a specimen")
    specimen.add_argument(
        "--rays",
        type=_number,
        metavar="N",
        help="rays for each incident direction (default: 1e6)",
    )
    specimen.add_argument("--seed", type=_number, default=0, metavar="S")
    specimen.add_argument(
        "--aperture-half-angle",
        type=_number,
        metavar="DEG",
        help="of the detector, if the table does not say it",
    )
    specimen.add_argument(
        "--variant",
        default=DEFAULT_VARIANT,
        metavar="V",
        help=f"Mitsuba variant (default: {DEFAULT_VARIANT})",
    )
    specimen.add_argument(
        "--plugin",
        nargs="+",
        action="extend",
        default=[],
        metavar="FILE",
        help="Python files that register your own Mitsuba plugins; run first",
    )


def _compare(options):
    from .comparison import compare, measure_like
    from .comparison_plot import check_picture
    from .measured import read_measured

    def is_record(path):
        return Path(path).suffix.lower() in files.ENDINGS

    if options.output is not None:
        check_picture(options.output)
    other = (files.load if is_record(options.other) else read_measured)(options.other)
    if is_record(options.record):
        record = files.load(options.record)
    elif is_record(options.other):
        raise ValueError(
            f"RECORD must be an .exr or .npz file if OTHER is one, got {options.record}"
        )
    else:
        _set_variant(options.variant)
        for path in options.plugin:
            load_plugin_file(path)
        record = measure_like(
            parse_specimen(options.record),
            other,
            aperture_half_angle=options.aperture_half_angle,
            rays=options.rays,
            seed=options.seed,
        )
    comparison = compare(
        record,
        other,
        uncertainty=options.uncertainty,
        scale_uncertainty=options.scale_uncertainty,
        alpha=options.alpha,
    )
    if options.output is not None:
        comparison.plot(options.output)
    if options.json:
        print(json.dumps(comparison.to_dict(), indent=2, allow_nan=False))
    else:
        print(comparison)
    return DONE if comparison.passed else FAILED


def _add_doctor(commands):
    parser = commands.add_parser(
        "doctor",
        help="is this machine able to measure?",
        description="Find out whether this machine is able to measure; if it is not, "
        "say the line that fixes it.",
    )
    parser.set_defaults(run=_doctor)


def _doctor(_options):
    from . import doctor

    return doctor.run()


# --------------------------------------------------------------------------- parsing


_COMMANDS = (_add_measure, _add_show, _add_plot, _add_compare, _add_doctor)

EXAMPLES = """\
examples:
  gonio-mi measure diffuse --theta-i 45
  gonio-mi measure scene.xml -D alpha=0.3 --rays 1e8 -o run.npz
  gonio-mi show run.npz
  gonio-mi plot run.npz -o run.png

exit codes: 0 done, 1 an error of yours (said in one line), 2 interrupted, or the asked
precision was not reached, 3 a validation or comparison failed
"""

MEASURE_EXAMPLES = """\
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


COMPARE_EXAMPLES = """\
examples:
  gonio-mi compare run.npz another.npz
  gonio-mi compare run.npz measured.csv --uncertainty 0.005 -o compared.png
  gonio-mi compare roughconductor:alpha=0.2 measured.csv --rays 1e8 --json

The table's header holds lines such as `# quantity: brdf`, `# uncertainty: 0.005`,
`# aperture_half_angle: 0.75` and `# emitter_half_angle: 0.25`; angles are in degrees.
Exit code 3: they differ by more than chance explains.
"""


class _Parser(argparse.ArgumentParser):
    """Parser whose errors are exceptions, for one sentence and one exit code."""

    def __init__(self, **kwargs):
        super().__init__(
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
            **kwargs,
        )
        # -1e3 is a number too, before Python 3.14
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def error(self, message):
        """Raise it."""
        raise _UsageError(re.sub(r"^argument (\S+): (?=must )", r"\1 ", message))


class _UsageError(ValueError):
    """Arguments that cannot be parsed."""


def _parser():
    parser = _Parser(
        prog=PROGRAM,
        description="A virtual goniophotometer for Mitsuba 3.",
        epilog=EXAMPLES,
    )
    version = metadata.version("gonio-mi")
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {version}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for add in _COMMANDS:
        add(commands)
    return parser


def _number(text):
    """Whole number or float; the measurement checks its range."""
    try:
        return int(text)
    except ValueError:
        pass
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"must be a number such as 45 or 1e7, got {text!r}"
        ) from None


def _number_or_word(text):
    try:
        return float(text)
    except ValueError:
        return text


def _pair(text):
    """Name and value of ``name=value``."""
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"must look like key=value, got {text!r}")
    return name, value


# -------------------------------------------------------------------------- messages


def _say(text):
    print(f"{PROGRAM}: {text}", file=sys.stderr)


def _show_warning(message, *_, **__):
    _say(f"warning: {' '.join(str(message).split())}")


def _is_the_users(error):
    """Whether an error is the user's to mend, and not a bug to trace.

    That is what the instrument itself raises, and what files do.
    """
    own = (FileFormatError, LLVMError, SpecimenError, VariantError, _UsageError)
    if isinstance(error, (*own, OSError)):
        return True
    innermost = list(traceback.walk_tb(error.__traceback__))[-1][0]
    module = innermost.f_globals.get("__name__", "")
    ours = (ImportError, TypeError, ValueError)
    return isinstance(error, ours) and module.startswith(__package__)


def _place(error, plugins):
    """Where in the user's own plugin files an error arose; empty if it did not."""
    names = {os.fspath(Path(plugin)) for plugin in plugins}
    place = ""
    for frame, line in traceback.walk_tb(error.__traceback__):
        code = frame.f_code
        if code.co_filename in names:
            place = f"{code.co_filename}, line {line}, in {code.co_name}: "
            place += f"{type(error).__name__}: "
    return place


def _sentence(error):
    """One line."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())
