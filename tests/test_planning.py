"""The arithmetic from what an hour of driving takes to what a fleet takes."""

from __future__ import annotations

import pytest

from tests.benchmarks.bench_planning import Cost, detection_hours, markdown, plan

COST = Cost("x", 36.0, 2e6, 1.8, 5e4, 9, 800, 0.018)


def test_a_plan_adds_what_hours_take_and_what_drives_take() -> None:
    found = plan(COST, hours=1000, drive_hours=0.5, cores=4)
    assert found.processor_hours == pytest.approx(1000 * 36 / 3600 + 2000 * 1.8 / 3600)
    assert found.days == pytest.approx(found.processor_hours / 96)
    assert found.bytes_ == pytest.approx(1000 * 2e6 + 2000 * 5e4)
    assert found.files == 18_000
    assert found.summary_bytes == 1_600_000
    assert found.resume_hours == pytest.approx(0.01)


def test_pictures_are_counted_at_their_rate() -> None:
    assert detection_hours(0.010, hours=100, frame_rate=10) == pytest.approx(10)


def test_the_tables_have_a_column_for_each_experiment_and_no_functions_of_detectors() -> None:
    text = markdown([COST, COST], [("**ml**", 0.01), ("ml: warp", 0.002)])
    assert "| processor hours | 1,050 | 1,050 |" in text
    assert "| **ml** | 10.0 ms | 10,000 |" in text
    assert "warp" not in text
