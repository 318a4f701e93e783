"""What every format must pass: it reads what it writes, and refuses what it cannot."""

import contextlib
import io

import numpy as np
import pytest
from lobes import VIAVI, lobes, phong

import gonio_mi as gonio
from gonio_mi.cli import main
from gonio_mi.collector.directions import direction
from gonio_mi.errors import FileFormatError
from gonio_mi.exchange.formats import merl, radiance, reading
from gonio_mi.exchange.formats.reading import format_of, load_material, read_scatter
from gonio_mi.exchange.formats.tensor_tree import TensorTree

# Files as text; others are written by their formats, below.
TEXTS = {
    "fred.txt": "type bsdf_data\nformat angles=deg bsdf=value scale=1\n"
    "10 0\n5 0 0.1\n9 0 0.1\n20 0\n5 0 0.1\n9 0 0.25\n",
    "viavi.txt": VIAVI,
    "a.astm": "KEY words\nNUM_POINTS 1\nVARS theta_i,phi_i,theta_s,phi_s,R\n"
    "0,0,1,2,0.5\n",
    # no reader takes these
    "alta.dat": "#DIM 3 1\n#PARAM_IN RUSIN_TH_TD_PD\n#PARAM_OUT INV_STERADIAN\n"
    "0 0 0 0.3\n",
    "mitsuba.bsdf": "tensor_file\0\1\0",
    "tracepro.txt": "*TracePro Surface Property Data\nFile Name\tpaint.txt\n",
    "a.bsdf180": "OPTIS - BSDF180 surface file v1.0\n0\n",
    "a.scattering": "OPTIS - Scattering v1.0\n",
    "a.simplescattering": "OPTIS - Simple scattering v1.0\n",
}
REFUSED = {
    "alta.dat": "a data file of ALTA, whose parametrisations",
    "tracepro.txt": "a surface property of TracePro, whose angles",
    "mitsuba.bsdf": "a material of Mitsuba: measure the specimen measured:filename=",
    "a.bsdf180": "names two other files",
    "a.scattering": "parameters of a model",
    "a.simplescattering": "parameters of a model",
}
WRITTEN = [one for one in reading._all() if one.write]

# Relative errors of values by the digits of a file, and of its totals.
DIGITS = {".bsdf": 1e-5, ".json": 1e-4}


@pytest.fixture(scope="module")
def examples():
    """A file of every format, by name; those of MERL have few cells."""
    contents = {name: text.encode() for name, text in TEXTS.items()}
    for one in WRITTEN:
        stream = io.BytesIO()
        one.write(lobes(one.specular), stream, "made for a test")
        contents[f"a{one.endings[0]}"] = stream.getvalue()
    trees = TensorTree.of(np.full((2,) * 3, 0.25)), np.full((41, 41), 0.25)
    for name, block in zip(("tree.xml", "klems.xml"), trees):
        stream = io.BytesIO()
        radiance.write({("Visible", "Reflection Back"): block}, stream)
        contents[name] = stream.getvalue()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(merl, "CELLS", (9, 9, 18))
        stream = io.BytesIO()
        merl.write(lambda theta_i, _: np.full((len(theta_i), 3), 0.25), stream)
        yield contents | {"a.binary": stream.getvalue()}


def read(path):
    """What a file holds: a material, or else a table."""
    known = format_of(path)
    if known is not None and (known.scatter or known.material):
        return read_scatter(path) if known.scatter else load_material(path)
    return gonio.read_measured(path, quantity="brdf")


def file_of(folder, name, content):
    path = folder / name
    path.write_bytes(content)
    return path


def test_every_format_has_an_example(tmp_path, examples):
    """Whatever lists FORMATS is found; endings that are written are written by one."""
    paths = [file_of(tmp_path, *one) for one in examples.items()]
    read_or_refused = {one for one in reading._all() if one.endings or one.begins}
    assert {format_of(path) for path in paths} == read_or_refused
    endings = [ending for one in reading._all() for ending in one.writes]
    assert sorted(endings) == sorted(set(endings))
    for path in paths:
        if path.name not in REFUSED:
            read(path)


