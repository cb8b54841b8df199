"""`egolane show` describes graphs, evidence rules and detectors correctly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from egolane_pgm.contracts import Detector, Rule
from egolane_pgm.inference.compile import compile_tables
from egolane_pgm.parameters import Value, resolve_parameters
from egolane_pgm.plugins import load_plugin, plugin_names
from egolane_pgm.tools.files import to_jsonable
from egolane_pgm.views.description import (
    describe_detector,
    describe_graph,
    describe_rule,
    description_text,
)
from egolane_pgm.views.tables import line_width
from tests.conformance.networks import graph, graph_names, tables_of, template


def described(name: str, *, numbers: bool = False, n_lanes: int = 3) -> dict[str, Any]:
    module = graph(name)
    parameters = resolve_parameters(module.parameters, {}, n_lanes)
    compiled = compile_tables(
        tables_of(module, n_lanes, parameters),
        hidden=module.hidden,
        observed=module.observed,
        inputs=module.inputs,
        values=module.values,
    )
    return {"name": name, **describe_graph(module, compiled, numbers=numbers)}


def test_a_graph_is_described_by_nodes_edges_tables_and_parameters() -> None:
    found = described("sensor_failure")
    assert found["nodes"][:2] == [
        {"name": "Lane", "role": "hidden", "values": ["1", "2", "3"]},
        {"name": "SensorState", "role": "hidden", "values": ["OK", "BAD"]},
    ]
    assert {node["name"]: node["role"] for node in found["nodes"]}["WOR_ve"] == "virtual evidence"
    assert found["edges"]["across"] == [("Lane", "Lane"), ("SensorState", "SensorState")]
    assert ("SensorState", "WOR") in found["edges"]["within"]
    assert found["tables"][1] == {
        "node": "Lane",
        "frames": "later frames",
        "axes": ["Lane before", "Lane"],
        "shape": [3, 3],
    }
    assert found["tables"][-1]["frames"] == "every frame"
    sigma1, *_ = found["parameters"]
    assert sigma1 == {
        "name": "sigma1",
        "kind": "sigma",
        "default": 0.4,
        "choices": [],
        "per_lane": False,
        "range": (0.0, 3.0),
        "meaning": "standard deviation of the lane dynamics, lanes; Table `tab:cptlane`",
    }


def test_an_input_is_given_and_has_no_table() -> None:
    found = described("position_in_lane")
    roles = {node["name"]: node["role"] for node in found["nodes"]}
    assert (roles["LineMotion"], roles["Lane"]) == ("input", "function")
    assert "LineMotion" not in [table["node"] for table in found["tables"]]
    text = " ".join(description_text(found).split())
    assert "virtual evidence: RoadPosition+SensorState_ve" in text


def test_numbers_are_the_tables_in_json_and_in_the_text() -> None:
    found = described("sensor_failure", numbers=True)
    output = next(table for table in found["tables"] if table["node"] == "DetectorOutput")
    table = template("sensor_failure", 3).tables["DetectorOutput", 1]
    np.testing.assert_array_equal(to_jsonable(output["values"]), table.values)
    rows = [line.split() for line in description_text(found).splitlines()]
    assert ["|", "BAD,", "2", "|", "0.3333", "|", "0.3333", "|", "0.3333", "|"] in rows
    assert ["|", "OK", "|", "0.6", "|", "0.4", "|"] in rows


def test_a_long_table_is_not_printed() -> None:
    text = description_text(described("position_in_lane", numbers=True, n_lanes=4))
    assert "P(RoadPosition given LineMotion): in the JSON only" in text


@pytest.mark.parametrize("name", graph_names())
def test_a_description_of_a_graph_fits_a_terminal(name: str) -> None:
    for numbers in (False, True):
        text = description_text(described(name, numbers=numbers))
        assert max(map(len, text.splitlines())) <= line_width()
    for spec in graph(name).parameters:
        assert f"\n  {spec.name} " in text


def rule(name: str, **given: Value) -> dict[str, Any]:
    module = load_plugin(Rule, name, "evidence")
    defaults = {spec.name: spec.default for spec in module.parameters}
    return {"name": name, **describe_rule(module, {**defaults, **given})}


def test_a_rule_is_described_by_its_evidence() -> None:
    found = rule("counting")
    assert (found["gives"], found["detector_only"]) == (["DetectorOutput", "WOR"], "DetectorOutput")
    assert (found["looks_ahead"], found["can_learn"]) == (None, False)
    found = rule("line_geometry")
    assert found["gives"] == [["RoadPosition", "SensorState"]]
    assert found["can_learn"]
    text = description_text(found)
    assert "the likelihood of RoadPosition and SensorState, jointly" in text
    assert found["looks_ahead"] is None
    assert "not causal" not in text
    whole = description_text(rule("line_geometry", lane_width_m="auto"))
    assert "it is not causal: the lane width" in whole
    assert max(map(len, whole.splitlines())) <= line_width()


@pytest.mark.parametrize("name", plugin_names(Detector))
def test_a_detector_needs_one_camera_or_two(name: str) -> None:
    module = load_plugin(Detector, name, "detector")
    found = {"name": name, **describe_detector(module)}
    text = description_text(found)
    assert f"cameras: {'two, as a stereo pair' if name.startswith('s') else 'one'}" in text
    assert found["stereo"] == name.startswith("s")
    assert max(map(len, text.splitlines())) <= line_width()
