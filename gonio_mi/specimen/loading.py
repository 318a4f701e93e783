"""Load specimens from a word, file, dictionary or object, and the files they name."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import linecache
import os
import re
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from os import PathLike
from pathlib import Path
from types import ModuleType
from typing import Any

import drjit as dr
import mitsuba as mi

from ..annexes import doors
from ..errors import (
    SettingError,
    SpecimenError,
    did_you_mean,
    is_ctrl_c,
    no_file,
    own_place,
    shown,
    tells_of_our_bug,
    warn,
)
from ..files.tensor_file import check_measured
from ..kernels import launches_kernels
from ..settings.values import Period, checked_period
from ..surfaces.height_maps import is_height_map
from ..surfaces.meshes import is_mesh
from ..threads import two_threads
from ..variants import check_variant, is_parallel
from .scene_objects import own_settings, traversed
from .shapes import WATERTIGHT, forget, remember, scene_of
from .specimen import Specimen
from .specimen_text import (
    CALLED,
    SpecimenLike,
    parse_specimen,
    specimen_name,
    with_real_indices,
)

# Endings of text files that may hold heights or measured values.
TEXTS = (".txt", ".csv", ".tsv")

# Mitsuba's message on parameters that a plugin does not read, and endings of plugins.
UNUSED = re.compile(r'Found \d+ unreferenced \w+ in \w+ plugin of type "(.+?)":(.*)')
NAMED = re.compile(r'- \w+ "([^"]+)"')
PLUGINS = (".so", ".dylib", ".dll", ".py")

# Plugins that crash Mitsuba without a property: what they need, and its names.
NEEDS: dict[str, tuple[str, set[str]]] = {
    "blendbsdf": ("a weight and two nested BSDFs", set()),
    "bitmap": ("a filename or a bitmap", {"filename", "bitmap", "data"}),
}

# Metals that Mitsuba knows by their symbols only.
METALS = {
    "aluminium": "Al",
    "aluminum": "Al",
    "chromium": "Cr",
    "copper": "Cu",
    "gold": "Au",
    "iridium": "Ir",
    "mercury": "Hg",
    "molybdenum": "Mo",
    "nickel": "Ni_palik",
    "silver": "Ag",
    "tungsten": "W",
}

# Parts of Mitsuba's messages that tell a user nothing: source positions, the root of a
# dictionary, the search for a plugin, and the frame around our own plugins' errors.
FRAMES = re.compile(
    r"\[\w+\.(cpp|h):\d+\] ?"
    r'|(At|While loading) dictionary node "root": '
    r'|failed to instantiate unknown plugin of type "[^"]*": \[PluginManager\] '
    r'|(At dictionary node "\w+": )?failed to instantiate \w+ plugin of type '
    r'"(anisotropicphong|collector|cosinelobe|glossymixture|goniometric|'
    r'goniophotometer|heightfield|patches|sobol|stl)": \w+: '
)

# Default material of a height map: every facet reflects all light, so the record shows
# the shape alone.
MIRROR = {"type": "conductor"}

# Modules that plugin files imported from their own folders.
_imported: list[str] = []

# Names under which they register plugins.
_registered: set[str] = set()


def existing(specimen: str | os.PathLike[str]) -> Path:
    """Path of a specimen file; raise SpecimenError if it does not exist."""
    path = Path(specimen)
    if not path.is_file():
        word = os.fspath(specimen)
        with contextlib.suppress(OSError):  # the folder may be gone
            word = path.name if path.parent == Path.cwd() else word
        hint = ""
        if re.fullmatch(r"[A-Za-z_]\w+(:\s*\w+\s*=.*)?", word):
            hint = f"; a BSDF is a dictionary such as {parse_specimen(word)!r}"
        raise SpecimenError(no_file(path) + hint)
    return path


@launches_kernels(is_parallel)
def specimen_of(
    specimen: SpecimenLike | Specimen,
    parameters: dict[str, Any] | None = None,
    period: Any = None,
) -> Specimen:
    """Load and describe a specimen: the first step of every measurement.

    Parameters
    ----------
    specimen : dict, mi.BSDF, mi.Scene, str or path
        A dictionary of a BSDF, a shape or a scene; an object; an XML file; or a file of
        heights, which is measured as a mirror. A BSDF is put on a square of 2 x 2 scene
        units in z = 0. A loaded specimen is returned as it is.
    parameters : dict, optional
        Values for the ``$name`` parameters of an XML file.
    period : {"box", "none"} or (float, float), optional
        It joins the borders of a file of heights. Default: the period of the scene's
        integrator `goniophotometer`, else none.

    Returns
    -------
    Specimen

    Raises
    ------
    SpecimenError
        If it is none of these, or cannot be loaded or measured.
    FileFormatError
        If it names a damaged file that would crash Mitsuba.
    """
    if isinstance(specimen, Specimen):
        return specimen
    scene, files = _scene(specimen, parameters, period)
    period = period_of(scene, period)
    return Specimen(scene, period, specimen_name(specimen, parameters), files)


def period_of(scene: mi.Scene, period: Any = None) -> Period:
    """Period that is given, else that of the scene's integrator, else none."""
    if period is None:
        period = own_settings(scene).get("period", "none")
    return checked_period("period", period)


