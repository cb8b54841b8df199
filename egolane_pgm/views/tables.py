"""Tables as text: Markdown, LaTeX and CSV from the same cells, and the scores of a result in them.
What a command prints fits the terminal: `page` is the one place that decides how. `box_text` lists
the lines of one frame."""

from __future__ import annotations

import re
import shutil
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from egolane_pgm.tools.files import as_csv
from egolane_pgm.types import InputError, LineLog

#: The words for `tuned_on` next to a score.
TUNED_ON = {
    "same_frames": "in-sample (tuned on these frames)",
    "other_frames": "held out (tuned on other frames)",
    "not_tuned": "not tuned",
    "unknown": "unknown (tuned_on is not set)",
}

#: The same in a narrow column.
TUNED_ON_SHORT = {key: words.split(" (")[0] for key, words in TUNED_ON.items()}

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


class Table(NamedTuple):
    """A table of text.

    - header, rows: a cell of the header for each of a row
    - labels: how many columns at the left say what a row is about
    - leaves_out: whether the columns that do not fit are left out, and named below; else they
      follow in a further table
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    labels: int = 1
    leaves_out: bool = False


def page(parts: Iterable[str | Table], style: str = "markdown", wide: bool = False) -> str:
    """What a command prints, text and tables, with an empty line between them.

    - style: one of STYLES; as LaTeX there are tables only, and as CSV the first table only.
    - wide: whether tables of Markdown are printed whole; else none is wider than the terminal.
    """
    shown = list(parts)
    if style != "markdown":
        found = [part for part in shown if isinstance(part, Table)]
        drawn = [STYLES[style](part.header, part.rows) for part in found]
        return "".join(drawn[:1]).rstrip("\n") if style == "csv" else "\n\n".join(drawn)
    texts = [wrapped(p) if isinstance(p, str) else _drawn(p, wide) for p in shown]
    return "\n\n".join(filter(None, texts))


def terminal_width() -> int:
    """How many characters a line of the terminal has: COLUMNS, or what it says itself, or 80."""
    return max(40, shutil.get_terminal_size().columns)


def line_width() -> int:
    """How long a line of text is: no longer than the terminal, nor than is easy to read."""
    return min(100, terminal_width())


def wrapped(text: str, hanging: int = 0) -> str:
    """Text in lines that are no longer than `line_width`; what follows a break is indented as its
    line is, and `hanging` characters more."""
    lines = []
    for line in text.splitlines():
        indent = " " * (len(line) - len(line.lstrip()))
        lines.append(
            textwrap.fill(
                line.strip(),
                line_width(),
                initial_indent=indent,
                subsequent_indent=indent + " " * hanging,
                break_long_words=False,
                break_on_hyphens=False,
            )
        )
    return "\n".join(lines)


def _drawn(table: Table, wide: bool) -> str:
    """A table of Markdown; where it is to fit the terminal in pieces that do."""
    cells = [[_escaped(str(c)) for c in row] for row in (table.header, *table.rows)]
    if wide or not table.rows:
        return _lines(cells)
    room, n = terminal_width(), table.labels
    columns = [list(column) for column in zip(*cells, strict=True)]
    if 1 + sum(map(_width, columns)) <= room:
        return _lines(cells)
    # The labels leave room for one more column.
    for_labels = room - 1 - min(max(map(_width, columns[n:]), default=0), room // 2)
    if sum(map(_width, columns[:n])) > for_labels:
        columns[:n] = [_cut(column, for_labels // n - 3) for column in columns[:n]]
    start = used = 1 + sum(map(_width, columns[:n]))
    pieces = [columns[:n]]
    for column in (_cut(column, room - start - 3) for column in columns[n:]):
        if used > start and used + _width(column) > room:
            pieces.append(columns[:n])
            used = start
        pieces[-1].append(column)
        used += _width(column)
    drawn = [_lines(list(zip(*piece, strict=True))) for piece in pieces]
    rest = ", ".join(dict.fromkeys(column[0] for piece in pieces[1:] for column in piece[n:]))
    if table.leaves_out and rest:
        return drawn[0] + "\n\n" + wrapped(f"Wide tables add: {rest}.")
    return "\n\n".join(drawn)


def _width(column: Sequence[str]) -> int:
    """How much a column takes with what is between two."""
    return 3 + max(1, *map(len, column))


def _cut(column: Sequence[str], most: int) -> list[str]:
    return [cell if len(cell) <= most else cell[: most - 1] + "\u2026" for cell in column]


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table, aligned to be read as plain text; the first column is aligned left."""
    return _lines([[_escaped(str(c)) for c in row] for row in (header, *rows)])


