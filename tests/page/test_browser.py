"""The page of a result in a real Chromium."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.page.document import write_page
from egolane_pgm.results import Result
from egolane_pgm.running import run_experiment
from tests.kits.browser import Opened, chromium, opened
from tests.kits.drives import simulated


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def result() -> Result:
    return run_experiment(simulated())


@pytest.fixture(scope="module")
def file(result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "a b#1.html"
    write_page([result], path)
    return path


@pytest.fixture(scope="module")
def page(browser: Any, file: Path) -> Opened:
    return opened(browser, file)


@pytest.fixture
def shown(page: Opened) -> Opened:
    """The page of the result, as it is when it was opened."""
    page.page.mouse.move(5, 5)
    page.page.evaluate("scrollTo(0, 0)")
    page.page.get_by_role("button", name="whole drive").click()
    return page


def plot(shown: Opened) -> dict[str, float]:
    """Where the panels are, in pixels."""
    return dict(shown.page.locator("#panels").bounding_box())


def middle(shown: Opened) -> tuple[float, float]:
    """A place in the first panel."""
    box = plot(shown)
    return box["x"] + box["width"] / 2, box["y"] + 40


def settled(shown: Opened) -> None:
    shown.page.wait_for_timeout(200)


def test_it_opens_from_its_file_without_an_error_and_asks_for_nothing(
    shown: Opened, file: Path
) -> None:
    settled(shown)
    assert shown.errors == []
    assert shown.asked == [file.absolute().as_uri()]


def test_every_panel_is_drawn_below_its_name(shown: Opened, tmp_path: Path) -> None:
    from egolane_pgm.vision.camera.pictures import read_image

    names = shown.page.locator("#panels h3").all_inner_texts()
    beginnings = ("Model", "Detector", "Truth", "Lane changes", "Wrong", "P(Sensor", "Lines")
    assert len(names) == len(beginnings)
    assert all(map(str.startswith, names, beginnings))
    settled(shown)
    shown.page.locator("#panels").screenshot(path=tmp_path / "panels.png")
    image = read_image(tmp_path / "panels.png")
    tops = shown.page.locator("#panels h3").evaluate_all("all => all.map(e => e.offsetTop + 22)")
    for name, top, end in zip(names, tops, [*tops[1:], len(image)], strict=True):
        inside = image[top + 2 : end - 24 if end < len(image) else end, 40:]
        assert len(np.unique(inside.reshape(-1, 3), axis=0)) >= 3, name


def test_the_wheel_zooms_at_the_mouse_and_dragging_moves(shown: Opened) -> None:
    begin, end = shown.range()
    shown.page.mouse.move(*middle(shown))
    shown.page.mouse.wheel(0, -600)
    settled(shown)
    closer = shown.range()
    assert begin < closer[0] < closer[1] < end
    x, y = middle(shown)
    shown.page.mouse.down()
    shown.page.mouse.move(x - 200, y, steps=5)
    shown.page.mouse.up()
    settled(shown)
    moved = shown.range()
    assert moved[1] - moved[0] == pytest.approx(closer[1] - closer[0])
    assert moved[0] > closer[0]
    shown.page.get_by_role("button", name="whole drive").click()
    assert shown.range() == pytest.approx((begin, end))
    assert shown.errors == []


def test_hovering_tells_the_frame_under_the_mouse(shown: Opened, result: Result) -> None:
    tip = shown.page.locator("#tip")
    assert tip.is_hidden()
    shown.page.mouse.move(*middle(shown))
    assert tip.is_visible()
    said = tip.inner_text()
    time_s = float(said.split(" s")[0])
    at = int(np.abs(result.time_s - time_s).argmin())
    assert abs(time_s - result.time_s.mean()) < 0.05 * np.ptp(result.time_s)
    assert f"frame {result.frame_id[at]}" in said
    assert f"lane {result.assigned_lane[at]}:" in said
    shown.page.mouse.move(5, 5)
    assert tip.is_hidden()


def test_what_is_drawn_is_what_was_believed(shown: Opened, result: Result) -> None:
    """At one pixel column for each frame the picture of a strip has the belief's colours."""
    from egolane_pgm.views.answers import PROBABILITY_COLOURS

    shown.page.evaluate(
        "t => Bokeh.documents[0].get_model_by_name('time').setv({start: t, end: t + 20})",
        float(result.time_s[100]),
    )
    settled(shown)
    found = shown.page.evaluate(
        "() => { const source = Bokeh.documents[0].get_model_by_name('image');"
        " const [image] = source.get_column('image');"
        " const [high, wide] = image.shape;"
        # The first panel begins below its name, and its lanes are 22 pixels high.
        " const rows = [0, 1, 2, 3].map(k => (high - 1 - 33 - 22 * k) * wide);"
        " const line = at => Array.from({length: wide}, (_, c) => image[at + c] & 255);"
        " return [rows.map(line),"
        " source.get_column('x')[0], source.get_column('dw')[0]] }"
    )
    reds_drawn = np.array(found[0])
    column = (result.time_s[100:300] - found[1]) / found[2] * reds_drawn.shape[1]
    red = reds_drawn[:, column.astype(int)].T
    reds = [int(colour[1:3], 16) for colour in PROBABILITY_COLOURS]
    expected = np.interp(result.marginals["Lane"][100:300], np.linspace(0, 1, 5), reds)
    assert np.abs(red - expected).max() <= 2


