"""The reproduction and its commands on a stand-in for the paper: one simulated drive whose matrices
were made with parameters that only their truncated values are known of."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from egolane_pgm import compare
from egolane_pgm import paper as paper
from egolane_pgm.run import run_experiment
from egolane_pgm.tune import recover as recovering
from tests.kits.drives import command, done, short_drive, write_drive

#: What was "used", and what is "printed" of it.
USED = {
    "sigma1": 0.2026,
    "sigma2": 0.5618,
    "p1": 0.4282,
    "p2": 0.8772,
    "p3": 0.3673,
    "p4": 0.6301,
    "bonus_value": 1,
}
N_FRAMES = 400
PRINTED = {k: v if k == "bonus_value" else int(v * 1000) / 1000 for k, v in USED.items()}


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """published.yaml and the experiment of run 2, found where the paper's would be."""
    folder = tmp_path / "experiments" / "paper"
    yaml_file = write_drive(folder, N_FRAMES, parameters=USED, tuned_on="same_frames")
    truth = run_experiment(yaml_file)
    shutil.move(
        write_drive(folder, N_FRAMES, parameters=PRINTED, name="run02"), folder / "run02_x.yaml"
    )
    entry: dict[str, Any] = {"run": 2, "n_lanes": 3, "parameters": PRINTED}
    for ours, theirs in (("detector", "detector_only"), ("model", "model")):
        scores = truth.scores[ours]
        entry[theirs] = {
            "confusion": scores["confusion"],
            "metrics": {key: round(scores[key], 2) for key in paper.SCORES},
        }
    text = "runs:\n  - run: 2\n" + "".join(
        f"    {key}: {json.dumps(value)}\n" for key, value in entry.items() if key != "run"
    )
    (folder / "published.yaml").write_text(text)
    monkeypatch.setattr(paper, "experiments_folder", lambda: tmp_path / "experiments")
    return entry


def test_the_search_finds_what_truncation_took_away(stand_in: dict[str, Any]) -> None:
    before = paper.reproduce_run(2, "published")
    assert before.detector_frames_off == 0
    found = recovering.recover(2, evaluations=2000)
    assert found.frames_off == 0
    assert before.model_frames_off == 4
    for name, printed in PRINTED.items():
        assert printed <= found.parameters[name] < printed + recovering.TRUNCATION
    recovering.store_recovered(2, found, "found in a test")
    after = paper.reproduce_run(2, "recovered")
    assert after.model_frames_off == 0
    assert after.run.experiment.parameters == found.parameters
    assert after.run.scores["model"]["confusion"] == stand_in["model"]["confusion"]
    assert paper.reproduce_run(2, "published").model_frames_off == before.model_frames_off


def test_frames_off_are_counted_against_the_published_matrix(stand_in: dict[str, Any]) -> None:
    path = paper.published_path()
    content = yaml.safe_load(path.read_text())
    matrix = np.array(content["runs"][0]["model"]["confusion"])
    at = np.unravel_index(matrix.argmax(), matrix.shape)
    matrix[at] -= 5
    matrix[-1, at[1]] += 5
    content["runs"][0]["model"]["confusion"] = matrix.tolist()
    content["runs"][0]["parameters"] = USED
    path.write_text(yaml.safe_dump(content))
    result = paper.reproduce_run(2, "published")
    assert result.model_frames_off == 5
    assert result.detector_frames_off == 0
    found = recovering.recover(2, evaluations=1)
    assert (found.frames_off, found.evaluations) == (5, 1)


def test_the_commands_print_store_and_compare(stand_in: dict[str, Any], tmp_path: Path) -> None:
    found = tmp_path / "found.json"
    shown = done("recover", "--run", "2", "--evaluations", "300", "--write", "--json", found).stdout
    document = json.loads(found.read_text())
    assert document["frames_off"] == 0
    assert "written to" in shown
    assert yaml.safe_load(shown.splitlines()[1]) == document["parameters"]

    target = tmp_path / "all.json"
    words = ("--runs", "2", "--matrices", "--out", tmp_path / "kept", "--json", target)
    shown = done("reproduce", *words).stdout
    document = json.loads(target.read_text())
    assert document["total_frames_off"] == 0
    total = 2 * document["runs"][0]["frames_scored"]
    assert total == 2 * int((~short_drive(N_FRAMES).truth.is_crossing).sum())
    assert f"\n0 of {total} classified frames differ" in shown
    assert "| run 2, model" in shown
    assert (tmp_path / "kept" / "run02" / "run.json").is_file()
    latex = done("reproduce", "--runs", "2", "--format", "latex").stdout
    assert latex.startswith(r"\begin{tabular}")

    target = tmp_path / "graphs.json"
    shown = done("compare", "--runs", "2", "--json", target).stdout
    scores = json.loads(target.read_text())["runs"][0]["scores"]
    assert list(scores) == ["detector", "sensor_failure", "wor_on_lane", "no_wor", "lane_only"]
    for key in ("accuracy", "f1", "log_loss"):
        numbers = " | ".join(f"{score[key]:.3f}" for score in scores.values())
        cells = [c.strip() for line in shown.splitlines() for c in line.strip("|").split("|")]
        assert numbers in " | ".join(cells)
    # The same model twice, as long as p3 and p4 are the same in every lane.
    assert scores["wor_on_lane"] == scores["sensor_failure"]
    assert scores["lane_only"] != scores["sensor_failure"]


def test_a_graph_gets_those_of_the_papers_parameters_that_it_has(stand_in: dict[str, Any]) -> None:
    compared = compare.compare_graphs(2, ["lane_only"], "published")
    right = {k: PRINTED[k] for k in ("sigma1", "sigma2", "bonus_value")}
    experiment = paper.load_experiment(paper.paper_experiment(2)).model_copy(
        update={"graph": "lane_only", "parameters": right}
    )
    run = run_experiment(experiment)
    assert compared.scores["lane_only"]["confusion"] == run.scores["model"]["confusion"]
    assert compared.mean_log_evidence == {"lane_only": run.beliefs.mean_log_evidence}
    header, rows = compare.compare_rows([compared], "accuracy")
    assert header == ["run", "detector", "lane_only"]
    assert rows == [["2", *(f"{compared.scores[n]['accuracy']:.3f}" for n in header[1:])]]


def test_an_interrupted_command_says_so(
    stand_in: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*words: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(paper, "reproduce_run", interrupted)
    result = command("reproduce", "--runs", "2")
    assert result.exit_code == 130
    assert result.stderr == (
        "egolane: interrupted; nothing was left half-written; the same command begins anew\n"
    )