def _escaped(text: str) -> str:
    """A cell in which Markdown sees nothing but text; an underscore inside a word is that."""
    return re.sub(r"[\\|<`]|(?<!\w)_|_(?!\w)", r"\\\g<0>", " ".join(text.split()))


def _lines(cells: Sequence[Sequence[str]]) -> str:
    """A Markdown table of cells that are escaped, the header first."""
    width = [max(1, *map(len, column)) for column in zip(*cells, strict=True)]

    def line(row: Sequence[str]) -> str:
        padded = [
            c.ljust(w) if k == 0 else c.rjust(w)
            for k, (c, w) in enumerate(zip(row, width, strict=True))
        ]
        return f"| {' | '.join(padded)} |"

    rule = ["-" * w if k == 0 else "-" * (w - 1) + ":" for k, w in enumerate(width)]
    return "\n".join([line(cells[0]), f"| {' | '.join(rule)} |", *map(line, cells[1:])])


_LATEX = str.maketrans(
    {character: "\\" + character for character in "&%$#_{}"}
    | {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "|": r"\textbar{}",
        "<": r"\textless{}",
        ">": r"\textgreater{}",
    }
)


def latex(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A LaTeX tabular with booktabs rules."""

    def line(cells: Sequence[str]) -> str:
        return " & ".join(str(c).translate(_LATEX) for c in cells) + r" \\"

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


#: What `with_interval` writes, and the star of parameters that are not held out.
_NUMBER = re.compile(r"([-+.\d]+)(?: \[([-+.\d]+), ([-+.\d]+)\])?(\*?)")


def tidy_csv(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Comma-separated values with one number in a cell: the bounds of an interval, and the star of
    what is not held out, have columns of their own; what is undefined is empty. A name that
    several columns have follows that of the column before them."""
    names = [
        name
        if header.count(name) == 1
        else next((f"{own} {name}" for own in header[k::-1] if header.count(own) == 1), name)
        for k, name in enumerate(header)
    ]
    tidy = []
    for name, cells in zip(names, zip(*rows, strict=True), strict=False):
        found = [_NUMBER.fullmatch(cell) or (None, cell, *[None] * 3) for cell in map(str, cells)]
        for k, more in enumerate(("", " low", " high", " in-sample"), start=1):
            column = ["" if each[k] in (None, "-") else each[k] for each in found]
            if k == 1 or any(column):
                tidy.append([name + more, *column])
    first, *others = zip(*tidy, strict=True) if tidy else [names]
    return as_csv(first, others)


#: The functions that write a table, by the names that `--format` has for them.
STYLES = {"markdown": markdown, "latex": latex, "csv": tidy_csv}


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


def score_rows(scores: Mapping[str, Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """All scores of a result: a row per score, with its 95 % interval; a column each for detector
    and model."""
    columns = [name for name in ("detector", "model") if name in scores]
    rows = [
        [label, *(with_interval(scores[c][key], scores[c]["intervals"].get(key)) for c in columns)]
        for key, label in _SCORES.items()
    ]
    delays = [scores[c]["delay"] for c in columns]
    rows.append(["delay, median (frames)"] + [score_text(d["median_frames"], 1) for d in delays])
    rows.append(["lane changes missed", *(score_text(d["share_missed"]) for d in delays)])
    has_intervals = any(scores[c]["intervals"]["accuracy"] for c in columns)
    return ["score [95 % interval]" if has_intervals else "score", *columns], rows


def runs_table_rows(summaries: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Several runs, each as `run.summary` gives it: a row per run."""
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
    later frames."""
    return f"{TUNED_ON_SHORT[found['tuned_on']]}, {causal_text(found)}".removesuffix(", causal")


def causal_text(found: Mapping[str, Any]) -> str:
    """Whether beliefs know the frames so far only, or what looks ahead (`model.causality`)."""
    ahead = [part for part, is_causal in found["causal"].items() if not is_causal]
    return f"not causal ({', '.join(ahead)})" if ahead else "causal"


def confusion_table(matrix: Sequence[Sequence[int]], header: str = "predicted") -> Table:
    """The table of a confusion matrix (n + 1, n) with its totals. Rows are the predicted
    lane, then Unassigned; columns are the actual lane."""
    n = len(matrix[0])
    names = [f"lane {k + 1}" for k in range(n)] + ["Unassigned"]
    rows = [[name, *map(str, row), str(sum(row))] for name, row in zip(names, matrix, strict=True)]
    support = [sum(row[k] for row in matrix) for k in range(n)]
    rows.append(["support", *map(str, support), str(sum(support))])
    return Table([header, *(f"actual {k + 1}" for k in range(n)), "total"], rows)


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
