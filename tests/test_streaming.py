"""A drive that is run part after part: the numbers of one piece, never all of its beliefs held."""

from __future__ import annotations

import json
import tracemalloc
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import egolane_pgm as ego
from egolane_pgm import running
from egolane_pgm.experiment import load_experiment
from egolane_pgm.inference import filtering
from egolane_pgm.inference.events import NO_EVENTS, next_events
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.results import Result, read_result
from egolane_pgm.running import LEFT_OUT, run_experiment, run_in_parts
from egolane_pgm.simulation import simulate
from egolane_pgm.types import InputError
from tests.kits.drives import done, refused, short_drive, write_drive
from tests.kits.rosbag_writer import write_lines

ROOT = Path(__file__).parents[1]
GAPS = (20, 21, 22, 60)
POSITION = {
    "evidence": "line_geometry",
    "graph": "position_in_lane",
    "filter": "exact",
    "parameters": {"lane_width_m": "causal", "cells": 5},
}
#: What differs from run to run, or is compared by itself.
OTHER = ("seconds", "created", "warnings", "mean_log_evidence")


@pytest.fixture
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    cut(monkeypatch, part=16, piece=8)


def cut(monkeypatch: pytest.MonkeyPatch, part: int, piece: int) -> None:
    """Parts of `part` frames, which the filter goes through in pieces of `piece`."""
    monkeypatch.setattr(running, "PART_FRAMES", part)
    monkeypatch.setattr(filtering, "piece_frames", lambda compiled: piece)
    monkeypatch.setattr(running, "piece_frames", lambda compiled: piece)


def streamed(path: Path, folder: Path) -> Result:
    run_in_parts(load_experiment(path), folder / "streamed")
    return read_result(folder / "streamed")


def assert_same(whole: Result, parts: Result, atol: float = 0.0) -> None:
    columns = parts.columns()
    assert list(columns) == list(whole.columns())
    for name, column in whole.columns().items():
        np.testing.assert_allclose(columns[name], column, rtol=0, atol=atol, err_msg=name)
    assert parts.lines is not None
    assert whole.lines is not None
    for name in ("frame_id", "time_s", "offset_m", "is_valid", "is_continuous", "lri"):
        ours, theirs = getattr(parts.lines, name), getattr(whole.lines, name)
        np.testing.assert_array_equal(ours, theirs, err_msg=name)
    np.testing.assert_array_equal(parts.lines.is_missing, whole.lines.is_missing)
    for mine, other in ((parts.scores, whole.scores), (parts.run, whole.run)):
        assert numbers(mine) == numbers(other)
        assert mine["mean_log_evidence"] == pytest.approx(other["mean_log_evidence"], rel=1e-12)
    for name, column in whole.events.columns().items():
        np.testing.assert_array_equal(parts.events.columns()[name], column, err_msg=name)


def numbers(content: Any) -> Any:
    if isinstance(content, dict):
        return {k: numbers(v) for k, v in content.items() if k not in OTHER}
    return content


@pytest.mark.usefixtures("small_parts")
@pytest.mark.parametrize(
    ("ending", "policy", "has_truth", "changes"),
    [
        ("csv", "skip", True, {}),
        ("bag", "hold", False, {"filter": "exact", "evidence_reading": "hard"}),
        ("parquet", "predict", True, {"recording__lri": "clip"}),
        ("parquet", "hold", True, {"unassigned_below": 0.7, "recording__frames": [10, 130]}),
        ("mcap", "predict", True, POSITION),
        ("csv", "skip", False, POSITION),
    ],
)
def test_a_streamed_drive_has_the_numbers_of_one_piece(
    tmp_path: Path, ending: str, policy: str, has_truth: bool, changes: dict[str, Any]
) -> None:
    if not has_truth:
        changes = {**changes, "ground_truth": None}
    path = write_drive(
        tmp_path,
        recording__path=f"long.{ending}",
        recording__missing_frames=policy,
        **changes,
    )
    log = short_drive().log
    write_lines(tmp_path / f"long.{ending}", log.take(~np.isin(log.frame_id, GAPS)))
    whole = run_experiment(path)
    assert_same(whole, streamed(path, tmp_path))


def test_a_run_of_the_paper_and_zero_label_are_the_same_streamed(
    recordings: Path, tmp_path: Path
) -> None:
    paper = load_experiment(ROOT / "experiments" / "paper" / "run01_italy_ml.yaml")
    zero = load_experiment(ROOT / "experiments" / "zero_label.yaml").model_dump()
    given = paper.model_dump()
    zero |= {name: given[name] for name in ("recording", "ground_truth", "n_lanes")}
    for experiment in (paper, ego.load_experiment(zero)):
        run_in_parts(experiment, tmp_path / experiment.name)
        assert_same(run_experiment(experiment), read_result(tmp_path / experiment.name))


