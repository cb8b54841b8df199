"""The pages of results/graphs, of short drives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import egolane_pgm as ego
from makers import graphs


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_pages_of_short_drives_have_a_row_per_edge_and_per_graph(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def short(run: int) -> Any:
        changes = {"recording.frames": [0, 700], "recording.seed": run, "filter": "exact"}
        return ego.load_experiment("quickstart", changes)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(graphs, "experiment", short)
    monkeypatch.setattr(graphs, "CHECKED", ("autoregressive",))
    monkeypatch.setattr(graphs, "EDGES", ["Lane -> WOR", "SensorState -> WOR"])
    graphs.edges()
    graphs.checks()
    folder = tmp_path / "results" / "graphs"
    assert (folder / "edges.png").stat().st_size > 10_000
    text = (folder / "edges.md").read_text()
    assert text.count("| without SensorState -> WOR ") == 1
    assert text.count("| own best set ") == 2
    # Five recordings of a road are resampled together; the gain over all is the mean of both.
    row = text.split("| Lane -> WOR ")[1].splitlines()[0].split("|")
    italy, spain, both = (float(cell.split()[0]) for cell in row[2:5])
    assert both == pytest.approx((italy + spain) / 2, abs=0.001)
    assert (folder / "checks.md").read_text().count("| autoregressive, learned ") == 2
