"""Runs on lines, lanes and graphs that were never a file: what the files of them give."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from egolane_pgm.comparing.graphs import with_graph
from egolane_pgm.drive import load_drive, source_of, with_recording
from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.graphs import no_wor
from egolane_pgm.learning.graph_file import graph_named
from egolane_pgm.model import prepare_model
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.memory import in_memory, truth_of
from egolane_pgm.recordings.source import IN_MEMORY
from egolane_pgm.recordings.table import rows_of
from egolane_pgm.results import read_result
from egolane_pgm.running import plan_runs, run_all, run_experiment
from egolane_pgm.types import InputError, LineLog
from tests.kits.drives import short_drive, simulated, write_drive


def lines(hertz: float) -> pd.DataFrame:
    frame = rows_of(short_drive().log).to_pandas()
    return frame.assign(time_s=frame["frame_id"] / hertz)


def lanes() -> pd.DataFrame:
    truth = short_drive().truth
    return pd.DataFrame(
        {"frame_id": truth.frame_id, "lane": truth.lane, "crossing": truth.is_crossing}
    )


def on_memory(experiment: Experiment) -> Experiment:
    return with_recording(experiment, IN_MEMORY, None, 3)


@pytest.mark.parametrize("hertz", [10.0, 25.0])
def test_a_run_on_a_frame_is_that_on_its_files(tmp_path: Path, hertz: float) -> None:
    of_files = run_experiment(write_drive(tmp_path, recording__frame_rate=hertz))
    experiment = on_memory(simulated())
    run = run_experiment(experiment, read=in_memory(experiment, lines(hertz), lanes()))
    assert run.run["frame_rate"] == hertz
    np.testing.assert_array_equal(run.beliefs.lane, of_files.beliefs.lane)
    assert run.scores["model"] == of_files.scores["model"]
    assert (run.name, run.run["data"]) == ("in_memory", [])


def test_lanes_in_memory_go_with_lines_of_a_file_and_runs_share_the_jobs(tmp_path: Path) -> None:
    experiment = load_experiment(write_drive(tmp_path))
    one_lane = truth_of(lanes().assign(lane=1, crossing=0))
    read = replace(source_of(experiment).read(), truth=one_lane)
    (plan,) = plan_runs([("one", lambda: experiment)], None)
    (done,) = run_all([replace(plan, read=read)], keep=True)
    assert done.result is not None
    assert set(done.result.true_lane) == {1}
    assert [Path(entry["path"]).name for entry in done.result.run["data"]] == ["lines.csv"]


def test_the_rate_of_the_experiment_goes_before_that_of_the_times() -> None:
    experiment = load_experiment(on_memory(simulated()), {"recording.frame_rate": 5})
    read = in_memory(experiment, lines(25), None)
    assert run_experiment(experiment, read=read).run["frame_rate"] == 5
    without = in_memory(experiment, lines(25).drop(columns="time_s"), None)
    np.testing.assert_array_equal(without.log.time_s, short_drive().log.frame_id / 5)


def test_a_run_in_memory_is_saved_loaded_and_shown(tmp_path: Path) -> None:
    experiment = on_memory(simulated())
    run = run_experiment(experiment, read=in_memory(experiment, lines(25), lanes()))
    back = read_result(run.save(tmp_path / "run", figures=False))
    assert back.experiment.recording.path == "./lines.parquet"
    assert back.run["frame_rate"] == 25
    assert back.lines is not None
    np.testing.assert_array_equal(back.lines.offset_m, short_drive().log.offset_m)
    assert back.report(tmp_path / "page.html").stat().st_size > 10_000


def test_clips_in_memory_are_each_a_drive() -> None:
    log = short_drive().log
    clip = np.where(np.arange(len(log)) < 70, "one", "two")
    experiment = on_memory(simulated())
    run = run_experiment(experiment, read=in_memory(experiment, replace(log, clip=clip), None))
    later: LineLog = log.take(slice(70, None))
    alone = run_experiment(experiment, read=in_memory(experiment, later, None))
    np.testing.assert_array_equal(run.beliefs.lane[70:], alone.beliefs.lane)


def test_lanes_in_memory_or_of_a_file_are_what_a_fit_needs(tmp_path: Path) -> None:
    experiment = on_memory(simulated())
    drive = load_drive(experiment, needs_truth="it", read=in_memory(experiment, lines(10), lanes()))
    assert len(drive) == len(short_drive().truth)
    write_ground_truth(tmp_path / "lanes.txt", short_drive().truth)
    named = load_experiment(experiment, {"ground_truth.path": str(tmp_path / "lanes.txt")})
    assert load_drive(named, needs_truth="it", read=in_memory(named, lines(10), None)).n_lanes == 3
    with pytest.raises(InputError, match="ground_truth: is missing, it"):
        load_drive(experiment, needs_truth="it", read=in_memory(experiment, lines(10), None))


def test_a_network_in_memory_is_run_saved_and_loaded_as_the_graph_that_it_is(
    tmp_path: Path,
) -> None:
    own = simulated(parameters={"sigma1": 0.4, "bonus_value": 5})
    network = prepare_model(own).network
    experiment = with_graph(own, graph_named(network, own))
    assert experiment.parameters == {"bonus_value": 5}
    run = run_experiment(experiment)
    np.testing.assert_array_equal(run.beliefs.lane, run_experiment(own).beliefs.lane)
    back = read_result(run.save(tmp_path / "run", figures=False))
    assert (tmp_path / "run" / back.experiment.graph).is_file()
    assert back.model.compiled.hidden == run.model.compiled.hidden
    again = run_experiment(tmp_path / "run" / "experiment.yaml")
    np.testing.assert_array_equal(again.beliefs.lane, run.beliefs.lane)


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
        assert graph_named(given, simulated()) == name


@pytest.mark.parametrize(
    ("graph", "said"),
    [
        (3, "graph: int is no name, file or module, and no network of pgmpy"),
        (ModuleType("mine"), "graph: the module mine has no file; write it to one"),
    ],
)
def test_what_is_no_graph_is_refused(graph: object, said: str) -> None:
    with pytest.raises(InputError) as info:
        graph_named(graph, simulated())
    assert str(info.value) == said
