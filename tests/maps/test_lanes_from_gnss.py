"""The offset to the middle of the road as evidence of the lane, beside the lines."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from egolane_pgm.experiment import Gnss
from egolane_pgm.graphs.cpds import Table, declare, dynamics, previous, prior
from egolane_pgm.inference.compile import compile
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.maps.lanes_from_gnss import (
    _JUMP_S,
    Across,
    _drifts,
    _wander,
    across,
    beside_lines,
)
from egolane_pgm.maps.road_table import RoadTable
from egolane_pgm.types import BoolArray, Evidence, FloatArray, LineLog
from tests.reference.oracle import oracle_filter

W = 3.5


NOISE = Gnss(lane_width_m=3.5, sigma_m=1.0, drift_sigma_m=1.0, drift_s=20.0)

#: A car that mostly keeps its lane.
STAYS = np.array([[0.9, 0.1, 0.0], [0.05, 0.9, 0.05], [0.0, 0.1, 0.9]])

SILENT = np.ones((1, 3))


def seen(metres: list[float], sigma: float = np.nan) -> Across:
    return Across(np.array(metres), np.full(len(metres), sigma))


def lanes_only() -> list[Table]:
    return [*prior("Lane", [0.2, 0.5, 0.3]), *dynamics("Lane", [previous("Lane")], STAYS)]


def said_by(across_road: Across, lines: FloatArray, noise: Gnss = NOISE) -> FloatArray:
    """What positions say, one a second, beside lines of these likelihoods (T, 3). Where these are
    all 1 no line is seen."""
    compiled = compile(declare(lanes_only(), ["Lane"]), hidden=("Lane",), observed=["Lane"])
    log = seen_once_a_second((lines < 1).any(axis=1))
    return beside_lines(compiled, Evidence({"Lane": lines}), "Lane", log, across_road, noise)


def seen_once_a_second(has_lines: BoolArray) -> LineLog:
    n, valid = len(has_lines), has_lines[:, None]
    offset = np.where(valid, 1.5, np.nan)
    return LineLog(np.arange(n), np.arange(n) * 1.0, offset, valid, ~valid & False, offset * 0)


def test_the_belief_is_that_of_the_network_with_the_drift_as_one_more_node() -> None:
    """By pgmpy's variable elimination."""
    noise = Gnss(lane_width_m=3.5, sigma_m=1.5, drift_sigma_m=1.5, drift_s=4.0)
    metres, lines = np.array([6.5, 9.9, 8.8]), np.array([[0.3, 1, 0.2], [1, 1, 0.9], [0.1, 0.9, 1]])
    start, rates = _wander(noise)
    stays = np.exp(-1 / _JUMP_S)
    moves = stays * expm(rates) + (1 - stays) * start
    network = declare(
        [*lanes_only(), *prior("Drift", start), *dynamics("Drift", [previous("Drift")], moves)],
        ["Lane", ("Lane", "Drift")],
    )
    centre = np.array([1.75, 5.25, 8.75])
    off = metres[:, None, None] - centre[:, None] - _drifts(noise)
    density = 0.95 * np.exp(-0.5 * (off / 1.5) ** 2) / np.sqrt(2 * np.pi) / 1.5 + 0.05 / 50
    both = Evidence({"Lane": lines, ("Lane", "Drift"): density})
    right = oracle_filter(network, ("Lane", "Drift"), ["Lane", ("Lane", "Drift")], both).lane

    compiled = compile(declare(lanes_only(), ["Lane"]), hidden=("Lane",), observed=["Lane"])
    joint = lines * said_by(seen(list(metres)), lines, noise)
    ours = filter_beliefs(compiled, Evidence({"Lane": joint})).lane
    np.testing.assert_allclose(ours, right, rtol=0, atol=1e-9)


def test_without_drift_a_position_is_worth_its_noise() -> None:
    noise = Gnss(lane_width_m=3.5, sigma_m=1.0, drift_sigma_m=0.0)
    said = said_by(seen([5.0]), SILENT, noise)
    off = 5.0 - np.array([1.75, 5.25, 8.75])
    normal = 0.95 * np.exp(-0.5 * off**2) / np.sqrt(2 * np.pi) + 0.05 / 50
    np.testing.assert_allclose(said[0], normal / normal.max())


