"""The command `egolane compare`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from egolane_pgm.comparing.groups import Group, by_recording, compare_groups
from egolane_pgm.comparing.placing import on_recording, recording_key
from egolane_pgm.drive import load_recording
from egolane_pgm.experiment import load_experiment
from tests.conftest import needs_compiler
from tests.kits.drives import command, done, write_drive
from tests.kits.labelled_drive import N_LABELLED


@needs_compiler
def test_graphs_are_compared_on_a_run_of_the_paper(recordings: Path, tmp_path: Path) -> None:
    target = tmp_path / "compared.json"
    words = ("--runs", "6", "--graphs", "sensor_failure,lane_only", "--json", target)
    shown = done("compare", *words).stdout
    document = json.loads(target.read_text())
    scores = document["runs"][0]["scores"]
    assert set(scores) == {"detector", "sensor_failure", "lane_only"}
    row = next(line for line in shown.splitlines() if line.startswith("| 6 "))
    for name in scores:
        assert f"{scores[name]['accuracy']:.3f}" in row


def test_ctrl_c_shows_the_recordings_that_were_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [write_drive(tmp_path / name, name=name) for name in ("a", "b")]
    real = compare_groups

    def interrupted(groups: Sequence[Group], *given: Any, **named: Any) -> Iterator[Any]:
        yield next(iter(real(groups[:1], *given, **named)))
        raise KeyboardInterrupt

    monkeypatch.setattr("egolane_pgm.verbs.compare.compare_groups", interrupted)
    result = command("compare", *paths, "--json", tmp_path / "x.json")
    assert result.exit_code == 130
    assert (
        result.stderr
        == "egolane: interrupted; this is 1 of 2 recordings; the same command begins anew\n"
    )
    assert "| a lines  |" in result.stdout
    assert len(json.loads((tmp_path / "x.json").read_text())["recordings"]) == 1


def test_a_model_from_elsewhere_reads_a_recordings_own_folder_and_camera(
    labelled: Path, tmp_path: Path
) -> None:
    place, model = load_experiment(labelled), load_experiment(write_drive(tmp_path / "m", 30))
    placed = on_recording(model, place)
    assert len(load_recording(placed).log) == N_LABELLED
    assert recording_key(placed) == recording_key(place) != recording_key(model)


def test_a_comparison_of_a_folder_of_lines_is_kept(labelled: Path, tmp_path: Path) -> None:
    done("compare", labelled, "--blocks", 2, "--out", tmp_path / "out")
    run = json.loads((tmp_path / "out" / "labels" / "drive" / "run.json").read_text())
    assert run["data"][0]["files"] == N_LABELLED
    names = [Path(entry["path"]).name for entry in run["data"]]
    assert names == ["labels", "cam.yaml", "t.txt"]
    kept = tmp_path / "out" / "labels" / "drive" / "experiment.yaml"
    assert len(load_recording(load_experiment(kept)).log) == N_LABELLED


def test_recordings_of_one_name_are_told_apart(tmp_path: Path) -> None:
    paths = [tmp_path / "a", tmp_path / "b", tmp_path / "c" / "a", tmp_path / "c"]
    experiments = [load_experiment(write_drive(path, 30)) for path in paths]
    titles = [group.title for group in by_recording(experiments)]
    assert titles == ["a lines", "b lines", "a lines (2)", "c lines"]
    assert [group.title for group in by_recording(experiments[:1])] == ["lines"]
    done("compare", *(path / "experiment.yaml" for path in paths[:2]), "--out", tmp_path / "out")
    parts = [tmp_path / "out" / name / "comparison.json" for name in ("a_lines", "b_lines")]
    assert [json.loads(part.read_text())["title"] for part in parts] == titles[:2]
