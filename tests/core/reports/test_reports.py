"""The page of records shows the record's numbers, in a real browser too."""

import base64
import csv
import json
import re
import shutil
import sys
import zlib
from dataclasses import replace

import numpy as np
import pytest
import synthetic

import gonio_mi as gonio
from gonio_mi.cli import main
from gonio_mi.collector.directions import direction
from gonio_mi.errors import SettingError, SettingTypeError
from gonio_mi.reports import report
from gonio_mi.reports.report import RASTER, names_apart, packed_record, raster
from gonio_mi.results.summary import summarize
from gonio_mi.results.summary_text import summary_text
from gonio_mi.results.tally import N_ELEMENTS, PolarisedTally

pytest.importorskip("plotly")

BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))),
    None,
)


def values(packed, index):
    """The four float arrays and the hits of one incident direction."""
    raw = zlib.decompress(base64.b64decode(packed["values"][index]))
    n = packed["hemispheres"] * packed["patches"] * len(packed["channels"])
    floats = np.frombuffer(raw[: 16 * n], "<f4").reshape(4, -1)
    return floats, np.frombuffer(raw[16 * n :], "<u4")


# ------------------------------------------------------------------------ the data


@pytest.mark.parametrize("collector", ["projected:6x8", "klems"])
def test_page_holds_the_record(collector):
    record = synthetic.record(
        collector, theta_i=(0, 30), phi_i=(0, 90), both=True, channels=("R", "G")
    )
    packed = packed_record(record)
    (mean, error, below, above), hits = values(packed, 1)
    single = record[1]
    pair = np.stack([single.brdf, single.btdf])
    np.testing.assert_array_equal(mean, pair.ravel().astype("f4"))
    np.testing.assert_array_equal(hits, single.counts.ravel())
    low, high = single.interval(of="btdf")
    half = mean.size // 2
    # 12 bits of a mantissa in [1/2, 1): half a unit of 2^-12, at most 2^-12 of it
    rounding = {"rtol": 2.0**-12, "atol": 0, "equal_nan": True}
    np.testing.assert_allclose(below[half:], (single.btdf - low).ravel(), **rounding)
    np.testing.assert_allclose(above[half:], (high - single.btdf).ravel(), **rounding)
    np.testing.assert_allclose(error[:half], single.brdf_std_err.ravel(), **rounding)
    assert not np.allclose(error[:half], 1.001 * single.brdf_std_err.ravel())


@pytest.mark.parametrize("collector", ["angle:5x4", "klems", "apertures:2@45/180,30/0"])
def test_raster_knows_the_patch_of_a_direction(collector):
    patches = gonio.subdivision(collector)
    known = raster(patches)
    steps = RASTER
    rows, columns = np.random.default_rng(1).integers(0, steps, (50, 2)).T
    theta, phi = (rows + 0.5) * 90 / steps[0], (columns + 0.5) * 360 / steps[1]
    expected = patches.patch(direction(np.radians(theta), np.radians(phi)))
    np.testing.assert_array_equal(known[rows, columns], expected)


def test_large_records_are_thinned_and_say_so(monkeypatch):
    record = synthetic.record(theta_i=(0, 10, 20, 30, 40), phi_i=(0,) * 5)
    assert "of the record's" not in str(packed_record(record)["notes"])
    monkeypatch.setattr(sys.modules[report.__module__], "MAX_VALUES", 3 * 48)
    packed = packed_record(record)
    assert [d["theta_i"] for d in packed["directions"]] == [0, 20, 40]
    assert "3 of the record's 5 incident directions" in packed["notes"][0]


def test_names_tell_records_apart():
    base = synthetic.record().with_settings(specimen="a.xml", period="box")
    order = [base.with_settings(order=k) for k in ("1", "2")]
    free = order[1].with_settings(period="none")
    assert names_apart(order) == ["a.xml, order 1", "a.xml, order 2"]
    assert names_apart([*order, free]) == [
        "a.xml, order 1",
        "a.xml, order 2, period box",
        "a.xml, order 2, period none",
    ]
    other = synthetic.record("klems").with_settings(specimen="a.xml", period="box")
    assert names_apart([base, other])[1] == "a.xml, collector klems"
    assert names_apart([base, base]) == ["a.xml", "a.xml"]  # alike, if all is
    assert names_apart([base, base.with_settings(specimen="b.xml", seed=9)]) == [
        "a.xml",
        "b.xml",
    ]
    long = [base.with_settings(specimen=f"{100 * 'a'}{k}.xml") for k in range(3)]
    assert [name[-5:] for name in names_apart(long)] == ["0.xml", "1.xml", "2.xml"]


