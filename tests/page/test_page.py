"""The page of results: its lists, and the page itself in a real Chromium."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import egolane_pgm as ego
from egolane_pgm.page.document import without_folders, write_page
from egolane_pgm.page.segments import lane_changes, worst_segments
from egolane_pgm.result import Result
from egolane_pgm.runs import open_input, run_input
from egolane_pgm.types import InputError
from tests.kits.browser import chromium, opened


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def result() -> Result:
    return run_input(open_input("quickstart"))


@pytest.fixture(scope="module")
def file(result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "a b#1.html"
    write_page([result], path)
    return path


def without_truth(result: Result) -> Result:
    frames = result.frames.assign(true_lane=pd.NA, is_crossing=pd.NA)
    frames = frames.astype({"true_lane": "Int64", "is_crossing": "boolean"})
    scores = {k: v for k, v in result.scores.items() if k not in ("model", "detector")}
    return replace(result, frames=frames, scores={**scores, "events": {"detected": 11}})


# --- lists ---------------------------------------------------------------------------------------


def test_the_lists_count_as_the_scores_do(result: Result) -> None:
    frames = result.frames
    found = lane_changes(result)["outcome"].value_counts()
    within = result.scores["events"]["within"]["2"]
    assert found.get("correct", 0) == within["right"] > 0
    assert found.get("false", 0) == within["false"] > 0
    assert found.get("missed", 0) == within["missed"]
    confusion = np.array(result.scores["model"]["confusion"])
    worst = worst_segments(frames)
    assert worst["frames"].sum() == confusion.sum() - np.trace(confusion)


def test_a_true_change_without_a_report_is_listed_as_missed(result: Result) -> None:
    silent = replace(result, frames=result.frames)
    silent.__dict__["events"] = result.events.iloc[1:]
    found = lane_changes(silent)
    [missed] = found[found["outcome"] == "missed"].to_dict("records")
    first = result.events.iloc[0]
    assert missed["lanes"] == f"{first['from_lane']:.0f} → {first['to_lane']:.0f}"
    end_s = first["detected_time_s"] - first["delay_s"]
    assert missed["begin_s"] < missed["end_s"] == pytest.approx(end_s)


def test_without_truth_the_least_certain_segments_are_listed(result: Result) -> None:
    worst = worst_segments(without_truth(result).frames)
    lanes = result.node("Lane")
    assert worst["frames"].sum() == (lanes.max(axis=1) < 0.95).sum()
    assert "truth" not in worst


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("/home/me/a b: is old", "a b: is old"),
        ("see /tmp/x/lines.csv, 3 km/h", "see lines.csv, 3 km/h"),
        (r"C:\data\run_1\lines.csv", "lines.csv"),
    ],
)
def test_paths_are_shown_without_their_folders(text: str, shown: str) -> None:
    assert without_folders(text) == shown


# --- the page ------------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1300])
def test_the_page_fits_its_window_and_jumps_on_a_click(
    browser: Any, file: Path, result: Result, scheme: str, width: int
) -> None:
    shown = opened(browser, file, width, color_scheme=scheme, has_touch=width < 500)
    page = shown.page
    assert page.evaluate("document.documentElement.scrollWidth") == width
    background = page.evaluate("getComputedStyle(document.documentElement).backgroundColor")
    assert background == ("rgb(255, 255, 255)" if scheme == "light" else "rgb(23, 23, 23)")
    whole = shown.range()
    for title in ("Worst segments", "Lane changes"):
        page.locator(f"h2:has-text('{title}') ~ .list button").first.click()
        begin, end = shown.range()
        assert end - begin < (whole[1] - whole[0]) / 3
        assert page.locator("#timeline").bounding_box()["y"] == pytest.approx(0, abs=1)
    first = result.events.iloc[0]
    assert begin <= first["time_s"] <= first["detected_time_s"] <= end
    assert shown.errors == []
    assert shown.asked == [file.absolute().as_uri()]


def test_strips_and_hovering_show_the_posterior(browser: Any, file: Path, result: Result) -> None:
    page = opened(browser, file, 1300).page
    images = page.evaluate(
        "() => [...Bokeh.documents[0]._all_models.values()]"
        ".filter(m => m.type == 'ColumnDataSource' && m.get_column('image'))"
        ".map(m => m.get_column('image')[0]).filter(i => i.shape[0] == 4).map(i => [...i])"
    )
    expected = 250 * result.node("Lane").T.ravel()
    assert any(np.abs(np.array(each) - expected).max() < 1 for each in images)
    page.mouse.move(650, page.locator("#timeline").bounding_box()["y"] + 160)
    page.wait_for_selector(".bk-Tooltip")
    tip = page.evaluate("document.querySelector('.bk-Tooltip').shadowRoot.textContent")
    frame = result.frames.loc[int(tip.split("frame ")[1].split("true")[0])]
    percent = ", ".join(f"{100 * frame[f'Lane_{k}']:.0f}" for k in range(1, 5))
    assert f"lane {frame['assigned_lane']} (P in %: {percent})" in tip
    assert abs(frame["time_s"] - result.frames["time_s"].mean()) < 5


def test_results_share_equal_panels(browser: Any, result: Result, tmp_path: Path) -> None:
    overrides = {"evidence_mode": "hard", "name": "hard"}
    other = run_input(open_input("quickstart", overrides=overrides))
    write_page([result, other], tmp_path / "two.html")
    shown = opened(browser, tmp_path / "two.html")
    titles = shown.page.evaluate(
        "() => [...Bokeh.documents[0]._all_models.values()]"
        ".filter(m => m.type == 'Title').map(m => m.text)"
    )
    count = {part: sum(part in title for title in titles) for part in ("Model", "Detector", "Off")}
    assert count == {"Model": 2, "Detector": 1, "Off": 1}
    assert shown.errors == []


def test_a_result_without_truth_and_lines_opens_without_an_error(
    browser: Any, result: Result, tmp_path: Path
) -> None:
    bare = without_truth(result)
    bare = replace(bare, frames=bare.frames.iloc[:300], lines={})
    write_page([bare], tmp_path / "bare.html")
    shown = opened(browser, tmp_path / "bare.html")
    assert shown.errors == []
    for words in ("Least certain segments", "quickstart: has no lines"):
        assert words in shown.page.content()
    drives = replace(result, frames=result.frames.assign(drive="a"))
    with pytest.raises(InputError, match="has several drives; run one of them"):
        write_page([drives], tmp_path / "drives.html")


def test_no_path_of_the_machine_is_in_the_page(result: Result, tmp_path: Path) -> None:
    place = tmp_path / "secret_folder"
    result.save(place / "out")
    done = run_input(open_input(place / "out" / "lines.parquet", n_lanes=4))
    write_page([ego.load_result(done.save(place / "again"))], tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "lines.parquet" in page
    assert "secret_folder" not in page
