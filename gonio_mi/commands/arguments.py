"""Arguments that commands share: exit codes, options, messages, specimens, tables."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from .. import llvm
from ..annexes import ask
from ..errors import (
    FileFormatError,
    SettingError,
    VariantError,
    did_you_mean,
    no_file,
    printable,
    shortened,
)
from ..start_up import PROGRAM
from .file_kinds import check_kind

if TYPE_CHECKING:
    from ..files.measured_table import MeasuredTable
    from ..results.record import Record
    from ..settings import Kind
    from ..specimen.specimen_text import SpecimenLike

DONE, USER_ERROR, INCOMPLETE, FAILED, UNDECIDED = 0, 1, 2, 3, 4

DEFAULT_VARIANT = "llvm_ad_mono"


# What options are added to: a parser, or a group of one.
Group: TypeAlias = argparse._ActionsContainer


# ------------------------------------------------------------- options and arguments


SURFACES = "a height map (x3p, ...), a mesh (obj, ply, stl) with --bsdf, "


def add_specimen(parser: argparse.ArgumentParser, surfaces: str = SURFACES) -> None:
    """Add the argument that :func:`specimen_of` understands."""
    text = (
        f"A Mitsuba scene file, {surfaces}or a BSDF such as roughconductor:alpha=0.2."
    )
    add_text(parser, "specimen", "SPECIMEN", text)


def add_number(
    group: Group, option: str, metavar: str, text: str, default: float | None = None
) -> None:
    """Add an option that is a number; its help ends with the default, if it has one."""
    if default is not None:
        text += f" Default: {default:g}."
    group.add_argument(option, type=number, default=default, metavar=metavar, help=text)


def add_stokes(group: Group, text: str) -> None:
    """Add the option that takes the Stokes vector of incident light."""
    text += " For records of polarised variants; 1 1 0 0 is light polarised along s."
    names: Any = ("I", "Q", "U", "V")
    add_text(group, "--stokes", names, text, nargs=4, type=number)


def add_text(group: Group, option: str, metavar: str, text: str, **how: Any) -> None:
    """Add an option or argument with one value, or several if `how` states it."""
    group.add_argument(option, metavar=metavar, help=text, **how)


def add_files(group: Group, *options: str, text: str) -> None:
    """Add an option that takes any number of files, and may be given again."""
    group.add_argument(
        *options, nargs="+", action="extend", default=[], metavar="FILE", help=text
    )


def add_output(group: Group, text: str) -> None:
    """Add the options for output files and quiet runs."""
    add_files(group, "-o", "--output", text=text)
    add_quiet(group)


def add_quiet(group: Group) -> None:
    """Add the option that suppresses output."""
    text = "Suppress summary and progress bar."
    group.add_argument("-q", "--quiet", action="store_true", help=text)


def add_json(group: Group) -> None:
    """Add the option of printing JSON."""
    group.add_argument("--json", action="store_true", help="Print the result as JSON.")


def add_scene_options(
    parser: argparse.ArgumentParser, variants: Sequence[str] = (DEFAULT_VARIANT,)
) -> None:
    """Add the options for variant, plugins and parameters of specimens.

    The default of ``--variant`` is None where a command takes several `variants`.
    """
    group = parser.add_argument_group("Scene")
    default = variants[0] if len(variants) == 1 else None
    text = f"Mitsuba variant. Default: {' and '.join(variants)}."
    add_text(group, "--variant", "V", text, default=default)
    add_files(group, "--plugin", text="Python files that register Mitsuba plugins.")
    how: dict[str, Any] = {"nargs": "+", "action": "extend", "default": []}
    text = "Values of the $KEY parameters of the scene file."
    add_text(group, "-D", "KEY=VALUE", text, dest="parameters", type=pair, **how)


# --------------------------------------------------------- settings of a measurement


def add_settings_group(
    parser: argparse.ArgumentParser, title: str, description: str | None = None
) -> Any:
    """Group of a parser, with the options of the settings declared in it."""
    from ..settings import MeasurementSettings, declarations  # with NumPy

    group = parser.add_argument_group(title.capitalize(), description)
    for name, declared in declarations(MeasurementSettings).items():
        if declared.group == title:
            add_setting(group, name)
    return group


def add_setting(group: Group, name: str, default: str | None = None) -> None:
    """Add the option of one setting, with its declared sentence and default.

    A command whose `default` is another says so. The measurement checks values.
    """
    from ..settings import Kind, MeasurementSettings, declarations

    readers: dict[Kind, dict[str, Any]] = {
        Kind.COUNT: {"type": number},
        Kind.NUMBER: {"type": number},
        Kind.WORD: {},
        Kind.WORD_OR_NUMBER: {"type": _number_or_word},
        Kind.NUMBERS: {"type": number, "nargs": "+"},
        Kind.WORDS: {"nargs": "+"},
        Kind.FLAG: {"action": "store_true", "default": None},
    }
    declared = declarations(MeasurementSettings)[name]
    reader = readers[declared.kind]
    if declared.kind is not Kind.FLAG:
        reader["metavar"] = declared.metavar
    sentence = declared.sentence.replace("``", "").replace("`", "").replace("*", "")
    help_text = f"{sentence} Default: {default or declared.shown_default}."
    group.add_argument(declared.option, help=help_text.replace("%", "%%"), **reader)


def given_settings(options: argparse.Namespace) -> dict[str, Any]:
    """Values of all settings that the command has options for; None if not given."""
    from ..settings import MeasurementSettings, declarations

    names = declarations(MeasurementSettings)
    return {name: getattr(options, name) for name in names if hasattr(options, name)}


def given_options(options: argparse.Namespace, names: Sequence[str]) -> dict[str, Any]:
    """Values of the given options."""
    values = {name: getattr(options, name) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def option_of(name: str) -> str:
    """Spelling of an option, from the name of its value."""
    return f"--{name.replace('_', '-')}"


# --------------------------------------------------------- the specimen, the variant


def check_not_read(specimen: SpecimenLike, word: str, outputs: Sequence[str]) -> None:
    """Raise ValueError if an output is a file that the specimen is read from."""
    read = [word, *(specimen.values() if isinstance(specimen, dict) else ())]
    named = [one for one in read if isinstance(one, str) and Path(one).is_file()]
    for output in outputs:
        if Path(output).exists() and any(Path(output).samefile(one) for one in named):
            raise SettingError(
                f"the output must not be a file of the specimen, got {output}"
            )


def specimen_of(
    word: str, options: argparse.Namespace, variants: Sequence[str] = ()
) -> tuple[Any, dict[str, Any]]:
    """Set the variant, run the plugin files, and read the specimen.

    The variant must be one of `variants`; by default one that measures.

    Returns
    -------
    specimen : str or dict
        What ``gonio_mi.measure`` takes.
    parameters : dict
        Values for the ``$name`` parameters of a scene file.
    """
    from ..specimen.loading import load_plugin_file
    from ..specimen.specimen_text import parse_specimen

    set_variant(options.variant, variants)
    for path in options.plugin:
        load_plugin_file(path)
    check_kind(word, "specimen")
    specimen = parse_specimen(word)
    if options.parameters and isinstance(specimen, dict):
        raise SettingError(f"-D applies to scene files only, got {word!r}")
    return specimen, dict(options.parameters)


def variant_of(values: Record | MeasuredTable) -> str:
    """Variant in which others are compared with a record's values, or a table's.

    A record's own, or LLVM's of the same colours if that needs a GPU and there is none;
    of a table the default one, spectral for a wavelength.
    """
    from drjit import JitBackend, has_backend

    from ..results.record import Record, wavelengths_nm  # slow to import: SciPy

    if isinstance(values, Record):
        own = values.provenance.variant or DEFAULT_VARIANT
        return own if has_backend(JitBackend.CUDA) else own.replace("cuda", "llvm")
    is_wavelength = wavelengths_nm([values.channel or ""]) is not None
    return "llvm_ad_spectral" if is_wavelength else DEFAULT_VARIANT


def set_variant(variant: str, variants: Sequence[str] = ()) -> None:
    """Set one of some Mitsuba variants; by default of those that measure."""
    import mitsuba as mi

    from .. import plugins  # noqa: F401  which a command line with --help may lack
    from ..loops import mitsubas_made_late
    from ..variants import unpolarised_variants

    usable = variants or unpolarised_variants()
    if variant not in usable:
        raise SettingError(
            f"--variant must be one of {', '.join(usable)}, got {variant!r}"
            f"{did_you_mean(variant, usable)}"
        )
    if variant.startswith("llvm"):
        llvm.check()
    try:
        with mitsubas_made_late():
            mi.set_variant(variant)
    except ImportError as error:
        raise VariantError(
            f"the variant {variant} does not work on this machine: {error}"
        ) from error


# ------------------------------------------------------------------ words of options


def number(text: str) -> float:
    """Whole number or float; the measurement checks its range."""
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    apart = " (numbers are separated by spaces: 0 15.5 30)" if "," in text else ""
    with contextlib.suppress(ValueError):
        apart = f" (write {float(text.rstrip(' %')) / 100:g})" if "%" in text else apart
    raise argparse.ArgumentTypeError(
        f"must be a number such as 45 or 1e7, got {text!r}{apart}"
    )


def _number_or_word(text: str) -> float | str:
    """Float, or the unchanged text."""
    try:
        return float(text)
    except ValueError:
        return text


def pair(text: str) -> tuple[str, str]:
    """Name and value of ``name=value``."""
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"must look like key=value, got {text!r}")
    return name, value


# -------------------------------------------------------------------------- messages


def tell(result: object) -> None:
    """Print a result, without control characters that a file may hold."""
    print(printable(str(result)), flush=True)


def tell_json(result: Any) -> None:
    """Print a result of JSON's types, for ``--json``."""
    import json

    print(json.dumps(result, indent=2, allow_nan=False))


