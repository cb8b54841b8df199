"""Tables as text: Markdown, LaTeX and CSV from the same cells, and the scores of a result in them.
`box_text` lists the lines of one frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from egolane_pgm.files import as_csv
from egolane_pgm.types import InputError, LineLog

#: How `tuned_on` is said beside a score.
TUNED_ON = {
    "same_frames": "in-sample (tuned on these frames)",
    "other_frames": "held out (tuned on other frames)",
    "not_tuned": "not tuned",
    "unknown": "unknown (tuned_on is not set)",
}

#: The same in a narrow column.
TUNED_ON_SHORT = {way: said.split(" (")[0] for way, said in TUNED_ON.items()}

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
    """A Markdown table, aligned to be read as plain text; the first column is aligned left."""
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
    """A LaTeX tabular with booktabs rules."""

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


#: The functions that write a table, by the names that `--format` has for them.
STYLES = {"markdown": markdown, "latex": latex, "csv": as_csv}


def _escape(text: str) -> str:
    for character in "&%$#_{}":
        text = text.replace(character, "\\" + character)
    return text


def score_text(value: float | None, digits: int = 3) -> str:
    """A score for a table; a dash if it is undefined."""
    return "-" if value is None else f"{value:.{digits}f}"


def with_interval(value: float | None, interval: Sequence[float] | None, form: str = ".3f") -> str:
    """A score and its interval, e.g. ".912 [.905, .919]"; a dash if the score is undefined.

    form: the format of each number.
    """
    if value is None:
        return "-"
    return f"{value:{form}}" + (
        f" [{interval[0]:{form}}, {interval[1]:{form}}]" if interval is not None else ""
    )


def scores_table(scores: Mapping[str, Mapping[str, Any]]) -> str:
    """A Markdown table of all scores of a result: a row per score, detector beside model."""
    return markdown(*score_rows(scores))


def score_rows(scores: Mapping[str, Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of `scores_table`."""
    columns = [name for name in ("detector", "model") if name in scores]
    rows = [
        [label, *(score_text(scores[c][key]) for c in columns)] for key, label in _SCORES.items()
    ]
    delays = [scores[c]["delay"] for c in columns]
    rows.append(
        ["delay after a lane change, median (frames)"]
        + [score_text(d["median_frames"], 1) for d in delays]
    )
    rows.append(["lane changes missed", *(score_text(d["share_missed"]) for d in delays)])
    for key, label in (("accuracy", "accuracy"), ("f1", "F1 (mean)")):
        found = [scores[c]["intervals"][key] for c in columns]
        if all(found):
            rows.append(
                [f"{label}, 95 % interval", *(f"{low:.3f} .. {high:.3f}" for low, high in found)]
            )
    return ["score", *columns], rows


def runs_table(summaries: Sequence[Mapping[str, Any]]) -> str:
    """A Markdown table of several runs, each as `run.summary` gives it: a row per run."""
    return markdown(*runs_table_rows(summaries))


def runs_table_rows(summaries: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of `runs_table`."""
    header = ["run", "frames", "scored", "detector", "model", "F1", "log-loss", "parameters"]
    rows = []
    for found in summaries:
        detector, model = found.get("detector"), found.get("model")
        scores = [score_text(s["accuracy"]) if s else "" for s in (detector, model)]
        scores += [score_text(model[key]) if model else "" for key in ("f1", "log_loss")]
        frames = [str(found["frames"]), str(found["frames_scored"])]
        rows.append([found["name"], *frames, *scores, tuned_on_text(found) if model else ""])
    return header, rows


def tuned_on_text(found: Mapping[str, Any]) -> str:
    """How a narrow column says on which frames the parameters were tuned, and which parts look at
    later frames (`model.causality`)."""
    ahead = [part for part, is_causal in found["causal"].items() if not is_causal]
    return TUNED_ON_SHORT[found["tuned_on"]] + (
        f", not causal ({', '.join(ahead)})" if ahead else ""
    )


def confusion_table(matrix: Sequence[Sequence[int]], header: str = "predicted") -> str:
    """A Markdown table of a confusion matrix (n + 1, n) with its totals. Rows are the predicted
    lane, then Unassigned; columns are the actual lane."""
    n = len(matrix[0])
    names = [f"lane {k + 1}" for k in range(n)] + ["Unassigned"]
    rows = [[name, *map(str, row), str(sum(row))] for name, row in zip(names, matrix, strict=True)]
    support = [sum(row[k] for row in matrix) for k in range(n)]
    rows.append(["support", *map(str, support), str(sum(support))])
    return markdown([header, *(f"actual {k + 1}" for k in range(n)), "total"], rows)


def reproduction_rows(
    document: Mapping[str, Any], published: Mapping[int, Any]
) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the table of `egolane reproduce`: for each run and matrix our score, the
    published one and the difference.

    - document: as `paper.reproduce_json` makes it
    - published: the published values of each run (`paper.load_published`)
    """
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
    """The lines of one frame, in the form of the paper's Box `box:box1`: a row
    `Line1: isValid = 1; continuous=1; LRI: 10; offset: -9.15m` per line, with `--` for an unknown
    LRI or offset.

    Raises InputError, with the nearest frame, if the log lacks the frame.
    """
    if not len(log):
        raise InputError(f"{log.source}: has no frames")
    first, last = int(log.frame_id[0]), int(log.frame_id[-1])
    # Limited first, because the number may be too large for an array.
    within = min(max(frame_id, first), last)
    at = int(np.argmin(np.abs(log.frame_id - within)))
    if log.frame_id[at] != frame_id:
        raise InputError(
            f"{log.source}: has no frame {frame_id}; the nearest is {int(log.frame_id[at])}"
            f" (frames {first} to {last})"
        )
    offset, lri = log.offset_m[at], log.lri[at]
    valid, continuous = log.is_valid[at], log.is_continuous[at]
    # Slots without any value are padding.
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
