"""The result directory: complete, read as it was written, and never half there."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import yaml
from pyarrow import parquet

from egolane_pgm.experiment import config_hash, load_experiment
from egolane_pgm.graphs.cpds import quiet
from egolane_pgm.inference.events import crossing_probability, lane_events
from egolane_pgm.results import (
    Result,
    check_writable,
    git_state,
    is_result,
    read_result,
    staged,
    versions,
)
from egolane_pgm.running import run_experiment
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.tools.files import file_sha256, plain
from egolane_pgm.types import InputError
from tests.kits.drives import command, contents, done, geometry, simulated, write_drive


@pytest.fixture(scope="module")
def run(drive: Path) -> Result:
    return run_experiment(drive)


@pytest.fixture(scope="module")
def saved(run: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run.save(tmp_path_factory.mktemp("saved") / "result", figures=False)


def test_everything_read_from_a_result_directory_equals_the_run(run: Result, saved: Path) -> None:
    result = read_result(saved)
    log, truth = run.lines, run.truth
    assert truth is not None
    assert run.tentative is not None
    np.testing.assert_array_equal(result.frame_id, log.frame_id)
    np.testing.assert_array_equal(result.time_s, log.time_s)
    assert set(result.marginals) == {"Lane", "SensorState"}
    for node, belief in run.beliefs.marginals.items():
        np.testing.assert_array_equal(result.marginals[node], belief)
    assert result.values == {"Lane": ("1", "2", "3"), "SensorState": ("OK", "BAD")}
    np.testing.assert_array_equal(result.tentative, run.tentative)
    np.testing.assert_array_equal(result.assigned_lane, assigned_lane(run.beliefs.lane))
    np.testing.assert_array_equal(result.detector_lane, assigned_lane(run.tentative))
    np.testing.assert_array_equal(result.true_lane[run.scored], truth.lane)
    np.testing.assert_array_equal(result.is_crossing[run.scored], truth.is_crossing)
    np.testing.assert_array_equal(result.log_evidence, run.beliefs.log_evidence)
    np.testing.assert_array_equal(result.is_impossible, run.beliefs.is_impossible)
    for kind in ("detector", "model"):
        assert result.scores[kind] == plain(run.scores[kind])
    assert result.n_lanes == 3


def test_the_lines_of_a_result_are_those_that_were_believed(
    drive: Path, run: Result, saved: Path, tmp_path: Path
) -> None:
    lines, log = read_result(saved).lines, run.lines
    assert lines is not None
    for name in ("frame_id", "time_s", "offset_m", "is_valid", "is_continuous", "lri"):
        np.testing.assert_array_equal(getattr(lines, name), getattr(log, name))
    # They are a recording that can be run.
    done("run", drive, "--recording", saved / "lines.parquet", "--out", tmp_path / "again")
    again = read_result(tmp_path / "again")
    np.testing.assert_array_equal(again.marginals["Lane"], run.beliefs.lane)
    # Older results have none.
    copy = damaged(saved, tmp_path, lambda copy: (copy / "lines.parquet").unlink())
    assert read_result(copy).lines is None


def test_frames_that_were_put_in_are_marked_in_the_lines_of_a_result(tmp_path: Path) -> None:
    place = write_drive(tmp_path / "drive", recording__missing_frames="predict")
    table = tmp_path / "drive" / "lines.csv"
    rows = table.read_text().splitlines(keepends=True)
    table.write_text("".join(row for row in rows if not row.startswith("20,")))
    run = run_experiment(place)
    assert run.lines.is_missing.sum() == 1
    lines = read_result(run.save(tmp_path / "result", figures=False)).lines
    assert lines is not None
    np.testing.assert_array_equal(lines.is_missing, run.lines.is_missing)


def test_a_result_says_where_its_numbers_come_from(drive: Path, run: Result, saved: Path) -> None:
    said = read_result(saved).run
    assert said["schema_version"] == 1
    assert said["data"] == [
        {
            "path": str(drive.parent / name),
            "sha256": file_sha256(drive.parent / name),
            "bytes": (drive.parent / name).stat().st_size,
        }
        for name in ("lines.csv", "ground_truth.txt")
    ]
    assert set(said["versions"]) >= {"python", "egolane-pgm", "numpy", "numba", "pgmpy"}
    assert "not installed" not in said["versions"].values()
    assert said["git"] is None or set(said["git"]) == {"commit", "dirty"}
    assert said["frames"] == len(run.beliefs)
    assert said["frames_scored"] == run.scores["model"]["frames_scored"]
    assert said["mean_log_evidence"] == run.beliefs.mean_log_evidence
    assert said["tuned_on"] == "not_tuned"
    assert said["created"].endswith("+00:00")


def test_the_hash_of_a_result_is_that_of_its_experiment_whatever_its_order(
    drive: Path, saved: Path, tmp_path: Path
) -> None:
    content = yaml.safe_load(drive.read_text())
    turned = dict(reversed(content.items()))
    (drive.parent / "turned.yaml").write_text(yaml.safe_dump(turned, sort_keys=False))
    again = run_experiment(drive.parent / "turned.yaml").save(tmp_path / "again", figures=False)
    assert read_result(again).run["config_hash"] == read_result(saved).run["config_hash"]
    changed = load_experiment(drive, ["parameters.sigma1=0.41"])
    other = run_experiment(changed).save(tmp_path / "other", figures=False)
    assert read_result(other).run["config_hash"] != read_result(saved).run["config_hash"]
    assert len(config_hash({})) == 64


def test_the_experiment_of_a_result_directory_gives_the_same_result_again(
    saved: Path, tmp_path: Path
) -> None:
    done("run", saved / "experiment.yaml", "--no-figures", "--out", tmp_path / "again")
    one, other = read_result(saved), read_result(tmp_path / "again")
    for node in one.marginals:
        np.testing.assert_array_equal(one.marginals[node], other.marginals[node])
    assert one.scores == other.scores
    assert one.config == other.config
    assert [d["sha256"] for d in one.run["data"]] == [d["sha256"] for d in other.run["data"]]


def test_frames_without_annotation_are_null_in_the_table(drive: Path, tmp_path: Path) -> None:
    experiment = load_experiment(drive, ["ground_truth=null"])
    run = run_experiment(experiment)
    assert "model" not in run.scores
    saved = run.save(tmp_path / "result", figures=False)
    table = parquet.read_table(saved / "beliefs.parquet")
    assert table.column("true_lane").null_count == len(table)
    result = read_result(saved)
    assert (result.true_lane == 0).all()
    assert not result.is_crossing.any()
    assert "model" not in result.scores
    assert result.scores["frames_scored"] == 0


def test_the_lane_changes_of_a_result_are_a_table_of_it(tmp_path: Path) -> None:
    import pandas as pd

    run = run_experiment(geometry())
    saved = run.save(tmp_path / "result", figures=False)
    result = read_result(saved)
    table = pd.read_csv(saved / "events.csv")
    assert "nan" not in (saved / "events.csv").read_text()
    assert len(table) == run.scores["events"]["told"] > 0
    assert table["delay_s"].notna().sum() == run.scores["events"]["within"]["2"]["right"]
    pd.testing.assert_frame_equal(table, result.events.to_pandas().round(6))
    crossing = parquet.read_table(saved / "beliefs.parquet").column("crossing").to_numpy()
    np.testing.assert_array_equal(crossing, crossing_probability(run.beliefs.marginals))
    assert result.scores["events"] == run.scores["events"]


def test_a_run_gives_its_network_and_the_frames_with_their_evidence(saved: Path) -> None:
    run = run_experiment(simulated(filter="exact"))
    assert run.network().nodes["WOR_ve", 1]
    some = run.network(evidence=True, first=200, last=202)
    with quiet():
        from pgmpy.inference import VariableElimination

        found: Any = VariableElimination(some.network).query(
            ["Lane@202"], evidence=some.given, show_progress=False
        )
    np.testing.assert_allclose(found.values, run.beliefs["Lane"][202], rtol=0, atol=1e-12)
    # A clip is a drive of its own: nothing comes before its first frame.
    clips = replace(run, clip=np.repeat(["a", "b"], [200, len(run) - 200]))
    alone = clips.network(evidence=True, first=200, last=202)
    assert "Lane@199" in some.network
    assert "Lane@199" not in alone.network
    for result, choice, said in (
        (run, {"first": 200}, r"choose frames of network\(evidence=True\)"),
        (clips, {"evidence": True, "first": 199, "last": 200}, "its frames are 0 to 199"),
        (read_result(saved), {"evidence": True}, "a stored result has no evidence; run the exper"),
    ):
        with pytest.raises(InputError, match=said):
            result.network(**choice)


def test_beliefs_that_come_late_tell_late(tmp_path: Path) -> None:
    lagged = run_experiment(simulated(filter="fixed_lag", lag=7, evidence_reading="soft"))
    saved = lagged.save(tmp_path / "result", figures=False)
    at_once = lane_events(lagged.beliefs, 10.0, places=lagged.place_in_lane)
    assert len(at_once)
    found = read_result(saved).events
    np.testing.assert_allclose(found.late_s, at_once.late_s + 0.7)
    assert found.delay_s is not None
    assert lagged.scores["events"]["delay_s"]["median"] == np.nanmedian(found.delay_s)


def test_where_git_or_a_package_is_not_there_that_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    assert versions(["numpy", "no-such-package"])["no-such-package"] == "not installed"
    monkeypatch.setenv("GIT_DIR", "/nonexistent")
    assert git_state.__wrapped__() is None
    monkeypatch.setenv("PATH", "/nonexistent")
    assert git_state.__wrapped__() is None


def damaged(saved: Path, folder: Path, change: Callable[[Path], object]) -> Path:
    copy = folder / "copy"
    for name, content in contents(saved).items():
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        (copy / name).write_bytes(content)
    read_result(copy)
    change(copy)
    return copy


def rewrite(name: str, **changes: object) -> Callable[[Path], object]:
    def change(folder: Path) -> None:
        content = json.loads((folder / name).read_text())
        for key, value in changes.items():
            content.pop(key) if value is None else content.update({key: value})
        (folder / name).write_text(json.dumps(content))

    return change


def without_lane_2(folder: Path) -> None:
    file = folder / "beliefs.parquet"
    parquet.write_table(parquet.read_table(file).drop_columns(["Lane_2"]), file)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: (d / "run.json").unlink(), ": is not a result directory"),
        (lambda d: (d / "beliefs.parquet").write_bytes(b"PAR1"), "/beliefs.parquet: is not a who"),
        (lambda d: (d / "lines.parquet").write_bytes(b"PAR1"), "/lines.parquet: is not a whole"),
        (lambda d: (d / "scores.json").write_text("{"), "/scores.json: is not JSON (EOF while"),
        (rewrite("run.json", schema_version=99), "/run.json: has schema_version 99, this program"),
        (rewrite("run.json", values=None), "/run.json: values: is missing"),
        (rewrite("run.json", frames=7), "/beliefs.parquet: has 150 frames, run.json says 7; run"),
        (without_lane_2, ': is damaged (KeyError: \'Field "Lane_2" does not exist'),
    ],
)
def test_a_damaged_result_is_refused_in_a_line_that_names_it(
    saved: Path, tmp_path: Path, change: Callable[[Path], object], said: str
) -> None:
    copy = damaged(saved, tmp_path, change)
    with pytest.raises(InputError) as info:
        read_result(copy)
    assert str(info.value).startswith(f"{copy}{said}")
    assert "\n" not in str(info.value)


def test_further_keys_and_columns_are_no_damage(saved: Path, tmp_path: Path) -> None:
    copy = damaged(saved, tmp_path, rewrite("run.json", note="of mine"))
    file = copy / "beliefs.parquet"
    table = parquet.read_table(file)
    parquet.write_table(table.append_column("mine", pa.array(["x"] * len(table))), file)
    assert read_result(copy).run["note"] == "of mine"


def earlier_result(folder: Path) -> Path:
    with staged(folder / "result") as new:
        (new / "run.json").write_text("old")
        (new / "scores.json").write_text("old")
    return folder / "result"


def test_check_writable_allows_new_empty_and_earlier_directories_only(tmp_path: Path) -> None:
    check_writable(tmp_path / "a" / "b" / "new")
    check_writable(earlier_result(tmp_path))
    (tmp_path / "empty").mkdir()
    check_writable(tmp_path / "empty")
    with pytest.raises(InputError, match="is not a result directory"):
        check_writable(tmp_path)
    with pytest.raises(InputError, match=r"run\.json: is a file, not a directory"):
        check_writable(tmp_path / "result" / "run.json")
    assert {p.name for p in tmp_path.iterdir()} == {"result", "empty"}


@pytest.mark.parametrize("is_there", [False, True])
def test_an_interrupted_run_leaves_no_result_and_an_earlier_one_untouched(
    drive: Path, saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_there: bool
) -> None:
    def interrupted(_: object, path: Path) -> None:
        assert is_result(path.parents[1])
        raise KeyboardInterrupt

    result = tmp_path / "result"
    if is_there:
        damaged(saved, tmp_path, lambda copy: copy.rename(result))
    before = contents(tmp_path)
    monkeypatch.setattr("egolane_pgm.views.strips.draw_strips", interrupted)
    assert command("run", drive, "--out", result).exit_code == 130
    assert contents(tmp_path) == before
