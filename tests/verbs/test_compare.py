"""`egolane compare`: result directories side by side."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.kits.drives import done, refused, write_drive


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the results of two graphs, run by two drivers on two drives."""
    folder = tmp_path_factory.mktemp("compare")
    for name, n_frames in (("one", 150), ("other", 120)):
        write_drive(folder / name, n_frames)
    drives = [f"{name}/lines.csv,{name}/ground_truth.txt" for name in ("one", "other")]
    rows = [
        f"{graph}_{k},{drive},{graph},{'ab'[k]}"
        for graph in ("sensor_failure", "lane_only")
        for k, drive in enumerate(drives)
    ]
    head = "name,recording.path,ground_truth.path,graph,tag.driver"
    (folder / "runs.csv").write_text("\n".join([head, *rows]))
    words = ("--table", folder / "runs.csv", "--out", folder / "results")
    done("run", folder / "one" / "experiment.yaml", *words)
    return folder / "results"


def test_two_directories_are_compared_by_name(results: Path) -> None:
    pair = (results / "sensor_failure_0", results / "lane_only_0")
    shown = done("compare", *pair, "--detector").stdout
    rows = [line for line in shown.splitlines() if line.startswith("| ")]
    for name in ("sensor_failure_0", "lane_only_0", "detector alone"):
        assert any(name in row for row in rows)


def test_a_folder_of_results_is_compared_of_a_key_and_by_a_tag(
    results: Path, tmp_path: Path
) -> None:
    words = ("compare", results, "--of", "graph", "--json", tmp_path / "x.json")
    done(*words, "--out", tmp_path / "x.png")
    rows = json.loads((tmp_path / "x.json").read_text())["rows"]
    assert [row["graph"] for row in rows] == ["sensor_failure", "lane_only"] or [
        row["graph"] for row in rows
    ] == ["lane_only", "sensor_failure"]
    assert {row["recordings"] for row in rows} == {2}
    assert rows[1]["accuracy_difference"] == pytest.approx(
        rows[1]["accuracy"] - rows[0]["accuracy"]
    )
    assert "event_recall" in rows[0]
    assert (tmp_path / "x.png").is_file()
    done(*words, "--by", "tag.driver")
    rows = json.loads((tmp_path / "x.json").read_text())["rows"]
    assert [row["tag.driver"] for row in rows] == ["a", "a", "b", "b"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("", "Missing argument"),
        ("{0}/gone", "gone: is not a result directory"),
        ("{0} --of tuned_on", "--of: not_tuned has two results of one recording"),
        ("{0} --by tag.drivr", "--by: no result has a value of tag.drivr"),
        ("{0}/lane_only_0 --out {0}/x.txt", "x.txt"),
    ],
)
def test_results_that_cannot_be_compared_are_refused(
    results: Path, words: str, message: str
) -> None:
    given = words.format(results).split()
    assert message in refused("compare", *given)