def say(text: str) -> None:
    """Print a line for the user to standard error, if it is open."""
    with contextlib.suppress(OSError, ValueError):
        print(shortened(f"{PROGRAM}: {text}"), file=sys.stderr)


def sentence(error: BaseException) -> str:
    """One line on an error."""
    if isinstance(error, FileNotFoundError) and error.filename is not None:
        return no_file(error.filename)
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return shortened(str(error))


# --------------------------------------------------------- tables of measured values

TABLE_OPTIONS = ("channel", "quantity", "columns", "azimuth", "panel_reflectance")


def add_table_options(group: Group) -> None:
    """Add the options for what a table of measured values does not state."""
    add_text(
        group, "--channel", "NAME", "Channel of a table with several, such as 550nm."
    )
    text = "Quantity of the values, if the table does not state it: "
    text += "brdf, brdf_cos, btdf or reflectance_factor."
    add_text(group, "--quantity", "Q", text)
    text = "Column of theta_i, phi_i, theta_o, phi_o, delta_phi, value, sigma or "
    text += "wavelength. ROLE=NAME:rad for an angle in radians, and so :um or :%%, "
    text += "sigma=NAME:k=2 for an expanded uncertainty, ROLE=0 for a number that "
    text += "holds for all rows, such as theta_i=30."
    how: dict[str, Any] = {"nargs": "+", "action": "extend", "type": pair}
    add_text(group, "--columns", "ROLE=NAME", text, **how)
    text = "Zero of azimuths of exit that are relative to incidence: source or mirror "
    text += "(the side of the mirror direction)."
    add_text(group, "--azimuth", "FROM", text)
    text = "Reflectance of the reference panel that values are relative to. "
    text += "Default: 1; required where the title states that of a panel."
    add_number(group, "--panel-reflectance", "X", text)