@pytest.mark.parametrize("hemisphere", [0, 1])
@pytest.mark.parametrize("one", WRITTEN, ids=lambda one: one.endings[0])
def test_what_is_written_is_read(tmp_path, one, hemisphere):
    """To the digits that the file has, as a material and as a table."""
    scatter = lobes(one.specular, hemisphere)
    ending = one.endings[0]
    path, digits = tmp_path / f"a{ending}", DIGITS.get(ending, 2e-5)
    with open(path, "wb") as stream:
        one.write(scatter, stream, "made for a test")
    if hemisphere and one.reflection_only:
        with pytest.raises(FileFormatError):
            read_scatter(path)
        return
    blocks = read_scatter(path).blocks
    places = [(block.theta_i, block.hemisphere) for block in blocks]
    assert places == [(theta_i, hemisphere) for theta_i in (0, 30, 60)]
    for block in blocks:
        expected = phong(block.theta_i, block.directions())[..., None]
        assert block.values == pytest.approx(expected, rel=digits, abs=digits)
    table = gonio.read_measured(path)
    assert table.quantity == ("brdf", "btdf")[hemisphere]
    assert ((table.theta_o > 90) == bool(hemisphere)).all()
    lit = np.where(table.theta_o > 90, 180 - table.theta_o, table.theta_o)
    for theta_i in (0, 30, 60):
        here = table.theta_i == theta_i
        wo = direction(np.radians(lit[here]), np.radians(table.phi_o[here]))
        # six decimals of a degree displace the lobe by as much
        assert table.value[here] == pytest.approx(phong(theta_i, wo), rel=1e-4)


