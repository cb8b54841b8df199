"""A page that compares folders of results."""

from __future__ import annotations

from pathlib import Path

import egolane_pgm as ego
from makers.pages import RECORDINGS, compared


def test_a_page_has_the_means_and_a_row_for_each_recording(tmp_path: Path) -> None:
    for graph in ("sensor_failure", "no_wor"):
        for seed in (0, 1):
            changes = {"name": f"seed{seed}", "recording.seed": seed, "recording.frames": [0, 400]}
            ego.run("quickstart", graph=graph, overrides=changes, out=tmp_path / graph / "*")
    text = compared("# Title", [tmp_path / "sensor_failure", tmp_path / "no_wor"], detector=True)
    assert text.startswith("# Title\n\nrecordings per row: 2\n")
    assert text.count("| sensor_failure ") == 3
    assert "| name  | sensor failure | no wor | detector alone |" in text
    assert text.splitlines()[-1].startswith("| seed1 |")


def test_the_table_of_the_papers_recordings_is_that_of_its_experiments() -> None:
    from egolane_pgm.paper import paper_experiment
    from egolane_pgm.runs import table_inputs

    for run, given in enumerate(table_inputs("zero_label", RECORDINGS), start=1):
        ours, papers = given.experiment, ego.load_experiment(paper_experiment(run))
        for key in ("name", "recording", "ground_truth", "n_lanes", "fit"):
            assert getattr(ours, key) == getattr(papers, key), (run, key)