@settings(max_examples=12, deadline=None)
@given(
    part=st.integers(1, 80),
    piece=st.integers(1, 40),
    is_of_places=st.booleans(),
)
def test_wherever_a_drive_is_cut_no_number_changes(
    drives: dict[bool, tuple[Path, Result]], part: int, piece: int, is_of_places: bool
) -> None:
    path, whole = drives[is_of_places]
    with pytest.MonkeyPatch.context() as patch:
        cut(patch, part, piece)
        parts = streamed(path, path.parent)
    # Where the filter is cut, its numbers are scaled anew: their last digit may differ.
    for node, belief in whole.marginals.items():
        np.testing.assert_allclose(parts.marginals[node], belief, rtol=0, atol=1e-12)
    assert numbers(parts.scores["events"]) == numbers(whole.scores["events"])
    for name in {"model", "detector"}.intersection(whole.scores):
        ours, theirs = parts.scores[name], whole.scores[name]
        for score in ("confusion", "delay", "false_switches_per_minute", "frames", "per_lane"):
            assert ours[score] == theirs[score]
        for score in ("log_loss", "brier", "expected_calibration_error"):
            assert ours[score] == pytest.approx(theirs[score], rel=1e-12)


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, tuple[Path, Result]]:
    found = {}
    for is_of_places, changes in ((False, {}), (True, POSITION)):
        path = write_drive(tmp_path_factory.mktemp("drive"), **changes)
        found[is_of_places] = path, run_experiment(path)
    return found


@pytest.mark.usefixtures("small_parts")
def test_later_frames_change_nothing_of_what_was_believed(tmp_path: Path) -> None:
    path = write_drive(tmp_path, **POSITION)
    whole = streamed(path, tmp_path)
    write_table(tmp_path / "lines.csv", short_drive().log.take(slice(0, 96)))
    early = streamed(path, tmp_path)
    np.testing.assert_array_equal(early.beliefs.lane, whole.beliefs.lane[:96])


NEEDS_ALL = [
    ({"filter": "smoothed"}, "filter: smoothed uses later frames"),
    ({"filter": "fixed_lag", "lag": 3}, "filter: fixed_lag uses later frames"),
    (
        {**POSITION, "parameters": {"lane_width_m": "auto"}},
        "evidence: line_geometry: not causal, the lane width and what the detector's flags",
    ),
]


@pytest.mark.parametrize(("changes", "said"), NEEDS_ALL)
def test_what_needs_the_whole_drive_is_refused_naming_the_key(
    tmp_path: Path, changes: dict[str, Any], said: str
) -> None:
    path = write_drive(tmp_path, **changes)
    with pytest.raises(InputError) as error:
        run_in_parts(load_experiment(path), tmp_path / "out")
    assert said in str(error.value)
    assert not (tmp_path / "out").exists()


def test_a_road_whose_lanes_change_is_refused(tmp_path: Path) -> None:
    mapped = {"n_lanes": "map", "road": "road.parquet"}
    experiment = load_experiment(write_drive(tmp_path), mapped)
    with pytest.raises(InputError, match="n_lanes: map: a recording is cut as a whole"):
        run_in_parts(experiment, tmp_path / "out")


@pytest.mark.usefixtures("small_parts")
def test_the_ground_truth_may_begin_later_and_end_later(tmp_path: Path) -> None:
    path = write_drive(tmp_path, recording__frames=[20, 120])
    truth = short_drive().truth
    write_ground_truth(tmp_path / "ground_truth.txt", truth.take(slice(70, None)))
    whole, parts = run_experiment(path), streamed(path, tmp_path)
    assert_same(whole, parts)
    assert parts.run["warnings"] == [*whole.run["warnings"], LEFT_OUT]
    assert "50 of 100 frames have no ground truth" in " ".join(parts.run["warnings"])
    late = replace(truth, frame_id=truth.frame_id + 1000)
    write_ground_truth(tmp_path / "ground_truth.txt", late)
    with pytest.raises(InputError) as error:
        streamed(path, tmp_path)
    with pytest.raises(InputError) as of_whole:
        run_experiment(path)
    assert str(error.value) == str(of_whole.value)