@launches_kernels(is_parallel)
def load_specimen(
    specimen: SpecimenLike, parameters: dict[str, Any] | None = None, period: Any = None
) -> Any:
    """Scene of a specimen, emitters and sensors included; see :func:`specimen_of`."""
    return _scene(specimen, parameters, period)[0]


def _scene(
    specimen: Any, parameters: dict[str, Any] | None, period: Any
) -> tuple[Any, list[tuple[str, float, float]]]:
    """Load the scene of a specimen; return it with the ranges of its measured files."""
    files: list[tuple[str, float, float]] = []
    if not isinstance(specimen, (mi.Scene, mi.Shape)):
        # frees the numbers of the last objects: kernels contain them, and fit the next
        forget()
    if isinstance(specimen, (str, os.PathLike)):
        path = existing(specimen)
        if is_height_map(path):
            specimen = surface_specimen(path, period=period)
        elif is_mesh(path):
            raise SpecimenError(
                f"the mesh {path.name} must come with its material, such as "
                "--bsdf diffuse:reflectance=0.7 or gonio.mesh(path, bsdf)"
            )
        elif path.suffix.lower() in TEXTS:
            raise SpecimenError(
                f"a specimen must not be a table, got {path.name}: heights in text are "
                "known by the ending .asc, and measured values go to gonio-mi compare "
                "or fit"
            )
    # with the options of `scene_of`: one for Embree, and none for OptiX
    built = isinstance(specimen, dict) or not mi.variant().startswith("llvm")
    if isinstance(specimen, (str, os.PathLike)):
        parameters = {k: str(v) for k, v in (parameters or {}).items()}
        files = _measured_files(_scene_names(path, {**parameters}))
        # Mitsuba's optimisation would merge shapes into meshes without a bounding box
        parameters |= {"optimize": False}
        specimen = loaded(f"the specimen {path}", mi.load_file, str(path), **parameters)
    elif isinstance(specimen, dict):
        if not isinstance(specimen.get("type"), str):
            needs = "specimen must have a type, as {'type': 'diffuse'} has"
            raise SpecimenError(f"{needs}, got {shown(specimen)}")
        files = _measured_files(_dictionary_names(specimen))
        if specimen.get("type") == "scene":
            specimen = specimen | WATERTIGHT
        specimen = loaded("the specimen", mi.load_dict, specimen, optimize=False)
    if isinstance(specimen, mi.Scene):
        if built:
            remember(specimen)
        return specimen, files
    if isinstance(specimen, mi.BSDF):
        specimen = mi.load_dict({"type": "rectangle", "bsdf": specimen})
    elif not isinstance(specimen, mi.Shape):
        raise SpecimenError(
            "specimen must be a BSDF, a shape or a scene of the variant "
            f"{mi.variant()}, as object, dictionary or XML file, got "
            f"{_one_line(repr(specimen)):.200}"
        )
    elif specimen.class_name() == "Instance":
        raise SpecimenError(
            "an instance must be measured in a scene that holds its shapegroup"
        )
    # as the specimen will be built, so that it is not built twice
    return loaded("the specimen", scene_of, [specimen]), files


