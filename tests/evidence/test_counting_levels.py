"""The evidence rule `counting_levels`."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.evidence.counting_levels import level_evidence


@settings(max_examples=50, deadline=None)
@given(s=st.lists(st.floats(0, 1), min_size=1, max_size=20), levels=st.integers(2, 9))
def test_levels_of_evidence_sum_to_one_and_keep_the_reliability(
    s: list[float], levels: int
) -> None:
    found = level_evidence(np.array(s), levels)
    assert (found >= 0).all()
    np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-12)
    reliability = 1 - np.arange(levels) / (levels - 1)
    np.testing.assert_allclose(found @ reliability, s, atol=1e-12)