def test_what_is_no_file_of_a_format_is_refused_in_a_sentence(tmp_path, examples):
    """Nothing, half of it, and noise; another's file is read as such, or refused."""
    noise = np.random.default_rng(1).bytes(1000)
    for name, content in examples.items():
        for damaged in (b"", content[: len(content) // 2], noise, b"\0" * 100):
            path = file_of(tmp_path, name, damaged)
            with pytest.raises(FileFormatError) as caught:
                read(path)
            assert name in str(caught.value)
            assert "\n" not in str(caught.value)
            # nothing but its own first bytes tells a material of Mitsuba
            assert "measured:" not in str(caught.value) or name in REFUSED
        for other in examples.values():
            with contextlib.suppress(ValueError):
                read(file_of(tmp_path, name, other))


@pytest.mark.parametrize("mark", [b"\xef\xbb\xbf", "utf-16"])
def test_byte_order_marks(tmp_path, examples, mark):
    """Before every text that is a table."""
    for name in examples.keys() - REFUSED.keys():
        path = file_of(tmp_path, name, examples[name])
        if name.endswith((".xml", ".binary")):
            continue
        bare = gonio.read_measured(path, quantity="brdf")
        text = examples[name].decode()
        path.write_bytes(
            mark + text.encode() if isinstance(mark, bytes) else text.encode(mark)
        )
        marked = gonio.read_measured(path, quantity="brdf")
        assert np.array_equal(marked.value, bare.value)
        assert np.array_equal(marked.phi_o, bare.phi_o)


@pytest.mark.parametrize("name", REFUSED)
def test_what_nothing_reads_is_named(tmp_path, capsys, name):
    """As a table, as a material, and by a command that takes something else."""
    path = file_of(tmp_path, name, TEXTS[name].encode())
    for reader in (gonio.read_measured, read_scatter):
        with pytest.raises(FileFormatError, match=REFUSED[name]) as caught:
            reader(path)
        assert str(path) in str(caught.value)
    for command in ("show", "surface"):
        assert main([command, str(path)]) == 1
        assert REFUSED[name] in capsys.readouterr().err


# What is replaced in an example, by what, and what is said of it.
DAMAGED = r"""
a.bsdf | BRDF | XRDF | ScatterType is XRDF
a.bsdf | Monochrome | Chrome | SpectralContent is Chrome
a.bsdf | ScatterRadial  19 | ScatterRadial  9999999999 | more values than any file
a.bsdf | ScatterRadial  19 | ScatterRadial  18 | must have 18 numbers, got 19
a.bsdf | TIS | SIT | must begin with TIS
a.bsdf | DataEnd | | must be DataEnd
a.bsdf | Symmetry | Cemetery | unknown keyword Cemetery
a.bsdf | Asymmetrical | PlaneSymmetrical | azimuths must go from 0 to 180, got 0 to 3
a.brdf | v9.0\n0 | v9.0\n1\0 | binary: save it as text
a.brdf | brdf surface file | a lamp | it is a OPTIS - a lamp
a.brdf | v9.0 | v1.0 | version 1.0: save it anew
a.json | "license" | "licence" | its metadata lack license
a.json | "uuid": " | "uuid": "x | its uuid does not match the format
a.json | "brdf" | "bsdf" | not an OpenMATERIAL table: it has no brdf
a.json | "metadata" | "meta" | not an OpenMATERIAL table: it has no metadata
a.json | "wavelengths": [5.5e-07] | "wavelengths": [5e-7] | not those of its lookupT
a.json | [[5.5e-07, 0.0 | [[5.5e-07, 2.0 | row 0 .* incident zenith 2
a.json | [[5.5e-07, 0.0 | [[5.5e-07 | row 0 of its lookupTable must have 5 numbers
fred.txt | angles=deg | angles=cos | angles are cos
fred.txt | 10 0\n5 0 0.1 | 5 0 0.1 | line 3 comes before an incidence
fred.txt | 9 0 0.25 | 9 0 x | line 8: must be a number
fred.txt | 9 0 0.1 | 5 0 0.9 | the values 0.1 and 0.9: one is wrong
fred.txt | 5 0 0.1\n9 0 0.25\n | | no values of the incidence 20, 0: it is
fred.txt | 9 0 0.25\n | 9 0 0.2\n30 0\n5 0 0. | has 1 of 2 directions, and no end
fred.txt | bsdf=value scale=1 | bsdf=log scale=1e400 | its scale is not finite
a.astm | VARS | WARS | no line VARS
a.astm | theta_s | theta | its VARS must be theta_i,
a.astm | ,R | | its VARS must be theta_i,
a.astm | POINTS 1 | POINTS 99999999999 | announces 99999999999 points and holds 1
a.astm | ,0.5 | | line 4 must have 5 numbers, got 4
a.astm | 0.5 | half | line 4: must be a number
a.astm | 1,2 | 2,2 | theta_o must be an angle in degrees in
a.astm | 0.5 | nan | value must be a finite number
a.astm | KEY | KEY\0 | it is not text
a.astm | 0,0,1,2,0.5\n | | announces 1 points and holds 0
a.astm | 1\nVARS | 0\nVARS | announces 0 points and holds 1
klems.xml | <?xml | <?xml oops | not XML
klems.xml | </WindowElement> | | not XML
klems.xml | <WindowElement  | <!DOCTYPE x [<!ENTITY a "b">]><WindowElement  | DTD
klems.xml | WindowElement | Elsewhere | not a Radiance WindowElement
klems.xml | Columns | TensorTree2 | must be Columns, Rows, TensorTree3, TensorTree4
klems.xml | LBNL/Klems Quarter< | LBNL/Klems Half< | must hold 5929 values
klems.xml | <RowAngleBasis>LBNL/Klems Quarter< | <RowAngleBasis>x< | must be one of
klems.xml | 0.25,  | | must hold 1681 values, got
klems.xml | 0.25,  | nan,  | not finite
klems.xml | 0.25,  | x,  | must be a number, got
klems.xml | >Visible< | >Solar< | no visible BSDF
tree.xml | { 0.25 } | | not closed
tree.xml | { 0.25 } | 1 { 2 } | does not begin with a brace
tree.xml | { 0.25 } | { 1 | not closed
tree.xml | { 0.25 } | { 1 } { 2 } | not closed
tree.xml | { 0.25 } | { 1 } } | out of place
tree.xml | { 0.25 } | { 1 } 2 | out of place
tree.xml | { 0.25 } | { 1 { 2 } } | out of place
tree.xml | { 0.25 } | { {1} {2} } | must have 8 children
tree.xml | { 0.25 } | { 1 2 3 } | 2.3k values, got 3
tree.xml | { 0.25 } | {1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1} | got 27
tree.xml | { 0.25 } | { x } | must be a number, got
tree.xml | { 0.25 } | { nan } | not finite
tree.xml | { 0.25 } | {{{{{{{{{{{{{{{{{{{{{{{{{{{{{{ | too deep
"""


@pytest.mark.parametrize("line", DAMAGED.strip().splitlines())
def test_damaged_files_are_refused(tmp_path, examples, line):
    name, old, new, message = line.replace("| |", "|  |").split(" | ")
    text = examples[name].decode()
    old, new = (part.encode().decode("unicode_escape") for part in (old, new))
    assert old in text
    path = file_of(tmp_path, name, text.replace(old, new).encode())
    with pytest.raises(FileFormatError, match=message) as caught:
        read(path)
    assert str(path) in str(caught.value)
