"""Graphs of roads whose lanes change, on a road that does not: beside those of a fixed road."""

from __future__ import annotations

import numpy as np

from egolane_pgm.graphs import changing_lanes, position_in_changing_lanes
from egolane_pgm.inference.compile import compile
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.types import Evidence, FloatArray
from tests.benchmarks import position
from tests.benchmarks.data import N_LANES, PARAMETERS, Data
from tests.benchmarks.timing import Row, largest_difference, take_turns


def changing_rows(data: Data, rounds: int) -> list[Row]:
    names = {p.name for p in changing_lanes.PARAMETERS}
    paper = {name: value for name, value in PARAMETERS.items() if name in names}
    given = resolve_parameters(changing_lanes.PARAMETERS, paper, N_LANES)
    compiled = compile(
        changing_lanes.build(N_LANES, given),
        hidden=changing_lanes.HIDDEN,
        observed=changing_lanes.OBSERVED,
        inputs=changing_lanes.INPUTS,
    )
    n_frames, seen = len(data.log), data.evidence.likelihoods
    joint = np.zeros((n_frames, N_LANES, N_LANES))
    joint[:, :, -1] = seen["DetectorOutput"]
    lanes = Evidence(
        {
            ("DetectorOutput", "Lanes"): joint,
            "WOR": seen["WOR"],
            "Lane": np.ones((n_frames, N_LANES)),
        },
        {"Step": np.zeros(n_frames, dtype=np.int64)},
    )
    fixed = position.prepared(data)
    of_positions = resolve_parameters(
        position_in_changing_lanes.PARAMETERS,
        {p.name: fixed.parameters[p.name] for p in position_in_changing_lanes.fixed.PARAMETERS},
        N_LANES,
    )
    positions = compile(
        position_in_changing_lanes.build(N_LANES, of_positions),
        hidden=position_in_changing_lanes.HIDDEN,
        observed=position_in_changing_lanes.OBSERVED,
        inputs=position_in_changing_lanes.INPUTS,
    )
    moved = Evidence(fixed.evidence.likelihoods, {"Step": fixed.evidence.inputs["LineMotion"]})
    rows = []
    for what, ours, against, theirs in (
        ("changing_lanes", (compiled, lanes), "sensor_failure", (data.compiled, data.evidence)),
        (
            "position_in_changing_lanes",
            (positions, moved),
            "position_in_lane",
            (fixed.compiled, fixed.evidence),
        ),
    ):

        def run(of: tuple[object, Evidence] = ours) -> FloatArray:
            return filter_beliefs(of[0], of[1], "exact").lane  # type: ignore[arg-type]

        def other(of: tuple[object, Evidence] = theirs) -> FloatArray:
            return filter_beliefs(of[0], of[1], "exact").lane  # type: ignore[arg-type]

        times = take_turns({"ours": run, "theirs": other}, rounds)
        rows.append(
            Row(
                f"{what} on a road that does not change: filter",
                times["ours"],
                n_frames,
                against,
                times["theirs"],
                largest_difference(run(), other()),
            )
        )
    return rows
