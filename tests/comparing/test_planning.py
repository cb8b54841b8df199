"""Which experiments are compared on which recording, and what cannot be compared."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from egolane_pgm import paper as paper
from egolane_pgm.comparing.document import folder_of
from egolane_pgm.comparing.placing import on_recording, recording_key
from egolane_pgm.comparing.planning import by_recording, planned
from egolane_pgm.drive import load_recording
from egolane_pgm.experiment import Experiment, load_experiment, resolved
from egolane_pgm.model import prepare_model
from egolane_pgm.plugins import plugin_names
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.types import InputError
from tests.conftest import needs_compiler
from tests.kits.drives import (
    done,
    geometry,
    refused,
    rewritten,
    short_drive,
    simulated,
    write_drive,
)
from tests.kits.labelled_drive import N_LABELLED

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*no frame to learn from:UserWarning"),
    needs_compiler,
]

N_FRAMES = 700


def test_experiments_are_grouped_by_recording() -> None:
    other = {"simulate": "quickstart", "seed": 7}
    groups = by_recording(
        [simulated("a"), simulated("b", recording=other), simulated("c", graph="no_wor")]
    )
    assert [[e.name for e in g.experiments] for g in groups] == [["a", "c"], ["b"]]
    assert groups[0].title != groups[1].title
    with pytest.raises(InputError, match="two experiments have the name a"):
        by_recording([simulated("a"), simulated("a", graph="no_wor")])


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run 2 of a paper whose recording is a simulated one, three lanes."""
    folder = tmp_path / "experiments" / "paper"
    own = write_drive(
        folder, N_FRAMES, tuned_on="same_frames", tuning={"never_fit": {"from_frame": 650}}
    )
    own.rename(folder / "run02_x.yaml")
    (folder / "published.yaml").write_text(
        "runs: [{run: 2, recovered: {parameters: {p1: 0.9, p2: 0.8}}}]\n"
    )
    monkeypatch.setattr(paper, "experiments_folder", lambda: tmp_path / "experiments")
    return folder


def test_a_model_is_put_on_the_recording_of_a_run(runs: Path) -> None:
    model = simulated("model", n_lanes=4, tuned_on="same_frames", graph="lane_only")
    (group,) = planned([model], numbers=[2])
    (placed,) = group.experiments
    assert (placed.graph, placed.n_lanes) == ("lane_only", 3)
    assert placed.tuned_on == "other_frames"
    assert placed.tuning is not None
    assert placed.tuning.never_fit == ((650, None),)
    assert len(load_recording(placed).log) == len(short_drive(N_FRAMES).log)
    own = load_experiment(runs / "run02_x.yaml")
    assert on_recording(own, own).tuned_on == "same_frames"
    (graphs,) = planned([], graphs=["lane_only"], numbers=[2])
    assert graphs.experiments[0].parameters == {}


def test_a_frame_rate_that_nobody_gave_is_left_to_the_recording() -> None:
    """A video tells its own."""
    place = {"simulate": "quickstart"}
    for given in ({}, {"frame_rate": 20.0}):
        placed = on_recording(simulated(), simulated("place", recording={**place, **given}))
        assert ("frame_rate" in placed.recording.model_fields_set) == bool(given)
    assert placed.recording.frame_rate == 20


def test_the_same_road_taken_for_another_number_of_lanes_is_another_recording(
    tmp_path: Path,
) -> None:
    three = load_experiment(write_drive(tmp_path, 60))
    assert recording_key(three) != recording_key(three.model_copy(update={"n_lanes": 4}))
    assert recording_key(three) == recording_key(three.model_copy(update={"name": "other"}))


def test_every_graph_gets_an_evidence_rule_that_fits_it(runs: Path) -> None:
    graphs = plugin_names("graphs")
    (group,) = planned((), graphs=graphs, numbers=[2], overrides={"fit": "tune"})
    assert [e.name for e in group.experiments] == graphs
    for experiment in group.experiments:
        assert experiment.fit == "tune"
        assert prepare_model(experiment).n_lanes == 3
    found = {e.graph: e.evidence for e in group.experiments}
    assert found["sensor_failure"] == "counting"
    assert found["wor_levels"] == "counting_levels"
    assert found["position_in_lane"] == "line_geometry"


def write(path: Path, experiment: Experiment) -> Path:
    content = experiment.model_dump(mode="json", exclude_defaults=True)
    path.write_text(yaml.safe_dump(content))
    return path


GRAPH = """
from egolane_pgm.graphs.lane_only import HIDDEN, OBSERVED, UNUSED, build
from egolane_pgm.parameters import Parameter

PARAMETERS = (
    Parameter("sigma1", "sigma", 0.4, "standard deviation of the lane dynamics, lanes"),
    Parameter("sigma2", "sigma", 0.5, "standard deviation of the detector output, lanes"),
    Parameter("normal", "choice", "density", "how F is made", choices=("density",)),
    Parameter("lane_widths", "positive", 1.0, "widths", search=None),
)
"""


def _entries(target: Path) -> list[list[tuple[str, str, int, str]]]:
    """Per recording name, graph, numbers fitted and fit of each experiment."""
    keys = ("name", "graph", "free_parameters", "fit")
    recordings = json.loads(target.read_text())["recordings"]
    return [[tuple(e[k] for k in keys) for e in r["experiments"]] for r in recordings]


