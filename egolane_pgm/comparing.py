"""Comparisons of results, with paired intervals."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.drives import drive_key
from egolane_pgm.experiment import DETECTOR
from egolane_pgm.identity import content_of, digest_of
from egolane_pgm.plugins import OWN_FILES
from egolane_pgm.result import TAG, Result, as_result, is_result, lanes_of, load_result, truth_of
from egolane_pgm.runs import SUMMARY, numbers
from egolane_pgm.scoring.bootstrap import score_intervals
from egolane_pgm.scoring.scores import SCORES, Answers
from egolane_pgm.tools.files import read_parquet
from egolane_pgm.tools.options import several_of
from egolane_pgm.types import InputError

#: A drive, and per score its summands in each frame.
Counts = tuple[str, Mapping[str, Any]]

#: Scores without an interval: the name of a column by the key in scores.json.
EVENT_SCORES = {
    "events.within.1.precision": "event_precision",
    "events.within.1.recall": "event_recall",
    "events.within.1.false_per_hour": "event_false_per_hour",
    "events.delay_s.median": "event_delay_s",
}


def compare(
    results: Any,
    *,
    of: str | None = None,
    by: str | None = None,
    detector: bool = False,
) -> pd.DataFrame:
    """Compare results on the annotated frames of the same recordings.

    - results: results, studies, their directories, or folders of result directories.
    - of: the sides of the comparison: a key of the experiment (`graph`, `parameters.sigma1`), a
      tag (`tag.driver`), `name`, `directory` (of the result) or `folder` (around it). By default
      the name if all results are of one recording, and the folder otherwise.
    - by: a second such key; results with different values of it are compared separately.
    - detector: whether the detectors' answers are a further side, the last one.

    Returns a row per value of `by` and `of`: each score (the mean over the recordings) with its
    95 % interval, and the difference to the first row with a paired interval over the same
    resamples; recordings of one drive are resampled together. `tuned_on` tells in-sample rows
    apart. For `log_evidence`, `free_parameters` and `bic` see `_log_evidence`; results without
    ground truth have only these. Rows with different evidence lack them, for the reason in
    `attrs["log_evidence"]`. Raises InputError unless all rows have the same recordings.
    """
    given = open_results(results)
    if not given:
        raise InputError("results: name at least one")
    for option, name in (("of", of), ("by", by)):
        if name is not None and all(_value(each, name) is None for each in given):
            raise InputError(f"{option}: no result has a value of {name}")
    rows, key, note = [], of or _default_key(given), ""
    has_truth = any(each.truth is not None for each in given)
    for group, members in _groups(given, by).items():
        named = _groups(members, key).items()
        sides = {str(name): _by_recording(side, name, has_truth) for name, side in named}
        first = next(iter(sides.values()))
        nodes = [(name, side, "Lane") for name, side in sides.items()]
        if detector and all("detector" in each.scores for each in first.values()):
            nodes.append(("detector alone", first, "detector"))
        for name, side in sides.items():
            if side.keys() != first.keys():
                raise InputError(f"{key} {name}: has other recordings, frames or labels")
        of_first = _counts([*first.values()], "Lane") if has_truth else []
        pairs = [[side[each] for each in first] for side in sides.values()]
        why = _differ_in(pairs)
        evidence = iter([{}] * len(pairs)) if why else _log_evidence(pairs)
        note = f"log evidence is not compared: {why}" if why else note
        for name, side, node in nodes:
            aligned = [side[recording] for recording in first]
            row = {} if by is None else {by: group}
            row |= {key: name, "recordings": len(aligned)}
            if has_truth:
                counts = _counts(aligned, node)
                row |= _intervals(counts)
                if side is not first or node != "Lane":
                    row |= _intervals(counts, of_first)
            row["tuned_on"] = ""
            if node == "Lane":
                row |= next(evidence)
                # The means of the defined scores of lane changes.
                table = pd.DataFrame([numbers(each.scores) for each in aligned])
                means = table.reindex(columns=list(EVENT_SCORES)).astype(float).mean()
                row |= means.rename(EVENT_SCORES).to_dict()
                row["tuned_on"] = ", ".join(dict.fromkeys(e.run["tuned_on"] for e in aligned))
            rows.append(row)
    table = pd.DataFrame(rows).set_index([key] if by is None else [by, key])
    table.attrs["log_evidence"] = note
    return table


def open_results(results: Any) -> list[Result]:
    """Results as given, or read from directories and from the directories below a folder; of a
    Study its held-out result, or the in-sample one without folds.

    Results of a table of runs come in the order of the table.
    """
    found: list[Result] = []
    for each in results if isinstance(results, Iterator) else several_of(results):
        if not isinstance(each, (str, os.PathLike)):
            result = as_result(each, "results")
            if result is not each:
                result = result if each.held_out is None else each.held_out
                name = {"name": each.experiment.name}
                result = replace(result, experiment=result.experiment.model_copy(update=name))
            found.append(result)
            continue
        if is_result(each):
            found.append(load_result(each))
            continue
        folder = Path(each)
        below = sorted(file.parent for file in folder.glob("**/run.json"))
        if (folder / SUMMARY).exists():
            rows = list(read_parquet(folder / SUMMARY).index)
            below.sort(key=lambda p: rows.index(p.name) if p.name in rows else len(rows))
        found += map(load_result, below or [folder])
    return found


# --- sides ---------------------------------------------------------------------------------------


def _default_key(results: Sequence[Result]) -> str:
    if len({_recording(each) for each in results}) > 1:
        return "folder"
    # Held-out results of studies are all in directories `held_out`.
    keys = ["name", "directory", "folder"]
    if len({len(each.frames) for each in results}) == 1:
        keys.insert(1, "graph")
    is_fit = (k for k in keys if len({_value(each, k) for each in results}) == len(results))
    return next(is_fit, "directory")


def _recording(result: Result) -> str:
    """The file of a result's recording, or its simulated drive."""
    recording = result.experiment.recording
    return recording.path or f"{recording.simulate}, seed {recording.seed}"


