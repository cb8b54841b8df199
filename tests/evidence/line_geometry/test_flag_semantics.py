"""Recordings of detectors that use flags, LRI and offsets in their own ways, or have another frame
rate: the rule finds the same in their lines."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache, reduce
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.evidence import line_geometry
from egolane_pgm.evidence.line_geometry import kernels
from egolane_pgm.evidence.line_geometry.flag_semantics import (
    NO_LINES,
    FlagSemantics,
    LineCounts,
    added,
    columns,
    count_lines,
    flag_semantics_of,
    is_placed,
)
from egolane_pgm.evidence.line_geometry.model import CLUTTER_PER_M
from egolane_pgm.evidence.line_geometry.reading import NO_FRAME, read_lines
from egolane_pgm.evidence.line_geometry.rule import NODES
from egolane_pgm.evidence.line_geometry.scale import line_classes
from egolane_pgm.parameters import Parameters
from egolane_pgm.simulation import SimulatedDrive, simulate
from egolane_pgm.types import FloatArray, LineLog
from tests.kits import line_logs
from tests.reference import line_geometry as _line_geometry_numpy


def counted(log: LineLog) -> LineCounts:
    return count_lines([columns(log)])


@cache
def drive() -> SimulatedDrive:
    return simulate("quickstart", seed=1, frames=900)


def resolved(**given: object) -> Parameters:
    """Unless `lane_width_m` is given, what is unusual is found in the whole recording."""
    return line_logs.resolved(**{"lane_width_m": "auto", **given})


def read(log: LineLog, **given: object) -> tuple[FloatArray, list[str]]:
    """The joint likelihood (T, n cells, 2), and what was said."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        evidence = line_geometry.evidence(log, 3, resolved(**given))
    return evidence.likelihoods[NODES], [str(w.message) for w in caught]


def same(log: LineLog, other: LineLog, **given: object) -> list[str]:
    """That both logs read the same; what was said of the other beside its lane width."""
    here, there = read(log, **given)[0], read(other, **given)
    np.testing.assert_allclose(there[0], here, atol=1e-9)
    return [text for text in there[1] if "lane width" not in text]


# --- LRI -----------------------------------------------------------------------------------------


@settings(max_examples=10, deadline=None)
@given(full=st.floats(1e-3, 1e4))
def test_the_lri_may_have_any_scale(full: float) -> None:
    log = drive().log
    messages = same(log, replace(log, lri=log.lri * (full / 10)))
    assert len(messages) == (0 if 7.5 < full < 13.5 else 1)
    if messages:
        assert f"the LRI of well tracked lines is {full:g}, not 10" in messages[0]


def test_numbers_from_nowhere_do_not_change_the_scale_of_the_lri() -> None:
    """The multi-lane detector reports an LRI of 1.9e9 now and then."""
    log = drive().log
    lri = np.where(np.random.default_rng(0).random(log.lri.shape) < 0.02, 1.9e9, log.lri)
    assert flag_semantics_of(counted(replace(log, lri=lri)), "x").full_lri == 10


@pytest.mark.parametrize("value", [10.0, 1.0, 0.0, -1.0])
def test_an_lri_that_never_changes_is_as_unknown(value: float) -> None:
    log = drive().log
    unknown = replace(log, lri=np.full(log.lri.shape, np.nan))
    constant = replace(log, lri=np.where(is_placed(log.offset_m), value, np.nan))
    (message,) = same(unknown, constant)
    assert "it is ignored" in message
    assert not same(unknown, unknown)


def test_without_an_lri_a_line_that_repeats_its_offset_is_held() -> None:
    """But not where offsets have so few digits that they repeat by chance."""
    log, rng = drive().log, np.random.default_rng(0)
    steady = replace(log, lri=np.where(is_placed(log.offset_m), 10.0, np.nan))
    coarse = replace(steady, offset_m=np.round(log.offset_m, 1))
    assert [
        flag_semantics_of(counted(each), "x").repeats_are_held for each in (log, steady, coarse)
    ] == [
        False,
        True,
        False,
    ]
    # Every line held for two frames of three: the lines that count are those of the third.
    is_fresh = (np.arange(len(log)) % 3 == 0)[:, None]
    frozen = np.arange(len(log)) // 3 * 3
    held = replace(
        log,
        offset_m=(log.offset_m + rng.normal(0, 0.01, log.offset_m.shape))[frozen],
        is_valid=log.is_valid[frozen],
        lri=np.full(log.lri.shape, np.nan),
    )
    gone = replace(
        held,
        offset_m=np.where(is_fresh, held.offset_m, np.nan),
        is_valid=held.is_valid & is_fresh,
    )
    widths = np.full(len(log), 3.75)
    ours, theirs = (
        read_lines(
            each,
            line_classes(each.offset_m, each.is_valid, each.is_continuous, each.lri)[0],
            widths,
            repeats_are_held=True,
        )[0].kind
        for each in (held, gone)
    )
    np.testing.assert_array_equal(ours >= 0, theirs >= 0)


