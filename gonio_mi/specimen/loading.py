"""From what a user calls a specimen to a Mitsuba scene, and the files that it names."""

import contextlib
import importlib
import importlib.util
import linecache
import os
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextvars import ContextVar
from os import PathLike
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

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
from ..surfaces.height_maps import is_height_map
from ..surfaces.meshes import is_mesh
from ..threads import two_threads
from ..variants import check_variant, is_parallel
from .shapes import WATERTIGHT, forget, remember, scene_of
from .specimen_text import CALLED, SpecimenLike, parse_specimen, with_real_indices

# Texts that may hold heights or measured values.
TEXTS = (".txt", ".csv", ".tsv")

# How Mitsuba tells of parameters that a plugin did not read, and endings of plugins.
UNUSED = re.compile(r'Found \d+ unreferenced \w+ in (\w+) plugin of type "(.+?)":(.*)')
NAMED = re.compile(r'- \w+ "([^"]+)"')
PLUGINS = (".so", ".dylib", ".dll", ".py")


# Plugins that end the process without a property: what they need, and by which names.
NEEDS: dict[str, tuple[str, set[str]]] = {
    "blendbsdf": ("a weight and two nested BSDFs", set()),
    "bitmap": ("a filename or a bitmap", {"filename", "bitmap", "data"}),
}

# Words for what Mitsuba knows by its symbol.
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

# What Mitsuba puts before messages that say it all: its source positions, the root of
# a dictionary, the search for a plugin, and the frame around our own plugins' errors.
FRAMES = re.compile(
    r"\[\w+\.(cpp|h):\d+\] ?"
    r'|(At|While loading) dictionary node "root": '
    r'|failed to instantiate unknown plugin of type "[^"]*": \[PluginManager\] '
    r'|(At dictionary node "\w+": )?failed to instantiate \w+ plugin of type '
    r'"(anisotropicphong|collector|cosinelobe|glossymixture|goniometric|'
    r'goniophotometer|heightfield|patches|sobol|stl)": \w+: '
)

# What a map of heights is made of, unless it is said: every facet reflects all light,
# so that the record tells the shape alone.
MIRROR = {"type": "conductor"}

# Modules that plugin files have imported from their own folder.
_imported: list[str] = []

# While tasks are at work in this thread: what was loaded last, and the scene it is.
_last: ContextVar[list[Any] | None] = ContextVar("_last", default=None)


def existing(specimen: str | os.PathLike[str]) -> Path:
    """Path of a specimen that is a file; SpecimenError if there is none."""
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


@contextlib.contextmanager
def loaded_once() -> Iterator[None]:
    """Context in which a specimen, the same object or path, is loaded once in a row."""
    before = _last.set([])
    try:
        yield
    finally:
        _last.reset(before)


@launches_kernels(is_parallel)
def load_specimen(
    specimen: SpecimenLike, parameters: dict[str, Any] | None = None, period: Any = None
) -> Any:
    """Load a specimen as a Mitsuba scene.

    Parameters
    ----------
    specimen : dict, mi.BSDF, mi.Scene, str or path
        A dictionary of a BSDF, a shape or a scene; an object; an XML file; or a file of
        heights, which is measured as a mirror. A BSDF is put on a square of 2 x 2 scene
        units in z = 0.
    parameters : dict, optional
        Values for the ``$name`` parameters of an XML file.
    period : {"box", "none"} or (float, float), optional
        Of the measurement: whether a file of heights is joined at its borders.

    Returns
    -------
    mi.Scene

    Raises
    ------
    SpecimenError
        If Mitsuba cannot load it, or it is none of these.
    FileFormatError
        If a file that it names is damaged, and Mitsuba would not notice.
    """
    last, names = _last.get(), (mi.variant(), *(parameters or ()))
    given = [specimen, period, *(parameters or {}).values()]
    if last and last[0] == names and all(map(_is_same, last[1], given)):
        return last[2]
    if last:
        last.clear()
    scene = _scene(specimen, parameters, period)
    if last is not None:
        last[:] = names, given, scene
    return scene


def _is_same(one: Any, other: Any) -> bool:
    """Whether two are one object, or the same number or text."""
    plain = isinstance(one, (str, float, int)) and type(one) is type(other)
    return one is other or (plain and one == other)


