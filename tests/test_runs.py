"""What is run, whatever it is given as; and tables of runs."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import pandas as pd
import pytest

from egolane_pgm.graphs import no_wor
from egolane_pgm.loading import load_experiment
from egolane_pgm.model import as_graph
from egolane_pgm.result import load_result
from egolane_pgm.runs import numbers, open_input, read_runs, run_table, table_inputs
from egolane_pgm.types import InputError
from tests.kits.drives import run, short_drive, simulated, write_drive

#: What differs from run to run.
TIMES = ["seconds", "was_there"]


# --- what is given -------------------------------------------------------------------------------


def test_lines_are_run_with_zero_label_if_nothing_else_is_named(tmp_path: Path) -> None:
    write_drive(tmp_path)
    zero = load_experiment("zero_label")
    for given in (tmp_path / "lines.csv", short_drive().log, short_drive().log.to_pandas()):
        opened = open_input(given, n_lanes=3, overrides={"start_lane": 2}).experiment
        assert (opened.graph, opened.evidence) == (zero.graph, zero.evidence)
        assert (opened.n_lanes, opened.start_lane) == (3, 2)


def test_an_experiment_is_run_on_a_file_with_its_truth(tmp_path: Path) -> None:
    path = write_drive(tmp_path)
    options: dict[str, Any] = {"experiment": simulated(), "n_lanes": 3}
    found = run(tmp_path / "lines.csv", ground_truth=tmp_path / "ground_truth.txt", **options)
    assert found.name == "lines"
    pd.testing.assert_frame_equal(found.frames, run(path).frames)
    assert run(path, ground_truth="none").truth is None
    again = run(found, {"filter": "exact"})
    assert again.experiment.recording == found.experiment.recording
    assert (again.experiment.filter, again.truth is None) == ("exact", False)


def test_a_graph_is_named_whatever_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    own = ModuleType("mine")
    own.__file__ = str(tmp_path / "mine.py")
    for given, name in (
        ("no_wor", "no_wor"),
        (no_wor, "no_wor"),
        (own, f"{tmp_path}/mine.py"),
        (Path("mine.py"), f"{tmp_path}/mine.py"),
    ):
        assert as_graph(given, simulated()) == name
    for graph, said in (
        (3, "graph: int is not a name, file, module, network or model"),
        (ModuleType("mine"), "graph: the module mine has no file; write it to one"),
    ):
        with pytest.raises(InputError, match=said):
            as_graph(graph, simulated())


# --- rows ----------------------------------------------------------------------------------------


def table(folder: Path, text: str, name: str = "runs.csv") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def runs_of(folder: Path, n: int = 4) -> Path:
    rows = [f'd{k},{k},"[0, 150]",{"rain" if k % 2 else "sun"}' for k in range(n)]
    head = "name,recording.seed,recording.frames,tag.weather"
    return table(folder, "\n".join([head, *rows]))


def test_a_table_is_the_same_as_csv_and_data_frame(tmp_path: Path) -> None:
    as_csv = table(tmp_path, "recording.path,n_lanes,tag.road\na.csv,3,4\nb.csv,,A2\n")
    cells = {
        "recording.path": ["a.csv", "b.csv"],
        "n_lanes": [3, None],
        "tag.road": ["4", "A2"],
    }
    frame = pd.DataFrame(cells).astype({"n_lanes": "Int64"})
    expected = [
        {"recording.path": "a.csv", "n_lanes": 3, "tag.road": "4"},
        {"recording.path": "b.csv", "tag.road": "A2"},
    ]
    assert read_runs(as_csv) == (expected, tmp_path)
    assert read_runs(frame) == (expected, Path.cwd())


def test_a_row_changes_the_keys_that_it_names(tmp_path: Path) -> None:
    text = "recording.seed,n_lanes,parameters.sigma1,parameters.p3,tag.driver\n"
    path = table(tmp_path, text + '7,3,0.2,"[0.6, 0.6, 0.7]",anna\n8,,,,\n')
    base = load_experiment("quickstart")
    first, second = table_inputs({**base.keys, "filter": "exact"}, path)
    one, other = first.experiment, second.experiment
    assert (one.name, one.recording.seed, one.n_lanes) == ("quickstart_1", 7, 3)
    assert one.parameters["p3"] == (0.6, 0.6, 0.7)
    assert (one.parameters["sigma1"], dict(first.tags)) == (0.2, {"driver": "anna"})
    assert (other.name, other.recording.seed, other.n_lanes) == ("quickstart_2", 8, base.n_lanes)
    assert (other.parameters, other.filter, dict(second.tags)) == (base.parameters, "exact", {})


def test_a_row_with_another_recording_drops_the_keys_of_the_old_drive(tmp_path: Path) -> None:
    keys = {"columns": {"offset_m": "y"}, "frames": [3, 9], "path": "/a.csv"}
    base = simulated(
        "base", recording=keys, ground_truth={"path": "/t.txt"}, tuned_on="same_frames"
    )
    text = 'recording.path,ground_truth.path,recording.frames\nx/b.csv,b.txt,"[0, 60]"\n/a.csv,,\n'
    other, same = (each.experiment for each in table_inputs(base, table(tmp_path, text)))
    assert (other.name, other.recording.path) == ("x_b", str(tmp_path / "x" / "b.csv"))
    assert other.recording.columns == base.recording.columns
    assert other.recording.frames == (0, 60)
    assert other.ground_truth is not None
    assert other.ground_truth.path == str(tmp_path / "b.txt")
    assert (other.tuned_on, same.tuned_on) == ("unknown", "same_frames")
    assert (same.recording.frames, same.ground_truth) == (None, None)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("recording.path,n_lane\na,3\n", "unknown column 'n_lane' (did you mean 'n_lanes'?)"),
        ("recording.path,weather\na,rain\n", "a tag is tag.weather"),
        ("recording.path\n", "has no rows; give it one for each run"),
        ("", "cannot be read as a table"),
        ("recording.path\nx/a.csv\nx/a.csv\n", "row 2: another row has the name x_a"),
        ("recording.path,n_lanes\na.csv,[\n", "n_lanes: is not YAML"),
        ("recording.seed,n_lanes\n1,three\n", "row 1: n_lanes: input should be a valid integer"),
        (
            "recording.path,filter\na.csv,exat\n",
            "row 1: filter: input should be 'assumed_density', ",
        ),
    ],
)
def test_a_table_that_does_not_fit_is_refused_in_one_line(
    tmp_path: Path, text: str, said: str
) -> None:
    with pytest.raises(InputError) as info:
        table_inputs("quickstart", table(tmp_path, text))
    assert said in str(info.value)
    assert "\n" not in str(info.value)


# --- runs ----------------------------------------------------------------------------------------


def summary(path: Path, out: Path, overrides: Any = None, **options: Any) -> pd.DataFrame:
    base = load_experiment("quickstart", overrides)
    return run_table(table_inputs(base, path), out, **options)


def test_processes_write_the_same_summary_as_one(tmp_path: Path) -> None:
    path = runs_of(tmp_path)
    one = summary(path, tmp_path / "one")
    two = summary(path, tmp_path / "two", jobs=2)
    pd.testing.assert_frame_equal(one.drop(columns=TIMES), two.drop(columns=TIMES))
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "one" / "summary.parquet"), one)
    assert one["tag.weather"].to_list() == ["sun", "rain"] * 2
    alone = load_result(tmp_path / "one" / "d3")
    assert one.loc["d3", "model.accuracy"] == alone.scores["model"]["accuracy"]
    flat = numbers({"model": {"f1": 0.5, "intervals": {"f1": [0.4, 0.6], "log_loss": None}}})
    assert flat == {"model.f1": 0.5, "model.intervals.f1.low": 0.4, "model.intervals.f1.high": 0.6}
    assert alone.run["tags"] == {"weather": "rain"}


def test_rows_that_are_there_are_not_run_again(tmp_path: Path) -> None:
    path, out = runs_of(tmp_path), tmp_path / "out"
    first = summary(path, out)
    assert not first["was_there"].any()
    again = summary(path, out)
    assert again["was_there"].all()
    pd.testing.assert_frame_equal(first.drop(columns=TIMES), again.drop(columns=TIMES))
    path.write_text(
        path.read_text().replace("d3,3,", "d3,33,").replace('150]",rain', '150]",fog', 1)
    )
    assert summary(path, out)["was_there"].to_list() == [True, False, True, False]
    assert not summary(path, out, {"parameters.sigma1": 0.3})["was_there"].any()
    held_out = summary(path, out, {"parameters.sigma1": 0.3}, n_blocks=2)
    assert not held_out["was_there"].any()
    assert "block" in load_result(out / "d0").frames


def test_a_row_whose_file_has_changed_is_run_again(tmp_path: Path) -> None:
    write_drive(tmp_path)
    path, out = table(tmp_path, "recording.path,n_lanes\nlines.csv,3\n"), tmp_path / "out"
    assert [summary(path, out)["was_there"].item() for _ in range(2)] == [False, True]
    lines = tmp_path / "lines.csv"
    lines.write_text("\n".join(lines.read_text().splitlines()[:-40]) + "\n")
    assert not summary(path, out)["was_there"].item()
