"""Results: scores by the frames, lane changes, and the directory that is read as it was written."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pandas.testing import assert_frame_equal

from egolane_pgm.drives import Drive, read_drives
from egolane_pgm.graphs import no_wor
from egolane_pgm.inference.events import SURE
from egolane_pgm.loading import load_experiment
from egolane_pgm.model import compile_model
from egolane_pgm.recordings.table import write_table
from egolane_pgm.result import (
    COLUMNS,
    Result,
    by_drive,
    check_writable,
    lanes_of,
    load_result,
    make_result,
)
from egolane_pgm.running import concat_drives, frames_of
from egolane_pgm.scoring import score_all
from egolane_pgm.tools.files import file_sha256
from egolane_pgm.tools.provenance import git_state
from egolane_pgm.types import InputError, LineLog
from tests.kits.drives import (
    contents,
    geometry,
    log_with_gaps,
    run,
    short_drive,
    simulated,
    write_drive,
)
from tests.kits.tiny_result import CROSSING, DETECTOR, IDS, MODEL, TRUTH, a_result

ARRAYS = ("frame_id", "time_s", "offset_m", "is_valid", "is_continuous", "lri", "is_missing")


@pytest.fixture(scope="module")
def result(drive: Path) -> Result:
    return run(drive)


@pytest.fixture(scope="module")
def saved(result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return result.save(tmp_path_factory.mktemp("saved") / "result")


def assert_same_lines(ours: LineLog, theirs: LineLog) -> None:
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)


# --- frames --------------------------------------------------------------------------------------


def test_a_result_gives_posteriors_truth_and_answers_by_name() -> None:
    found = a_result()
    np.testing.assert_array_equal(found.node("Lane"), MODEL)
    np.testing.assert_array_equal(lanes_of(found.frames, "detector"), DETECTOR)
    assert found.truth is not None
    assert found.truth.index.tolist() == IDS[:-1]
    assert found.truth["true_lane"].tolist() == TRUTH[:-1]
    assert found.truth["is_crossing"].tolist() == [bool(c) for c in CROSSING[:-1]]


def test_the_columns_of_frames_are_those_that_are_documented() -> None:
    found = run(geometry())
    names = {name.rstrip("?") for name in COLUMNS}
    values = {f"{node}_{v}" for node, own in found.run["values"].items() for v in own}
    detector = {f"detector_{k}" for k in range(1, 5)}
    assert set(found.frames) - values - detector <= names
    assert values < set(found.frames)
    assert found.frames.index.name == "frame_id"


def test_the_scores_of_a_drive_are_those_of_its_annotated_frames(result: Result) -> None:
    truth = result.truth
    assert truth is not None
    for side, node in (("model", "Lane"), ("detector", "detector")):
        own = score_all(lanes_of(result.frames, node), truth, 10.0)
        assert result.scores[side] == json.loads(json.dumps(own))
    assert result.scores["frames_scored"] == (~truth["is_crossing"]).sum()
    sure = (result.node("Lane").max(axis=1) >= SURE).mean()
    assert result.scores["sure"] == pytest.approx(sure)
    evidence = result.frames["log_evidence"][~result.frames["is_impossible"]]
    assert result.scores["mean_log_evidence"] == pytest.approx(evidence.mean())


def test_without_ground_truth_nothing_is_scored(drive: Path) -> None:
    found = run(drive, {"ground_truth": None})
    assert "model" not in found.scores
    assert (found.truth, found.scores["frames_scored"]) == (None, 0)
    assert found.frames["true_lane"].isna().all()
    assert found.scores["events"] == {"detected": len(found.events)}


# --- several drives ------------------------------------------------------------------------------


def two_drives(n_lanes: int = 4) -> list[Drive]:
    drives = []
    for seed, lanes in ((0, 4), (1, n_lanes)):
        named = simulated(f"d{seed}", recording={"simulate": "quickstart", "seed": seed})
        drives += read_drives(load_experiment(named, n_lanes=lanes))
    return drives


def of_drives(drives: list[Drive]) -> Result:
    frames = concat_drives(drives, [frames_of(drive) for drive in drives])
    return make_result(drives[0].experiment, drives, frames)


def test_scores_of_several_drives_are_those_of_all_their_frames() -> None:
    drives = two_drives()
    both, each = of_drives(drives), [of_drives([drive]) for drive in drives]
    scores, own = both.scores["model"], [one.scores["model"] for one in each]
    assert scores["confusion"] == np.sum([s["confusion"] for s in own], axis=0).tolist()
    assert scores["delay"]["changes"] == sum(s["delay"]["changes"] for s in own)
    weights = [s["frames"] for s in own]
    for name in ("log_loss",):
        assert scores[name] == pytest.approx(np.average([s[name] for s in own], weights=weights))
    for key in ("changes", "detected", "hours"):
        right = sum(one.scores["events"][key] for one in each)
        assert both.scores["events"][key] == pytest.approx(right)
    for key in ("right", "false", "missed"):
        right = sum(one.scores["events"]["within"]["1"][key] for one in each)
        assert both.scores["events"]["within"]["1"][key] == right
    assert_frame_equal(
        both.events.drop(columns="drive"),
        pd.concat([one.events for one in each], ignore_index=True),
    )
    assert [name for name, _ in by_drive(both.frames)] == ["d0", "d1"]
    # The road of the second drive may have another number of lanes.
    narrow = two_drives(n_lanes=3)
    changes = [of_drives(given).scores["events"]["changes"] for given in (narrow, [narrow[1]])]
    assert changes[0] - changes[1] == each[0].scores["events"]["changes"] > 0


# --- lane changes --------------------------------------------------------------------------------


def test_posteriors_that_come_late_report_late(drive: Path) -> None:
    lagged = run(simulated(filter="fixed_lag", lag=7))
    at_once = replace(lagged, experiment=lagged.experiment.model_copy(update={"lag": None}))
    assert len(at_once.events) > 0
    np.testing.assert_allclose(lagged.events["late_s"], at_once.events["late_s"] + 0.7)
    median = np.nanmedian(lagged.events["delay_s"])
    assert lagged.scores["events"]["delay_s"]["median"] == pytest.approx(median)


# --- the model -----------------------------------------------------------------------------------


def test_a_result_gives_its_network_and_its_evidence(saved: Path) -> None:
    found = run(simulated(filter="exact"))
    assert ("WOR_ve", 1) in found.model.network
    # A result that was loaded makes its evidence from its lines.
    again, own = load_result(saved), load_result(saved).evidence
    right = run(again.experiment).evidence
    for node, values in own.likelihoods.items():
        np.testing.assert_array_equal(values, right.likelihoods[node])


# --- the directory -------------------------------------------------------------------------------


def test_a_result_is_loaded_as_it_was_saved(result: Result, saved: Path) -> None:
    again = load_result(saved)
    assert_frame_equal(again.frames, result.frames)
    assert (again.run, again.scores) == (result.run, result.scores)
    assert_frame_equal(again.events, result.events)
    assert_same_lines(again.lines["drive"], result.lines["drive"])
    assert again.experiment.model_dump() == load_experiment(saved / "experiment.yaml").model_dump()
    assert again.directory == saved
    table = pd.read_csv(saved / "events.csv")
    assert_frame_equal(table, result.events.round(6), check_dtype=False)


def test_frames_that_were_filled_in_are_marked_in_the_lines(tmp_path: Path) -> None:
    path = write_drive(tmp_path / "drive", recording__missing_frames="predict")
    write_table(tmp_path / "drive" / "lines.csv", log_with_gaps())
    found = run(path)
    again = load_result(found.save(tmp_path / "result"))
    assert found.lines["drive"].is_missing.sum() == 4
    assert_same_lines(again.lines["drive"], found.lines["drive"])
    for node, values in found.evidence.likelihoods.items():
        np.testing.assert_array_equal(again.evidence.likelihoods[node], values)


def test_a_loaded_result_runs_again(saved: Path, tmp_path: Path) -> None:
    one = load_result(saved)
    for again in (run(one), run(saved / "experiment.yaml")):
        assert_frame_equal(again.frames, one.frames)
        assert again.scores == one.scores
        assert again.run["config"] == one.run["config"]


def test_a_result_of_lines_in_memory_runs_again(tmp_path: Path) -> None:
    options = {"experiment": simulated(), "n_lanes": 3, "ground_truth": short_drive().truth}
    found = run(log_with_gaps(), {"recording.missing_frames": "hold"}, **options)
    again = load_result(found.save(tmp_path / "result"))
    for other in (run(found), run(again)):
        kept = found.frames.drop(columns=["true_lane", "is_crossing"])
        assert_frame_equal(other.frames[kept.columns], kept)
    assert run(found).scores == found.scores


def test_a_result_of_several_drives_is_loaded_as_it_was_saved(tmp_path: Path) -> None:
    log = short_drive().log
    clips = replace(log, clip=np.where(np.arange(len(log)) < 70, "one", "two"))
    found = run(clips, experiment=simulated(), n_lanes=3)
    again = load_result(found.save(tmp_path / "result"))
    assert_frame_equal(again.frames, found.frames)
    assert [*again.lines] == ["one", "two"]
    assert_same_lines(again.lines["two"], found.lines["two"])


def test_ones_own_plugin_is_copied_and_used(tmp_path: Path) -> None:
    graph, rule = tmp_path / "graph_mine.py", tmp_path / "rule.py"
    shutil.copy(str(no_wor.__file__), graph)
    rule.write_text(
        "from egolane_pgm.evidence.counting import PARAMETERS, PROVIDES, TENTATIVE, evidence\n"
    )
    path = write_drive(tmp_path, graph="./graph_mine.py", evidence="./rule.py")
    found = run(path)
    saved = found.save(tmp_path / "result")
    graph.unlink()
    rule.unlink()
    assert {"graph_mine.py", "evidence_rule.py"} <= {file.name for file in saved.iterdir()}
    assert_frame_equal(run(saved / "experiment.yaml").frames, found.frames)
    # Saved over itself, it stays whole.
    load_result(saved).save(saved)
    assert_frame_equal(run(load_result(saved)).frames, found.frames)


def test_a_network_in_memory_is_saved_as_the_graph_that_it_is(tmp_path: Path) -> None:
    own = simulated(parameters={"sigma1": 0.4, "bonus_value": 5})
    found = run(own, graph=compile_model(own).network)
    assert found.experiment.parameters == {"bonus_value": 5}
    np.testing.assert_allclose(found.node("Lane"), run(own).node("Lane"), rtol=0, atol=1e-12)
    again = run(found.save(tmp_path / "run") / "experiment.yaml")
    assert_frame_equal(again.frames, found.frames)


def test_a_result_has_its_provenance(
    drive: Path, saved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = load_result(saved).run
    files = [drive.parent / name for name in ("lines.csv", "ground_truth.txt")]
    assert found["data"] == [
        {"path": str(file), "sha256": file_sha256(file), "bytes": file.stat().st_size}
        for file in files
    ]
    assert set(found["versions"]) >= {"python", "egolane-pgm", "numpy", "numba", "pgmpy"}
    assert "not installed" not in found["versions"].values()
    assert found["git"] is None or set(found["git"]) == {"commit", "dirty"}
    assert found["created"].endswith("+00:00")
    changed = run(drive, ["parameters.sigma1=0.41"])
    assert changed.run["identity"] != found["identity"]
    monkeypatch.setenv("PATH", "/nonexistent")
    assert git_state.__wrapped__() is None


# --- damage --------------------------------------------------------------------------------------


def rewrite(name: str, **changes: object) -> Callable[[Path], object]:
    def change(folder: Path) -> None:
        content = json.loads((folder / name).read_text())
        for key, value in changes.items():
            content.pop(key) if value is None else content.update({key: value})
        (folder / name).write_text(json.dumps(content))

    return change


def rewrite_beliefs(folder: Path) -> None:
    file = folder / "beliefs.parquet"
    pd.read_parquet(file).astype({"SensorState_OK": str}).to_parquet(file)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: (d / "run.json").unlink(), "is not a result directory (no run.json and scor"),
        (lambda d: (d / "beliefs.parquet").write_bytes(b"PAR1"), "cannot be read as Parquet"),
        (lambda d: (d / "beliefs.parquet").unlink(), "beliefs.parquet: cannot be read"),
        (lambda d: (d / "lines.parquet").write_bytes(b"PAR1"), "lines.parquet: cannot be read"),
        (lambda d: (d / "scores.json").write_text("{"), "is damaged (JSONDecodeError: "),
        (lambda d: (d / "scores.json").write_text("[]"), "scores.json need keys and values"),
        (rewrite("run.json", frames=7), "beliefs.parquet has 150 of 7 frames"),
        (rewrite("run.json", identity=None), "was written by another version; run the experiment"),
        (rewrite("run.json", n_lanes="x"), "is damaged (TypeError: "),
        (rewrite("run.json", warnings=5), "its files differ from the checksum in run.json"),
        (rewrite("scores.json", sure="x"), "its files differ from the checksum in run.json"),
        (rewrite_beliefs, "its files differ from the checksum in run.json"),
    ],
)
def test_a_damaged_result_is_refused_in_a_line_that_names_it(
    saved: Path, tmp_path: Path, change: Callable[[Path], object], message: str
) -> None:
    copy = shutil.copytree(saved, tmp_path / "copy")
    load_result(copy)
    change(copy)
    with pytest.raises(InputError) as info:
        load_result(copy)
    assert str(info.value).startswith(str(copy))
    assert message in str(info.value)
    assert "\n" not in str(info.value)


def test_new_empty_and_earlier_directories_are_written_only(saved: Path, tmp_path: Path) -> None:
    check_writable(tmp_path / "a" / "b" / "new")
    copy = shutil.copytree(saved, tmp_path / "result")
    check_writable(copy)
    with pytest.raises(InputError, match="exists and is not a result directory; name another"):
        check_writable(tmp_path)
    with pytest.raises(InputError, match=r"run\.json: is a file, not a directory"):
        check_writable(copy / "run.json")
    (tmp_path / "link").symlink_to(tmp_path)
    check_writable(tmp_path / "link" / "result")
    for place, message in (("link", "is a link; name"), ("/", "cannot be replaced; name a folder")):
        with pytest.raises(InputError, match=message):
            check_writable(tmp_path / place)


def test_a_result_that_cannot_be_written_leaves_the_older_one(
    result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = result.save(tmp_path / "result", figures=True)
    (place / "notes.txt").write_text("mine")
    before = contents(place)

    def fails(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(pd.DataFrame, "to_parquet", fails)
        with pytest.raises(InputError, match="result: cannot be written: No space left on device"):
            result.save(place)
    assert contents(place) == before
    assert [path.name for path in tmp_path.iterdir()] == ["result"]
    result.save(place)
    # A picture of another run does not stay.
    assert contents(place) == {k: v for k, v in before.items() if "strips" not in str(k)}