def test_polarised_records_have_maps_of_all_elements(tmp_path):
    pytest.importorskip("matplotlib")
    record = synthetic.record(both=True)
    (tally,) = record.tallies
    shape = *tally.sums.shape[:-1], N_ELEMENTS, tally.channels
    polarised = PolarisedTally(**vars(tally), elements=np.zeros(shape))
    others = record, replace(record, tallies=(polarised,))
    report(others, tmp_path / "a.html")
    assert (tmp_path / "a.html").read_text().count("<img ") == 2
    report(record, tmp_path / "a.html")
    assert "<img " not in (tmp_path / "a.html").read_text()


# ------------------------------------------------------------------------ bad input


def test_wrong_records_are_named(tmp_path):
    with pytest.raises(SettingError, match=r"a Record or several, got \[\]"):
        report([], tmp_path / "a.html")
    with pytest.raises(SettingTypeError, match=r"a Record or several, got .*run\.npz"):
        report(["run.npz"], tmp_path / "a.html")
    with pytest.raises(SettingError, match=r"must end in \.html"):
        report(synthetic.record(), tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


def test_without_plotly_one_sentence(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "plotly", None)
    with pytest.raises(ImportError, match=re.escape('pip install ".[report]"')):
        report(synthetic.record(), tmp_path / "a.html")


def test_command_writes_the_page(tmp_path):
    record = synthetic.record()
    record = record.with_settings(specimen="</script><b>")
    record.save(tmp_path / "a.npz")
    page = tmp_path / "a.html"
    assert main(["report", str(tmp_path / "a.npz"), "-o", str(page)]) == 0
    text = page.read_text()
    start = text.index('id="data">') + len('id="data">')
    data = json.loads(text[start : text.index("</script>", start)])
    assert data["records"][0]["name"] == "</script><b>"


# ------------------------------------------------------------------------ a browser


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium of this machine."""
    playwright = pytest.importorskip("playwright.sync_api")
    if BROWSER is None:
        pytest.skip("there is no Chromium on this machine")
    with playwright.sync_playwright() as driver:
        flags = ["--no-sandbox", "--enable-unsafe-swiftshader", "--disable-gpu"]
        chromium = driver.chromium.launch(executable_path=BROWSER, args=flags)
        yield chromium
        chromium.close()


@pytest.fixture
def opened(browser, tmp_path):
    """Function that opens the page of records; at the end nothing went wrong in it."""
    wrong = []

    def log(message):
        if message.type == "error":
            wrong.append(message.text)

    def ask(request):
        if not request.url.startswith(("file:", "data:", "blob:")):
            wrong.append(request.url)

    def open_page(*records):
        path = tmp_path / "page.html"
        report(records, path)
        page = browser.new_page()
        page.on("console", log)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("request", ask)
        page.goto(path.as_uri())
        page.wait_for_function("document.body.dataset.drawn", timeout=60_000)
        return page

    yield open_page
    assert wrong == []


def pointed(page, panel, theta, phi):
    """What the page tells of the patch in that direction, pointer on the map."""
    page.mouse.move(0, 0)
    spot = page.evaluate(
        """([panel, x, y]) => {
            const plot = document.querySelector(`#${panel} .plot`);
            const box = plot.getBoundingClientRect(), { xaxis, yaxis, _size: size } =
                plot._fullLayout;
            return [box.x + size.l + xaxis.d2p(x), box.y + size.t + yaxis.d2p(y)];
        }""",
        [
            panel,
            float(np.sin(theta) * np.cos(phi)),
            float(np.sin(theta) * np.sin(phi)),
        ],
    )
    page.mouse.move(spot[0] - 3, spot[1])
    page.mouse.move(*spot)
    page.wait_for_function(f"document.querySelector('#{panel} output').value.trim()")
    return page.locator(f"#{panel} output").text_content()


def choose(page, menu, number):
    """Choose from a menu, and wait until the page shows it."""
    page.evaluate("delete document.body.dataset.drawn")
    page.locator(f"#{menu}").select_option(str(number))
    page.wait_for_function("document.body.dataset.drawn")


@pytest.mark.promise("an interactive page")
def test_slider_pointer_and_csv_show_the_record(opened, tmp_path):
    record = synthetic.record(theta_i=(0, 30, 60), phi_i=(20,) * 3, both=True)
    page = opened(record)
    theta, phi = record.subdivision.middles
    for index in (0, 2):
        page.locator("#theta").fill(str(index))
        page.wait_for_function(f"document.body.dataset.drawn === '0/{index}/0'")
        text = pointed(page, "map-0-1", theta[3, 2], phi[3, 2])
        number = float(re.search(r": (\S+) ±", text)[1])
        # half a unit of the second digit of its error, which begins with 1 at least
        shown = 0.05 * record.btdf_std_err[index, 3, 2, 0]
        assert number == pytest.approx(record.btdf[index, 3, 2, 0], rel=0, abs=shown)
        assert number != pytest.approx(record.btdf[1, 3, 2, 0], rel=0, abs=shown)
        assert f"{record.counts[index, 1, 3, 2]} rays" in text
    angles = page.locator("#map-0-1 .annotation-text").all_text_contents()
    assert angles == ["30°", "60°", "φ 0°", "90°", "180°", "270°"]
    with page.expect_download() as download:
        page.locator("#csv").click()
    path = tmp_path / "direction.csv"
    download.value.save_as(path)
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert len(rows) == 2 * 48  # of the direction that is shown
    found = np.array([float(row["value"]) for row in rows], "f4")
    both = np.stack([record.brdf[2], record.btdf[2]])
    np.testing.assert_array_equal(found, both.ravel().astype("f4"))
    assert [int(row["rays"]) for row in rows] == record.counts[2].ravel().tolist()
    stand_in_order_and_apart(page, [f"map-0-{h}" for h in (0, 1)], 2)


def test_totals_have_the_digits_that_show_gives_them(opened):
    """And no difference is drawn of unlike channels."""
    record, integrals = (
        synthetic.record(both=True, channels=("R", "G")),
        synthetic.integrals(),
    )
    page = opened(record, integrals)
    is_without_difference(page)
    rows = page.locator("#readings tr").all_text_contents()
    lines = summary_text(summarize(record)).splitlines()
    assert rows[5] == "ledger (counts rays, not power)raysshare of rays"
    for row, line in zip(rows[1:5], [one for one in lines if "  dh" in one]):
        *_, value, _, low, high = line.split()
        assert value in row
        assert row.endswith(f"{low} to {high}")
    choose(page, "record", 1)
    assert "none: integrals" in page.locator("#readings").text_content()
    assert "share" not in page.locator("#readings").text_content()
    theta, phi = integrals.subdivision.middles
    assert "integrated, solid" in pointed(page, "map-0-0", theta[3, 2], phi[3, 2])


def darkened(record, *patch):
    """The record with a patch that no ray reached."""
    tally = synthetic.writeable(record.tallies[0])
    tally.hits[(0, *patch)] = 0
    tally.sums[(slice(None), 0, *patch)] = 0
    return replace(record, tallies=(tally,))


def test_two_records_and_their_difference(opened):
    """Where one has no hit it is largest: against the limit of what no ray reached."""
    one, other = synthetic.record(), synthetic.record(power=28)
    dark = darkened(synthetic.record(seed=2), 2, 4)
    page = opened(one, other, dark)
    theta, phi = one.subdivision.middles
    text = pointed(page, "map-z-0", theta[2, 4], phi[2, 4])
    apart = float(re.search(r"(\S+) standard errors", text)[1])
    both = np.hypot(one.brdf_std_err, other.brdf_std_err)[2, 4, 0]
    expected = (one.brdf - other.brdf)[2, 4, 0] / both
    # errors of 12 bits each, values of 24 bits that nearly cancel, five digits
    few = 2.0**-12 + 2.0**-23 * one.brdf[2, 4, 0] / (abs(expected) * both) + 1e-4
    assert apart == pytest.approx(expected, rel=few)
    assert apart != pytest.approx(1.01 * expected, rel=few)
    choose(page, "beside", 2)
    text = pointed(page, "map-z-0", theta[2, 4], phi[2, 4])
    apart = float(re.search(r"(\S+) standard errors", text)[1])
    limit = dark.interval(0.95)[1][2, 4, 0]
    assert dark.brdf[2, 4, 0] == 0 < limit
    spread = np.hypot(one.brdf_std_err[2, 4, 0], limit / 1.96)
    # errors of 12 bits, a limit of as many, five digits
    assert apart == pytest.approx(one.brdf[2, 4, 0] / spread, rel=2.0**-12 + 1e-4)
    assert apart > 5
    colours = page.evaluate(
        "document.querySelector('#map-z-0 .plot').data[0].z.flat()"
        ".filter((v) => v !== null).length"
    )
    disc = page.evaluate(
        "document.querySelector('#map-0-0 .plot').data[0].z.flat()"
        ".filter((v) => v !== null).length"
    )
    assert colours == disc


BOXES = """[...document.querySelectorAll('#maps .panel')].map((panel) => {
    const { x, y, right, bottom } = panel.getBoundingClientRect();
    return [panel.id, x, y, right, bottom];
})"""


def stand_in_order_and_apart(page, keys, columns):
    """By hemisphere: a record, the other, their difference; also when one is added."""
    for width, side_by_side in ((1280, columns), (500, 1)):
        page.set_viewport_size({"width": width, "height": 900})
        page.wait_for_function(
            f"""() => {{
                const panels = [...document.querySelectorAll('#maps .panel')];
                const right = (one) => one?.getBoundingClientRect().right;
                return innerWidth === {width} && panels.length === {len(keys)} &&
                    panels.every((panel) =>
                        right(panel.querySelector('.main-svg')) <= right(panel) + 1);
            }}"""
        )
        boxes = page.evaluate(BOXES)
        assert [key for key, *_ in boxes] == keys
        assert len({x for _, x, *_ in boxes}) == side_by_side
        assert len({y for _, _, y, *_ in boxes}) == len(keys) // side_by_side
        for i, (_, _, _, right, bottom) in enumerate(boxes):
            assert all(x >= right or y >= bottom for _, x, y, *_ in boxes[i + 1 :])
        # profiles follow the width of the window later than maps
        page.wait_for_function("document.documentElement.scrollWidth <= innerWidth")


ROOM = """() => {
    const menu = document.querySelector('#record'), style = getComputedStyle(menu);
    const pen = document.createElement('canvas').getContext('2d');
    pen.font = style.font;
    return menu.clientWidth - Math.max(...Array.from(menu.options, (one) =>
        pen.measureText(one.text).width));
}"""


def test_records_of_unlike_settings_have_unlike_names(opened):
    """In menus, headings and legends, which are as wide as the names in them.

    Twin: a narrower menu cuts the order, by which they differ.
    """
    base = synthetic.record(both=True).with_settings(specimen="grooves_of_a_tile.xml")
    records = [base.with_settings(order=order) for order in ("1", "2", "3+")]
    page = opened(*records)
    name = "grooves_of_a_tile.xml, order"
    names = [f"{i}: {name} {k}" for i, k in ((1, "1"), (2, "2"), (3, "3+"))]
    assert page.locator("#record option").all_text_contents() == names
    assert page.locator("#beside option").all_text_contents() == ["none", *names]
    assert page.locator("#title").text_content() == names[0]

    assert page.locator("#maps h2").all_text_contents()[:2] == [
        f"reflection: {name}" for name in names[:2]
    ]
    legend = page.locator("#cut .legendtext").all_text_contents()
    assert legend[0] == f"{names[0]}, reflection"
    assert legend[-1] == f"{names[1]}, transmission"
    choose(page, "beside", -1)
    assert page.locator("#maps .panel").count() == 2
    choose(page, "beside", 2)
    keys = [f"map-{which}-{h}" for h in (0, 1) for which in (0, 1, "z")]
    stand_in_order_and_apart(page, keys, 3)
    assert page.evaluate(ROOM) > 0
    page.add_style_tag(content=".bar select { max-width: 12em; }")
    assert page.evaluate(ROOM) < 0


def is_without_difference(page):
    assert "No difference is drawn" in page.locator("#notes").text_content()
    assert page.locator("#map-z-0").count() == 0
    assert page.locator("#map-1-0").count() == 1


def test_no_difference_of_unlike_patches(opened):
    is_without_difference(opened(synthetic.record(), synthetic.record("klems")))
