r"""``gonio-mi measure``: measure how a specimen scatters light.

Measure how a specimen scatters light, and show the numbers.

examples:
  gonio-mi measure diffuse --theta-i 45
  gonio-mi measure roughconductor:alpha=0.2,distribution=ggx --theta-i 0 30 60 \
      --rays 1e8 -o run.npz map.exr
  gonio-mi measure roughdielectric:alpha=0.1 --theta-i 45 --rel-err 0.01
  gonio-mi measure plastic:diffuse_reflectance=0.2/0.5/0.1 --theta-i 45 \
      --variant llvm_ad_rgb
  gonio-mi measure mybsdf:roughness=0.3 --plugin mybsdf.py --theta-i 45
  gonio-mi measure roughconductor:alpha=0.3 --tolerance 0.02 -o material.npz
  gonio-mi measure scan.x3p --form plane --fill nearest --theta-i 30 -o scan.npz
  gonio-mi measure grooves.xml --theta-i 30 --order 1,2,3+ -o grooves.npz
  gonio-mi measure scene.xml -D height=0.5 --theta-i 45 -o run.npz \
      --resume run.npz

Several orders give a file each: grooves_order_1.npz, grooves_order_2.npz, ... A scene
file that is a complete measurement sets the defaults of all options.
"""

from __future__ import annotations

import signal
import warnings
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .. import files
from ..annexes import ask
from ..errors import LostLightWarning, SettingError
from ..results.record import Record
from ..results.summary import summarize
from ..results.summary_text import summary_text
from ..results.tally import grouped
from ..settings.values import ALL_ORDERS, Order
from ..specimen.specimen_text import SpecimenLike
from .arguments import (
    DONE,
    INCOMPLETE,
    USER_ERROR,
    Group,
    add_json,
    add_number,
    add_output,
    add_scene_options,
    add_settings_group,
    add_specimen,
    add_text,
    check_not_read,
    given_options,
    given_settings,
    number,
    say,
    sentence,
    specimen_of,
    tell,
    tell_json,
)
from .campaign_options import (
    CampaignParts,
    add_campaign,
    answered_by,
    campaign_options,
    is_imprecise,
    kept_after_ctrl_c,
)
from .file_kinds import record_of
from .surface import add_surface_options, prepared_surface, tell_mesh

USAGE = "%(prog)s SPECIMEN [--theta-i DEG ...] [options]"

# Options of some measurements only, for --help-all.
RARE = (
    *("--footprint", "--divergence", "--incident", "--emission", "--theta-max"),
    "--relative-tolerance",
    *("--collector-radius", "--hemispheres", "--max-rays", "--points", "--batches"),
    *("--max-depth", "--max-scatterings", "--rr-depth", "--trace"),
    *("--size-y", "--scale", "--range", "--unit", "--form", "--fill", "--mean-plane"),
    *("--normal", "--size", "--wavelengths", "--workers", "--folder", "--resume"),
    "--gradients",
)


