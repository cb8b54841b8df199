"""Tables as text: a DataFrame as Markdown, LaTeX or CSV, in the width of the terminal."""

from __future__ import annotations

import re
import shutil
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from egolane_pgm.scoring.scores import SCORES

#: The words for `tuned_on` next to a score.
TUNED_ON = {
    "same_frames": "in-sample (tuned on these frames)",
    "same_drive": "in-sample (tuned on these frames of another detector)",
    "unknown": "unknown (it is not known which frames it was tuned on)",
    "other_frames": "held out (tuned on other frames of this drive)",
    "other_drive": "held out (tuned on another drive)",
    "not_tuned": "not tuned",
}

#: The same in a narrow column.
TUNED_ON_SHORT = {key: words.split(" (")[0] for key, words in TUNED_ON.items()}

#: The meaning of log evidence, printed next to it.
LOG_EVIDENCE = (
    "Log evidence and BIC judge how well a model describes the lines; on the paper's recordings"
    " they ranked models nearly opposite to held-out lanes."
)


class Table(NamedTuple):
    """A table of text, and its numbers for CSV."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    frame: pd.DataFrame = pd.DataFrame()


def table(frame: pd.DataFrame, digits: Mapping[Any, int | str] | None = None) -> Table:
    """Return a DataFrame as a table; the levels of its index name the rows.

    - digits: decimals (3 by default), or a format such as "+.3f", by column or row.

    A column `x` with columns `x_low` and `x_high` becomes one cell, `0.85 [0.81, 0.89]`. CSV keeps
    the three columns, with all digits.

    >>> import pandas as pd
    >>> scores = {"run": ["A", "B"], "f1": [0.85, 0.88], "f1_low": 0.8, "f1_high": 0.9}
    >>> print(page([table(pd.DataFrame(scores).set_index("run"))]))
    | run |                   f1 |
    | --- | -------------------: |
    | A   | 0.850 [0.800, 0.900] |
    | B   | 0.880 [0.800, 0.900] |
    """
    forms = digits or {}
    ends = {f"{name}_{end}" for name in frame for end in ("low", "high")}
    shown = [name for name in frame if name not in ends]
    rows = []
    for label, row in zip(frame.index, frame.to_dict("records"), strict=True):
        cells = [str(each) for each in (label if frame.index.nlevels > 1 else [label])]
        for name in shown:
            bounds = [row[f"{name}_{end}"] for end in ("low", "high") if f"{name}_low" in row]
            cells.append(with_interval(row[name], bounds, forms.get(label, forms.get(name, 3))))
        rows.append(cells)
    header = [*map(str, frame.index.names), *(str(name).replace("_", " ") for name in shown)]
    return Table(header, rows, frame)


def cell(value: Any, form: int | str = 3) -> str:
    """A value as text: a number with `form` decimals or in this format, a dash if missing."""
    if value is None or value is pd.NA or value != value:
        return "-"
    if isinstance(value, (float, np.floating)):
        text = format(value, f".{form}f" if isinstance(form, int) else form)
        # A rounded -0.0 has no sign.
        return text.replace("-", "+" if "+" in str(form) else "") if float(text) == 0 else text
    return str(value)


def percent(share: float) -> str:
    """Return a share in percent with one decimal, or no decimal for exactly 0 and 1."""
    value = 100 * float(share)
    if 0 < value < 0.05:
        return "<0.1"
    if 99.95 <= value < 100:
        return ">99.9"
    return f"{value:.0f}" if value in (0.0, 100.0) else f"{value:.1f}"


def with_interval(value: Any, interval: Sequence[Any] | None, form: int | str = 3) -> str:
    """A value and its interval, if it has one, e.g. "0.912 [0.905, 0.919]"; see `cell`."""
    if not interval or pd.isna(interval).any():
        return cell(value, form)
    return f"{cell(value, form)} [{', '.join(cell(end, form) for end in interval)}]"


# --- printing ------------------------------------------------------------------------------------

#: The styles of tables (`--format`).
STYLES = ("markdown", "wide", "latex", "csv")


def page(parts: Iterable[str | Table], style: str = "markdown") -> str:
    """The output of a command: text and tables, separated by empty lines.

    - style: one of STYLES: Markdown that fits the terminal or is as wide as its tables, LaTeX of
      the tables only, or CSV of the first table only.
    """
    shown = list(parts)
    tables = [part for part in shown if isinstance(part, Table)]
    if style == "csv":
        return str(tables[0].frame.to_csv(lineterminator="\n")).rstrip("\n") if tables else ""
    if style == "latex":
        return "\n\n".join(latex(each.header, each.rows) for each in tables)
    texts = [wrapped(p) if isinstance(p, str) else _fitted(p, style == "wide") for p in shown]
    return "\n\n".join(filter(None, texts))


def terminal_width() -> int:
    """Characters in a line of the terminal: COLUMNS, its width, or 80."""
    return max(40, shutil.get_terminal_size().columns)


def line_width() -> int:
    """The length of a line of text: the width of the terminal, at most 100."""
    return min(100, terminal_width())


def wrapped(text: str, hanging: int = 0) -> str:
    """Wrap text to `line_width`, keeping each line's indent; `hanging` indents broken lines."""
    lines = []
    for line in text.splitlines():
        indent = " " * (len(line) - len(line.lstrip()))
        look: Any = {"break_long_words": False, "break_on_hyphens": False}
        look |= {"initial_indent": indent, "subsequent_indent": indent + " " * hanging}
        lines.append(textwrap.fill(line.strip(), line_width(), **look))
    return "\n".join(lines)


