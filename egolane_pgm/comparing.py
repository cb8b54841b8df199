"""Comparisons of results, with paired intervals."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.drives import drive_key
from egolane_pgm.plugins import OWN_FILES
from egolane_pgm.result import Result, is_result, lanes_of, load_result, truth_of
from egolane_pgm.runs import SUMMARY, numbers
from egolane_pgm.scoring.bootstrap import on_timeline, score_counts, score_intervals
from egolane_pgm.tools.files import read_parquet
from egolane_pgm.types import InputError, IntArray

ResultLike = Result | str | os.PathLike[str]

#: The scores with an interval; each is the mean over the recordings.
SCORES = ("accuracy", "f1", "log_loss")

#: Scores without an interval: the column by the key in scores.json.
EVENT_SCORES = {
    "events.within.1.precision": "event_precision",
    "events.within.1.recall": "event_recall",
    "events.within.1.false_per_hour": "event_false_per_hour",
    "events.delay_s.median": "event_delay_s",
}


def compare(
    results: ResultLike | Iterable[ResultLike],
    *,
    of: str | None = None,
    by: str | None = None,
    detector: bool = False,
) -> pd.DataFrame:
    """Compare results on the annotated frames of the same recordings.

    - results: results, their directories, or folders of result directories.
    - of: the sides of the comparison: a key of the experiment (`graph`, `parameters.sigma1`), a
      tag (`tag.driver`), `name`, `directory` (of the result) or `folder` (its parent). By default
      the name if all results have one recording, and the folder otherwise.
    - by: a second such key: results with different values of it are compared separately.
    - detector: whether to add the detectors' own answers as the last side.

    Returns a row per value of `by` and `of`: each score (the mean over the recordings), its 95 %
    interval, the difference to the first row with a paired interval over the same resamples
    (recordings of one drive are resampled together), scores of lane changes reported within 1 s,
    and `tuned_on`. Raises InputError unless all rows have the same recordings.
    """
    given = open_results(results)
    if not given:
        raise InputError("results: name at least one")
    for option, name in (("of", of), ("by", by)):
        if name is not None and all(_value(each, name) is None for each in given):
            raise InputError(f"{option}: no result has a value of {name}")
    rows, key = [], of or _default_key(given)
    for group, members in _groups(given, by).items():
        sides = {
            str(name): _by_recording(side, name) for name, side in _groups(members, key).items()
        }
        first = next(iter(sides.values()))
        own = [(name, side, "Lane") for name, side in sides.items()]
        if detector and all("detector" in each.scores for each in first.values()):
            own.append(("detector alone", first, "detector"))
        of_first = _counts([*first.values()], "Lane")
        for name, side, node in own:
            if side.keys() != first.keys():
                raise InputError(f"{key} {name}: has other recordings, frames or labels")
            aligned = [side[recording] for recording in first]
            counts = _counts(aligned, node)
            row = {} if by is None else {by: group}
            row |= {key: name, "recordings": len(aligned), **_cells(counts)}
            if side is not first or node != "Lane":
                row |= _cells(counts, of_first, "_difference")
            if node == "Lane":
                row |= _event_scores(aligned)
            tuned = dict.fromkeys(each.run["tuned_on"] for each in aligned)
            row["tuned_on"] = "" if node != "Lane" else ", ".join(tuned)
            rows.append(row)
    return pd.DataFrame(rows).set_index([key] if by is None else [by, key])


def open_results(results: ResultLike | Iterable[ResultLike]) -> list[Result]:
    """Results as given, read from directories, or from the folders below a folder."""
    several = [results] if isinstance(results, (Result, str, os.PathLike)) else list(results)
    found: list[Result] = []
    for each in several:
        if isinstance(each, Result):
            found.append(each)
            continue
        place = Path(each)
        below = [] if is_result(place) else results_in(place)
        found += [load_result(directory) for directory in below or [place]]
    return found


def results_in(folder: Path) -> list[Path]:
    """The result directories below a folder, in the order of a table of runs if it has one."""
    found = sorted(file.parent for file in folder.glob("**/run.json"))
    if (folder / SUMMARY).exists():
        rows = list(read_parquet(folder / SUMMARY).index)
        found.sort(key=lambda place: rows.index(place.name) if place.name in rows else len(rows))
    return found


def _default_key(results: Sequence[Result]) -> str:
    """The default key of the sides."""
    if len({_recording(each) for each in results}) > 1:
        return "folder"
    return "name" if len({each.name for each in results}) == len(results) else "directory"


def _recording(result: Result) -> str:
    """The file of a result's recording, or its simulated drive."""
    recording = result.experiment.recording
    return recording.path or f"{recording.simulate}, seed {recording.seed}"


