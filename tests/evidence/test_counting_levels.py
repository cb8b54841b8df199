"""Special cases in which one graph equals another, and the evidence rule `counting_levels`."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.evidence import counting_levels
from egolane_pgm.evidence.counting_levels import level_evidence
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.simulation import simulate


@settings(max_examples=50, deadline=None)
@given(s=st.lists(st.floats(0, 1), min_size=1, max_size=20), levels=st.integers(2, 9))
def test_levels_of_evidence_sum_to_one_and_keep_the_reliability(
    s: list[float], levels: int
) -> None:
    reliability = np.array(s)
    linear = level_evidence(reliability, levels, "linear")
    assert (linear >= 0).all()
    np.testing.assert_allclose(linear.sum(axis=1), 1, atol=1e-12)
    stands_for = 1 - np.arange(levels) / (levels - 1)
    np.testing.assert_allclose(linear @ stands_for, reliability, atol=1e-12)
    hot = level_evidence(reliability, levels, "one_hot")
    assert ((hot == 0) | (hot == 1)).all()
    centre = 1 - (np.arange(levels) + 0.5) / levels
    assert (np.abs(hot @ centre - reliability) <= 0.5 / levels + 1e-12).all()
    np.testing.assert_array_equal(hot.sum(axis=1), 1)


def test_levels_of_a_frame_without_a_line_say_nothing_where_that_is_wanted() -> None:
    log = simulate("quickstart", seed=0, frames=20).log
    log.is_valid[3] = False
    given = {"no_valid_line": "ignore", "wor_levels": 5, "level_evidence": "one_hot"}
    parameters = resolve_parameters(counting_levels.PARAMETERS, given, 4)
    wor = counting_levels.evidence(log, 4, parameters).likelihoods["WOR"]
    np.testing.assert_array_equal(wor[3], np.full(5, 0.2))
    assert set(np.unique(wor[:3])) == {0.0, 1.0}