def add_options(parser: ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    add_specimen(parser)
    beam = "A collimated beam, or the scene's own emitter if no angle is given."
    _add_angles(add_settings_group(parser, "light", beam))
    for title in ("collector", "method", "events on the surface"):
        add_settings_group(parser, title)
    add_surface_options(parser)
    add_scene_options(parser)
    group = parser.add_argument_group("Output")
    add_json(group)
    add_output(group, "Write the record to .exr or .npz files. Both hold all of it.")
    text = "Resume this interrupted record of the same measurement."
    add_text(group, "--resume", "RECORD", text)
    folder = "none; with --tolerance a temporary folder next to the output file"
    add_campaign(group, folder)


def _add_angles(group: Group) -> None:
    """Add the options of the incident directions."""
    several: dict[str, Any] = {"nargs": "+", "type": number}
    add_text(group, "--theta-i", "DEG", "Angles of incidence in [0, 90).", **several)
    text = "Azimuths of incidence, each combined with each --theta-i. Default: 0."
    add_text(group, "--phi-i", "DEG", text, default=[0], **several)
    text = "Instead of angles: choose incident directions adaptively until the "
    text += "interpolated BSDF misplaces at most this fraction of the scattered flux."
    add_number(group, "--tolerance", "X", text)
    text = "With --tolerance: largest relative error of a patch whose BSDF is at least "
    text += "a tenth of its mean."
    add_number(group, "--relative-tolerance", "X", text)
    text = "Largest angle of incidence for --tolerance. Default: 80."
    add_number(group, "--theta-max", "DEG", text)


def run(options: Namespace) -> int:
    """Measure, after the output files have been checked.

    Several orders, ``1,2,3+``, are measured with the same rays, each into files of its
    own: all at once, or one campaign after the other.
    """
    orders = str(options.order).split(",")
    if len(orders) == 1:
        return _run(options)
    if options.resume is not None or options.folder is not None or options.json:
        raise SettingError(
            "--resume, --folder and --json apply to one order, got several"
        )
    for order in orders:
        Order.parse("order", order)
    if options.workers is None and options.tolerance is None:
        return _run(options, orders)
    code = DONE
    for order in orders:
        output = [_order_path(path, order) for path in options.output]
        single = Namespace(**vars(options) | {"order": order, "output": output})
        code = max(code, _run(single))
    return code


def _order_path(path: str, order: str) -> str:
    """File name of one order among several; unchanged without one."""
    if not order:
        return path
    whole = Path(path)
    return str(whole.with_name(f"{whole.stem}_order_{order}{whole.suffix}"))


def _run(options: Namespace, orders: Sequence[str] = ()) -> int:
    """Measure by the options, or several orders at once."""
    for path in options.output:
        _check_kind(path)
        files.check_output(path, files.ENDINGS)
    from ..variants import parallel_variants

    specimen, parameters = specimen_of(options.specimen, options, parallel_variants())
    check_not_read(specimen, options.specimen, options.output)
    specimen = prepared_surface(specimen, options)
    if not (options.quiet or options.json):
        tell_mesh(specimen, options)
    settings = given_settings(options)
    settings |= {"parameters": parameters, "progress": not options.quiet}
    for name in ("theta_i", "phi_i"):  # one value asks for a record, not for a stack
        values = getattr(options, name)
        settings[name] = values[0] if values and len(values) == 1 else values
    if orders:
        del settings["order"]

    code = DONE
    with _CtrlC() as ctrl_c, CampaignParts(options) as parts:
        # said below, with the files' names, and with the numbers
        for text in ("interrupted: ", r"sample\(\) and eval\(\) of the phase function"):
            warnings.filterwarnings("ignore", text, RuntimeWarning)
        warnings.simplefilter("ignore", LostLightWarning)
        measured = _measured(specimen, options, orders, settings)
        ctrl_c.ignored = True
        records: dict[str, Record] = measured if orders else {"": measured}
        of_order = {
            one: [_order_path(p, one) for p in options.output] for one in records
        }
        unsaved = [p for one in records for p in _save(records[one], of_order[one])]
        for one, record in records.items():
            code = max(code, _finish(record, options, of_order[one], ctrl_c.pressed))
        if unsaved:
            code = USER_ERROR
        parts.finished = code != USER_ERROR
    return code


def _check_kind(path: str) -> None:
    """Name the command that makes a file which is not a record."""
    from ..plots.figure import ANIMATION_ENDINGS, FIGURE_ENDINGS

    ending = Path(path).suffix.lower()
    if ending in files.ENDINGS:
        return
    makers = {
        "plot": FIGURE_ENDINGS + ANIMATION_ENDINGS,
        "report": (".html",),
        "export": ask("exchange", "endings_of", lambda *_: ())("writes", "writes"),
    }
    for command, endings in makers.items():
        if ending in endings:
            raise SettingError(
                f"measure writes records, .npz or .exr, got {path}: save one, and "
                f"gonio-mi {command} makes {path} of it"
            )


def _finish(
    record: Record, options: Namespace, output: Sequence[str], pressed: bool
) -> int:
    """Show a record, which was saved; return the exit code."""
    numbers = summarize(record)
    if options.json:
        tell_json(numbers.as_mapping())
    elif options.quiet:
        for text in numbers.warnings:
            say(f"warning: {text}")
    else:
        tell(summary_text(numbers))
    if pressed:
        say(f"interrupted: {_remains(options, output, record)}")
    return INCOMPLETE if pressed or is_imprecise(record) else DONE


def _measured(
    specimen: SpecimenLike,
    options: Namespace,
    orders: Sequence[str],
    settings: Mapping[str, Any],
) -> Any:
    """Record, measured here and at once or in a campaign; of several orders a dict."""
    names = "tolerance", "relative_tolerance", "theta_max"
    chosen = given_options(options, names)
    if "relative_tolerance" in chosen and "tolerance" not in chosen:
        raise SettingError("--relative-tolerance applies with --tolerance only")
    if "theta_max" in chosen and "tolerance" not in chosen:
        raise SettingError("--theta-max applies with --tolerance only")
    if orders:
        from ..instrument.measure import measure_orders

        return measure_orders(specimen, orders=orders, **settings)
    where = campaign_options(options)
    if not where and not chosen:
        from ..campaigns.measure import measure

        resume = None if options.resume is None else record_of(options.resume)
        return measure(specimen, resume=resume, **settings)
    if options.resume is not None:
        raise SettingError(
            "--resume cannot be combined with --workers, --folder or --tolerance"
        )
    where = where or {"plugins": options.plugin}
    from ..campaigns.campaign import campaign

    with kept_after_ctrl_c(options.folder):
        given = {options.specimen: specimen}
        record = campaign(given, **where, **chosen, **settings)[options.specimen]
    return record if len(record) > 1 else record[0]


def _save(record: Record, paths: Sequence[str]) -> list[str]:
    """Write the record to every path that it can be written to; return the others."""
    unsaved = []
    for path in paths:
        try:
            record.save(path)
        except OSError as error:
            unsaved.append(path)
            say(sentence(error))
    return unsaved


def _remains(options: Namespace, output: Sequence[str], record: Record) -> str:
    """What an interrupted measurement has finished and saved."""
    asked = len(options.theta_i or [None]) * len(options.phi_i)
    kept = f"{len(record)} of {asked} incident directions"
    if record.ledger.emitted:
        rays = f"{grouped(record.ledger.emitted)} rays"
        kept = f"{rays} of {kept}" if asked > 1 else rays
    if not output:
        return f"{kept} were finished and nothing was saved, because no -o was given"
    kept = f"{' and '.join(output)} holds {kept}"
    if record.asked.integrates or options.rel_err is not None:
        return kept
    order = record.asked.order
    again = "" if order == ALL_ORDERS else f"--order {order} "
    return f"{kept}; {again}--resume {output[0]} continues it"


class _CtrlC:
    """Ctrl-C while measuring: the first ends it; later ones are ignored to the end.

    Attributes
    ----------
    pressed : bool
        Whether the measurement was ended by it.
    ignored : bool
        To be set when nothing is to be ended any more.
    """

    def __init__(self) -> None:
        self.pressed = self.ignored = False

    def __enter__(self) -> _CtrlC:
        self._previous = answered_by(self._press, signal.SIGINT)
        return self

    def __exit__(self, *_: object) -> None:
        answered_by(signal.SIG_IGN if self.pressed else self._previous, signal.SIGINT)

    def _press(self, *_: object) -> None:
        if not (self.ignored or self.pressed):
            self.pressed = True
            raise KeyboardInterrupt