def test_a_click_on_a_worst_stretch_goes_there(shown: Opened, result: Result) -> None:
    before = shown.range()
    for button in ("#stretches button", "header .figures button"):
        shown.page.get_by_role("button", name="whole drive").click()
        place = shown.page.locator(button).first
        begin, end = (float(place.get_attribute(f"data-{name}")) for name in ("begin", "end"))
        place.click()
        start, stop = shown.range()
        assert start <= begin <= end <= stop
        assert stop - start < before[1] - before[0]
        assert shown.page.locator("#timeline").bounding_box()["y"] < 900
    figures = shown.page.locator("header .figures li").all_inner_texts()
    accuracy = result.scores["model"]["accuracy"]
    assert float(figures[0].split(" %")[0]) == pytest.approx(100 * accuracy, abs=0.05)
    for landmark in ("banner", "navigation", "main"):
        assert shown.page.get_by_role(landmark).count() == 1
    assert shown.page.get_by_role("region").count() >= 7


def test_a_telephone_shows_it_without_scrolling_sidewards(browser: Any, file: Path) -> None:
    telephone = {"device_scale_factor": 2, "has_touch": True, "is_mobile": True}
    shown = opened(browser, file, width=390, **telephone)
    assert shown.errors == []
    wide, inner = shown.page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
    assert wide <= inner == 390
    shown.page.touchscreen.tap(*middle(shown))
    assert shown.page.locator("#tip").is_visible()
    tip = shown.page.locator("#tip").bounding_box()
    assert tip["x"] >= 0
    assert tip["x"] + tip["width"] <= 390


def test_several_results_stand_on_one_axis(browser: Any, result: Result, tmp_path: Path) -> None:
    other = run_experiment(simulated("b", evidence_reading="hard"))
    write_page([result, other], tmp_path / "two.html")
    shown = opened(browser, tmp_path / "two.html")
    titles = shown.page.locator("#panels h3").all_inner_texts()
    # The detector, the truth and the lines of both are the same, and shown once.
    for once in ("Detector alone", "Truth", "Lines"):
        assert sum(title.startswith(once) for title in titles) == 1
    for each in ("Model: belief", "Wrong: ", "Lane changes"):
        assert sum(title.startswith(each) for title in titles) == 2
    shown.page.mouse.move(*middle(shown))
    said = shown.page.locator("#tip").inner_text()
    assert "a" in said.split()
    assert "b" in said.split()
    assert shown.errors == []
