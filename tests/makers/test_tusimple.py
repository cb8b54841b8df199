"""The scores of single frames on real stills, and how they are counted."""

import numpy as np
import pytest

from makers.camera import tusimple
from makers.camera.tusimple import Still
from tests.conftest import needs_compiler


def test_pairs_are_matched_one_to_one_nearest_first():
    still = Still(np.array([0.0, 0.3]), np.array([0.2, 0.62]), np.array([1.0, 1.0]))
    label, line = still.matched()
    assert (label.tolist(), line.tolist()) == ([False, True], [True, False])
    both = Still(np.array([0.0, 0.3]), np.array([-0.2, 0.2]), np.array([0.5, 1.0]))
    assert both.counts().tolist() == [2, 2, 2, 2]
    assert both.counts(0.6).tolist() == [1, 2, 1, 1]


def test_lines_at_the_rim_may_match_labels_beyond_it():
    still = Still(np.array([6.1]), np.array([5.9]), np.array([1.0]))
    assert still.counts().tolist() == [0, 0, 1, 1]


@needs_compiler
@pytest.mark.parametrize("curve", ["clothoid", "line"])
def test_half_of_a_drive_that_was_never_looked_at_has_its_lines_found(curve):
    labels = tusimple.data_file()
    if labels is None:
        pytest.skip(f"stills: needs EGOLANE_DATA with {tusimple.FILE}")
    stills = tusimple.look_at(labels, slice(tusimple.HALF, None), curve=curve)
    recall, precision = tusimple.recall_precision(stills, tusimple.least_score())
    assert recall > 0.70
    assert precision > 0.75
    assert np.median(tusimple.errors_m(stills, tusimple.least_score())) < 0.1
