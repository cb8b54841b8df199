"""A result directory for each experiment of a comparison: what it was, and what it believed in each
block with parameters that have not seen it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.compare.side import Side
from egolane_pgm.experiment import config_hash, resolved
from egolane_pgm.loading import file_entry
from egolane_pgm.model import Model, prepare_model
from egolane_pgm.results import (
    git_state,
    make_directory,
    staged,
    versions,
    write_json,
    write_result,
)
from egolane_pgm.run import plugin_files, portable
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.held_out import blocks

SCHEMA_VERSION = 1


def folder_of(title: str) -> str:
    """A recording's title as the name of a directory."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", title).strip("._-") or "recording"


def save_comparison(out: Path, part: Mapping[str, Any], runs: Sequence[Side]) -> Path:
    """Write `out`/<recording>: comparison.json (the recording's part of the document) and a result
    directory for each experiment, whose beliefs.parquet has the annotated frames and their block.

    Raises InputError where they cannot be written.
    """
    folder = out / folder_of(part["title"])
    make_directory(folder)
    for run, entry in zip(runs, part["experiments"], strict=True):
        experiment = run.experiment
        model = prepare_model(experiment)
        content = {**resolved(experiment, model.parameters), "fit": experiment.fit}
        with staged(folder / experiment.name) as directory:
            write_result(
                directory,
                experiment=portable(experiment, model, content, directory),
                run=_provenance(run, model, content, part["blocks"]),
                scores={"name": experiment.name, "held_out": entry},
                columns=_columns(run, part["blocks"]),
            )
    write_json(folder / "comparison.json", {"schema_version": SCHEMA_VERSION, **part})
    return folder


def _provenance(
    run: Side, model: Model, content: Mapping[str, Any], n_blocks: int
) -> dict[str, Any]:
    experiment = run.experiment
    return {
        "name": experiment.name,
        "config_hash": config_hash(content),
        "data": [
            file_entry(path, pictures=experiment.recording.detector is not None)
            for path in run.drive.recorded.files
        ],
        "plugins": plugin_files(model),
        "versions": versions(),
        "git": git_state(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "n_lanes": experiment.n_lanes,
        "frame_rate": experiment.recording.frame_rate,
        "fit": experiment.fit,
        "blocks": n_blocks,
        "parameters_per_block": [dict(found) for found in run.held_out.parameters],
        "tuned_on": run.tuned_on,
        "is_causal": experiment.is_causal,
        "frames": len(run.truth),
        "mean_log_evidence": float(run.beliefs.log_evidence[~run.beliefs.is_impossible].mean())
        if not run.beliefs.is_impossible.all()
        else None,
        "impossible_frames": int(run.beliefs.is_impossible.sum()),
        "warnings": [*run.drive.recorded.notes, *run.notes],
        "values": {"Lane": [str(k + 1) for k in range(experiment.n_lanes)]},
    }


def _columns(run: Side, n_blocks: int) -> dict[str, np.ndarray[Any, Any]]:
    truth, experiment = run.truth, run.experiment
    n_frames = len(truth)
    parts = blocks(n_frames, n_blocks)
    columns: dict[str, np.ndarray[Any, Any]] = {
        "frame_id": truth.frame_id,
        "time_s": truth.frame_id / experiment.recording.frame_rate,
    }
    for k in range(experiment.n_lanes):
        columns[f"Lane_{k + 1}"] = run.beliefs.lane[:, k]
    columns["assigned_lane"] = assigned_lane(run.beliefs.lane, experiment.unassigned_below)
    columns["log_evidence"] = run.beliefs.log_evidence
    columns["is_impossible"] = run.beliefs.is_impossible
    columns["block"] = np.repeat(np.arange(n_blocks), [len(part) for part in parts])
    columns["true_lane"] = truth.lane
    columns["is_crossing"] = truth.is_crossing
    return columns
