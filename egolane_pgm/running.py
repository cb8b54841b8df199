"""Inference over drives, over chunks of a drive, and online: one generator, `infer`."""

from __future__ import annotations

import contextlib
import os
import time
import warnings
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.drives import Drive, drive_names, read_drives
from egolane_pgm.evidence.line_geometry.scale import place_finder
from egolane_pgm.experiment import Experiment
from egolane_pgm.inference.events import across_lanes
from egolane_pgm.inference.filtering import filter_beliefs, step
from egolane_pgm.inference.smoothing import fixed_lag_beliefs, lag_rest, lag_step, smooth_beliefs
from egolane_pgm.inference.viterbi import viterbi
from egolane_pgm.model import Model, make_evidence, online_rule, why_not_causal
from egolane_pgm.recordings.select import fill_after
from egolane_pgm.result import Result, make_result
from egolane_pgm.scoring.confusion import assigned_lane
from egolane_pgm.types import NOT_ANNOTATED, Beliefs, FloatArray, InputError, LineLog

#: The columns of some frames, (T,) each, by the names of `result.COLUMNS`.
Columns = dict[str, Any]


def infer(model: Model, logs: LineLog | Iterable[LineLog]) -> Iterator[Columns]:
    """Yield the columns of the frames of each log.

    - logs: a LineLog for a whole drive, or an iterable of its chunks or frames; the columns are the
      same.

    Frames missing between two logs are filled in (`missing_frames`) and yielded with the second
    one. With `filter: fixed_lag` columns come one frame at a time, `lag` frames late. Raises
    InputError for chunks if the filter or the evidence rule needs the whole drive.
    """
    e = model.experiment
    # A graph with RoadPosition has the lateral offset; otherwise it is estimated from the lines.
    has_offset = "RoadPosition" in model.compiled.values
    places_of = None if has_offset else place_finder(model.parameters)
    if isinstance(logs, LineLog):
        evidence, tentative = make_evidence(model, logs)
        if e.filter in ("smoothed", "viterbi"):
            beliefs = smooth_beliefs(model.compiled, evidence, frame_id=logs.frame_id)
        elif e.lag is not None:
            beliefs = fixed_lag_beliefs(model.compiled, evidence, e.lag, frame_id=logs.frame_id)
        else:
            beliefs = filter_beliefs(model.compiled, evidence, e.filter, frame_id=logs.frame_id)
        offset = None if places_of is None else places_of(logs)
        columns = _columns_of(model, logs, beliefs, tentative, offset)
        if e.filter == "viterbi":
            path = viterbi(model.compiled, evidence, frame_id=logs.frame_id)
            columns["assigned_lane"] = path.lane
        yield columns
        return
    # A fixed lag waits for its later frames.
    if reasons := why_not_causal(model)[e.lag is not None :]:
        raise InputError(f"{e.source}: {reasons[0]}; this needs the whole drive")
    recording = e.recording
    rule = online_rule(model)
    last: LineLog | None = None
    state: Any = None
    waiting: deque[tuple[LineLog, FloatArray | None, FloatArray | None]] = deque()
    for log in logs:
        due = fill_after(last, log, recording.missing_frames, recording.frame_rate)
        last = log.take(slice(-1, None))
        evidence, tentative = make_evidence(model, due, rule)
        offset = None if places_of is None else places_of(due)
        if e.lag is None:
            state, beliefs = step(model.compiled, state, evidence, e.filter)
            yield _columns_of(model, due, beliefs, tentative, offset)
            continue
        for t in range(len(due)):
            here = slice(t, t + 1)
            waiting.append((due.take(here), _rows(tentative, here), _rows(offset, here)))
            state, beliefs = lag_step(model.compiled, state, evidence.take(here), e.lag)
            if len(beliefs):
                frame, answer, place = waiting.popleft()
                yield _columns_of(model, frame, beliefs, answer, place)
    if e.lag is not None and state is not None:
        rest = lag_rest(model.compiled, state)
        for t, (frame, answer, place) in enumerate(waiting):
            yield _columns_of(model, frame, rest.take(slice(t, t + 1)), answer, place)