def test_a_bias_that_lasts_is_evidence_of_the_lane_once() -> None:
    """A minute of the same position says little more than the first of them."""
    stays = [*prior("Lane", np.full(3, 1 / 3)), *dynamics("Lane", [previous("Lane")], np.eye(3))]
    compiled = compile(declare(stays, ["Lane"]), hidden=("Lane",), observed=["Lane"])
    silent, log = Evidence({"Lane": np.ones((60, 3))}), seen_once_a_second(np.ones(60, dtype=bool))
    said = beside_lines(compiled, silent, "Lane", log, seen([9.4] * 60), Gnss())
    belief = filter_beliefs(compiled, Evidence({"Lane": said})).lane[:, 2]
    assert 0.4 < belief[0] < 0.6
    assert abs(belief[-1] - belief[0]) < 0.1


def test_in_a_mirror_the_lanes_are_mirrored() -> None:
    rng = np.random.default_rng(3)
    metres, lines = rng.uniform(0, 10.5, 20), rng.dirichlet(np.ones(3), 20)
    metres[[4, 11]] = np.nan
    # The first frame's prior is not symmetric.
    lines[0] = [0, 1, 0]
    said = said_by(Across(metres, np.full(20, np.nan)), lines)
    other = said_by(Across(10.5 - metres, np.full(20, np.nan)), lines[:, ::-1])
    np.testing.assert_allclose(other, said[:, ::-1], rtol=1e-6)
    assert (said[[4, 11]] == 1).all()


def test_no_position_is_told_of_before_it_is_there() -> None:
    rng = np.random.default_rng(4)
    metres, lines = rng.uniform(0, 10.5, 20), rng.dirichlet(np.ones(3), 20)
    whole = said_by(seen(list(metres)), lines)
    half = said_by(seen(list(metres[:10])), lines[:10])
    np.testing.assert_array_equal(whole[:10], half)


def test_the_drift_that_the_lines_tell_is_taken_off_where_they_are_missing() -> None:
    """The receiver errs by a lane; by itself it would be believed."""
    known, unknown = np.tile([0, 1.0, 0], (10, 1)), np.ones((5, 3))
    said = said_by(seen([5.25 + 3.5] * 15), np.concatenate([known, unknown]))
    assert said[0].argmax() == 2
    assert (said[10:].argmax(axis=1) == 1).all()


def test_a_receiver_that_says_it_is_unsure_says_little() -> None:
    assert said_by(seen([1.75]), SILENT)[0, 2] < 0.1
    assert said_by(seen([1.75], 20.0), SILENT)[0, 2] > 0.9


def test_a_position_far_off_the_road_says_nothing() -> None:
    np.testing.assert_allclose(said_by(seen([400.0]), SILENT), 1.0)


def table(t_s: list[float], offset_m: list[float], n: int, way_line: float) -> RoadTable:
    rows = len(t_s)
    nothing, whole = np.full(rows, np.nan), np.zeros(rows, dtype=np.int64)
    return RoadTable(
        t_s=np.array(t_s), segment=whole, along_m=np.arange(rows) * 30.0,
        offset_m=np.array(offset_m), sigma_m=nothing, way_line=np.full(rows, way_line),
        sure=np.ones(rows), n_lanes=whole + n, next_n_lanes=whole, next_in_m=nothing,
        next_shift=nothing, next_join=np.full(rows, ""), next_side=whole,
        next_optional=np.full(rows, ""),
    )  # fmt: skip


def test_a_position_counts_once_in_the_first_frame_behind_it() -> None:
    time_s = np.arange(0, 3, 0.1)
    said = across(
        table([0.0, 1.05, 2.0, 9.0], [0, 1, np.nan, 5], 3, 1.0), time_s, np.full(30, 3), 3.5
    )
    assert np.flatnonzero(np.isfinite(said.metres)).tolist() == [0, 11]
    np.testing.assert_allclose(said.metres[[0, 11]], [3.5, 4.5])


def test_where_the_map_has_another_number_of_lanes_its_line_is_the_middle() -> None:
    time_s = np.arange(0, 1, 0.1)
    for lanes, way_line, left in ((3, 1.0, 3.5), (4, 1.0, 7.0), (3, np.nan, 5.25)):
        said = across(table([0.0], [0.0], 3, way_line), time_s, np.full(10, lanes), 3.5)
        assert said.metres[0] == pytest.approx(left)
