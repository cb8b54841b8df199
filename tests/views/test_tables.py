"""Tables as text."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.scoring.summary import score_all
from egolane_pgm.types import InputError
from egolane_pgm.views import tables
from egolane_pgm.views.tables import box_text
from tests.kits.box import BOX, box_log
from tests.kits.drives import short_drive

HEADER = ["run", "score & co_1"]
ROWS = [["1", "50%"], ["two", "#{x}"]]


def test_a_markdown_table_is_aligned_first_column_left_the_others_right() -> None:
    assert tables.markdown(HEADER, ROWS).splitlines() == [
        "| run | score & co_1 |",
        "| --- | -----------: |",
        "| 1   |          50% |",
        "| two |         #{x} |",
    ]


def test_a_latex_table_escapes_what_latex_would_take() -> None:
    assert tables.latex(HEADER, ROWS).splitlines() == [
        r"\begin{tabular}{lr}",
        r"\toprule",
        r"run & score \& co\_1 \\",
        r"\midrule",
        r"1 & 50\% \\",
        r"two & \#\{x\} \\",
        r"\bottomrule",
        r"\end{tabular}",
    ]


def test_names_are_text_in_every_format() -> None:
    name = r"a|b\c_d & <i> _e_"
    assert tables.markdown([name], [["x"]]).splitlines()[0] == r"| a\|b\\c_d & \<i> \_e\_ |"
    shown = tables.latex([name], [["x"]])
    assert r"a\textbar{}b\textbackslash{}c\_d \& \textless{}i\textgreater{} \_e\_" in shown
    assert next(csv.reader(io.StringIO(tables.tidy_csv([name], [["x"]])))) == [name]


def test_csv_has_one_number_in_a_cell_and_one_column_of_a_name() -> None:
    header = ["run", "accuracy", "diff", "F1", "diff"]
    rows = [
        ["1", "0.852 [0.813, 0.892]*", "-", "-0.1", "+0.001 [-0.010, +0.020]"],
        ["2", "0.9", "not causal", "-", "-"],
    ]
    text = tables.tidy_csv(header, rows)
    assert next(csv.DictReader(io.StringIO(text))) == {
        "run": "1",
        "accuracy": "0.852",
        "accuracy low": "0.813",
        "accuracy high": "0.892",
        "accuracy in-sample": "*",
        "accuracy diff": "",
        "F1": "-0.1",
        "F1 diff": "+0.001",
        "F1 diff low": "-0.010",
        "F1 diff high": "+0.020",
    }
    assert text.splitlines()[2] == "2,0.9,,,,not causal,,,,"
    assert tables.tidy_csv(header, []).count("\n") == 1


words = st.text("ab_| \\", max_size=30)


@settings(max_examples=40)
@given(st.data(), st.integers(1, 3), st.sampled_from([60, 80, 120]), st.booleans())
def test_a_printed_table_is_never_wider_than_the_terminal(
    data: st.DataObject, labels: int, width: int, leaves_out: bool
) -> None:
    row = st.lists(words, min_size=labels + 8, max_size=labels + 8)
    header, *rows = data.draw(st.lists(row, min_size=2, max_size=4))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", str(width))
        shown = tables.page([tables.Table(header, rows, labels, leaves_out)])
    assert max(map(len, shown.splitlines())) <= width


def test_a_table_goes_on_below_or_says_what_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    header = ["run", *(f"long column {k}" for k in range(4))]
    table = tables.Table(header, [["a", "1", "2", "3", "4"]])
    assert tables.page([table]).splitlines() == [
        "| run | long column 0 | long column 1 |",
        "| --- | ------------: | ------------: |",
        "| a   |             1 |             2 |",
        "",
        "| run | long column 2 | long column 3 |",
        "| --- | ------------: | ------------: |",
        "| a   |             3 |             4 |",
    ]
    said = tables.page([table._replace(leaves_out=True), "and text " * 7]).splitlines()
    assert said[4:] == [
        "Wide tables add: long column 2, long",
        "column 3.",
        "",
        "and text and text and text and text and",
        "text and text and text",
    ]
    assert tables.page([table], wide=True) == tables.markdown(*table[:2])


cells = st.text(st.characters(codec="utf-8", exclude_characters="\r\0"), max_size=8)


@given(st.lists(st.lists(cells, min_size=2, max_size=2), max_size=4))
def test_csv_is_read_back_as_it_was(rows: list[list[str]]) -> None:
    text = tables.as_csv(HEADER, rows)
    assert list(csv.reader(io.StringIO(text, newline=""))) == [HEADER, *rows]


def test_a_confusion_table_has_the_totals() -> None:
    shown = tables.confusion_table([[5, 1], [0, 7], [2, 3]], "model")
    assert shown.header == ["model", "actual 1", "actual 2", "total"]
    assert shown.rows == [
        ["lane 1", "5", "1", "6"],
        ["lane 2", "0", "7", "7"],
        ["Unassigned", "2", "3", "5"],
        ["support", "7", "11", "18"],
    ]


def test_the_scores_of_detector_and_model_stand_side_by_side() -> None:
    belief = [[0.9, 0.1], [0.8, 0.2], [0.1, 0.9], [0.1, 0.9]]

    def scores(truth: list[int], **changes: object) -> dict[str, object]:
        found = score_all(belief, truth, [False] * 4, [1, 2, 3, 4], 10.0)
        return {**found, "intervals": {"accuracy": None, "f1": None}, **changes}

    right, wrong = scores([1, 1, 2, 2]), scores([2, 2, 1, 1])
    header, rows = tables.score_rows({"detector": wrong, "model": right})
    assert header == ["score", "detector", "model"]  # too short a drive for intervals
    assert rows[0] == ["accuracy", "0.000", "1.000"]
    intervals = {"accuracy": [0.5, 1.0], "f1": [0.25, 1.0]}
    header, rows = tables.score_rows({"model": {**right, "brier": None, "intervals": intervals}})
    assert header == ["score [95 % interval]", "model"]
    assert ["Brier score", "-"] in rows
    assert ["F1 (mean)", "1.000 [0.250, 1.000]"] in rows


def test_the_reproduction_table_shows_ours_theirs_and_the_difference() -> None:
    ours = {"accuracy": 0.8584, "precision": 1, "recall": 0.5, "f1": 0.25, "log_loss": 1.2599}
    theirs = {"accuracy": 0.85, "precision": 1, "recall": 0.51, "f1": 0.25, "log_loss": 1.25}
    entry = {"run": 7, "detector_frames_off": 0, "model_frames_off": 12}
    document = {"runs": [{**entry, "detector": ours, "model": ours}]}
    published = {7: {"detector_only": {"metrics": theirs}, "model": {"metrics": theirs}}}
    header, rows = tables.reproduction_rows(document, published)
    assert [len(r) for r in rows] == [len(header)] * 2
    assert [r[:3] for r in rows] == [["7", "detector", "0"], ["7", "model", "12"]]
    at = header.index("accuracy")
    assert rows[1][at : at + 3] == ["0.8584", "0.85", "+0.0084"]
    at = header.index("recall")
    assert rows[1][at : at + 3] == ["0.5000", "0.51", "-0.0100"]


def test_the_nearest_frame_is_named_in_a_gap() -> None:
    log = short_drive(30).log.take(np.array([0, 1, 9, 10]))
    with pytest.raises(InputError, match=f"the nearest is {int(log.frame_id[2])} "):
        box_text(log, int(log.frame_id[2]) - 1)
    assert box_text(log, int(log.frame_id[2])).startswith("Line1: ")


def test_the_papers_box_is_printed_as_in_the_paper() -> None:
    assert box_text(box_log(), 1234) == BOX
    assert box_text(box_log(), 1236) == "no lines"
    unknown = box_text(box_log(), 1237).splitlines()
    assert unknown == [
        "Line1: isValid = 0; continuous=0; LRI: 03; offset: --",
        "Line2: isValid = 1; continuous=0; LRI: --; offset: +1.50m",
    ]
