"""A comparison's tables: header and rows of text from the document of `comparing.document`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from egolane_pgm.report.tables import number, seen

LEGEND = """\
Held out: each block of the drive is scored with parameters fitted without it, or with fixed ones
from another recording (which may be another detector's of the same drive); not tuned: no label was
used; in-sample: tuned on the frames that are scored; not causal: the filter or the evidence look at
later frames too, as a lane width from the whole recording does. Intervals: 95 %, block bootstrap;
those of differences (to the first experiment of the recording) are paired. Log evidence can be
compared only between experiments with the same evidence rule and parameters of it. us/frame:
processor time of evidence and filter. Parameters: numbers that were fitted to labels."""

HEALTH_LEGEND = """\
AUC: area under the ROC curve for "the detector alone is wrong in this frame", over non-crossing
frames in which it commits to a lane; doubt: 1 - P(the detector's lane), P(BAD): the belief that
SensorState is BAD. Unassigned: the detector's own silence as the score, over all non-crossing
frames, in which it is no surprise."""


def trusted_or_all(part: Mapping[str, Any]) -> Any:
    """What a document says per subset, without the frames of untrusted labels where there are
    such."""
    return part.get("without_never_fit", part["all_frames"])


def experiment_names(document: Mapping[str, Any]) -> list[str]:
    """The experiments of all recordings, in the order in which they first occur."""
    entries = [e for recording in document["recordings"] for e in recording["experiments"]]
    return list(dict.fromkeys(entry["name"] for entry in entries))


def accuracy_rows(
    document: Mapping[str, Any], subset: str | None = None
) -> tuple[list[str], list[list[str]]]:
    """A row per recording, a column per experiment: accuracy [interval]. subset: None for the
    frames whose labels can be trusted."""
    names = experiment_names(document)
    rows = []
    for recording in document["recordings"]:
        found = {e["name"]: e for e in recording["experiments"]}
        cells = []
        for name in names:
            if name not in found:
                cells.append("")
                continue
            scores = found[name]["scores"]
            chosen = trusted_or_all(scores) if subset is None else scores[subset]
            cells.append(_with_interval(chosen, "accuracy") + _mark(found[name]))
        rows.append([recording["title"], *cells])
    return ["accuracy", *names], rows


def has_untrusted(document: Mapping[str, Any]) -> bool:
    """Whether some frames' labels are not trusted."""
    return any(
        "without_never_fit" in entry["scores"]
        for recording in document["recordings"]
        for entry in recording["experiments"]
    )


def full_rows(document: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """A row per recording, experiment and subset of frames: every score."""
    header = [
        "recording", "experiment", "frames", "parameters from", "accuracy", "F1", "log-loss",
        "Brier", "calibration error", "false switches/min", "delay median", "delay p90", "missed",
        "coverage", "log evidence", "us/frame", "parameters", "accuracy diff", "F1 diff",
        "log-loss diff",
    ]  # fmt: skip
    rows = []
    for recording in document["recordings"]:
        for entry in recording["experiments"]:
            for subset, scores in entry["scores"].items():
                rows.append([recording["title"], *_cells(entry, subset, scores)])
    return header, rows


def _cells(entry: Mapping[str, Any], subset: str, scores: Mapping[str, Any]) -> list[str]:
    delay = scores["delay"]
    difference = (entry["difference"] or {}).get(subset) or {}
    return [
        entry["name"],
        "all" if subset == "all_frames" else "trusted",
        seen(entry),
        _with_interval(scores, "accuracy", 4),
        _with_interval(scores, "f1", 4),
        number(scores["log_loss"]),
        number(scores["brier"]),
        number(scores["expected_calibration_error"]),
        number(scores["false_switches_per_minute"], 2),
        number(delay["median_frames"], 1),
        number(delay["p90_frames"], 1),
        number(delay["share_missed"]),
        number(scores["coverage"]),
        number(scores["mean_log_evidence"]),
        number(entry["microseconds_per_frame"], 1),
        str(entry["free_parameters"]),
        *(_difference(difference.get(key)) for key in ("accuracy", "f1", "log_loss")),
    ]


def chosen_rows(document: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """A row per recording and experiment with `fit: choose`, a column per block: what was chosen
    without it."""
    n_blocks = document["blocks"]
    rows = []
    for recording in document["recordings"]:
        for entry in recording["experiments"]:
            cells = [
                ", ".join(f"{name} {_short(found[name])}" for name in entry["chosen"])
                for found in entry["parameters"]
            ]
            if entry["chosen"]:
                rows.append([recording["title"], entry["name"], *cells])
    return ["chosen", "experiment", *(f"block {b + 1}" for b in range(n_blocks))], rows


def _short(value: Any) -> str:
    return f"{value:g}" if isinstance(value, (int, float)) else str(value)


def health_rows(document: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """A row per recording: areas under the ROC curve for "the detector alone is wrong", over the
    frames whose labels can be trusted."""
    names = experiment_names(document)
    header = ["AUC", "committed", "wrong", "Unassigned (all frames)"]
    header += [f"{name}: {what}" for name in names for what in ("doubt", "P(BAD)")]
    rows = []
    for recording in document["recordings"]:
        detector = trusted_or_all(recording["health"])
        found = {e["name"]: trusted_or_all(e["health"]) for e in recording["experiments"]}
        row = [recording["title"], str(detector["committed"]), str(detector["wrong"])]
        row.append(_auc(detector["auc_unassigned"]))
        for name in names:
            mine = found.get(name, {})
            row += [_auc(mine.get("auc_doubt")), _auc(mine.get("auc_bad"))]
        rows.append(row)
    return header, rows


def _auc(value: float | None) -> str:
    return "-" if value is None or value != value else f"{value:.4f}"


def _mark(entry: Mapping[str, Any]) -> str:
    """A star where the parameters were tuned on the frames that are scored."""
    return "*" if entry["tuned_on"] in ("same_frames", "unknown") else ""


def _with_interval(scores: Mapping[str, Any], key: str, digits: int = 3) -> str:
    interval: Sequence[float] | None = scores["intervals"][key]
    shown = f"{scores[key]:.{digits}f}"
    if interval is None:
        return shown
    return f"{shown} [{interval[0]:.{digits}f}, {interval[1]:.{digits}f}]"


def _difference(found: Sequence[float] | None) -> str:
    if found is None:
        return "-"
    estimate, low, high = found
    return f"{estimate:+.3f} [{low:+.3f}, {high:+.3f}]"