def add_uncertainties(group: Group, name: str) -> None:
    """Add the options on how well the values of a file are known, named so in help."""
    text = "Relative standard uncertainty of "
    stated = "Default: as the table states."
    own = f"each value of {name}, independent between points: 0.005 is 0.5 %%. {stated}"
    add_number(group, "--uncertainty", "X", text + own)
    common = f"a factor common to all values: calibration. {stated}"
    add_number(group, "--scale-uncertainty", "X", text + common)


def add_aperture(group: Group) -> None:
    """Add the option on the detector of a table that does not state it."""
    text = "Half-angle of the detector's aperture, if the table does not state it."
    add_number(group, "--aperture-half-angle", "DEG", text)


def check_no_table_options(
    path: str, options: argparse.Namespace, more: Sequence[str] = ()
) -> None:
    """Raise ValueError for an option of tables, or one `more`, of another file."""
    for name in given_options(options, (*TABLE_OPTIONS, *more)):
        raise SettingError(f"{option_of(name)} applies to tables only, got {path!r}")


def table_of(path: str, options: argparse.Namespace) -> MeasuredTable:
    """Table of a file, read with the given options."""
    read_measured = ask("exchange", "read_measured")
    said = given_options(options, TABLE_OPTIONS)
    if "columns" in said:
        said["columns"] = dict(said["columns"])
    try:
        table: MeasuredTable = read_measured(path, **said)
    except FileFormatError:
        check_kind(path, "table")
        raise
    return table
