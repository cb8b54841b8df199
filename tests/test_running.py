"""Inference over a drive: what plain NumPy gives, and the same for whole drives, chunks and single
frames."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.drives import read_drives
from egolane_pgm.evidence.counting import evidence as counting
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.inference.smoothing import fixed_lag_beliefs, smooth_beliefs
from egolane_pgm.inference.viterbi import viterbi
from egolane_pgm.loading import load_experiment
from egolane_pgm.model import Model, compile_model
from egolane_pgm.recordings.table import write_table
from egolane_pgm.result import truth_of
from egolane_pgm.running import concat_drives, frames_of, infer
from egolane_pgm.scoring.confusion import assigned_lane, confusion
from egolane_pgm.types import InputError, LineLog
from tests.kits.drives import (
    GAPS,
    N_FRAMES,
    log_with_gaps,
    run,
    short_drive,
    simulated,
    write_drive,
)
from tests.reference import counting as reference_counting
from tests.reference import inference as reference

POSITION: dict[str, Any] = {
    "evidence": "line_geometry",
    "graph": "position_in_lane",
    "filter": "exact",
    "parameters": {"lane_width_m": "causal", "cells": 5},
}

#: Experiments that need no later frames, or only a few.
CAUSAL: dict[str, dict[str, Any]] = {
    "paper": {},
    "exact": {"filter": "exact", "evidence_mode": "hard", "min_confidence": 0.7},
    "hold": {"recording": {"missing_frames": "hold"}},
    "predict": {"filter": "exact", "recording": {"missing_frames": "predict"}},
    "lag 0": {"filter": "fixed_lag", "lag": 0},
    "lag 7": {"filter": "fixed_lag", "lag": 7, "recording": {"missing_frames": "predict"}},
    "lag 500": {"filter": "fixed_lag", "lag": 500},
    "position": POSITION,
    "position, predict": {**POSITION, "recording": {"missing_frames": "predict"}},
}


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("drive"))


def with_gaps(folder: Path, **changes: Any) -> Path:
    """The drive without the frames of GAPS."""
    path = write_drive(folder, **changes)
    write_table(folder / "lines.csv", log_with_gaps())
    return path


def table(model: Model, logs: LineLog | Sequence[LineLog]) -> pd.DataFrame:
    parts = [pd.DataFrame(columns) for columns in infer(model, logs)]
    return pd.concat(parts, ignore_index=True)


def assert_same(ours: pd.DataFrame, theirs: pd.DataFrame) -> None:
    """Check that two tables are equal up to 1e-12: cut elsewhere, a filter scales anew."""
    pd.testing.assert_frame_equal(ours, theirs, rtol=0, atol=1e-12)


# --- what is inferred ----------------------------------------------------------------------------


@pytest.mark.parametrize("choice", ["assumed_density", "exact"])
def test_a_run_gives_what_plain_numpy_gives(drive: Path, choice: str) -> None:
    found = run(drive, {"filter": choice})
    model = found.model
    seen = reference_counting.evidence(found.lines["drive"], model.n_lanes, model.parameters)
    right = reference.filter_beliefs(model.compiled, seen, choice)
    np.testing.assert_allclose(found.node("Lane"), right.lane, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.frames["log_evidence"], right.log_evidence, atol=1e-12)


def test_hard_evidence_has_the_most_probable_value_only(drive: Path) -> None:
    hard, soft = run(drive, {"evidence_mode": "hard"}), run(drive)
    for node, values in hard.evidence.likelihoods.items():
        best = soft.evidence.likelihoods[node].max(axis=1, keepdims=True)
        is_best = soft.evidence.likelihoods[node] >= best * (1 - 1e-9)
        np.testing.assert_array_equal(values, is_best)
    # The detector's own answer is as it was.
    detector = [column for column in soft.frames if column.startswith("detector")]
    pd.testing.assert_frame_equal(hard.frames[detector], soft.frames[detector])
    assert np.abs(hard.node("Lane") - soft.node("Lane")).max() > 0.01


def test_smoothers_are_those_of_the_inference_and_not_causal(drive: Path) -> None:
    causal = run(drive)
    for keys, why in (
        ({"filter": "smoothed"}, "smoothed: not causal, a frame's belief uses all later"),
        (
            {"filter": "fixed_lag", "lag": 4},
            "fixed_lag: not causal, a frame's belief uses the next 4",
        ),
    ):
        found = run(drive, keys)
        compiled, evidence = found.model.compiled, found.evidence
        right = (
            smooth_beliefs(compiled, evidence)
            if "lag" not in keys
            else fixed_lag_beliefs(compiled, evidence, 4)
        )
        np.testing.assert_allclose(found.node("Lane"), right.lane, rtol=0, atol=1e-12)
        assert np.abs(found.node("Lane") - causal.node("Lane")).max() > 0.01
        assert found.run["is_causal"] is False
        assert found.run["why_not_causal"][0].startswith(why)
    plain = reference.fixed_lag_beliefs(compiled, evidence, 4)
    np.testing.assert_allclose(plain.lane, right.lane, rtol=0, atol=1e-10)
    assert causal.run["is_causal"] is True


def test_a_decoded_run_answers_the_most_probable_path(drive: Path) -> None:
    found = run(drive, {"filter": "viterbi"})
    path = viterbi(found.model.compiled, found.evidence)
    np.testing.assert_array_equal(found.frames["assigned_lane"], path.lane)
    truth = truth_of(found.frames)
    assert truth is not None
    known = truth["true_lane"].to_numpy(), truth["is_crossing"].to_numpy()
    assert found.scores["model"]["confusion"] == confusion(path.lane, *known, 3).tolist()


# --- gaps ----------------------------------------------------------------------------------------


def test_missing_frames_are_held_as_if_the_frame_before_came_again(tmp_path: Path) -> None:
    found = run(with_gaps(tmp_path, recording__missing_frames="hold"))
    log = short_drive().log
    index = np.arange(len(log))
    for gap in GAPS:  # in order, so that each holds what was held before it
        index[log.frame_id == gap] = index[np.flatnonzero(log.frame_id == gap) - 1]
    model = found.model
    evidence = counting(log, 3, model.parameters).take(index)
    right = filter_beliefs(model.compiled, evidence, "assumed_density")
    np.testing.assert_array_equal(found.frames.index, log.frame_id)
    np.testing.assert_array_equal(found.node("Lane"), right.lane)


@pytest.mark.parametrize("reading", ["soft", "hard"])
def test_missing_frames_are_predicted_by_the_model_alone(tmp_path: Path, reading: str) -> None:
    keys = {"recording__missing_frames": "predict", "evidence_mode": reading}
    found = run(with_gaps(tmp_path, **keys))
    assert len(found) == N_FRAMES
    sigma1, p1, p2 = (float(found.model.parameters[k]) for k in ("sigma1", "p1", "p2"))  # type: ignore[arg-type]
    lanes = np.arange(1, 4)
    f = np.exp(-0.5 * ((lanes[None] - lanes[:, None]) / sigma1) ** 2)
    f /= f.sum(axis=1, keepdims=True)
    tables = {"Lane": f, "SensorState": np.array([[p1, 1 - p1], [1 - p2, p2]])}
    for node, transition in tables.items():
        posterior = found.node(node)
        for t in np.flatnonzero(found.frames.index.isin(GAPS)):
            right = posterior[t - 1] @ transition
            np.testing.assert_allclose(posterior[t], right, rtol=0, atol=1e-12)
            assert found.frames["log_evidence"].iloc[t] == pytest.approx(0, abs=1e-12)


# --- whole drives, chunks, frames ----------------------------------------------------------------


@cache
def _whole(name: str) -> tuple[Model, LineLog, pd.DataFrame]:
    """A model, the recorded frames, and the table of the whole drive."""
    log = log_with_gaps()
    experiment = load_experiment(simulated(), CAUSAL[name], lines=log, n_lanes=3)
    [drive] = read_drives(experiment, log)
    return drive.model, log, table(drive.model, drive.log)


@pytest.mark.filterwarnings("ignore::UserWarning")
@settings(max_examples=20)
@given(st.sampled_from([*CAUSAL]), st.sets(st.integers(0, N_FRAMES), max_size=9))
def test_wherever_a_drive_is_cut_the_frames_are_those_of_the_whole(name: str, cuts: Any) -> None:
    model, log, whole = _whole(name)
    borders = sorted({0, len(log), *(cut for cut in cuts if cut < len(log))})
    parts = [log.take(slice(a, b)) for a, b in pairwise(borders)]
    assert_same(table(model, parts), whole)


@pytest.mark.parametrize("name", CAUSAL)
def test_frame_by_frame_each_answer_comes_as_soon_as_it_can(name: str) -> None:
    model, log, whole = _whole(name)
    lag, sent, rows = model.experiment.lag or 0, [0], []

    def send() -> Any:
        for t in range(len(log)):
            sent[0] = int(log.frame_id[t])
            yield log.take(slice(t, t + 1))

    for columns in infer(model, send()):
        assert sent[0] == log.frame_id[-1] or (columns["frame_id"] <= sent[0] - lag).all()
        rows.append(pd.DataFrame(columns))
    assert_same(pd.concat(rows, ignore_index=True), whole)


def test_a_run_in_chunks_is_the_run(drive: Path) -> None:
    whole, parts = run(drive), run(drive, chunk_frames=16)
    pd.testing.assert_frame_equal(parts.frames, whole.frames, rtol=0, atol=1e-12)
    assert parts.scores["model"]["confusion"] == whole.scores["model"]["confusion"]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"filter": "smoothed"},
            "smoothed: not causal, .* this needs the whole drive",
        ),
        (
            {**POSITION, "parameters": {"lane_width_m": "auto"}},
            "the lane width and what the detector's flags",
        ),
    ],
)
def test_what_needs_the_whole_drive_is_refused_for_chunks(
    drive: Path, changes: dict[str, Any], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        run(drive, changes, chunk_frames=16)


def test_frames_that_do_not_follow_each_other_are_refused(drive: Path) -> None:
    log = short_drive().log
    model = compile_model(load_experiment(drive))
    with pytest.raises(InputError, match="frame id 4 does not come after 9"):
        table(model, [log.take(slice(0, 10)), log.take(slice(4, 20))])


# --- the table of frames -------------------------------------------------------------------------


def test_crossing_frames_are_filtered_but_not_scored(drive: Path) -> None:
    found = run(drive)
    frames = found.frames
    crossing = frames["is_crossing"].to_numpy(dtype=bool)
    assert 0 < crossing.sum() < N_FRAMES == len(frames)
    for side in (found.scores["model"], found.scores["detector"]):
        assert np.sum(side["confusion"]) == side["frames_scored"] == (~crossing).sum()
    assigned = assigned_lane(found.node("Lane"))
    np.testing.assert_array_equal(frames["assigned_lane"], assigned)
    right = (assigned == frames["true_lane"].to_numpy())[~crossing].mean()
    assert found.scores["model"]["accuracy"] == pytest.approx(right)


def test_a_lane_that_the_road_of_a_drive_does_not_have_has_probability_0(tmp_path: Path) -> None:
    drives = []
    for n_lanes in (3, 5):
        [read] = read_drives(load_experiment(simulated(f"of_{n_lanes}"), n_lanes=n_lanes))
        drives.append(read)
    frames = concat_drives(drives, [frames_of(drive) for drive in drives])
    narrow, wide = (part for _, part in frames.groupby("drive", sort=False))
    assert (narrow[["Lane_4", "Lane_5", "detector_5"]] == 0).all(axis=None)
    assert (wide[["Lane_4", "Lane_5"]] > 0).any(axis=None)
    assert (set(narrow["n_lanes"]), set(wide["n_lanes"])) == ({3}, {5})
    sums = frames[[f"Lane_{k}" for k in range(1, 6)]].sum(axis=1)
    np.testing.assert_allclose(sums, 1)
