"""What a number depends on, and whether a fit saw the frames that are scored.

A number depends on all keys of its experiment except `HARMLESS`, on the content of the files that
they name (own plugins included), on data in memory, and on the version of this package. `digest_of`
makes a checksum of them, for everything that is kept.

A fit keeps marks of its training recordings and the ids of its training frames (`trained_on`). They
are compared with those of the frames of a later run (`compared`), so a copy of a recording is the
same recording, whatever its name.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd

from egolane_pgm.experiment import DETECTOR, Experiment, TrainedOn, TunedOn
from egolane_pgm.recordings import files_of
from egolane_pgm.tools.files import file_sha256
from egolane_pgm.types import BoolArray, IntArray, LineLog

#: Keys of an experiment on which no number depends.
HARMLESS = ("name", "description")

# --- checksums -----------------------------------------------------------------------------------


def digest_of(*parts: Any) -> str:
    """Return a checksum of the version and of plain values, arrays and dataclasses."""
    text = json.dumps((metadata.version("egolane-pgm"), *parts), sort_keys=True, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        content = hashlib.sha256(np.ascontiguousarray(value).tobytes())
        return [str(value.dtype), value.shape, content.hexdigest()]
    if isinstance(value, np.generic):
        return value.item()
    if dataclasses.is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    raise TypeError(f"{type(value).__name__} has no checksum")


def content_of(
    experiment: Experiment,
    harmless: Collection[str] = (),
    data: Iterable[dict[str, Any]] = (),
) -> dict[str, Any]:
    """The keys on which a number depends, with checksums of files in place of their paths.

    - harmless: further keys that are left out.
    - data: the `digest` of each of `data_files`, if known.
    """
    text = experiment.model_dump_json(exclude={*HARMLESS, *harmless})
    for each in data or map(digest, data_files(experiment)):
        text = text.replace(json.dumps(each["path"]), json.dumps(each["sha256"]))
    content: dict[str, Any] = json.loads(text)
    return content


def data_files(experiment: Experiment) -> list[Path]:
    """The files that an experiment names, plugins included."""
    recording, truth = experiment.recording, experiment.ground_truth
    named: list[Any] = [recording.path, recording.right, recording.camera, truth and truth.path]
    named += [experiment.road, experiment.evidence, experiment.graph, recording.format]
    named += [recording.detector, *experiment.parameters.get(DETECTOR, {}).values()]
    return [Path(name) for name in named if isinstance(name, str) and os.path.isabs(name)]


def digest(path: Path) -> dict[str, Any]:
    """Path, sha256 and size in bytes of a file, of a folder or of a glob of files."""
    if path.is_file():
        return {"path": str(path), "sha256": file_sha256(path), "bytes": path.stat().st_size}
    files = files_of(path) if path.is_dir() else sorted(path.parent.glob(path.name))
    lines = "".join(f"{file_sha256(file)}  {file.name}\n" for file in files)
    size = sum(file.stat().st_size for file in files)
    sha256 = hashlib.sha256(lines.encode()).hexdigest()
    return {"path": str(path), "sha256": sha256, "bytes": size, "files": len(files)}


# --- training frames -----------------------------------------------------------------------------

#: Frames in each mark of lines, and runs of labels in each mark of labels: so many are hardly the
#: same in two drives.
FRAMES_PER_MARK = 10
RUNS_PER_MARK = 2

#: Marks of a recording that a fit keeps, those with the smallest numbers.
MOST_MARKS = 100

#: Marks that two recordings share if they are of one drive.
MIN_SHARED = 2

#: Ranges of training frames that a fit keeps; smaller gaps count as trained on.
MOST_RANGES = 50


@dataclass(frozen=True)
class Marks:
    """Numbers of 32 bits that identify a recording and its labels, whatever the frame ids.

    - lines: one for the lateral offsets in each `FRAMES_PER_MARK` successive frames.
    - labels: one for the lanes and lengths of each `RUNS_PER_MARK` successive runs of equal labels.
    """

    lines: frozenset[int] = frozenset()
    labels: frozenset[int] = frozenset()


def marks_of(log: LineLog, truth: pd.DataFrame | None) -> Marks:
    """Return the marks of a whole recording.

    - truth: with columns true_lane and is_crossing, or None.
    """
    # Millimetres, since a copy may have other decimals.
    offset = np.round(np.nan_to_num(log.offset_m, nan=1e6), 3) + 0.0
    there = np.isfinite(log.offset_m)
    # Lines of a frame count in any order, and padding does not count.
    hashed = pd.util.hash_array(offset.ravel()).reshape(offset.shape)
    frames = np.where(there, hashed, np.uint64(0)).sum(axis=1, dtype=np.uint64)
    lines = _windows(frames, np.asarray(there.any(axis=1)), FRAMES_PER_MARK)
    if truth is None or truth.empty:
        return Marks(lines, frozenset())
    label = truth["true_lane"].to_numpy(np.int64) * 2 + truth["is_crossing"].to_numpy(bool)
    starts = np.flatnonzero(np.diff(label, prepend=-1))
    # The first run and the last one end with the annotation.
    runs = pd.DataFrame({"label": label[starts[1:-1]], "length": np.diff(starts)[1:]})
    hashed = pd.util.hash_pandas_object(runs, index=False).to_numpy(np.uint64)
    return Marks(lines, _windows(hashed, np.ones(len(runs), dtype=bool), RUNS_PER_MARK))


def _windows(values: Any, counts: BoolArray, size: int) -> frozenset[int]:
    """The number of each window of successive values of which one counts."""
    size = min(size, len(values))
    if not size:
        return frozenset()
    weights = pd.util.hash_array(np.arange(size, dtype=np.uint64)) | np.uint64(1)
    windows = np.lib.stride_tricks.sliding_window_view(values, size)
    numbers = (windows * weights).sum(axis=1, dtype=np.uint64) >> np.uint64(32)
    kept = np.lib.stride_tricks.sliding_window_view(counts, size).any(axis=1)
    return frozenset(numbers[kept].tolist())


def trained_on(marks: Marks, frame_id: IntArray) -> TrainedOn:
    """Return what a fit keeps of a training drive. frame_id: of its training frames."""
    gaps = np.diff(frame_id)
    cuts = np.sort(np.argsort(-gaps, kind="stable")[: MOST_RANGES - 1])
    cuts = cuts[gaps[cuts] > 1]
    firsts = frame_id[np.concatenate([[0], cuts + 1]).astype(int)].tolist() if len(frame_id) else []
    lasts = frame_id[np.concatenate([cuts, [-1]]).astype(int)].tolist() if len(frame_id) else []
    frames = tuple((first, last + 1) for first, last in zip(firsts, lasts, strict=True))
    return TrainedOn(_text(marks.lines), _text(marks.labels), frames)


def _text(marks: Iterable[int]) -> str:
    return " ".join(f"{mark:08x}" for mark in sorted(marks)[:MOST_MARKS])


def most_in_sample(values: Iterable[TunedOn]) -> TunedOn:
    """The value nearest to in-sample."""
    return max(values, key=get_args(TunedOn).index)


def compared(trained: TrainedOn, marks: Marks, frame_id: IntArray) -> TunedOn:
    """Compare what a fit was trained on with some frames of a recording, by their ids."""
    has_lines = _shares(trained.lines, marks.lines)
    if not has_lines and not _shares(trained.labels, marks.labels):
        return "other_drive" if trained.lines and marks.lines else "unknown"
    is_trained = (((frame_id >= first) & (frame_id < stop)).any() for first, stop in trained.frames)
    if not any(is_trained):
        return "other_frames"
    return "same_frames" if has_lines else "same_drive"


def _shares(text: str, marks: frozenset[int]) -> bool:
    kept = {int(mark, 16) for mark in text.split()}
    return bool(kept) and len(kept & marks) >= min(MIN_SHARED, len(kept))
