"""Tables as text: Markdown, LaTeX and CSV from the same cells."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from egolane_pgm.types import InputError, LineLog

#: How `tuned_on` is said beside a score.
TUNED_ON = {
    "same_frames": "in-sample (tuned on these frames)",
    "other_frames": "held out (tuned on other frames)",
    "not_tuned": "not tuned",
    "unknown": "unknown (tuned_on is not set)",
}

#: The same in a narrow column.
SEEN = {way: said.split(" (")[0] for way, said in TUNED_ON.items()}

_SCORES = {
    "accuracy": "accuracy",
    "precision": "precision (mean)",
    "recall": "recall (mean)",
    "f1": "F1 (mean)",
    "log_loss": "log-loss (all frames)",
    "brier": "Brier score",
    "expected_calibration_error": "calibration error",
    "coverage": "coverage",
    "false_switches_per_minute": "false switches / min",
}


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table, columns aligned for reading as plain text; the first column is left."""
    width = [max(len(str(r[k])) for r in [header, *rows]) for k in range(len(header))]

    def line(cells: Sequence[str]) -> str:
        padded = [
            str(c).ljust(w) if k == 0 else str(c).rjust(w)
            for k, (c, w) in enumerate(zip(cells, width, strict=True))
        ]
        return f"| {' | '.join(padded)} |"

    rule = [("-" * w if k == 0 else "-" * (w - 1) + ":") for k, w in enumerate(width)]
    return "\n".join([line(header), f"| {' | '.join(rule)} |", *map(line, rows)])


def latex(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """The same as a LaTeX tabular with booktabs rules."""

    def line(cells: Sequence[str]) -> str:
        return " & ".join(_escape(str(c)) for c in cells) + r" \\"

    return "\n".join(
        [
            rf"\begin{{tabular}}{{l{'r' * (len(header) - 1)}}}",
            r"\toprule",
            line(header),
            r"\midrule",
            *map(line, rows),
            r"\bottomrule",
            r"\end{tabular}",
        ]
    )


def as_csv(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """The same as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([header, *rows])
    return text.getvalue()


#: How a table is written, by the name that `--format` has for it.
STYLES = {"markdown": markdown, "latex": latex, "csv": as_csv}


def _escape(text: str) -> str:
    for character in "&%$#_{}":
        text = text.replace(character, "\\" + character)
    return text


def number(value: float | None, digits: int = 3) -> str:
    """A score for a table; a dash where it is undefined."""
    return "-" if value is None else f"{value:.{digits}f}"


def scores_table(scores: Mapping[str, Mapping[str, Any]]) -> str:
    """Markdown: one row per score, detector beside model."""
    columns = [name for name in ("detector", "model") if name in scores]
    rows = [[label, *(number(scores[c][key]) for c in columns)] for key, label in _SCORES.items()]
    delays = [scores[c]["delay"] for c in columns]
    rows.append(
        ["delay after a lane change, median (frames)"]
        + [number(d["median_frames"], 1) for d in delays]
    )
    rows.append(["lane changes missed", *(number(d["share_missed"]) for d in delays)])
    for key, label in (("accuracy", "accuracy"), ("f1", "F1 (mean)")):
        found = [scores[c]["intervals"][key] for c in columns]
        if all(found):
            rows.append(
                [f"{label}, 95 % interval", *(f"{low:.3f} .. {high:.3f}" for low, high in found)]
            )
    return markdown(["score", *columns], rows)


def runs_table(summaries: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: one row per run (as `run.summary`), detector beside model."""
    header = ["run", "frames", "scored", "detector", "model", "F1", "log-loss", "parameters"]
    rows = []
    for found in summaries:
        detector, model = found.get("detector"), found.get("model")
        scores = [number(s["accuracy"]) if s else "" for s in (detector, model)]
        scores += [number(model[key]) if model else "" for key in ("f1", "log_loss")]
        frames = [str(found["frames"]), str(found["frames_scored"])]
        rows.append([found["name"], *frames, *scores, seen(found) if model else ""])
    return markdown(header, rows)


def seen(found: Mapping[str, Any]) -> str:
    """Which frames the parameters have seen, and what looks at later frames (`model.causality`),
    in a narrow column."""
    ahead = [part for part, is_causal in found["causal"].items() if not is_causal]
    return SEEN[found["tuned_on"]] + (f", not causal ({', '.join(ahead)})" if ahead else "")


def confusion_table(matrix: Sequence[Sequence[int]], header: str = "predicted") -> str:
    """Markdown: rows predicted lane (then Unassigned), columns actual lane, with totals."""
    n = len(matrix[0])
    names = [f"lane {k + 1}" for k in range(n)] + ["Unassigned"]
    rows = [[name, *map(str, row), str(sum(row))] for name, row in zip(names, matrix, strict=True)]
    support = [sum(row[k] for row in matrix) for k in range(n)]
    rows.append(["support", *map(str, support), str(sum(support))])
    return markdown([header, *(f"actual {k + 1}" for k in range(n)), "total"], rows)


def reproduction_rows(
    document: Mapping[str, Any], published: Mapping[int, Any]
) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the table of `egolane reproduce`: per run and matrix ours, published and
    the difference. document: as `reproduce_json` makes it."""
    header = ["run", "matrix", "frames off"]
    keys = ("accuracy", "precision", "recall", "f1", "log_loss")
    for key in keys:
        header += [key, "paper", "diff"]
    rows = []
    for entry in document["runs"]:
        for kind, theirs in (("detector", "detector_only"), ("model", "model")):
            printed = published[entry["run"]][theirs]["metrics"]
            row = [str(entry["run"]), kind, str(entry[f"{kind}_frames_off"])]
            for key in keys:
                ours = entry[kind][key]
                row += [f"{ours:.4f}", f"{printed[key]:.2f}", f"{ours - printed[key]:+.4f}"]
            rows.append(row)
    return header, rows


def box_text(log: LineLog, frame_id: int) -> str:
    """One row per line of the frame, `Line1: isValid = 1; continuous=1; LRI: 10; offset: -9.15m`;
    an LRI that is not known is `--`, as is an offset.

    Raises InputError, with the nearest frame that there is, where the log lacks the frame.
    """
    if not len(log):
        raise InputError(f"{log.source}: has no frames")
    first, last = int(log.frame_id[0]), int(log.frame_id[-1])
    # Whatever number is asked for, it fits an array.
    within = min(max(frame_id, first), last)
    at = int(np.argmin(np.abs(log.frame_id - within)))
    if log.frame_id[at] != frame_id:
        raise InputError(
            f"{log.source}: has no frame {frame_id}; the nearest is {int(log.frame_id[at])}"
            f" (frames {first} to {last})"
        )
    offset, lri = log.offset_m[at], log.lri[at]
    valid, continuous = log.is_valid[at], log.is_continuous[at]
    # The rest is padding.
    is_there = np.isfinite(offset) | np.isfinite(lri) | valid | continuous
    rows = []
    for k in np.flatnonzero(is_there):
        reliability = f"{lri[k]:02.0f}" if np.isfinite(lri[k]) else "--"
        place = f"{offset[k]:+.2f}m" if np.isfinite(offset[k]) else "--"
        rows.append(
            f"Line{k + 1}: isValid = {int(valid[k])}; continuous={int(continuous[k])};"
            f" LRI: {reliability}; offset: {place}"
        )
    return "\n".join(rows) if rows else "no lines"
