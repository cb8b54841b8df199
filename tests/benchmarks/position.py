"""Position in lane: 4 lanes, 16 cells each, 128 joint states. The others have no banded
transitions and no input nodes: they get the same dense matrices, and the motion is held still for
all where they are compared. Their likelihoods of the states are ready, as our evidence is."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from egolane_pgm.evidence import line_geometry
from egolane_pgm.graphs import position_in_lane
from egolane_pgm.inference.compile import Compiled, compile_tables
from egolane_pgm.inference.filtering import filter_beliefs, step
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.types import Evidence, FloatArray
from tests.benchmarks import peers
from tests.benchmarks.data import N_LANES, Data
from tests.benchmarks.timing import Row, duel, take_turns

#: Frames that are stepped through one by one.
STEPS = 2000

WHAT = "position in lane, 128 joint states"


@dataclass(frozen=True)
class Position:
    """compiled: the network. evidence: of all frames, causal. still: the same as if no line ever
    moved; u: the value of the input in it."""

    parameters: Parameters
    compiled: Compiled
    evidence: Evidence
    still: Evidence
    u: int


def prepared(data: Data) -> Position:
    specs = {p.name: p for p in (*line_geometry.PARAMETERS, *position_in_lane.PARAMETERS)}
    parameters = resolve_parameters(specs.values(), {}, N_LANES)
    compiled = compile_tables(
        position_in_lane.tables(N_LANES, parameters),
        hidden=position_in_lane.HIDDEN,
        observed=position_in_lane.OBSERVED,
        inputs=position_in_lane.INPUTS,
    )
    evidence = made(data, parameters)
    u = int(parameters["motion_bins"]) // 2  # type: ignore[arg-type]
    motion = np.full(len(evidence), u)
    still = Evidence(evidence.likelihoods, {"LineMotion": motion})
    return Position(parameters, compiled, evidence, still, u)


def made(data: Data, parameters: Parameters) -> Evidence:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return line_geometry.evidence(data.log, N_LANES, parameters)


def position_rows(data: Data, rounds: int) -> list[Row]:
    position = prepared(data)
    return [
        *evidence_rows(data, position, rounds),
        *filter_rows(data, position, rounds),
        *step_rows(position, rounds),
    ]


def evidence_rows(data: Data, position: Position, rounds: int) -> list[Row]:
    rows = []
    for width in ("causal", "auto"):
        given = {**position.parameters, "lane_width_m": width}

        def ours(given: Parameters = given) -> FloatArray:
            return made(data, given).likelihoods[line_geometry.NODES]

        seconds = take_turns({"ours": ours}, min(rounds, 10))["ours"]
        rows.append(Row(f"line geometry evidence, lane width {width}", seconds, len(data.log)))
    return rows


def filter_rows(data: Data, position: Position, rounds: int) -> list[Row]:
    compiled, still, u = position.compiled, position.still, position.u

    def ours() -> FloatArray:
        return filter_beliefs(compiled, still, "exact").lane

    def moving() -> FloatArray:
        return filter_beliefs(compiled, position.evidence, "exact").lane

    others = {
        **{name: make(compiled, still, u) for name, make in peers.HMMLEARN.items()},
        "dynamax, jit": peers.dynamax_filter([compiled], still, u),
    }
    rounds = max(3, rounds // 8)
    seconds = take_turns({"ours": moving}, rounds)["ours"]
    rows = [Row(f"{WHAT}: filter, motion as measured", seconds, len(data.log))]
    what = f"{WHAT}: filter, motion held still"
    rows += [duel(what, ours, name, run, len(data.log), rounds) for name, run in others.items()]
    return rows


def step_rows(position: Position, rounds: int) -> list[Row]:
    frames = [
        position.evidence.take(slice(t, t + 1)) for t in range(min(STEPS, len(position.evidence)))
    ]

    def ours() -> None:
        state = None
        for frame in frames:
            state, _ = step(position.compiled, state, frame, "exact")

    times = take_turns({"ours": ours}, max(3, rounds // 4))
    return [Row(f"{WHAT}: online step, evidence ready", times["ours"], len(frames))]
