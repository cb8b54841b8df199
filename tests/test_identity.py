"""What a number depends on, and whether a fit saw the frames that are scored."""

from __future__ import annotations

from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import egolane_pgm as ego
from egolane_pgm.identity import (
    HARMLESS,
    MOST_RANGES,
    Marks,
    compared,
    content_of,
    digest_of,
    marks_of,
    trained_on,
)
from egolane_pgm.recordings.ground_truth import write_ground_truth

FRAMES = 600
SHORT = {"recording.frames": [0, 300]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drives, copies and parts of the first, and it as another detector saw it."""
    place = tmp_path_factory.mktemp("drives")
    for name, seed in (("lines", 1), ("other", 2)):
        drive = ego.simulate("a4", frames=FRAMES, seed=seed)
        drive.log.to_pandas().to_csv(place / f"{name}.csv")
        write_ground_truth(place / f"{name}.txt", drive.truth)
    lines = pd.read_csv(place / "lines.csv")
    lines.round({"offset_m": 5}).to_csv(place / "copy.csv", index=False)
    lines.to_parquet(place / "table.parquet")
    lines[lines["frame_id"] < 300].to_csv(place / "part.csv", index=False)
    noise = np.random.default_rng(0).normal(0, 0.1, len(lines))
    seen = lines.assign(offset_m=lines["offset_m"] + noise)
    seen.sort_values(["frame_id", "offset_m"]).to_csv(place / "detector.csv", index=False)
    return place


def keys(folder: Path, lines: str, truth: str = "lines.txt", **more: Any) -> dict[str, Any]:
    recording = {"path": str(folder / lines), **more}
    truths = {"path": str(folder / truth)}
    return {"name": "x", "recording": recording, "ground_truth": truths, "n_lanes": 4}


@pytest.fixture(scope="module")
def learned(folder: Path) -> ego.Study:
    return ego.learn(keys(folder, "lines.csv"), folds=0, out=folder / "learned")


@pytest.mark.parametrize(
    ("lines", "truth", "frames", "expected"),
    [
        ("lines.csv", "lines.txt", None, "same_frames"),
        ("copy.csv", "lines.txt", None, "same_frames"),
        ("table.parquet", "lines.txt", None, "same_frames"),
        ("part.csv", "lines.txt", None, "same_frames"),
        ("detector.csv", "lines.txt", None, "same_drive"),
        ("other.csv", "other.txt", None, "other_drive"),
        ("lines.csv", "lines.txt", [100, 300], "same_frames"),
    ],
)
def test_a_later_run_is_compared_by_its_frames(
    learned: ego.Study, folder: Path, lines: str, truth: str, frames: Any, expected: str
) -> None:
    more = {} if frames is None else {"frames": frames}
    found = ego.run(keys(folder, lines, truth, **more), graph=learned)
    assert found.run["tuned_on"] == expected
    changes = {"recording.path": str(folder / lines), "ground_truth.path": str(folder / truth)}
    if frames is None:
        again = ego.run(folder / "learned" / "best.yaml", overrides=changes)
        assert again.run["tuned_on"] == expected


def test_other_frames_of_the_drive_are_held_out(folder: Path) -> None:
    study = ego.learn(keys(folder, "lines.csv", frames=[0, 300]), folds=0)
    for lines, frames, expected in (
        ("lines.csv", [300, 600], "other_frames"),
        ("copy.csv", [300, 600], "other_frames"),
        ("detector.csv", [300, 600], "other_frames"),
        ("copy.csv", [299, 600], "same_frames"),
    ):
        found = ego.run(keys(folder, lines, frames=frames), graph=study)
        assert (found.run["tuned_on"], lines) == (expected, lines)


def test_a_second_fit_keeps_what_the_first_was_trained_on(folder: Path) -> None:
    first = ego.learn(keys(folder, "lines.csv", frames=[0, 200]), folds=0)
    changes = {"recording.frames": [200, 400], "fit.sampler": "random"}
    second = ego.tune(first, overrides=changes, trials=2, folds=0)
    for frames, expected in (
        ([0, 200], "same_frames"),
        ([200, 400], "same_frames"),
        ([400, 600], "other_frames"),
    ):
        found = ego.run(second, overrides={"recording.frames": frames})
        assert (found.run["tuned_on"], frames) == (expected, frames)
    alone = ego.run(keys(folder, "lines.csv", frames=[200, 400]), graph=second)
    assert alone.run["tuned_on"] == "other_frames"


def test_the_saved_result_of_a_fit_has_its_model(tmp_path: Path) -> None:
    study = ego.learn("quickstart", overrides=SHORT, folds=0)
    loaded = ego.load_result(study.in_sample.save(tmp_path / "saved"))
    for node, table in study.model.compiled.tables.items():
        np.testing.assert_array_equal(loaded.model.compiled.tables[node].values, table.values)
    beliefs = ego.filter_beliefs(loaded, loaded.evidence, "assumed_density")
    np.testing.assert_array_equal(beliefs.lane, loaded.node("Lane"))
    assert ego.check(loaded, n=30).equals(ego.check(study, n=30))
    again = ego.run(study.in_sample)
    pd.testing.assert_frame_equal(again.frames, study.in_sample.frames)
    assert again.run["tuned_on"] == loaded.run["tuned_on"] == "same_frames"


def test_a_table_of_held_out_runs_depends_on_the_settings_of_the_fit(tmp_path: Path) -> None:
    rows = pd.DataFrame({"name": ["a"]})
    fit = {"fit.method": "tune", "fit.sampler": "random", "fit.trials": 2, "fit.folds": 2}
    was_there = []
    for changes in ({}, {}, {"fit.trials": 4}, {"fit.seed": 1}, {"description": "harmless"}):
        fit |= changes
        more: dict[str, Any] = {"table": rows, "held_out": True, "out": tmp_path}
        found = ego.run("quickstart", overrides={**SHORT, **fit}, **more)
        was_there.append(bool(found["was_there"].item()))
    assert was_there == [False, True, False, False, True]


@pytest.mark.parametrize("changes", [{"n_lanes": 5}, {"start_lane": 1}, {"filter": "exact"}])
def test_a_study_is_not_continued_with_another_model(
    tmp_path: Path, changes: dict[str, Any]
) -> None:
    options: dict[str, Any] = {"trials": 2, "folds": 0, "out": tmp_path}
    base = {**SHORT, "fit.sampler": "random"}
    ego.tune("quickstart", overrides=base, **options)
    with pytest.raises(ego.InputError, match="with another experiment"):
        ego.tune("quickstart", overrides={**base, **changes}, **options)


def test_kept_fits_depend_on_the_version_and_are_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    changes = {**SHORT, "fit.folds": 2}
    for version in ("1", "1", "2"):
        monkeypatch.setattr(metadata, "version", lambda _, version=version: version)
        ego.explore("quickstart", overrides=changes, edge=["Lane -> WOR"], out=tmp_path)
        n_kept = len([*(tmp_path / "tried").iterdir()])
        # Two structures in two folds and in all frames.
        assert n_kept == 6 * int(version)
    assert {file.suffix for file in (tmp_path / "tried").iterdir()} == {".parquet"}


def test_every_key_but_the_harmless_ones_counts() -> None:
    first = ego.load_experiment("quickstart")
    before = digest_of(content_of(first))
    for key, value in {
        "n_lanes": 5,
        "start_lane": 2,
        "graph": "no_wor",
        "evidence_mode": "hard",
        "min_confidence": 0.5,
        "parameters.sigma1": 0.3,
        "recording.seed": 1,
        "fit.strength": 3,
        "name": "another",
        "description": "another",
    }.items():
        same = digest_of(content_of(ego.load_experiment(first, {key: value}))) == before
        assert same == (key in HARMLESS), key


# --- marks ---------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(st.sets(st.integers(0, 3000), min_size=1, max_size=400))
def test_every_training_frame_is_in_a_kept_range(ids: set[int]) -> None:
    frame_id = np.array(sorted(ids))
    trained = trained_on(Marks(), frame_id)
    assert len(trained.frames) <= MOST_RANGES
    kept = np.concatenate([np.arange(first, stop) for first, stop in trained.frames])
    assert set(frame_id) <= set(kept)
    if np.count_nonzero(np.diff(frame_id) > 1) < MOST_RANGES:
        np.testing.assert_array_equal(kept, frame_id)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 1000), st.integers(0, 500), st.integers(0, 300))
def test_marks_do_not_depend_on_frame_ids_and_find_parts(seed: int, shift: int, cut: int) -> None:
    drive = ego.simulate("a4", frames=FRAMES, seed=seed)
    whole = marks_of(drive.log, drive.truth)
    ids = drive.log.frame_id
    moved = replace(drive.log, frame_id=ids + shift)
    assert marks_of(moved, drive.truth) == whole
    part = drive.log.take(slice(cut, cut + 300))
    assert compared(trained_on(whole, ids), marks_of(part, None), part.frame_id) == "same_frames"
    assert compared(trained_on(whole, ids[:cut]), whole, ids[cut:]) == "other_frames"
