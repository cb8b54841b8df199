"""Clocks: units, and steps that no recording has."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

import egolane_pgm as ego
from egolane_pgm.recordings.clock import EPOCH_S, STEP_S, clock_warning, unit_of

N_FRAMES = 12


@pytest.mark.parametrize(
    ("number", "plausible_s", "unit"),
    [
        (1.79e9, EPOCH_S, "s"),
        (1.79e12, EPOCH_S, "ms"),
        (1.79e15, EPOCH_S, "us"),
        (1.79e18, EPOCH_S, "ns"),
        # 1989 and 2101.
        (6.2e8, EPOCH_S, None),
        (4.2e9, EPOCH_S, None),
        (2.0, STEP_S, "s"),
        (5.0, STEP_S, "ms"),
        (2.1, STEP_S, None),
        (0.0, STEP_S, None),
    ],
)
def test_the_unit_of_a_number_gives_a_plausible_time(
    number: float, plausible_s: tuple[float, float], unit: str | None
) -> None:
    assert unit_of(number, plausible_s) == unit


@pytest.mark.parametrize(
    ("first", "step", "unit", "cure"),
    [
        (0, 2.0, "s", None),
        (0, 1 / 200, "s", None),
        (0, 2.1, "s", "; if it is right, set recording.frame_rate"),
        (0, 100, "s", "; if the times are in ms, set `columns: {time_unit: ms}`; if it is right, "),
        (0, 1e-4, "us", "; if the times are in ms, set `columns: {time_unit: ms}`; if it is"),
        (0, 1e-4, "ms", "; if the times are in s, set `columns: {time_unit: s}`; if it is"),
        # The unit of a date is right.
        (1.79e9, 100, "s", "; if it is right, set recording.frame_rate"),
        (0, 0, "s", "; if it is right, set recording.frame_rate"),
        (0, 100, None, "; if it is right, set recording.frame_rate"),
    ],
)
def test_a_step_that_is_not_plausible_is_warned_of_with_the_cure(
    first: float, step: float, unit: str | None, cure: str | None
) -> None:
    frame_id = np.arange(N_FRAMES)
    warned = clock_warning("a.csv", frame_id, first + step * frame_id, unit)
    assert [text.partition(" s; ")[0] for text in warned] == (
        [] if cure is None else [f"a.csv: the median step of its times is {step:.4g}"]
    )
    assert cure is None or f"; {warned[0].partition(' s; ')[2]}".startswith(cure)


def test_a_single_frame_has_no_step() -> None:
    assert clock_warning("a.csv", np.zeros(1, dtype=int), np.zeros(1)) == []


def times(**changes: Any) -> pd.DataFrame:
    time_s = np.arange(N_FRAMES) * 100
    return pd.DataFrame({"time_s": time_s, "offset_1": -1.8, "offset_2": 1.8}).assign(**changes)


@pytest.mark.parametrize(
    ("columns", "overrides", "is_warned"),
    [
        (None, {}, True),
        ({"time_unit": "us"}, {}, True),
        ({"time_unit": "ms"}, {}, False),
        (None, {"recording.frame_rate": 0.01}, False),
    ],
)
def test_a_run_is_warned_of_its_clock_unless_the_rate_is_given(
    columns: Any, overrides: Any, is_warned: bool
) -> None:
    run = ego.run(times(), n_lanes=3, columns=columns, overrides=overrides)
    assert any("the median step of its times" in text for text in run.notes) == is_warned
