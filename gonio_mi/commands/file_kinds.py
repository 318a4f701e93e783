"""Kinds of files, and the command for each, named when another command got one."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from ..annexes import ask
from ..errors import SettingError

if TYPE_CHECKING:
    from ..results.record import Record

# Bytes in which an XML file names its root.
HEAD = 4096

# Sentences on files by the endings of their names; those of records, tables, meshes and
# heights are listed where they are read.
RECORD = "is named as a record is: give it to gonio-mi show, plot or report"
MEASURED = (
    "holds measured values: give it to gonio-mi show, compare, fit or quantity, or "
    "measure the material goniometric:filename={path}"
)
MESH = "is a mesh: give it to gonio-mi measure or surface, with --bsdf"
HEIGHTS = "is read as heights of a surface: give it to gonio-mi surface or measure"
TABLE = (
    "is named as a table is: give it to gonio-mi show, compare, fit or quantity "
    "(heights in text are known by the ending .asc)"
)
TABLES = (".csv", ".tsv", ".txt", ".astm", ".rtd")
POINTS = (
    "is a cloud of points, which no command reads: make a mesh of it (obj, ply, stl) "
    "or heights on a regular grid (npy)"
)
OTHERS = {
    ".jpg .jpeg .gif .pdf .svg .webp .bmp": "is a picture, which no command reads: "
    "records end in .npz or .exr",
    ".ies .ldt": "is the light of a lamp, which no command reads: emitters are parts "
    "of scenes",
    ".h5 .hdf5 .nc": "holds arrays, which gonio-mi export writes and no command reads: "
    "records end in .npz or .exr",
    ".xyz .pts .pcd .las .laz .e57": POINTS,
    ".step .iges .gltf .glb .fbx .dae .blend .3ds": "is a model of another program, "
    "which no command reads: export a mesh (obj, ply, stl)",
    ".rad .oct": "is a scene of Radiance, which no command reads: scenes are "
    "Mitsuba's, in XML, and meshes end in .obj, .ply or .stl",
    ".py": "is a program in Python: give a plugin with --plugin, and its name as the "
    "specimen",
}
OF_RADIANCE = "is a BSDF of Radiance: measure the specimen goniometric:filename={path}"
SCENE = "is a scene: give it to gonio-mi measure"
UNKNOWN = (
    "is no specimen: scenes are Mitsuba's, in XML, meshes end in .obj, .ply or .stl, "
    "and heights in .npy, .png, .x3p or as instruments have them"
)


def check_kind(path: str, wanted: str) -> None:
    """Raise one sentence if a file is of a known kind and not of the one `wanted`.

    Parameters
    ----------
    path : str
        Of a file; nothing is said of one that does not exist.
    wanted : {"record", "table", "specimen"}

    Raises
    ------
    SettingError
        What the file is, and which command takes it.
    """
    if Path(path).is_file():
        kind, sentence = _kind(Path(path))
        said = ("unknown",) if wanted == "specimen" else ("unknown", "other")
        if kind not in (wanted, *said):
            raise SettingError(f"{path} {sentence.format(path=path)}")


def is_table(path: str) -> bool:
    """Whether a file is of a kind that commands take as a table."""
    return Path(path).is_file() and _kind(Path(path))[0] == "table"


def record_of(path: str) -> Record:
    """Record of a file.

    Raises
    ------
    SettingError, OSError
        As of :func:`gonio_mi.load`, and of :func:`check_kind`.
    """
    from .. import files

    if not path.lower().endswith(files.ENDINGS):
        check_kind(path, "record")
    return files.load(path)


def _kind(path: Path) -> tuple[str, str]:
    """Kind of a file, and a sentence on which commands take it."""
    from .. import files
    from ..surfaces import height_maps
    from ..surfaces.meshes import MESHES

    with path.open("rb") as stream:
        head = stream.read(HEAD)
    name = path.name.lower()
    known = ask("exchange", "format_of", lambda _: None)(path)
    if known is not None and known.refused:
        return "material", known.refused.removeprefix("it ")
    if name.endswith(".xml"):
        is_radiance = b"<WindowElement" in head
        return ("material", OF_RADIANCE) if is_radiance else ("specimen", SCENE)
    if name.endswith(".ply") and not re.search(rb"element face +[1-9]", head):
        return "points", POINTS
    # text with labels is told from heights by who reads it
    if name.endswith((".asc", ".dat")) and re.search(rb"(?m)^[^#\n]*[A-Za-z]{3}", head):
        return "unknown", ""
    others = ((tuple(names.split()), "foreign", OTHERS[names]) for names in OTHERS)
    kinds = (
        (files.ENDINGS, "record", RECORD),
        (ask("exchange", "endings_of", lambda _: ())("scatter"), "table", MEASURED),
        (TABLES, "table", TABLE),
        *others,
        (tuple(MESHES), "specimen", MESH),
        (height_maps.ENDINGS, "specimen", HEIGHTS),
    )
    for endings, kind, sentence in kinds:
        if name.endswith(endings):
            return kind, sentence
    return ("unknown", "") if head.lstrip().startswith(b"<") else ("other", UNKNOWN)