def _scene(specimen: Any, parameters: dict[str, Any] | None, period: Any) -> Any:
    """Scene of a specimen, loaded anew."""
    if not isinstance(specimen, (mi.Scene, mi.Shape)):
        # kernels hold the numbers of objects, which are those of the ones before then
        forget()
    if isinstance(specimen, (str, os.PathLike)):
        path = existing(specimen)
        if is_height_map(path):
            specimen = surface_specimen(path, period=period)
        elif is_mesh(path):
            raise SpecimenError(
                f"the mesh {path.name} must come with what it is made of, such as "
                "--bsdf diffuse:reflectance=0.7 or gonio.mesh(path, bsdf)"
            )
        elif path.suffix.lower() in TEXTS:
            raise SpecimenError(
                f"a specimen must not be a table, got {path.name}: heights in text are "
                "known by the ending .asc, and measured values go to gonio-mi compare "
                "or fit"
            )
    # built as the specimen will be: with an option for Embree, which OptiX does without
    built = isinstance(specimen, dict) or not mi.variant().startswith("llvm")
    if isinstance(specimen, (str, os.PathLike)):
        parameters = {k: str(v) for k, v in (parameters or {}).items()}
        check_named_files(path, parameters)
        # Mitsuba's optimisation would merge shapes into meshes without a bounding box
        parameters |= {"optimize": False}
        specimen = loaded(f"the specimen {path}", mi.load_file, str(path), **parameters)
    elif isinstance(specimen, dict):
        if not isinstance(specimen.get("type"), str):
            needs = "specimen must have a type, as {'type': 'diffuse'} has"
            raise SpecimenError(f"{needs}, got {shown(specimen)}")
        check_named_files(specimen)
        if specimen.get("type") == "scene":
            specimen = specimen | WATERTIGHT
        specimen = loaded("the specimen", mi.load_dict, specimen, optimize=False)
    if isinstance(specimen, mi.Scene):
        if built:
            remember(specimen)
        return specimen
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
    # built as the specimen will be, so that it is not built twice
    return loaded("the specimen", scene_of, [specimen])


