"""The containers' checks and the messages of wrong parameters."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from egolane_pgm.parameters import Parameter, resolve_parameters
from egolane_pgm.types import (
    Evidence,
    InputError,
    LineLog,
    lane_truth,
)


def a_log(n_frames: int = 3, n_lines: int = 2) -> LineLog:
    shape = (n_frames, n_lines)
    return LineLog(
        np.arange(n_frames) * 2 + 10,
        (np.arange(n_frames) * 2 + 10) / 10,
        np.zeros(shape),
        np.ones(shape, dtype=bool),
        np.zeros(shape, dtype=bool),
        np.full(shape, 5.0),
        source="drive.bag",
    )


# --- line logs and truth -------------------------------------------------------------------------


@pytest.mark.parametrize("ids", [[4, 5, 5], [4, 7, 6]])
def test_frame_ids_that_do_not_increase_are_refused(ids: list[int]) -> None:
    message = f"frame ids must increase, {ids[1]} is followed by {ids[2]}"
    with pytest.raises(InputError, match=f"^drive.bag: {message}$"):
        replace(a_log(), frame_id=np.array(ids))
    with pytest.raises(InputError, match=message):
        lane_truth(ids, [1, 1, 1], [False] * 3)


def test_arrays_of_another_shape_are_refused_naming_the_array() -> None:
    for name, shape, said in (
        *((name, (3, 3), "(3, 3), needs (3, 2)") for name in ("is_valid", "is_continuous", "lri")),
        *((name, (2,), "(2,), needs (3,)") for name in ("time_s", "is_missing")),
        ("offset_m", (3,), "(3,), needs (3, 3)"),
        ("offset_m", (2, 2), "(2, 2), needs (3, 2)"),
        ("frame_id", (3, 1), "(3, 1)"),
    ):
        with pytest.raises(InputError, match=re.escape(f"drive.bag: {name} has shape {said}")):
            replace(a_log(), **{name: np.zeros(shape, dtype=int)})  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_an_offset_that_is_no_number_is_refused_on_a_valid_line_only(value: float) -> None:
    offset = np.zeros((3, 2))
    offset[1, 1] = value
    with pytest.raises(InputError) as error:
        replace(a_log(), offset_m=offset)
    assert str(error.value) == (
        f"drive.bag: frame 12: line 2 is valid but its offset is {value};"
        " drop it or mark it not valid"
    )
    kept = replace(a_log(), offset_m=offset, is_valid=np.zeros((3, 2), dtype=bool))
    assert len(kept) == 3


def test_taking_frames_keeps_every_array_in_step() -> None:
    log = replace(a_log(), lri=np.arange(6.0).reshape(3, 2))
    some = log.take(np.array([True, False, True]))
    assert some.frame_id.tolist() == [10, 14]
    assert some.lri.tolist() == [[0, 1], [4, 5]]
    assert some.source == "drive.bag"


def test_lines_given_one_after_the_other_are_padded_frame_by_frame() -> None:
    row, offset, lri = np.array([0, 0, 2]), np.array([-1.8, 1.7, 1.6]), np.array([9.0, 8.0, 7.0])
    valid, ids = np.array([True, False, True]), np.array([5, 6, 8])
    log = LineLog.from_rows(ids, 4.0, row, offset, valid, ~valid, lri, source="here")
    nan = np.nan
    np.testing.assert_array_equal(log.offset_m, [[-1.8, 1.7], [nan, nan], [1.6, nan]])
    np.testing.assert_array_equal(log.lri, [[9, 8], [nan, nan], [7, nan]])
    assert log.is_valid.tolist() == [[True, False], [False, False], [True, False]]
    assert log.is_continuous.tolist() == [[False, True], [False, False], [False, False]]
    assert (log.time_s.tolist(), log.source) == ([1.25, 1.5, 2.0], "here")
    assert not log.is_missing.any()
    assert LineLog.from_rows(ids[:0], 4.0, row[:0], *[offset[:0]] * 4).offset_m.shape == (0, 0)
    both = LineLog.concat([a_log(1, 1), replace(log, frame_id=ids + 20)])
    assert np.isnan(both.offset_m[0, 1])
    assert both.frame_id.tolist() == [10, 25, 26, 28]


# --- evidence and beliefs ------------------------------------------------------------------------


def test_evidence_of_different_lengths_is_refused_with_the_lengths() -> None:
    with pytest.raises(InputError, match=r"different numbers of frames: A 2, B 3$"):
        Evidence({"A": np.ones((2, 2)), "B": np.ones((3, 2))})
    with pytest.raises(InputError, match=r"different numbers of frames: A 2, I 1$"):
        Evidence({"A": np.ones((2, 2))}, {"I": np.zeros(1, dtype=int)})


@pytest.mark.parametrize("value", [-1e-9, math.nan, math.inf])
def test_evidence_that_is_negative_or_no_number_is_refused_naming_node_and_frame(
    value: float,
) -> None:
    values = np.ones((3, 2))
    values[2, 1] = value
    with pytest.raises(InputError, match="evidence for WOR: frame 2"):
        Evidence({"WOR": values})


def test_evidence_may_be_zero_and_need_not_sum_to_one() -> None:
    evidence = Evidence({"A": np.array([[0.0, 0.0], [5.0, 3.0]])}, {"I": np.array([0, 1])})
    assert len(evidence) == 2
    assert len(Evidence({})) == 0
    last = evidence.take(slice(1, 2))
    assert last.likelihoods["A"].tolist() == [[5, 3]]
    assert last.inputs["I"].tolist() == [1]


# --- parameters ----------------------------------------------------------------------------------

SPECS = (
    Parameter("sigma1", "sigma", 0.4, "standard deviation"),
    Parameter("p1", "probability", 0.9, "a probability"),
    Parameter("p3", "probability", 0.6, "a probability", per_lane=True),
    Parameter("width", "positive", 3.5, "a width"),
    Parameter("noise", "non_negative", 0.0, "a noise"),
    Parameter("count", "integer", 2, "a count"),
    Parameter("normal", "choice", "density", "a choice", choices=("density", "integral")),
)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("p1", 1.3, "1.3 is not a probability (0 to 1)"),
        ("p1", math.nan, "nan is not a finite number"),
        ("p1", True, "True is not a number"),
        ("p1", "0.5", "'0.5' is not a number"),
        ("p1", [0.1, 0.2, 0.3], "needs one number, got a list"),
        ("p3", [0.1, 0.2], "has 2 values for 3 lanes"),
        ("sigma1", 0, "0 must be greater than 0"),
        ("sigma1", math.inf, "inf is not a finite number"),
        ("noise", -0.5, "-0.5 must be at least 0"),
        ("count", 1.5, "1.5 is not a whole number"),
        ("count", -1, "-1 must be at least 0"),
        ("normal", "densty", "'densty' is not one of density, integral (did you mean 'density'?)"),
    ],
)
def test_a_value_out_of_range_is_refused_with_the_key_and_the_reason(
    name: str, value: object, message: str
) -> None:
    with pytest.raises(InputError) as error:
        resolve_parameters(SPECS, {name: value}, 3)
    assert str(error.value) == f"parameters.{name}: {message}"


def test_an_unknown_key_is_refused_with_a_suggestion() -> None:
    with pytest.raises(InputError) as error:
        resolve_parameters(SPECS, {"sigma_1": 0.4}, 3)
    assert str(error.value) == "parameters: unknown key 'sigma_1' (did you mean 'sigma1'?)"
    with pytest.raises(InputError, match=r"^graph: unknown key 'zzz' \(known: count, noise, "):
        resolve_parameters(SPECS, {"zzz": 1}, 3, "graph")


def test_what_is_not_given_has_its_default_and_what_is_given_its_own_type() -> None:
    values = resolve_parameters(SPECS, {"p1": 1, "count": 3.0, "p3": np.array([0.1, 0.2, 1])}, 3)
    assert values["sigma1"] == 0.4
    assert (values["p1"], type(values["p1"])) == (1.0, float)
    assert (values["count"], type(values["count"])) == (3, int)
    assert values["p3"] == (0.1, 0.2, 1.0)
    assert resolve_parameters(SPECS, {"p1": np.float32(0.5)}, 3)["p1"] == 0.5
