"""A real network on real pictures."""

from __future__ import annotations

import numpy as np
import pytest

from makers.camera import lstr, tusimple


def test_a_real_network_finds_the_lines_that_it_was_trained_on() -> None:
    """Its published decoder had 97 and 98 % on other stills of that drive."""
    labels = tusimple.data_file()
    if labels is None or lstr.data_file() is None:
        pytest.skip(f"stills: needs EGOLANE_DATA with {tusimple.FILE} and {lstr.FILE}")
    stills = lstr.look_at(labels, slice(30, 50))
    assert min(tusimple.recall_precision(stills, 0)) > 0.96
    assert np.median(tusimple.errors_m(stills, 0)) < 0.06