def test_a_graph_is_found_from_where_one_stands(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And is searched as the package's are, without saying so."""
    for folder in ("mine", "theirs"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "worn.py").write_text(GRAPH)
    experiment = write_drive(tmp_path / "elsewhere", tuned_on="not_tuned")
    monkeypatch.chdir(tmp_path / "mine")
    target = tmp_path / "found.json"
    few = ("--set", "fit=tune", "--set", "tuning.trials=2", "--blocks", 2, "--json", target)
    done("compare", "--graphs", "lane_only,./worn.py,../theirs/worn.py", "--runs", 2, *few)
    expected = [("lane_only", "lane_only", 3, "tune")]
    assert _entries(target) == [
        [*expected, ("mine_worn", "worn.py", 3, "tune"), ("theirs_worn", "worn.py", 3, "tune")]
    ]
    other = write_drive(tmp_path / "other", name="other")
    done("compare", experiment, other, "--graphs", "lane_only,worn.py", *few)
    assert _entries(target) == [[*expected, ("worn", "worn.py", 3, "tune")]] * 2
    again = rewritten(experiment, tmp_path / "elsewhere" / "again.yaml", name="again")
    words = (experiment, again, "--graphs", "worn.py,lane_only")
    done("compare", *words, "--set", "unassigned_below=0.3", "--json", target)
    (found,) = _entries(target)
    names = ["drive_worn", "drive_lane_only", "again_worn", "again_lane_only"]
    assert [name for name, *_ in found] == names
    assert {fit for *_, fit in found} == {"none"}
    done("compare", experiment, "--graphs", "worn.py", "--runs", 2, "--json", target)
    assert [r["title"] for r in json.loads(target.read_text())["recordings"]] == ["run 2"]


def test_a_graph_that_cannot_be_used_is_named_before_a_recording_is_read(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (runs / "lines.csv").unlink()
    (tmp_path / "bad.py").write_text(GRAPH.replace("OBSERVED,", "") + "OBSERVED = ('Lanes',)\n")
    on_run = ("--runs", 2)
    message = refused("compare", "--graphs", "lane_olny", *on_run)
    assert "--graphs: unknown name 'lane_olny' (did you mean 'lane_only'?)" in message
    message = refused("compare", "--graphs", "./absent.py", *on_run)
    assert f"--graphs: no file {tmp_path / 'absent.py'}" in message
    message = refused("compare", "--graphs", "lane_only,bad.py", *on_run)
    assert "Lanes" in message
    assert "lines.csv" not in message
    assert "lines.csv: no such file" in refused("compare", "--graphs", "lane_only", "--runs", 2)
    message = refused("compare", "--graphs", "lane_only,lane_only", *on_run)
    assert message == "--graphs: lane_only is named twice"


def test_what_cannot_be_compared_is_refused_in_one_line(runs: Path, tmp_path: Path) -> None:
    one, two = (write(tmp_path / f"{name}.yaml", simulated(name)) for name in ("one", "two"))
    wide = write(tmp_path / "wide.yaml", geometry("w", parameters={"sigmas_m": [0.2] * 7}))
    bare = write_drive(tmp_path / "bare", ground_truth=None)
    crossing = write_drive(tmp_path / "crossing", 60)
    truth = short_drive(60).truth
    flags = np.ones(len(truth), dtype=bool)
    write_ground_truth(crossing.parent / "ground_truth.txt", replace(truth, is_crossing=flags))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").touch()
    tuned = ("--set", "fit=tune")
    for words, said in (
        (
            (two, "--set", "fit=lern"),
            "'lern' is not one of none, learn, tune (did you mean",
        ),
        ((bare,), "ground_truth: is missing"),
        ((crossing,), "ground_truth.txt: every frame is a crossing, nothing to score"),
        ((one, "--out", tmp_path / "mine"), "exists and is not a result directory"),
        ((one, *tuned, "--set", "filter=smoothed"), "a search takes assumed_density or exact"),
        ((wide, "--runs", "2"), "run 2, 3 lanes: "),
        ((wide, "--runs", "2"), "parameters.sigmas_m: has 7 numbers, needs a list of 6"),
        ((one, *tuned, "--set", "tuning.never_fit=[[0, null]]"), "no frame is left to fit on"),
    ):
        assert said in refused("compare", *words)


def test_how_it_is_fitted_is_no_part_of_what_is_run() -> None:
    plain, learned = (resolved(simulated(fit=fit), {}) for fit in ("none", "learn"))
    assert plain == learned


def test_a_model_from_elsewhere_reads_a_recordings_own_file_and_camera(
    labelled: Path, tmp_path: Path
) -> None:
    place, model = load_experiment(labelled), load_experiment(write_drive(tmp_path / "m", 30))
    placed = on_recording(model, place)
    assert len(load_recording(placed).log) == N_LABELLED
    assert recording_key(placed) == recording_key(place) != recording_key(model)
    done("compare", labelled, "--blocks", 2, "--out", tmp_path / "out")
    kept = tmp_path / "out" / "labels" / "drive"
    run = json.loads((kept / "run.json").read_text())
    assert [Path(entry["path"]).name for entry in run["data"]] == [
        "labels.json",
        "cam.yaml",
        "t.txt",
    ]
    assert len(load_recording(load_experiment(kept / "experiment.yaml")).log) == N_LABELLED


def test_recordings_of_one_name_are_told_apart(tmp_path: Path) -> None:
    paths = [tmp_path / "a", tmp_path / "b", tmp_path / "c" / "a", tmp_path / "c"]
    experiments = [load_experiment(write_drive(path, 30)) for path in paths]
    titles = [group.title for group in by_recording(experiments)]
    assert titles == ["a lines", "b lines", "a lines (2)", "c lines"]
    assert [group.title for group in by_recording(experiments[:1])] == ["lines"]


def test_a_title_becomes_a_plain_directory_name() -> None:
    assert folder_of("quickstart, seed 1") == "quickstart_seed_1"
    assert folder_of("../..") == "recording"