# --- flags ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.0, 0.02])
def test_a_valid_flag_that_hardly_any_line_has_is_ignored(share: float) -> None:
    log = drive().log
    valid = log.is_valid & (np.random.default_rng(0).random(log.is_valid.shape) < share)
    (message,) = same(replace(log, is_valid=is_placed(log.offset_m)), replace(log, is_valid=valid))
    assert (
        f"only {int(valid.sum())} of {int(is_placed(log.offset_m).sum())} lines are valid"
        in message
    )


@pytest.mark.parametrize("flagged", ["one", "all"])
def test_a_continuous_flag_that_one_line_has_or_all_is_ignored(flagged: str) -> None:
    log = drive().log
    none = np.zeros(log.is_valid.shape, dtype=bool)
    flags = is_placed(log.offset_m)
    if flagged == "one":
        flags = none.copy()
        flags[tuple(np.argwhere(log.is_valid & is_placed(log.offset_m))[77])] = True
    messages = same(replace(log, is_continuous=none), replace(log, is_continuous=flags))
    assert len(messages) == 1
    assert "are continuous; the flag is ignored" in messages[0]


def test_an_ordinary_detector_is_left_alone() -> None:
    log = drive().log
    found = flag_semantics_of(counted(log), "x")
    assert found == FlagSemantics(10.0, uses_valid=True, uses_continuous=True)
    assert not [text for text in read(log)[1] if "lane width" not in text]


def test_counts_of_parts_add_up_to_that_of_the_drive() -> None:
    log = drive().log
    parts = [counted(log.take(slice(a, b))) for a, b in pairwise([0, 1, 300, 300, len(log)])]
    total = reduce(added, parts, NO_LINES)
    assert flag_semantics_of(total, "x") == flag_semantics_of(counted(log), "x")
    np.testing.assert_array_equal(total.numbers, counted(log).numbers)


# --- offsets -------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", [100.0, 1 / 0.3048, 2.0, 0.25])
def test_offsets_in_another_unit_are_brought_to_the_expected_lane_width(unit: float) -> None:
    log = drive().log
    in_lanes = replace(log, offset_m=log.offset_m * (3.5 / 3.75))
    here, _ = read(in_lanes, lane_width_m=3.5)
    there, messages = read(replace(log, offset_m=log.offset_m * unit), lane_width_m=3.75 * unit)
    np.testing.assert_allclose(there, here, atol=1e-6)
    # Found, not given: to a per cent.
    found, messages = read(replace(log, offset_m=log.offset_m * unit))
    assert "no lane has that in metres, offsets are taken to be in another unit" in messages[0]
    assert np.abs(found - here).mean() < 0.03


def test_lines_that_are_too_far_to_be_used_give_a_warning() -> None:
    log = drive().log
    _, messages = read(replace(log, offset_m=log.offset_m * 100), lane_width_m=3.75)
    assert len(messages) == 1
    assert "are 17.14 m away or more and are not used, with lanes of 3.75 m;" in messages[0]
    assert "are offsets in metres from the vehicle?" in messages[0]


@pytest.mark.parametrize(("shift", "side"), [(1.2, "right"), (-1.2, "left")])
def test_a_camera_that_is_not_in_the_middle_gives_a_warning(shift: float, side: str) -> None:
    log = drive().log
    offset = np.where(is_placed(log.offset_m), log.offset_m + shift, log.offset_m)
    _, messages = read(replace(log, offset_m=offset), lane_width_m=3.75)
    (text,) = messages
    assert f"m {side} of where a vehicle in the middle of its lane has them" in text


# --- lines reported twice ------------------------------------------------------------------------


@pytest.mark.parametrize("apart", [0.0, 0.05, 0.2])
def test_lines_that_are_reported_twice_count_once(apart: float) -> None:
    log = drive().log
    twice = LineLog(
        log.frame_id,
        log.time_s,
        # The second one further away: the nearer of two alike counts.
        np.hstack([log.offset_m, log.offset_m + apart * np.sign(log.offset_m)]),
        *(np.hstack([a, a]) for a in (log.is_valid, log.is_continuous, log.lri)),
    )
    given = {"lane_width_m": 3.75, "clutter": CLUTTER_PER_M.tolist()}
    once, both = read(log, **given)[0], read(twice, **given)
    # Beside the few doubles that the drive has itself.
    assert (np.abs(once - both[0]).max(axis=(1, 2)) > 1e-6).mean() < 0.15
    (message,) = both[1]
    assert "lie within 0.1 lane widths of another one; such lines count once" in message


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n_lines=st.integers(0, 7))
def test_of_two_lines_close_together_the_better_one_is_kept(seed: int, n_lines: int) -> None:
    rng = np.random.default_rng(seed)
    offset = np.round(rng.uniform(-2, 2, (30, n_lines)), 1)
    kind = rng.integers(-1, 4, (30, n_lines))
    near = rng.uniform(0, 0.6, 30)
    found = []
    for module in (kernels, _line_geometry_numpy):
        before = np.zeros(2, dtype=np.int64)
        is_double, lines = module.find_doubles(offset, kind, near / kernels.DOUBLE, before)
        assert lines[-1].tolist() == [(kind >= 0).sum(), is_double.sum()]
        found.append((is_double, lines))
    (ours, lines), (twin, of_twin) = found
    np.testing.assert_array_equal(ours, twin)
    np.testing.assert_array_equal(lines, of_twin)


