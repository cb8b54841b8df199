"""Tables as text."""

from __future__ import annotations

import csv
import io

import pandas as pd
import pytest

from egolane_pgm.scoring import score_all
from egolane_pgm.types import lane_truth
from egolane_pgm.views import tables
from egolane_pgm.views.tables import Table, page, table

FRAME = pd.DataFrame(
    {"run": ["1", "two"], "f_1": [0.5, None], "f_1_low": [0.25, None], "f_1_high": [0.75, None]}
).set_index("run")


def test_a_column_with_bounds_is_one_cell_and_csv_keeps_the_three() -> None:
    found = table(FRAME.assign(delay=[-0.01, 2.0], note="x"), {"delay": "+.1f"})
    assert page([found]).splitlines() == [
        "| run |                  f 1 | delay | note |",
        "| --- | -------------------: | ----: | ---: |",
        "| 1   | 0.500 [0.250, 0.750] |  +0.0 |    x |",
        "| two |                    - |  +2.0 |    x |",
    ]
    assert page([found, found], "csv").splitlines() == [
        "run,f_1,f_1_low,f_1_high,delay,note",
        "1,0.5,0.25,0.75,-0.01,x",
        "two,,,,2.0,x",
    ]
    assert page(["text", found], "latex").splitlines()[:4] == [
        r"\begin{tabular}{lrrr}",
        r"\toprule",
        r"run & f 1 & delay & note \\",
        r"\midrule",
    ]


def test_names_are_text_in_every_format() -> None:
    name = r"a|b\c_d & <i> _e_"
    assert tables.markdown([name], [["x"]]).splitlines()[0] == r"| a\|b\\c_d & \<i> \_e\_ |"
    shown = tables.latex([name], [["x"]])
    assert r"a|b\textbackslash{}c\_d \& <i> \_e\_" in shown
    frame = pd.DataFrame({name: ["x"]})
    assert next(csv.reader(io.StringIO(page([table(frame)], "csv"))))[1] == name


def test_columns_that_do_not_fit_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    header = ["run", *(f"long column {k}" for k in range(4))]
    long = Table(header, [["a", "1", "2", "3", "4"]])
    assert page([long]).splitlines() == [
        "| run | long column 0 | long column 1 |",
        "| --- | ------------: | ------------: |",
        "| a   |             1 |             2 |",
        "",
        "Not shown at this width: long column 2,",
        "long column 3.",
    ]
    assert page(["and text " * 7]).splitlines() == [
        "and text and text and text and text and",
        "text and text and text",
    ]
    assert page([long], style="wide") == tables.markdown(*long[:2])


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
        found = score_all(belief, lane_truth([1, 2, 3, 4], truth, [False] * 4), 10.0)
        return {**found, "intervals": {"accuracy": None, "f1": None}, **changes}

    right, wrong = scores([1, 1, 2, 2]), scores([2, 2, 1, 1])
    shown = tables.score_table({"detector": wrong, "model": right})
    assert shown.header == ["score", "detector", "model"]  # too short a drive for intervals
    assert shown.rows[0] == ["accuracy", "0.000", "1.000"]
    intervals = {"accuracy": [0.5, 1.0], "f1": [0.25, 1.0]}
    shown = tables.score_table({"model": {**right, "brier": None, "intervals": intervals}})
    assert shown.header == ["score [95 % interval]", "model"]
    assert ["Brier score", "-"] in shown.rows
    assert ["F1 (mean)", "1.000 [0.250, 1.000]"] in shown.rows