def _columns_of(
    model: Model,
    log: LineLog,
    beliefs: Beliefs,
    tentative: FloatArray | None,
    by_lines: FloatArray | None,
) -> Columns:
    """Return the columns of T frames.

    - tentative (T, n): the detector's answer, or None.
    - by_lines (T,): lateral offset estimated from the lines, or None.
    """
    columns: Columns = {"frame_id": log.frame_id, "time_s": log.time_s}
    for node, names in model.values.items():
        posterior = beliefs.marginals[node]
        columns |= {f"{node}_{name}": posterior[:, k] for k, name in enumerate(names)}
    crossing, offset = across_lanes(beliefs.marginals, by_lines)
    if crossing is not None:
        columns["line_crossing_probability"] = crossing
    if offset is not None:
        columns["lateral_offset"] = offset
    columns["assigned_lane"] = assigned_lane(beliefs.lane, model.experiment.min_confidence)
    if tentative is not None:
        columns |= {f"detector_{k}": column for k, column in enumerate(tentative.T, start=1)}
        columns["detector_lane"] = assigned_lane(tentative)
    columns["log_evidence"] = beliefs.log_evidence
    columns["is_impossible"] = beliefs.is_impossible
    return columns


def _rows(values: FloatArray | None, frames: slice) -> FloatArray | None:
    return None if values is None else values[frames]


# --- drives --------------------------------------------------------------------------------------


def chunks(log: LineLog, frames: int) -> Iterator[LineLog]:
    """Split a log into chunks."""
    for start, stop in pairwise([*range(0, len(log), frames), len(log)]):
        yield log.take(slice(start, stop))


def frames_of(drive: Drive, chunk_frames: int | None = None) -> pd.DataFrame:
    """Infer a drive; return a row per frame, with its ground truth.

    - chunk_frames: number of frames to infer at a time.
    """
    logs = drive.log if chunk_frames is None else chunks(drive.log, chunk_frames)
    parts = [pd.DataFrame(columns) for columns in infer(drive.model, logs)]
    frames = parts[0] if len(parts) == 1 else pd.concat(parts, ignore_index=True)
    unknown = drive.true_lane == NOT_ANNOTATED
    lane = pd.array(drive.true_lane, dtype="Int64")
    crossing = pd.array(drive.is_crossing, dtype="boolean")
    lane[unknown], crossing[unknown] = pd.NA, pd.NA
    return frames.assign(true_lane=lane, is_crossing=crossing).set_index("frame_id")


def concat_drives(drives: Sequence[Drive], tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Concatenate the tables of several drives, with a column `drive`.

    Lanes that the road of a drive does not have get probability 0.
    """
    if len(tables) == 1:
        return tables[0]
    named = [t.assign(drive=n) for t, n in zip(tables, drive_names(drives), strict=True)]
    frames = pd.concat(named)
    if "is_trusted" in frames:
        # Only drives with untrusted labels have the column.
        frames["is_trusted"] = frames["is_trusted"].eq(True) | frames["is_trusted"].isna()
    if len({drive.model.n_lanes for drive in drives}) > 1:
        lanes = [np.full(len(t), d.model.n_lanes) for d, t in zip(drives, tables, strict=True)]
        widest = max(drives, key=lambda drive: drive.model.n_lanes).model
        nodes = tuple(f"{node}_" for node in ("detector", *widest.values))
        values = [c for c in frames if c.startswith(nodes) and c != "detector_lane"]
        frames[values] = frames[values].fillna(0.0)
        frames["n_lanes"] = np.concatenate(lanes)
    return frames


def run_experiment(
    experiment: Experiment,
    lines: Any = None,
    truth: Any = None,
    *,
    chunk_frames: int | None = None,
    tags: Mapping[str, str] | None = None,
) -> Result:
    """Read the drives of an experiment, infer the lane in each frame, and score it.

    - lines, truth: data in memory, as for `read_drives`.
    - chunk_frames: number of frames to infer at a time, to save memory.
    - tags: labels to group results by.
    """
    begin = time.perf_counter()
    with noting() as notes:
        drives = read_drives(experiment, lines, truth, tags)
        frames = concat_drives(drives, [frames_of(drive, chunk_frames) for drive in drives])
    return make_result(experiment, drives, frames, notes, begin=begin)


@contextlib.contextmanager
def noting() -> Iterator[list[str]]:
    """Collect distinct user warnings; the list is filled at the end.

    Files in the current folder are named by their relative path.
    """
    notes: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        yield notes
    here = f"{Path.cwd()}{os.sep}"
    for each in caught:
        if not issubclass(each.category, UserWarning):
            warnings.warn_explicit(each.message, each.category, each.filename, each.lineno)
        elif (note := str(each.message).replace(here, "")) not in notes:
            notes.append(note)
