"""The tables of a comparison: header and rows of text, from the document of
`comparing.groups.document`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from egolane_pgm.views.tables import TUNED_ON_SHORT, Table, causal_text, score_text, with_interval

LEGEND = """\
Held out: each block of the drive is scored with parameters fitted without it, or with fixed ones
from another recording (which may be another detector's of the same drive); not tuned: no label was
used; in-sample: tuned on the frames that are scored; not causal: the filter or the evidence look at
later frames too, as a lane width from the whole recording does. Intervals: 95 %, block bootstrap;
those of differences (to the first experiment of the recording) are paired. Log evidence can be
compared only between experiments with the same evidence rule and parameters of it. us/frame:
processor time of evidence and filter. Parameters: numbers that were fitted to labels. Trials: of
the search without one block."""

TOGETHER_LEGEND = """\
All recordings: plain means over them. Recordings of one drive by several detectors are not
independent: their frames are resampled together, each drive by itself."""

#: The scores that are compared, and how a table calls them.
_COMPARED = {"accuracy": "accuracy", "f1": "F1", "log_loss": "log-loss"}


def trusted_or_all(part: Mapping[str, Any]) -> Any:
    """Of a part of a document that is given for several subsets of frames, the one without the
    frames of untrusted labels, if there is one."""
    return part.get("without_never_fit", part["all_frames"])


def entries_of(document: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """Each experiment on each recording: the recording's title, and its part of the document."""
    recordings = document["recordings"]
    return [(str(each["title"]), entry) for each in recordings for entry in each["experiments"]]


def experiment_names(document: Mapping[str, Any]) -> list[str]:
    """The names of the experiments of all recordings, in order of their first occurrence."""
    return list(dict.fromkeys(entry["name"] for _, entry in entries_of(document)))


def accuracy_rows(
    document: Mapping[str, Any], subset: str | None = None
) -> tuple[list[str], list[list[str]]]:
    """Accuracies with their intervals: a row per recording, a column per experiment.

    subset: the frames that are scored; None for those whose labels can be trusted.
    """
    names = experiment_names(document)
    rows = []
    for recording in document["recordings"]:
        cells = dict.fromkeys(names, "")
        for entry in recording["experiments"]:
            scores = trusted_or_all(entry["scores"]) if subset is None else entry["scores"][subset]
            cells[entry["name"]] = _score(scores, "accuracy", 3) + _mark(entry)
        rows.append([recording["title"], *cells.values()])
    return ["accuracy", *names], rows


def marks_text(document: Mapping[str, Any]) -> str:
    """The lines below a table of accuracies: what a star means, and which experiments look at later
    frames, and by what."""
    entries = [entry for _, entry in entries_of(document)]
    lines = ["* in-sample, or not known to be held out"] if any(map(_mark, entries)) else []
    names: dict[str, dict[str, None]] = {}
    for entry in entries:
        if "causal" in entry:
            names.setdefault(causal_text(entry), {})[entry["name"]] = None
    return "\n".join([*lines, *(f"{text}: {', '.join(names[text])}" for text in sorted(names))])


def has_untrusted(document: Mapping[str, Any]) -> bool:
    """Whether the labels of some frames are not trusted."""
    return any("without_never_fit" in entry["scores"] for _, entry in entries_of(document))


def full_rows(document: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """All scores: a row per recording, experiment and subset of frames."""
    header = [
        "recording", "experiment", "frames", "accuracy", "F1", "log-loss", "parameters from",
        "causality", "Brier", "calibration error", "false switches/min", "delay median",
        "delay p90", "missed", "coverage", "log evidence", "us/frame", "parameters",
        "accuracy diff", "F1 diff", "log-loss diff", "fixed", "trials",
    ]  # fmt: skip
    return header, [
        [title, *_cells(entry, subset, scores)]
        for title, entry in entries_of(document)
        for subset, scores in entry["scores"].items()
    ]


def full_tables(document: Mapping[str, Any]) -> list[Table]:
    """The scores that some experiment has, to be read as plain text: for several recordings a row
    each, as in `full_rows`; for one a column per experiment, the frames whose labels can be trusted
    first."""
    header, rows = full_rows(document)
    if len(document["recordings"]) > 1:
        kept = _filled(rows)
        cells = [[row[k] for k in kept] for row in rows]
        return [Table([header[k] for k in kept], cells, labels=3, leaves_out=True)]
    tables = []
    for subset in sorted({row[2] for row in rows}, reverse=True):
        of_subset = [row for row in rows if row[2] == subset]
        title = of_subset[0][0] + f", {subset} frames" * has_untrusted(document)
        kept = [k for k in _filled(of_subset) if k > 2]
        lines = [[header[k], *(row[k] for row in of_subset)] for k in kept]
        tables.append(Table([title, *(row[1] for row in of_subset)], lines))
    return tables


def _filled(rows: Sequence[Sequence[str]]) -> list[int]:
    """The columns with a value in some row."""
    return [k for k, cells in enumerate(zip(*rows, strict=True)) if any(c != "-" for c in cells)]


def _cells(entry: Mapping[str, Any], subset: str, scores: Mapping[str, Any]) -> list[str]:
    delay = scores["delay"]
    difference = (entry["difference"] or {}).get(subset) or {}
    return [
        entry["name"],
        "all" if subset == "all_frames" else "trusted",
        _score(scores, "accuracy", 4),
        _score(scores, "f1", 4),
        score_text(scores["log_loss"]),
        TUNED_ON_SHORT[entry["tuned_on"]],
        causal_text(entry),
        score_text(scores["brier"]),
        score_text(scores["expected_calibration_error"]),
        score_text(scores["false_switches_per_minute"], 2),
        score_text(delay["median_frames"], 1),
        score_text(delay["p90_frames"], 1),
        score_text(delay["share_missed"]),
        score_text(scores["coverage"]),
        score_text(scores["mean_log_evidence"]),
        score_text(entry["microseconds_per_frame"], 1),
        score_text(entry["free_parameters"], 0),
        *(_bounds_text(difference.get(key), "+.3f") for key in _COMPARED),
        *(score_text(entry[key], 0) for key in ("fixed_parameters", "trials")),
    ]


def search_rows(document: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """What was searched: a row for each experiment that was, the least and the most where it is not
    the same on all recordings."""
    rows = []
    for name in experiment_names(document):
        searches = [e for _, e in entries_of(document) if e["name"] == name and e["trials"]]
        keys = ("free_parameters", "fixed_parameters", "trials")
        numbers = [[e[key] for e in searches] for key in keys]
        if searches:
            rows.append([name, *("-".join(map(str, sorted({min(n), max(n)}))) for n in numbers)])
    return ["search", "numbers searched", "held fixed", "trials"], rows


def together_tables(document: Mapping[str, Any]) -> list[tuple[list[str], list[list[str]]]]:
    """All recordings together: a table for each score, a row per experiment. Empty where there is
    nothing to take together."""
    means = document["together"]
    tables = []
    for key, title in _COMPARED.items() if means else ():
        header = [f"all {means[0]['recordings']} recordings", title, f"to {means[0]['name']}"]
        rows = [
            [
                each["name"],
                _bounds_text(each["scores"][key]),
                _bounds_text((each["difference"] or {}).get(key), "+.3f"),
            ]
            for each in means
        ]
        tables.append((header, rows))
    return tables


def _mark(entry: Mapping[str, Any]) -> str:
    """A star if the parameters were tuned on the frames that are scored, or if that is unknown."""
    return "*" if entry["tuned_on"] in ("same_frames", "unknown") else ""


def _score(scores: Mapping[str, Any], key: str, digits: int) -> str:
    return with_interval(scores[key], scores["intervals"][key], f".{digits}f")


def _bounds_text(bounds: Sequence[float] | None, form: str = ".3f") -> str:
    """A score from [estimate, low, high]; a dash for a short drive."""
    return "-" if bounds is None else with_interval(bounds[0], bounds[1:], form)
