"""The table of a fleet: accuracy by tag."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import compress
from typing import Any

import numpy as np

from egolane_pgm.fleet import FleetDrive, by_tag, pooled
from egolane_pgm.scoring.bootstrap import over_drives
from egolane_pgm.types import FloatArray
from egolane_pgm.views.tables import with_interval


def fleet_table_rows(rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Header and rows: all drives, then those with each value of each tag.

    - rows: of summary.parquet, see `fleet.summary_rows`. Without a drive that failed, or without
      the accuracy of a detector, that column is left out.
    """
    header = ["drives", "number", "failed", "frames scored", "accuracy (95 %)", "detector"]
    table = []
    found = pooled(rows)
    for each in found:
        accuracy = ""
        if each.accuracy is not None:
            accuracy = with_interval(each.accuracy, each.interval)
        detector = "" if each.detector is None else f"{each.detector:.3f}"
        name = f"{each.tag} {each.value}".strip() or "all"
        numbers = [str(each.drives), str(each.failed), str(each.frames)]
        table.append([name, *numbers, accuracy, detector])
    is_shown = [True] * len(header)
    is_shown[2] = any(each.failed for each in found)
    is_shown[5] = any(each.detector is not None for each in found)
    cut = [list(compress(row, is_shown)) for row in (header, *table)]
    return cut[0], cut[1:]


FLEET_LEGEND = (
    "Accuracy of all scored frames of the drives, without those of tuning.never_fit; intervals and"
    " paired differences, 95 %, whole drives drawn."
)


def fleet_comparison_rows(
    document: Mapping[str, Any], drives: Sequence[FleetDrive]
) -> tuple[list[str], list[list[str]]]:
    """Header and rows: each experiment on all drives, then on those with each value of each tag;
    the difference is to the first.

    - document: of `egolane compare`, whose recordings are drives. Those that failed are left out.
    """
    tags = {drive.name: drive.tags for drive in drives}
    parts = document["recordings"]
    rows = []
    for tag, value, which in by_tag([tags[part["title"]] for part in parts]):
        some = [parts[k]["experiments"] for k in which]
        drive_of = [parts[k]["drive"] for k in which]
        first: FloatArray | None = None
        for k in range(len(some[0])):
            # The last subset leaves out what is not trusted.
            scores = [list(experiments[k]["scores"].values())[-1] for experiments in some]
            frames = np.array([each["frames_scored"] for each in scores], dtype=np.float64)
            right = frames * np.array([each["accuracy"] for each in scores])
            difference = "" if first is None else _share(right - first, frames, drive_of, "+.3f")
            first = right if first is None else first
            name, size = f"{tag} {value}".strip() or "all", [str(len(some)), str(int(frames.sum()))]
            accuracy = _share(right, frames, drive_of, ".3f")
            rows.append([name, some[0][k]["name"], *size, accuracy, difference])
    header = ["drives", "experiment", "number", "frames scored", "accuracy", "difference"]
    return header, rows


def _share(right: FloatArray, frames: FloatArray, drive_of: Sequence[str], form: str) -> str:
    return with_interval(*over_drives(np.stack([right, frames], axis=1), drive_of=drive_of), form)