# --- frame rates ---------------------------------------------------------------------------------


def test_evidence_weighs_by_the_time_since_the_frame_before() -> None:
    log = drive().log.take(slice(0, 40))
    given = {"lane_width_m": 3.75, "clutter": CLUTTER_PER_M.tolist()}
    once, _ = read(log, **given)
    thrice, _ = read(replace(log, time_s=3 * log.time_s), **given)
    np.testing.assert_allclose(np.log(thrice[1:]), 3 * np.log(once[1:]), atol=1e-9)
    # Never more than once, however long it is.
    long, _ = read(replace(log, time_s=1e6 * log.time_s), **given)
    full, _ = read(log, **given, alpha=1.0, beta=1.0)
    np.testing.assert_allclose(np.log(long[1]), np.log(full[1]), atol=1e-9)


def frame_weights(log: LineLog) -> FloatArray:
    weights: FloatArray = kernels.count_ticks(log.frame_id, log.time_s, NO_FRAME)[1]
    return weights


def test_ten_frames_a_second_weigh_one_each() -> None:
    log = drive().log
    assert (frame_weights(log) == 1).all()
    late = replace(log, frame_id=log.frame_id + 10**9, time_s=(log.frame_id + 10**9) / 10.0)
    assert (frame_weights(late) == 1).all()
    unknown = replace(log, time_s=np.full(len(log), np.nan))
    assert (frame_weights(unknown) == 1).all()


@pytest.mark.parametrize(
    ("rate", "frame_id", "ticks", "weights"),
    [
        (10, [0, 1, 2, 5, 6], [1, 1, 1, 3, 1], [1, 1, 1, 1, 1]),
        (30, [0, 1, 2, 3, 4, 5, 6], [1, 0, 0, 1, 0, 0, 1], [1, *[1 / 3] * 6]),
        # Frames thinned by their reader are no gap, if a tick is not longer.
        (30, [0, 3, 6, 15], [1, 1, 1, 3], [1, 1, 1, 1]),
        (5, [0, 1, 2, 5], [1, 2, 2, 6], [1, 2, 2, 2]),
        (12, [0, 1, 2, 3, 4, 5, 6], [1, 1, 0, 1, 1, 1, 1], [1, *[10 / 12] * 6]),
    ],
)
def test_ticks_are_tenths_of_a_second(
    rate: float, frame_id: list[int], ticks: list[int], weights: list[float]
) -> None:
    """Absent frames are frames without lines, so the frame after them weighs one frame."""
    ids = np.array(frame_id)
    found = kernels.count_ticks(ids, ids / rate, NO_FRAME)
    assert found[0].tolist() == ticks
    np.testing.assert_allclose(found[1], weights, atol=1e-6)


# --- online --------------------------------------------------------------------------------------


def test_one_frame_after_the_other_finds_out_as_well() -> None:
    """LRI 0 to 1, centimetres, every line twice, no line valid, one continuous: after a while the
    evidence is that of the whole recording with the same lane width."""
    log = simulate("quickstart", seed=4, frames=500).log
    flags = np.zeros(log.is_valid.shape, dtype=bool)
    flags[0, 0] = True
    odd = LineLog(
        log.frame_id,
        log.time_s,
        100 * np.hstack([log.offset_m, log.offset_m]),
        *(np.hstack([a, a]) for a in (np.zeros_like(flags), flags, log.lri / 10)),
    )
    parameters = resolved(lane_width_m=375, clutter=CLUTTER_PER_M.tolist())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        whole = line_geometry.evidence(odd, 3, parameters)
    give = line_geometry.online(3, parameters)
    cuts = [0, 1, 2, 150, 150, 420, len(odd)]
    parts = [give(odd.take(slice(a, b))) for a, b in pairwise(cuts)]
    ours = np.concatenate([p.likelihoods[NODES] for p in parts])
    np.testing.assert_allclose(ours[202:], whole.likelihoods[NODES][202:], atol=1e-9)
    motion = np.concatenate([p.inputs["LineMotion"] for p in parts])
    np.testing.assert_array_equal(motion[202:], whole.inputs["LineMotion"][202:])


# --- learning ------------------------------------------------------------------------------------


def test_what_is_learned_does_not_depend_on_how_the_detector_fills_its_columns() -> None:
    log, lane = drive().log, drive().truth["true_lane"].to_numpy()
    everywhere = np.ones(len(log), dtype=bool)
    odd = replace(log, lri=log.lri / 10, offset_m=log.offset_m * 100)
    in_lanes = replace(log, offset_m=log.offset_m * (3.5 / 3.75))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = [
            line_geometry.fit([(each, lane, everywhere)], 3, resolved(lane_width_m=width))
            for each, width in ((in_lanes, 3.5), (odd, 375))
        ]
    for name in found[0]:
        np.testing.assert_allclose(found[1][name], found[0][name], rtol=1e-6)