def loaded(what: str, load: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
    """Return ``load(*args, **kwargs)``; report a failure in one sentence.

    Plugins are built one after another: one that calls :func:`mi.load_dict` in its
    constructor changes, and finally frees, the paths in which others look for files.
    """
    if load is not scene_of:
        kwargs |= {"parallel": False}
    try:
        given = [with_real_indices(_as_loaded(one)) for one in args]
        with two_threads():
            return load(*given, **kwargs)
    except (RuntimeError, TypeError, ValueError, AttributeError, KeyError) as error:
        if is_ctrl_c(error):
            raise KeyboardInterrupt from None
        if tells_of_our_bug(error):
            raise  # a bug of ours in a plugin
        text = _with_advice(_one_line(error))
        raise SpecimenError(
            f"{what} cannot be loaded: {text}{own_place(error)}"
        ) from error


def _with_advice(text: str) -> str:
    """Mitsuba's message, with a remedy where one is known."""
    if advice := _without_base(text):
        return advice
    if missing := re.search(r'Plugin "([^"]+)" not found', text):
        own = "; import your own plugins first, or name their file with --plugin"
        if missing[1] in CALLED:
            return f"{text.rstrip('!')}; did you mean {CALLED[missing[1]]}?"
        known = [*(_registered - {missing[1]}), *plugin_files()]
        return text.rstrip("!") + (did_you_mean(missing[1], known) or own)
    if variant := re.search(r"require the use of an? (RGB|spectral) variant", text):
        return f"{text.rstrip('!')}, such as llvm_ad_{variant[1].lower()}"
    if metal := re.search(r'"data/ior/([^"]+)\.eta\.spd": file does not exist', text):
        return _no_metal(metal[1])
    if unused := UNUSED.search(text):
        plugin, names = unused[1], NAMED.findall(unused[2])
        manual = _manual_names(plugin)
        known = sorted((manual or _traversed_names(plugin)) - {*names})
        similar = [did_you_mean(name, known) for name in names]
        similar += [f"; it knows {', '.join(known)}"] if manual else []
        # in quotes where spaces would be invisible
        names = [name if name == name.strip() else shown(name) for name in names]
        return (
            f"{text[: unused.start()]}the plugin {plugin} has no use for "
            f"{', '.join(names)}{next(filter(None, similar), '')}"
        )
    return text


def _without_base(text: str) -> str:
    """Message on a plugin class that does not initialise its base; empty for others.

    Mitsuba finds no object in it, or cannot store the attributes it sets.
    """
    failed = re.search(r'unknown plugin of type "([^"]+)": (.*)', text)
    if failed is None:
        return ""
    if failed[2] == "std::bad_cast":
        return (
            f"the class of {failed[1]} must derive from mi.BSDF, or from the base of "
            "its kind, and call mi.BSDF.__init__(self, props) first"
        )
    given = re.search(r"Invoked with types: (?:\w+\.)*(\w+), ", failed[2])
    classes = [x for x in _subclasses(mi.Object) if given and x.__name__ == given[1]]
    for one in classes[-1:]:  # the last, where a notebook has defined it again
        code = getattr(vars(one).get("__init__"), "__code__", None)
        if code and "__init__" not in code.co_names:
            base = f"mi.{one.__mro__[1].__name__}.__init__(self, props)"
            return f"{one.__name__}.__init__ must call {base} first"
    return ""


def _subclasses(base: Any) -> Iterator[Any]:
    """Direct and indirect subclasses."""
    for one in base.__subclasses__():
        yield from (one, *_subclasses(one))


def _no_metal(word: str) -> str:
    """Message on a conductor's material that Mitsuba has no data for."""
    folder = Path(mi.__file__).parent / "data" / "ior"
    metals = sorted(path.name.partition(".")[0] for path in folder.glob("*.eta.spd"))
    symbol = METALS.get(word.lower())
    meant = f"; {word} is {symbol}" if symbol else did_you_mean(word, metals)
    few = [name for name in metals if name.removesuffix("_palik") in (name, symbol)]
    return f"material must be one of {', '.join(few)}, got {shown(word)}{meant}"


def plugin_files() -> dict[str, Path]:
    """Files of Mitsuba's plugins and of ours, by plugin name."""
    folders = Path(mi.__file__).parent, Path(__file__).parents[1]
    files = [path for one in folders for path in (one / "plugins").rglob("*.*")]
    for _, door in doors():
        files += [Path(str(door.__file__)).with_name(f"{n}.py") for n in door.PLUGINS]
    return {path.stem: path for path in files if path.suffix in PLUGINS}


def _manual_names(plugin: str) -> set[str]:
    """Parameters of one of our plugins, from its manual page; none of others."""
    path = plugin_files().get(plugin, Path())
    if path.suffix != ".py":
        return set()
    rows = " ".join(re.findall(r"\* - ([a-z].+)", path.read_text("utf-8")))
    return {*re.findall(r"\w+", rows)} - {"or", "and"}


def _traversed_names(plugin: str) -> set[str]:
    """Names under which ``mi.traverse`` lists a plugin's parameters: most of them.

    None if the plugin cannot be loaded without parameters.
    """
    if plugin in NEEDS:
        return set()
    try:
        found = traversed(mi.load_dict({"type": plugin})).properties
    except Exception:  # one in Python may raise anything
        return set()
    return {key.partition(".")[0] for key in found}


def _as_loaded(node: Any) -> Any:
    """Copy of a dictionary with its own tensors: Mitsuba empties those that it loads.

    Raise ValueError for values that Mitsuba has no type for or that would crash it.
    """
    if isinstance(node, str) and re.search("[\ud800-\udfff]", node):  # not in UTF-8
        raise SpecimenError(
            f"names of files must be UTF-8, got {shown(node)}: rename it"
        )
    if isinstance(node, dict):
        _check_complete(node.get("type"), node.keys() - {"type", "id"})
        for key, value in node.items():
            if isinstance(value, int) and not -(2**63) <= value < 2**63:
                raise SettingError(f"{key} must be below 2^63, got {shown(value)}")
        return {key: _as_loaded(value) for key, value in node.items()}
    return type(node)(node) if dr.is_tensor_v(node) else node


def _check_complete(plugin: Any, names: Collection[str | None]) -> None:
    """Raise SpecimenError for a plugin without any of the properties it needs."""
    needs, some = NEEDS.get(str(plugin), ("", set()))
    if needs and (not names or (some and some.isdisjoint(names))):
        raise SpecimenError(f"{plugin} must be given {needs}, got none of them")


def _one_line(error: object) -> str:
    """Mitsuba's message without frames, tracebacks and line breaks."""
    text = str(error)
    if "Traceback (most recent call last)" in text:
        head, _, trace = text.partition("Traceback (most recent call last)")
        # the lines of a traceback that are not indented are the error itself
        lines = [line for line in trace.splitlines()[1:] if line[:1].strip()]
        text = head.rstrip(": \n") + ": " + " ".join(lines[-3:])
    return " ".join(FRAMES.sub("", text).split())


def load_plugin_file(path: str | PathLike[str]) -> None:
    """Run a user's Python file that registers Mitsuba plugins, or a package.

    It imports modules from its own folder, as with ``python FILE``, by relative imports
    too. They are imported anew when the file is run again, as they may be bound to a
    variant.

    Parameters
    ----------
    path : str or path
        A file; or a folder with an ``__init__.py``, which is imported.

    Raises
    ------
    SpecimenError
        If the file is missing, raises, or registers a plugin of Mitsuba's name.
    """
    check_variant(is_parallel)
    path, before = Path(path), mi.variant()
    is_package = path.is_dir() and (path / "__init__.py").is_file()
    if not (is_package or path.is_file()):
        hint = ", and has no __init__.py" * path.is_dir()
        raise SpecimenError(f"{no_file(path)}{hint}")
    whole = path.resolve()
    folder = whole if is_package else whole.parent
    # another file may have imported a module of the same name from its own folder
    sys.path[:] = [str(folder), *(one for one in sys.path if one != str(folder))]
    # where relative imports find the folder
    added = [str(folder.parent)] * (str(folder.parent) not in sys.path)
    sys.path[1:1] = added
    while _imported:
        sys.modules.pop(_imported.pop(), None)
    known = set(sys.modules)
    module = ModuleType(path.stem)
    module.__dict__.update(__file__=str(whole), __package__=folder.name)
    if not is_package:  # what dataclasses and annotations look names up in
        sys.modules.setdefault(path.stem, module)
    # Python recognises changed modules by size and the second of their change only, and
    # caches the list of a folder's files by its time of change
    writes_no_bytecode, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    importlib.invalidate_caches()
    try:
        content = b"from . import *" if is_package else path.read_bytes()
        text = importlib.util.decode_source(content)
        for one in folder.glob("*.py") if is_package else [path]:
            _note_names(path, importlib.util.decode_source(one.read_bytes()))
        # digests and tracebacks show the code that runs, even if the file changes
        linecache.cache[str(path)] = len(text), None, text.splitlines(True), str(path)
        exec(compile(content, str(path), "exec"), vars(module))
    except SpecimenError:
        raise
    except (Exception, SystemExit) as error:
        # a user's file may raise anything
        hint = "; leave out its mi.set_variant" * ("jit_init" in str(error))
        raise SpecimenError(
            f"plugin file {path} raised {type(error).__name__}: {_one_line(error)}"
            f"{own_place(error)}{hint}"
        ) from error
    finally:
        sys.dont_write_bytecode = writes_no_bytecode
        for parent in added:
            sys.path.remove(parent)
        _imported[:] = [
            name
            for name, one in list(sys.modules.items())
            if name not in known
            and (
                name == folder.name
                or str(getattr(one, "__file__", None)).startswith(f"{folder}{os.sep}")
            )
        ]
    if mi.variant() != before:
        warn(f"plugin file {path} sets the variant {mi.variant()}, instead of {before}")


def _note_names(path: Path, text: str) -> None:
    """Remember the names that a file registers; SpecimenError for one of Mitsuba's.

    Mitsuba takes its own plugin of that name in one variant, and the file's in another.
    """
    named = re.findall(r"""register_\w+\(\s*["']([^"']+)["']""", text)
    kinds = mi.PluginManager.instance()
    for name in named:
        if kinds.plugin_type(name) is not mi.ObjectType.Unknown:
            raise SpecimenError(
                f"plugin file {path} must register another name than {name}, which a "
                "plugin of Mitsuba has"
            )
    _registered.update(named)


def surface_specimen(
    path: str | os.PathLike[str],
    bsdf: dict[str, Any] | None = None,
    period: Any = None,
    **settings: Any,
) -> dict[str, Any]:
    """Mitsuba dictionary of the plugin `heightfield` for a file of heights.

    Parameters
    ----------
    path : str or path
    bsdf : dict, optional
        What the surface is made of. Default: a mirror.
    period : {"box", "none"} or (float, float), optional
        As of :func:`gonio_mi.measure`. Without one the surface is finite, whatever its
        file says; in a cell its last row and column are joined to the first, so that
        there is no step.
    settings : optional
        Properties of the plugin; None for its default.
    """
    given = {name: value for name, value in settings.items() if value is not None}
    finite = period is None or (isinstance(period, str) and period == "none")
    shape = {
        "type": "heightfield",
        "filename": os.fspath(path),
        "periodic": not finite,
        "bsdf": MIRROR if bsdf is None else bsdf,
    }
    return shape | given


# -------------------------------------------------------------------------- named files


# Depth to which Mitsuba accepts scene files that include others.
MAX_INCLUDES = 15


def _measured_files(
    names: Iterable[str | Path],
) -> list[tuple[str, float, float]]:
    """Names and ranges in nm of spectral files for Mitsuba's plugin `measured`.

    Raise FileFormatError for a damaged file, which would crash Mitsuba. Missing files,
    and scene files that are not XML, are left to Mitsuba.
    """
    paths = [Path(str(mi.file_resolver().resolve(str(name)))) for name in names]
    found = [(path.name, check_measured(path)) for path in paths if path.is_file()]
    return [(name, *covered) for name, covered in found if covered]


def _dictionary_names(node: Mapping[str, Any]) -> Iterator[str | Path]:
    """File names in a dictionary and in those nested in it."""
    if node.get("type") == "measured" and isinstance(node.get("filename"), str):
        yield node["filename"]
    for value in node.values():
        if isinstance(value, Mapping):
            yield from _dictionary_names(value)


def _scene_names(
    path: Path, parameters: dict[str, str], within: tuple[Path, ...] = ()
) -> Iterator[str | Path]:
    """File names in a scene file and in those it includes; beside it where they exist.

    Raise SpecimenError if a file includes itself, or a plugin would crash Mitsuba.
    """
    path = path.resolve()
    if path in within:
        raise SpecimenError(
            f"a scene file must not include itself, but {path.name} is included by "
            f"{within[-1].name}"
        )
    if len(within) > MAX_INCLUDES:
        return
    from xml.etree import ElementTree  # slow to import

    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, OSError, ValueError, LookupError):
        return
    for default in root.iter("default"):
        parameters.setdefault(default.get("name", ""), default.get("value", ""))
    for plugin in root.iter():
        _check_complete(plugin.get("type"), [child.get("name") for child in plugin])
        if plugin.get("type") == "measured":
            for child in plugin.iter("string"):
                if child.get("name") == "filename":
                    yield _beside(path, child.get("value", ""), parameters)
    for include in root.iter("include"):
        other = Path(_beside(path, include.get("filename", ""), parameters))
        yield from _scene_names(other, parameters, (*within, path))


def _beside(path: Path, name: str, parameters: Mapping[str, str]) -> str | Path:
    """File of that name beside `path`, or the name alone if there is none."""
    for key in sorted(parameters, key=len, reverse=True):
        name = name.replace(f"${key}", parameters[key])
    beside = path.parent / name
    return beside if beside.is_file() else name