def _value(result: Result, key: str | None) -> Any:
    """The value of a key; a plugin in a file is named by the file's stem."""
    if key is None or key == "name":
        return key and result.name
    if key in ("folder", "directory"):
        place = result.directory
        if place is None:
            return result.name
        return place.parent.name if key == "folder" else place.name
    if key.startswith(TAG):
        return result.run["tags"].get(key.removeprefix(TAG))
    value: Any = result.run["config"]
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    if isinstance(value, str) and value.endswith(OWN_FILES):
        return Path(value).stem
    return tuple(value) if isinstance(value, list) else value


def _groups(results: Sequence[Result], key: str | None) -> dict[Any, list[Result]]:
    """The results with each value of a key, in order."""
    groups: dict[Any, list[Result]] = {}
    for result in results:
        groups.setdefault(_value(result, key), []).append(result)
    return groups


def _kept(result: Result) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The annotated frames whose labels are trusted, and their ground truth."""
    frames = result.frames.dropna(subset=["true_lane"])
    frames = frames[frames["is_trusted"]] if "is_trusted" in frames else frames
    truth = truth_of(frames)
    if truth is None:
        raise InputError(f"{result.name}: has no ground truth to compare with")
    return frames, truth


def _by_recording(results: Sequence[Result], side: Any, has_truth: bool) -> dict[str, Result]:
    """Results by their recordings, which are identified by file, annotated frames and labels."""
    found: dict[str, Result] = {}
    for result in results:
        truth = _kept(result)[1] if has_truth else pd.DataFrame()
        key = f"{_recording(result)} {pd.util.hash_pandas_object(truth).sum()}"
        if key in found:
            raise InputError(
                f"of: {side} has two results of one recording, {found[key].name} and {result.name};"
                " name a key in which they differ, e.g. graph"
            )
        found[key] = result
    return found


# --- scores --------------------------------------------------------------------------------------


def _counts(results: Sequence[Result], node: str) -> list[Counts]:
    """Per recording its drive, and the summands of the scores on the frames of the whole drive."""
    column = "assigned_lane" if node == "Lane" else "detector_lane"
    parts = []
    for result in results:
        frames, truth = _kept(result)
        answers = Answers(
            lanes_of(frames, node),
            truth["true_lane"].to_numpy(),
            truth["is_crossing"].to_numpy(),
            frames[column].to_numpy(),
            frame_rate=result.frame_rate,
        )
        counts = {name: score.summands(answers) for name, score in SCORES.items()}
        del counts["log_evidence"]
        parts.append((counts, truth.index))
    return _on_drives(results, parts)


def _on_drives(
    results: Sequence[Result], parts: Sequence[tuple[Mapping[str, Any], pd.Index]]
) -> list[Counts]:
    """Place the summands of some frames of each recording among all frames of its drive, with zeros
    elsewhere: recordings of one drive are resampled together."""
    # A result of several drives shares its frames with no other.
    more = (" and more" * ("drive" in each.frames) for each in results)
    keys = (drive_key(each.experiment, each.run["data"]) for each in results)
    drives = [key + others for key, others in zip(keys, more, strict=True)]
    timeline: dict[str, pd.Index] = {}
    for drive, (_, index) in zip(drives, parts, strict=True):
        timeline[drive] = timeline.get(drive, index).union(index)
    found: list[Counts] = []
    for drive, (counts, index) in zip(drives, parts, strict=True):
        placed, at = {}, timeline[drive].get_indexer(index)
        for name, values in counts.items():
            placed[name] = np.zeros((len(timeline[drive]), *values.shape[1:]), values.dtype)
            placed[name][at] = values
        found.append((drive, placed))
    return found


def _intervals(
    counts: Sequence[Counts], minus: Sequence[Counts] | None = None
) -> dict[str, float | None]:
    """Each score, or difference, with the ends of its interval."""
    drives = list(dict.fromkeys(drive for drive, _ in counts))
    seeds = [drives.index(drive) for drive, _ in counts]
    theirs = None if minus is None else [each for _, each in minus]
    cells: dict[str, float | None] = {}
    for name, found in score_intervals([each for _, each in counts], theirs, seeds=seeds).items():
        label = name if minus is None else f"{name}_difference"
        cells |= {label: found.estimate, f"{label}_low": found.low, f"{label}_high": found.high}
    return cells


# --- log evidence --------------------------------------------------------------------------------


def _differ_in(sides: Sequence[Sequence[Result]]) -> str:
    """Why log evidence of the sides cannot be compared; empty if it can."""
    if not all("of_rule" in each.run for side in sides for each in side):
        return "a result was written by an older version; run it again"
    is_same = len({tuple(map(_evidence_key, side)) for side in sides}) == 1
    return "" if is_same else "the rows differ in evidence rule, its parameters or observed nodes"


def _log_evidence(sides: Sequence[Sequence[Result]]) -> Iterator[dict[str, Any]]:
    """Yield the cells of log evidence of each side, in order.

    - sides: per side its results, of the same recordings.

    `log_evidence` is the mean over the frames that all sides have and none calls impossible, nats,
    with its interval and the difference to the first side. `bic` is the sum over these frames less
    half the logarithm of their number for each of the `free_parameters`, so larger is better; held
    out frames need no such penalty and have none. Both are the mean over the recordings.
    """
    pairs = zip(*sides, strict=True)
    recordings = [pd.concat(map(_by_frame, each), axis=1, join="inner") for each in pairs]
    first: list[Counts] = []
    for k, side in enumerate(sides):
        parts = []
        for table in recordings:
            is_possible = table.notna().all(axis=1)
            values = table.iloc[:, k].where(is_possible, 0.0)
            parts.append(({"log_evidence": np.stack([values, is_possible], axis=1)}, table.index))
        counts = _on_drives(sides[0], parts)
        cells: dict[str, Any] = _intervals(counts)
        cells |= _intervals(counts, first) if first else {}
        first = first or counts
        sizes = np.array([each.run["free_parameters"] for each in side])
        cells["free_parameters"] = float(sizes.mean())
        if not any(each.run["tuned_on"] in ("other_frames", "other_drive") for each in side):
            total, n_frames = np.transpose([each["log_evidence"].sum(axis=0) for each, _ in parts])
            cells["bic"] = float(np.mean(total - sizes / 2 * np.log(n_frames)))
        yield cells


def _by_frame(result: Result) -> pd.Series[float]:
    """Log evidence by frame id, and by drive if there are several; NaN if impossible."""
    frames = result.frames
    frames = frames.set_index("drive", append=True) if "drive" in frames else frames
    return frames["log_evidence"].mask(frames["is_impossible"])


def _evidence_key(result: Result) -> str:
    """A checksum that is equal for results with the same evidence, up to their graphs."""
    run, others = result.run, ("graph", "filter", "lag", "start_lane", "min_confidence", "fit")
    content = content_of(result.experiment, [*others, "tuned_on", "ground_truth", "parameters"])
    for key in ("frames", "columns"):
        content["recording"].pop(key)
    names = {DETECTOR, *run["of_rule"]}
    fits = [run["config"]["parameters"], *run.get("fitted", ())]
    own = [{k: v for k, v in each.items() if k.split(".")[0] in names} for each in fits]
    return digest_of(content, [*filter(None, own)], run["observed"])