def _fitted(found: Table, wide: bool) -> str:
    """A Markdown table; unless `wide`, columns that do not fit the terminal are named below it."""
    text = markdown(found.header, found.rows)
    borders = [place.end() for place in re.finditer(r"\|", text.splitlines()[1])]
    n = max(2, sum(border <= terminal_width() for border in borders) - 1)
    if wide or n >= len(found.header):
        return text
    missing = ", ".join(found.header[n:])
    text = markdown(found.header[:n], [row[:n] for row in found.rows])
    return f"{text}\n\n{wrapped(f'Not shown at this width: {missing}.')}"


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table, aligned for reading as plain text; the first column is aligned left."""
    padded = []
    for k, column in enumerate(zip(header, *rows, strict=True)):
        cells = [" ".join(str(each).split()) for each in column]
        # An underscore inside a word needs no escape.
        cells = [re.sub(r"[\\|<`]|(?<!\w)_|_(?!\w)", r"\\\g<0>", each) for each in cells]
        width = max(1, *map(len, cells))
        rule = "-" * width if k == 0 else "-" * (width - 1) + ":"
        cells.insert(1, rule)
        padded.append([each.rjust(width) if k else each.ljust(width) for each in cells])
    return "\n".join(f"| {' | '.join(row)} |" for row in zip(*padded, strict=True))


_LATEX = str.maketrans(
    {character: "\\" + character for character in "&%$#_{}"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
)


def latex(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A LaTeX tabular with booktabs rules."""
    head, *body = (
        " & ".join(str(c).translate(_LATEX) for c in cells) + r" \\" for cells in (header, *rows)
    )
    start = rf"\begin{{tabular}}{{l{'r' * (len(header) - 1)}}}"
    end = [r"\bottomrule", r"\end{tabular}"]
    return "\n".join([start, r"\toprule", head, r"\midrule", *body, *end])


# --- tables that several commands print ----------------------------------------------------------


def score_table(scores: Mapping[str, Mapping[str, Any]]) -> Table:
    """The scores of results: a row per score, with its 95 % interval; a column per result.

    - scores: of the model or the detector, as in scores.json, by the name of the column.
    """
    columns: dict[str, dict[str, Any]] = {}
    for name, found in scores.items():
        columns[name] = {each.label: found[key] for key, each in SCORES.items() if key in found}
        columns[name]["delay, median (frames)"] = found["delay"]["median_frames"]
        columns[name]["lane changes missed"] = found["delay"]["share_missed"]
        bounds = {SCORES[key].label: ends for key, ends in found["intervals"].items() if ends}
        for k, end in enumerate(("low", "high") if bounds else ()):
            columns[f"{name}_{end}"] = {label: ends[k] for label, ends in bounds.items()}
    title = "score [95 % interval]" if len(columns) > len(scores) else "score"
    frame = pd.DataFrame(columns, dtype=float).rename_axis(title)
    frame = frame.loc[[*next(iter(columns.values()))]]
    return table(frame, {"delay, median (frames)": 1})


def confusion_table(matrix: Sequence[Sequence[int]], header: str = "predicted") -> Table:
    """A confusion matrix (n + 1, n) with its totals: rows are predicted, columns true lanes."""
    counts = np.asarray(matrix)
    n = counts.shape[1]
    names = [*(f"lane {k + 1}" for k in range(n)), "Unassigned"]
    frame = pd.DataFrame(counts, index=names, columns=[f"actual {k + 1}" for k in range(n)])
    frame.loc["support"] = counts.sum(axis=0)
    return table(frame.assign(total=frame.sum(axis=1)).rename_axis(header))
