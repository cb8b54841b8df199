"""Runs whose parameters are at the ends of what is allowed: refused in a line, or right numbers."""

from __future__ import annotations

import importlib
import warnings

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.parameters import LARGEST, Parameter

#: Graphs and rules that go together, whatever the drive.
PAIRS = [
    ("sensor_failure", "counting"),
    ("position_in_lane", "line_geometry"),
]


def end(spec: Parameter, rng: np.random.Generator) -> object:
    """One of the smallest and largest values of a number; other kinds keep their default."""
    if spec.kind in ("text", "choice", "integer") or spec.shape is not None:
        return spec.default
    ends = [spec.lowest, 5e-324, 1e-300, 1e-9, spec.highest, LARGEST]
    if spec.kind == "probability":
        ends = [0.0, 1.0, 5e-324, 1 - 2**-53]
    elif spec.kind in ("sigma", "positive"):
        ends = [value for value in ends if value > 0]
    allowed = [value for value in ends if spec.lowest <= value <= min(spec.highest, LARGEST)]
    return float(rng.choice(allowed))


@pytest.mark.parametrize("seed", range(8))
def test_parameters_at_their_ends_give_beliefs_and_no_warnings(seed: int) -> None:
    rng = np.random.default_rng(seed)
    graph, rule = PAIRS[seed % len(PAIRS)]
    parts = [f"graphs.{graph}", f"evidence.{rule}"]
    specs = [s for p in parts for s in importlib.import_module(f"egolane_pgm.{p}").PARAMETERS]
    parameters = {spec.name: end(spec, rng) for spec in specs}
    changes = {
        "graph": graph,
        "evidence": rule,
        "filter": "exact",
        "recording.frames": [0, 40],
        "parameters": parameters,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            result = ego.run(ego.experiments_folder() / "zero_label.yaml", overrides=changes)
        except ego.InputError:
            return
    for name in result.model.values:
        np.testing.assert_allclose(result.node(name).sum(axis=1), 1, rtol=1e-9, err_msg=name)
    assert np.isfinite(result.frames["log_evidence"]).all()


def test_what_no_graph_can_use_is_refused() -> None:
    place = ego.experiments_folder() / "zero_label.yaml"
    few = {"recording.frames": [0, 40], "evidence": "counting"}
    with pytest.raises(ego.InputError, match=r"lane_width_m: 1.7e\+308 must be at most 1e\+100"):
        ego.run(place, overrides={**few, "parameters.lane_width_m": 1.7e308})