def loaded(what: str, load: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
    """Return ``load(*args, **kwargs)``; if that fails, say why in one sentence.

    Plugins are built one after another: one that calls :func:`mi.load_dict` as it is
    built changes, and in the end frees, the paths in which all others look for files.
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
    """Mitsuba's message with what would mend it, where that is known."""
    if advice := _without_base(text):
        return advice
    if missing := re.search(r'Plugin "([^"]+)" not found', text):
        own = "; import your own plugins first, or name their file with --plugin"
        if missing[1] in CALLED:
            return f"{text.rstrip('!')}; did you mean {CALLED[missing[1]]}?"
        return text.rstrip("!") + (did_you_mean(missing[1], _plugin_files()) or own)
    if variant := re.search(r"require the use of an? (RGB|spectral) variant", text):
        return f"{text.rstrip('!')}, such as llvm_ad_{variant[1].lower()}"
    if metal := re.search(r'"data/ior/([^"]+)\.eta\.spd": file does not exist', text):
        return _no_metal(metal[1])
    if unused := UNUSED.search(text):
        kind, plugin, names = unused[1], unused[2], NAMED.findall(unused[3])
        known, words = _parameters(kind, plugin), _words(plugin) - {*names}
        similar = [did_you_mean(x, known) or did_you_mean(x, words) for x in names]
        similar += [f"; it knows {', '.join(known)}"] if known else []
        # in quotes where spaces would go unseen
        names = [name if name == name.strip() else shown(name) for name in names]
        return (
            f"{text[: unused.start()]}the plugin {plugin} has no use for "
            f"{', '.join(names)}{next(filter(None, similar), '')}"
        )
    return text


def _without_base(text: str) -> str:
    """Message on a plugin whose class did not initialise its base; empty for others.

    Mitsuba finds no object in it, or no place for what its constructor sets.
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
    """Classes that derive from one, directly or not."""
    for one in base.__subclasses__():
        yield from (one, *_subclasses(one))


def _no_metal(word: str) -> str:
    """Message on a material of conductors that Mitsuba has no data of."""
    folder = Path(mi.__file__).parent / "data" / "ior"
    metals = sorted(path.name.partition(".")[0] for path in folder.glob("*.eta.spd"))
    symbol = METALS.get(word.lower())
    meant = f"; {word} is {symbol}" if symbol else did_you_mean(word, metals)
    few = [name for name in metals if name.removesuffix("_palik") in (name, symbol)]
    return f"material must be one of {', '.join(few)}, got {shown(word)}{meant}"


def _plugin_files() -> dict[str, Path]:
    """Files of Mitsuba's own plugins and of ours, which have their names."""
    folders = Path(mi.__file__).parent, Path(__file__).parents[1]
    files = [path for one in folders for path in (one / "plugins").rglob("*.*")]
    for _, door in doors():
        files += [Path(str(door.__file__)).with_name(f"{n}.py") for n in door.PLUGINS]
    return {path.stem: path for path in files if path.suffix in PLUGINS}


def _words(plugin: str) -> set[str]:
    """Words among which a plugin's parameters are.

    Of ours they are those of its manual page; of Mitsuba's, the texts in its file, in
    which some short ones are not; of others, the texts that BSDFs in Python begin with.
    """
    path = _plugin_files().get(plugin)
    if path is None:
        own = [getattr(x.__init__, "__code__", None) for x in mi.BSDF.__subclasses__()]
        texts = [x for code in filter(None, own) for x in code.co_consts]
        return {x for x in texts if isinstance(x, str)}
    text = path.read_bytes().decode(errors="replace")
    if path.suffix == ".py":
        rows = " ".join(re.findall(r"\* - ([a-z].+)", text))
        return {*re.findall(r"\w+", rows)} - {"or", "and"}
    return {"int_ior", "ext_ior", "k", *re.findall(r"(?<=\0)[a-z]\w{2,}(?=\0)", text)}


def _parameters(kind: str, plugin: str) -> list[str]:
    """Names of a plugin's parameters, as far as they can be found out.

    A BSDF of Mitsuba's is given all words as booleans: it refuses, one after another,
    those of its parameters that are none, and then Mitsuba lists what was not read.
    """
    words = _words(plugin)
    ours = _plugin_files().get(plugin, Path()).suffix == ".py"
    if ours or kind != "bsdf" or plugin in NEEDS:
        return sorted(words) if ours else []
    found = words & {"specular"}  # which principled refuses beside eta
    while True:
        try:
            mi.load_dict({"type": plugin, **dict.fromkeys(words - found, False)})
            return sorted(words)
        except RuntimeError as error:
            if unread := NAMED.findall(str(error)):
                return sorted(words - {*unread})
            refused = words & {*re.findall(r"""['"](\w+)['"]""", str(error))} - found
        if not refused:  # it needs what is not known
            return []
        found |= refused


def _as_loaded(node: Any) -> Any:
    """Dictionary with tensors of its own: Mitsuba empties those that it loads.

    ValueError for what has no type in Mitsuba, which prints lines of it, or is no text,
    or would end the process.
    """
    if isinstance(node, str) and re.search("[\ud800-\udfff]", node):  # in no UTF-8
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
    """Raise SpecimenError for a plugin that has none of the properties it needs."""
    needs, some = NEEDS.get(str(plugin), ("", set()))
    if needs and (not names or (some and some.isdisjoint(names))):
        raise SpecimenError(f"{plugin} must be given {needs}, got none of them")


def _one_line(error: object) -> str:
    """Mitsuba's message without frames, tracebacks and line breaks."""
    text = str(error)
    if "Traceback (most recent call last)" in text:
        head, _, trace = text.partition("Traceback (most recent call last)")
        # of a traceback, the lines that are not indented: the error itself
        lines = [line for line in trace.splitlines()[1:] if line[:1].strip()]
        text = head.rstrip(": \n") + ": " + " ".join(lines[-3:])
    return " ".join(FRAMES.sub("", text).split())


def load_plugin_file(path: str | PathLike[str]) -> None:
    """Run a user's Python file that registers Mitsuba plugins.

    Its folder is where it finds its own modules, as with ``python FILE``. Those are
    imported anew when the file is run again, for they may be bound to a variant.

    Raises
    ------
    SpecimenError
        If the file is missing or raises.
    """
    check_variant(is_parallel)
    path, before = Path(path), mi.variant()
    if not path.is_file():
        raise SpecimenError(no_file(path))
    folder = str(path.resolve().parent)
    # another file may have imported a module of the same name from its own folder
    sys.path[:] = [folder, *(one for one in sys.path if one != folder)]
    while _imported:
        sys.modules.pop(_imported.pop(), None)
    known = set(sys.modules)
    scope = {"__name__": path.stem, "__file__": str(path.resolve())}
    # Python takes a module for unchanged if its size and the second of its change are
    # those of the bytecode, and a folder's list of files for that of the same moment
    writes_no_bytecode, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    importlib.invalidate_caches()
    try:
        content = path.read_bytes()
        text = importlib.util.decode_source(content)
        # digests and tracebacks are of what is run, whatever becomes of the file
        linecache.cache[str(path)] = len(text), None, text.splitlines(True), str(path)
        exec(compile(content, str(path), "exec"), scope)
    except (Exception, SystemExit) as error:
        # a user's file may raise anything
        hint = "; leave out its mi.set_variant" * ("jit_init" in str(error))
        raise SpecimenError(
            f"plugin file {path} raised {type(error).__name__}: {_one_line(error)}"
            f"{own_place(error)}{hint}"
        ) from error
    finally:
        sys.dont_write_bytecode = writes_no_bytecode
        _imported[:] = [
            name
            for name, module in list(sys.modules.items())
            if name not in known
            and str(getattr(module, "__file__", None)).startswith(folder + os.sep)
        ]
    if mi.variant() != before:
        warn(f"plugin file {path} sets the variant {mi.variant()}, instead of {before}")


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


# Scene files may include others; Mitsuba takes no more than this many deep.
MAX_INCLUDES = 15


def check_named_files(
    specimen: Mapping[str, Any] | str | os.PathLike[str],
    parameters: Mapping[str, str] | None = None,
    wavelengths: Sequence[float] = (),
) -> None:
    """Raise if a damaged file would crash Mitsuba's plugin `measured`.

    Or if it has no data at one of the `wavelengths`, beyond which it goes on with its
    last ones.

    Names that are not found are left to Mitsuba, and so are scene files that are not
    XML.

    Parameters
    ----------
    specimen : dict, str or path
        Dictionary or scene file, as Mitsuba loads it.
    parameters : dict, optional
        Values of the ``$name`` parameters of a scene file.
    wavelengths : sequence of float
        In nm, of a measurement in a spectral variant.

    Raises
    ------
    FileFormatError
        If a file is damaged.
    SpecimenError
        If its data do not cover the wavelengths.
    """
    if isinstance(specimen, Mapping):
        names = _dictionary_names(specimen)
    else:
        names = _scene_names(Path(specimen), dict(parameters or {}))
    for name in names:
        path = Path(str(mi.file_resolver().resolve(str(name))))
        if path.is_file():
            low, high = check_measured(path) or (0.0, np.inf)
            # in the single precision of Mitsuba's
            singles = np.array(wavelengths, np.float32).astype(float)
            beyond = [nm for nm, x in zip(wavelengths, singles) if not low <= x <= high]
            if beyond:
                raise SpecimenError(
                    f"{path.name} covers the wavelengths from {low:g} to {high:g} nm, "
                    f"got {beyond[0]:g} nm"
                )


def _dictionary_names(node: Mapping[str, Any]) -> Iterator[str | Path]:
    """File names in a dictionary and all that it holds."""
    if node.get("type") == "measured" and isinstance(node.get("filename"), str):
        yield node["filename"]
    for value in node.values():
        if isinstance(value, Mapping):
            yield from _dictionary_names(value)


def _scene_names(
    path: Path, parameters: dict[str, str], within: tuple[Path, ...] = ()
) -> Iterator[str | Path]:
    """File names in a scene file and those that it includes, beside it if there.

    SpecimenError if a file includes itself, or a plugin would end the process.
    """
    path = path.resolve()
    if path in within:
        raise SpecimenError(
            f"a scene file must not include itself, but {path.name} is included by "
            f"{within[-1].name}"
        )
    if len(within) > MAX_INCLUDES:
        return
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
