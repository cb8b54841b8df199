"""Columns of a recording as inputs of a graph (BOUNDS), from the file to the belief."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

import egolane_pgm as ego
from egolane_pgm.model import graph_in_memory
from egolane_pgm.online import online, read_messages
from egolane_pgm.tools.files import write_yaml
from tests.kits.bags import line_bag
from tests.kits.drives import log_with_gaps, short_drive
from tests.kits.streams import messages

GRAPH = """
import numpy as np
from egolane_pgm.graphs import sensor_failure
from egolane_pgm.graphs.cpds import binary, uniform, within

HIDDEN = sensor_failure.HIDDEN
OBSERVED = sensor_failure.OBSERVED
VALUES = sensor_failure.VALUES
PARAMETERS = sensor_failure.PARAMETERS
INPUTS = ("Rain",)
BOUNDS = {"Rain": (0.5, 2.0)}


def tables(n_lanes, parameters):
    wor = np.stack([binary(0.9, 0.6), binary(0.7, 0.6), binary(0.2, 0.9)])
    return [
        *sensor_failure.tables_without_wor(n_lanes, parameters),
        *within("Rain", [], uniform(3)),
        *within("WOR", ["Rain", "SensorState"], wor),
    ]
"""

LOG = short_drive().log

#: Values at, below and above the bounds, and their indices by hand.
CYCLE, INDEX = [0.0, 0.5, 1.9, 2.0, 7.0], [0, 1, 1, 2, 2]
RAIN = np.resize(CYCLE, len(LOG))
INDICES = np.resize(INDEX, len(LOG))
MODEL: dict[str, Any] = {"evidence": "counting", "filter": "exact", "name": "rain"}


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("graph") / "rain.py"
    file.write_text(GRAPH)
    return file


@pytest.fixture(scope="module")
def result(graph: Path) -> ego.Result:
    return run(replace(LOG, covariates={"Rain": RAIN}), graph)


def run(given: Any, graph: Any, overrides: Any = None, **options: Any) -> ego.Result:
    changes = {**MODEL, **(overrides or {})}
    return ego.run(given, graph=graph, n_lanes=3, overrides=changes, **options)


def with_rain(log: ego.LineLog = LOG, name: str = "Rain", rain: Any = RAIN) -> pd.DataFrame:
    """A row per line, with the rain in each row."""
    table = log.to_pandas()
    return table.assign(**{name: rain[table.index.get_level_values("frame_id")]})


def beliefs_of(result: ego.Result) -> pd.DataFrame:
    columns = [c for c in result.frames if c.startswith(("Lane_", "Sensor", "log_evidence"))]
    return result.frames[columns].reset_index(drop=True)


def test_the_input_has_the_interval_of_its_value_and_counts(result: ego.Result) -> None:
    np.testing.assert_array_equal(result.evidence.inputs["Rain"], INDICES)
    plain = ego.run(LOG, graph="sensor_failure", n_lanes=3, overrides=MODEL)
    assert not np.allclose(result.node("Lane"), plain.node("Lane"))


def test_log_evidence_with_and_without_the_input_is_compared(
    result: ego.Result, graph: Path
) -> None:
    named = with_rain(name="mm")
    plain = run(named, "sensor_failure", {"name": "plain"})
    found = ego.compare([plain, run(named, graph, columns="Rain=mm")])
    right = result.frames["log_evidence"].mean() - plain.frames["log_evidence"].mean()
    assert found.loc["rain", "log_evidence_difference"] == pytest.approx(right)


def test_a_table_a_bag_and_messages_give_the_same(
    result: ego.Result, graph: Path, tmp_path: Path
) -> None:
    right = beliefs_of(result)
    with_rain().to_parquet(tmp_path / "a.parquet")
    with_rain(name="rain_mm").reset_index().to_csv(tmp_path / "b.csv", index=False)
    for given, columns in (
        (with_rain(), None),
        (tmp_path / "a.parquet", None),
        (tmp_path / "b.csv", "Rain=rain_mm"),
    ):
        found = run(given, graph, columns=columns)
        pd.testing.assert_frame_equal(beliefs_of(found), right)
    rows = pd.DataFrame({"frame_id": [4, 5], "offset_1": [-1.8, -1.9], "Wet": [True, False]})
    assert ego_lines(rows, "Wet=Wet").covariates["Wet"].tolist() == [1.0, 0.0]
    # The published message has a field goodLines, 1 in this bag.
    bag = line_bag(tmp_path / "c.bag", [3, 4, 6])
    assert ego.read_lines(bag, columns="Good=goodLines").covariates["Good"].tolist() == [1.0] * 3
    assert not ego.read_lines(bag).covariates


def ego_lines(table: pd.DataFrame, columns: str) -> ego.LineLog:
    result = ego.run(table, n_lanes=3, columns=columns, overrides={"min_confidence": 0.1})
    [log] = result.lines.values()
    return log


def test_frames_one_by_one_and_in_chunks_are_as_the_whole(result: ego.Result, graph: Path) -> None:
    right = beliefs_of(result)
    chunked = run(with_rain(), graph, chunk_frames=40)
    pd.testing.assert_frame_equal(beliefs_of(chunked), right)
    rows = [{**json.loads(m), "Rain": x} for m, x in zip(messages(LOG), RAIN, strict=True)]
    experiment = chunked.experiment
    answers = list(online(experiment, read_messages(experiment, map(json.dumps, rows)), ["Lane"]))
    ours = [list(answer["beliefs"]["Lane"].values()) for answer in answers]
    np.testing.assert_allclose(ours, result.node("Lane"), atol=1e-12)
    del rows[3]["Rain"]
    with pytest.raises(ego.InputError, match="message 4: columns: Rain: there is no column 'Rain'"):
        list(online(experiment, read_messages(experiment, map(json.dumps, rows))))


@pytest.mark.parametrize("policy", ["skip", "hold", "predict"])
def test_frames_that_are_selected_or_filled_in_keep_their_rain(graph: Path, policy: str) -> None:
    log = log_with_gaps()
    table = with_rain(log)
    changes = {"recording.missing_frames": policy, "recording.frames": [10, 90]}
    result = run(table, graph, changes)
    ids = result.frames.index.to_numpy()
    assert len(ids) == (76 if policy == "skip" else 80)
    before = log.frame_id[np.searchsorted(log.frame_id, ids, side="right") - 1]
    np.testing.assert_array_equal(result.evidence.inputs["Rain"], INDICES[before])
    again = run(result, graph, changes)
    pd.testing.assert_frame_equal(again.frames, result.frames)


def test_a_result_a_yaml_graph_and_a_table_of_runs_keep_it(
    result: ego.Result, graph: Path, tmp_path: Path
) -> None:
    loaded = ego.load_result(result.save(tmp_path / "saved"))
    np.testing.assert_array_equal(loaded.evidence.inputs["Rain"], INDICES)
    pd.testing.assert_frame_equal(ego.run(loaded).frames, result.frames)
    file = tmp_path / "graph.yaml"
    write_yaml(file, graph_in_memory(result.model, "unknown").keys or {})
    assert yaml.safe_load(file.read_text())["bounds"] == {"Rain": [0.5, 2.0]}
    same = run(with_rain(), file)
    pd.testing.assert_frame_equal(beliefs_of(same), beliefs_of(result))
    with_rain().reset_index().to_csv(tmp_path / "lines.csv", index=False)
    base = {"n_lanes": 3, **MODEL, "recording": {"path": tmp_path / "lines.csv"}}
    table = pd.DataFrame({"name": ["a", "b"], "graph": [str(graph), "sensor_failure"]})
    ran = ego.run(base, table=table, out=tmp_path / "runs")
    assert ran["error"].isna().all()
    assert ran.loc["a", "mean_log_evidence"] == result.scores["mean_log_evidence"]


def test_fits_and_searches_of_edges_keep_it(graph: Path) -> None:
    log = replace(LOG, covariates={"Rain": RAIN})
    more: dict[str, Any] = {
        "graph": graph,
        "ground_truth": short_drive().truth,
        "n_lanes": 3,
        "overrides": {**MODEL, "fit.folds": 2},
    }
    learned = ego.learn(log, **more)
    assert "tables.SensorState.next" in learned.fitted
    # Tables that an input selects are not learned.
    assert not any(name.startswith("tables.WOR") for name in learned.fitted)
    again = ego.run(learned)
    assert again.scores == learned.in_sample.scores
    tuned = ego.tune(log, trials=3, **more)
    assert tuned.held_out is not None
    explored = ego.explore(log, edge=["DetectorOutput repeats itself"], **more)
    assert explored.model.compiled.inputs == ("Rain",)
    for edge in ("Lane -> Rain", "Rain -> DetectorOutput", "Lane -> WOR"):
        with pytest.raises(ego.InputError, match=f"edge '{edge}': "):
            ego.explore(log, edge=[edge], **more)


# --- what is refused -----------------------------------------------------------------------------


def at(frame: int, value: Any) -> pd.DataFrame:
    """The table with another cell in all rows of a frame."""
    table = with_rain().astype({"Rain": object})
    table.loc[table.index.get_level_values("frame_id") == frame, "Rain"] = value
    return table


@pytest.mark.parametrize(
    ("given", "columns", "said"),
    [
        (LOG, None, "simulated line detector: no column Rain, an input of the graph"),
        (LOG.to_pandas(), None, "in memory: columns: Rain: there is no column 'Rain'; there are"),
        (with_rain(name="rain"), None, r"no column 'Rain' \(did you mean 'rain'\?\)"),
        (with_rain(), "Rain=rane", "columns: Rain: there is no column 'rane'"),
        (at(12, np.nan), None, "in memory: frame 12: no Rain, an input of the"),
        (at(12, ""), None, "in memory: frame 12: no Rain"),
        (at(12, "wet"), None, r"in memory: row \d+: Rain is 'wet', not a number"),
        (with_rain(), {"Rain": 3}, "unknown key 'Rain'"),
    ],
)
def test_a_column_that_cannot_be_used_is_refused_in_a_line(
    graph: Path, given: Any, columns: Any, said: str
) -> None:
    with pytest.raises(ego.InputError, match=said) as caught:
        run(given, graph, columns=columns)
    assert "\n" not in str(caught.value)


def test_rows_of_a_frame_that_differ_are_refused(graph: Path) -> None:
    table = with_rain().reset_index()
    table.loc[1, "Rain"] = 3.5
    with pytest.raises(ego.InputError, match="row 2: Rain differs from the row before, of the"):
        run(table, graph)


@pytest.mark.parametrize(
    ("bounds", "said"),
    [
        ("(2.0, 0.5)", "BOUNDS: Rain: .* do not increase"),
        ("(0.5, float('nan'))", "BOUNDS: Rain: .* do not increase"),
        ("(0.5,)", "BOUNDS: Rain has 3 values, needs 2"),
    ],
)
def test_bounds_that_do_not_fit_are_refused(tmp_path: Path, bounds: str, said: str) -> None:
    file = tmp_path / "graph.py"
    file.write_text(GRAPH.replace("(0.5, 2.0)}", f"{bounds}}}"))
    with pytest.raises(ego.InputError, match=said):
        run(with_rain(), file)
