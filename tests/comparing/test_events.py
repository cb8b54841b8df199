"""Lane changes side by side, on simulated drives and on the paper's recordings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import egolane_pgm as ego
from egolane_pgm.comparing.groups import Options, by_recording, compare_group
from egolane_pgm.running import run_experiment
from egolane_pgm.views.events import event_comparison_rows
from tests.conftest import needs_compiler
from tests.kits.drives import done, geometry, refused, simulated, write_drive


def test_the_events_of_a_comparison_are_those_of_the_runs() -> None:
    experiments = [simulated("counting"), geometry(), simulated("late", filter="fixed_lag", lag=9)]
    found = compare_group(by_recording(experiments)[0], Options(events=True))
    for experiment, entry in zip(experiments, found["experiments"], strict=True):
        assert entry["events"]["all_frames"] == run_experiment(experiment).scores["events"]
    first, second, _ = (entry["events"]["all_frames"] for entry in found["experiments"])
    assert first["crossing"] is None
    assert second["crossing"]["warned"] > 0
    assert first["changes"] == second["changes"] > 0


def test_frames_without_annotation_are_neither_right_nor_false(tmp_path: Path) -> None:
    model = {"evidence": "line_geometry", "graph": "position_in_lane", "filter": "exact"}
    path = write_drive(tmp_path, 300, **model)
    whole = run_experiment(path).scores["events"]
    truth = path.with_name("ground_truth.txt")
    truth.write_text("".join(line + "\n" for line in truth.read_text().splitlines()[50:]))
    found = run_experiment(path).scores["events"]
    assert found["hours"] == pytest.approx(whole["hours"] * 250 / 300)
    assert found["crossing"]["auc"] != whole["crossing"]["auc"]


def test_nothing_is_said_of_events_unless_asked() -> None:
    (entry,) = compare_group(by_recording([simulated()])[0], Options())["experiments"]
    assert entry["events"] is None


def test_changes_in_frames_of_untrusted_labels_are_not_counted() -> None:
    tuning = {"never_fit": {"from_frame": 600}}
    group = by_recording([geometry(tuning=tuning)])[0]
    (entry,) = compare_group(group, Options(events=True))["experiments"]
    every, trusted = entry["events"].values()
    assert 0 < trusted["changes"] < every["changes"]
    assert trusted["hours"] == pytest.approx(600 / 36000)


def test_the_command_has_a_row_per_recording_and_one_for_all(tmp_path: Path) -> None:
    paths = [write_drive(tmp_path / name, name="one", n_frames=400) for name in ("a", "b")]
    target = tmp_path / "all.json"
    shown = done("compare", *paths, "--events", "--wide", "--json", target).stdout
    found = json.loads(target.read_text())
    header, rows = event_comparison_rows(found)
    assert {len(row) for row in rows} == {len(header)}
    assert [row[0] for row in rows][-1] == "all 2"
    scores = [r["experiments"][0]["events"]["all_frames"] for r in found["recordings"]]
    right = sum(each["within"]["2"]["right"] for each in scores)
    total = dict(zip(header, rows[-1], strict=True))
    assert total["right"] == f"{right}"
    assert total["recall"] == f"{right / sum(each['changes'] for each in scores):.3f}"
    for row in rows:
        assert all(cell in shown for cell in row)
    assert "lane changes" not in done("compare", *paths).stdout
    assert "--events" in refused("compare", "--events", "--runs", "2")


def total_of(found: dict[str, Any], key: str) -> int:
    return sum(
        list(r["experiments"][0]["events"].values())[-1]["within"]["2"][key]
        for r in found["recordings"]
    )


@needs_compiler
def test_the_causal_model_tells_the_lane_changes_of_the_paper_s_runs(recordings: Path) -> None:
    """Runs 5 and 10 are those of a multi-lane detector; Spain counts before frame 9577."""
    place = ego.experiments_folder() / "zero_label.yaml"
    found = dict(ego.compare(place, runs="1-4,6-9", events=True, progress=False).document)
    right, false, missed = (total_of(found, key) for key in ("right", "false", "missed"))
    assert right + missed == 4 * 109 + 4 * 34
    assert right / (right + false) >= 0.98
    assert right / (right + missed) >= 0.98
    for recording in found["recordings"]:
        scores = list(recording["experiments"][0]["events"].values())[-1]
        warning = scores["crossing"]
        assert warning["warned"] == warning["changes"]
        assert warning["auc"] > (0.9 if recording["run"] < 6 else 0.8)
        assert warning["lead_s"]["median"] > 1.3