def _value(result: Result, key: str | None) -> Any:
    if key is None:
        return None
    if key in ("folder", "directory"):
        place = result.directory
        if place is None:
            return result.name
        return place.parent.name if key == "folder" else place.name
    value = result.value(key)
    if isinstance(value, str) and value.endswith(OWN_FILES):
        # A user's graph or rule is named after its file.
        return Path(value).stem
    return tuple(value) if isinstance(value, list) else value


def _groups(results: Sequence[Result], key: str | None) -> dict[Any, list[Result]]:
    """The results with each value of a key, in order."""
    groups: dict[Any, list[Result]] = {}
    for result in results:
        groups.setdefault(_value(result, key), []).append(result)
    return groups


def _kept(result: Result) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The annotated frames with trusted labels, and their truth."""
    frames = result.frames.dropna(subset=["true_lane"])
    if "is_trusted" in frames:
        frames = frames[frames["is_trusted"]]
    truth = truth_of(frames)
    if truth is None:
        raise InputError(f"{result.name}: has no ground truth to compare with")
    return frames, truth


def _by_recording(results: Sequence[Result], side: Any) -> dict[str, Result]:
    """Results by recording: its file, frames and labels."""
    found: dict[str, Result] = {}
    for result in results:
        _, truth = _kept(result)
        key = f"{_recording(result)} {pd.util.hash_pandas_object(truth).sum()}"
        if key in found:
            raise InputError(
                f"of: {side} has two results of one recording, {found[key].name} and {result.name};"
                " name a key in which they differ, e.g. graph"
            )
        found[key] = result
    return found


def _counts(results: Sequence[Result], node: str) -> list[tuple[str, Mapping[str, Any]]]:
    """Per recording its drive, and per-frame summands of each score on the drive's timeline."""
    kept = [_kept(result) for result in results]
    drives = [drive_key(each.experiment, each.run["data"]) for each in results]
    column = "assigned_lane" if node == "Lane" else "detector_lane"
    timeline: dict[str, IntArray] = {}
    for drive, (_, truth) in zip(drives, kept, strict=True):
        ids = truth.index.to_numpy()
        timeline[drive] = np.union1d(timeline.get(drive, ids), ids)
    found: list[tuple[str, Mapping[str, Any]]] = []
    for drive, (frames, truth) in zip(drives, kept, strict=True):
        lane, crossing = truth["true_lane"].to_numpy(), truth["is_crossing"].to_numpy()
        assigned = frames[column].to_numpy()
        counts = score_counts(lanes_of(frames, node), lane, crossing, assigned=assigned)
        found.append((drive, on_timeline(counts, truth.index.to_numpy(), timeline[drive])))
    return found


def _cells(
    counts: Sequence[tuple[str, Mapping[str, Any]]],
    minus: Sequence[tuple[str, Mapping[str, Any]]] | None = None,
    suffix: str = "",
) -> dict[str, float | None]:
    """Each score, or difference, with the ends of its interval."""
    drives = list(dict.fromkeys(drive for drive, _ in counts))
    seeds = [drives.index(drive) for drive, _ in counts]
    mine = [each for _, each in counts]
    theirs = None if minus is None else [each for _, each in minus]
    cells: dict[str, float | None] = {}
    for name, interval in score_intervals(mine, theirs, seeds=seeds).items():
        for end in ("estimate", "low", "high"):
            label = f"{name}{suffix}" if end == "estimate" else f"{name}{suffix}_{end}"
            cells[label] = getattr(interval, end)
    return cells


def _event_scores(results: Sequence[Result]) -> dict[str, float | None]:
    """The scores of lane changes, each the mean over the recordings that define it."""
    flat = [numbers(result.scores) for result in results]
    values = {name: [each.get(key) for each in flat] for key, name in EVENT_SCORES.items()}
    known = {name: [v for v in each if v is not None] for name, each in values.items()}
    return {name: float(np.mean(each)) if each else None for name, each in known.items()}
