"""The text and the figure of predictive checks show their numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import egolane_pgm as ego
from egolane_pgm.views.checks import check_figure, check_text
from tests.kits.drives import run
from tests.kits.tiny_result import legend_labels

RESULT = run("quickstart", {"recording.frames": [0, 300]})
CALIBRATION = pd.DataFrame(
    {
        "node": ["A", "A", "A", "B"],
        "predicted": [0.1, 0.4, 0.8, 0.5],
        "comes": [0.2, 0.1, 0.1, 0.5],
        "count": [1000, 500, 10, 20],
    }
)


def test_the_text_fits_eighty_columns_and_names_the_worst_prediction(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    found = ego.check(RESULT, n=50)
    text = check_text(replace(RESULT, scores={"impossible_frames": 3}), found, CALIBRATION)
    assert max(map(len, text.splitlines())) <= 80
    assert "quickstart: does the model look like the data?" in text
    assert "ground truth: 240 lane changes per hour" in text
    assert "does not allow 3 frame(s)" in text
    row = found.loc["lane changes per hour"]
    cells = [f"{row[k]:.0f} [{row[f'{k}_low']:.0f}, {row[f'{k}_high']:.0f}]" for k in CELLS]
    assert all(cell in text for cell in cells)
    # The bin with 10 of 1,510 predictions is left out.
    assert "with 0.40 come in 0.10 of 500" in " ".join(text.split())


CELLS = ("posterior", "model")


def test_a_figure_has_each_statistic_and_each_bin() -> None:
    found = ego.check(RESULT, n=50)
    figure = check_figure(found, CALIBRATION, "a")
    *rows, right = figure.axes
    assert [ax.get_title() for ax in rows] == list(found.index)
    for ax, (_, row) in zip(rows, found.iterrows(), strict=True):
        marks = [line.get_xdata()[0] for line in ax.lines]
        assert marks == row[[*CELLS, "truth"]].dropna().tolist()
        ends = np.ravel([c.get_segments()[0][:, 0] for c in ax.collections])
        assert ends.tolist() == row[[f"{k}_{e}" for k in CELLS for e in ("low", "high")]].tolist()
    points = np.concatenate([each.get_offsets() for each in right.collections])
    assert points.tolist() == CALIBRATION[["predicted", "comes"]].to_numpy().tolist()
    assert right.collections[0].get_sizes().tolist() == [200, 105, 11.9]
    assert legend_labels(figure.subfigs[1].legends[0]) == ["A", "B"]
    alone = check_figure(found[:1], CALIBRATION[:0], "a")
    assert len(alone.axes) == 2
    [legend] = alone.subfigs[1].legends
    assert legend.get_title().get_text() == "no node is observed alone"