def test_beliefs_are_not_all_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cut(monkeypatch, part=128, piece=64)
    log = simulate("quickstart", seed=3, frames=3200).log

    def peak(n_frames: int) -> int:
        path = write_drive(
            tmp_path, 10, ground_truth=None, recording__path="long.parquet", **POSITION
        )
        write_table(tmp_path / "long.parquet", log.take(slice(0, n_frames)))
        experiment = load_experiment(path)
        tracemalloc.start()
        run_in_parts(experiment, tmp_path / "out")
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    peak(200)
    # The evidence and the beliefs of a frame have 72 numbers of eight bytes, 1.4 MB in 2,400.
    assert peak(3200) - peak(800) < 700_000


def test_the_command_says_what_run_says(tmp_path: Path) -> None:
    path = write_drive(tmp_path)
    whole = done("run", path, "--no-figures", "--out", tmp_path / "whole", "--wide")
    parts = done("run", path, "--stream", "--out", tmp_path / "parts", "--wide")
    assert LEFT_OUT in parts.stderr
    assert parts.stdout.replace("parts", "whole") == whole.stdout
    both = ("--recording", tmp_path / "lines.csv")
    for words in ((path, path), (path, *both, *both[:1], tmp_path / "other.csv")):
        said = refused("run", *words, "--stream")
        assert said == "--stream: goes with one experiment, one recording and out"


def test_a_streamed_result_is_read_as_any_other(tmp_path: Path) -> None:
    path = write_drive(tmp_path)
    done("run", path, "--no-figures", "--out", tmp_path / "whole")
    done("run", path, "--stream", "--out", tmp_path / "parts")
    done("plot", tmp_path / "parts", "--out", tmp_path / "figures")
    done("plot", tmp_path / "parts", "--out", tmp_path / "page.html")
    assert "run in parts" in (tmp_path / "page.html").read_text()
    target = tmp_path / "compared.json"
    done("compare", tmp_path / "whole", tmp_path / "parts", "--json", target)
    one, other, *_ = json.loads(target.read_text())["recordings"][0]["experiments"]
    assert one["scores"] == other["scores"]
    done("run", tmp_path / "parts" / "experiment.yaml", "--stream", "--out", tmp_path / "again")


def test_python_gives_the_scores_and_the_directory(tmp_path: Path) -> None:
    path = write_drive(tmp_path)
    found = ego.run(path, stream=True, out=tmp_path / "out", overrides={"name": "mine"})
    run = ego.run(path, overrides={"name": "mine"})
    assert len(found) == len(run)
    assert found.scores["model"]["accuracy"] == run.scores["model"]["accuracy"]
    assert found.notes == [*run.notes, LEFT_OUT]
    assert "'mine': 150 frames, accuracy" in repr(found)
    assert "<th>model</th>" in found._repr_html_()
    np.testing.assert_array_equal(found.beliefs.lane, run.beliefs.lane)
    assert repr(found.events) == repr(run.events)
    assert len(ego.load_result(found.directory)) == 150


# --- what is told -------------------------------------------------------------------------------


@st.composite
def annotated(draw: st.DrawFn) -> tuple[ego.Beliefs, list[slice]]:
    """Beliefs over two lanes that change often, and where they are cut."""
    n_frames = draw(st.integers(1, 80))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    left = np.repeat(rng.choice([0.02, 0.3, 0.5, 0.7, 0.99], n_frames), 3)[:n_frames]
    frame_id = np.cumsum(rng.integers(1, 4, n_frames))
    beliefs = ego.Beliefs(
        frame_id,
        {"Lane": np.stack([left, 1 - left], axis=1)},
        np.zeros(n_frames),
        np.zeros(n_frames, dtype=bool),
    )
    cuts = sorted(draw(st.sets(st.integers(0, n_frames), max_size=6)))
    parts = [slice(a, b) for a, b in pairwise([0, *cuts, n_frames]) if a < b]
    return beliefs, parts


@given(annotated())
def test_lane_changes_are_the_same_wherever_they_are_cut(
    drawn: tuple[ego.Beliefs, list[slice]],
) -> None:
    beliefs, parts = drawn
    rng = np.random.default_rng(len(beliefs))
    places = (rng.normal(0, 0.2, len(beliefs)).cumsum() + 0.5) % 1 - 0.5
    places[rng.random(len(beliefs)) < 0.1] = np.nan
    whole = ego.lane_events(beliefs, 10.0, places=places)
    so_far, found = NO_EVENTS, []
    for part in parts:
        here = beliefs.take(part)
        so_far, _, events = next_events(
            so_far, here.lane, here.frame_id, here.frame_id / 10.0, places[part]
        )
        found.append(events)
    told = ego.LaneEvents.joined(found)
    for name, column in whole.columns().items():
        np.testing.assert_array_equal(told.columns()[name], column, err_msg=name)
