"""The pictures of a review list."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.types import InputError
from egolane_pgm.views.review import BESIDE_S, PICTURES, draw_review, review_figure
from tests.kits.drives import write_drive

PLACE = ego.experiments_folder() / "zero_label.yaml"


@pytest.fixture(scope="module")
def found() -> ego.Labels:
    return ego.label(experiment=PLACE, overrides={"recording.frames": [0, 400]}, below=0.99999)


def test_a_picture_shows_lines_belief_and_confidence_around_the_frames(
    found: ego.Labels,
) -> None:
    figure = review_figure(found, 100, 150)
    lines, belief, wrong = figure.axes
    for ax in figure.axes:
        assert ax.get_xlim() == pytest.approx((10 - BESIDE_S, 15 + BESIDE_S))
    assert "[m]" in lines.get_ylabel()
    assert "[s]" in wrong.get_xlabel()
    # Left is above, in the lines and in the lanes.
    assert lines.get_ylim()[0] > lines.get_ylim()[1]
    assert belief.get_ylim()[0] > belief.get_ylim()[1]
    assert belief.get_yticklabels()[0].get_text() == "lane 1 (leftmost)"
    (image,) = belief.get_images()
    shown = np.asarray(image.get_array())
    np.testing.assert_allclose(shown, found.run.beliefs.lane[60:191].T)
    label = belief.get_lines()[0].get_xydata()
    np.testing.assert_allclose(np.round(label[:, 1]), found.lane[60:191])


def test_a_gap_in_the_recording_is_left_blank(tmp_path: Path) -> None:
    write_drive(tmp_path, ground_truth=None)
    lines = (tmp_path / "lines.csv").read_text().splitlines()
    gone = tuple(f"{frame}," for frame in range(40, 60))
    kept = [line for line in lines if not line.startswith(gone)]
    (tmp_path / "lines.csv").write_text("\n".join(kept) + "\n")
    labels = ego.label(tmp_path / "lines.csv", n_lanes=3)
    image = review_figure(labels, 30, 70).axes[1].get_images()[0].get_array()
    assert image is not None
    blank = np.ma.getmaskarray(image).all(axis=0)
    assert np.flatnonzero(blank).tolist() == list(range(40, 60))


def test_the_worst_stretches_are_drawn_each_in_a_file(found: ego.Labels, tmp_path: Path) -> None:
    files = draw_review(found, tmp_path / "figures")
    worst = found.worst[:PICTURES]
    assert len(files) == len(worst) > 0
    for file, each in zip(files, worst, strict=True):
        assert file.read_bytes().startswith(b"\x89PNG")
        assert f"frames_{each.first}_to_{each.last}" in file.name


def test_a_range_without_frames_is_refused(found: ego.Labels) -> None:
    with pytest.raises(InputError, match="the range 900 to 950 has no frames"):
        review_figure(found, 900, 950)


def test_what_label_returns_draws_the_worst_stretch(found: ego.Labels) -> None:
    worst = found.worst[0]
    title = found.plot().texts[0].get_text()
    assert f"frames {worst.first} to {worst.last}" in title
    assert "frames 0 to 50" in found.plot(last=50).texts[0].get_text()
    assert "<table>" in found._repr_html_()
