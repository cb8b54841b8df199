"""Pictures of simulated drives show the lines where the truth says they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from egolane_pgm.simulation import simulate, simulated_road
from egolane_pgm.vision.camera.model import road_to_image
from egolane_pgm.vision.simulated import CAMERA, Paint, draw_road


@pytest.mark.parametrize("yaw_deg", [0.0, -2.0])
@pytest.mark.parametrize("roll_deg", [0.0, 3.0])
def test_a_line_is_in_the_picture_where_the_camera_projects_it(
    yaw_deg: float, roll_deg: float
) -> None:
    camera = replace(CAMERA, yaw_deg=yaw_deg, roll_deg=roll_deg)
    line = Paint(-1.7, heading=0.01, curvature=1 / 500, rate=1e-5)
    image = draw_road([line], camera=camera, noise=0)
    x = np.linspace(6, 25, 40)
    y = -1.7 + 0.01 * x + x**2 / 1000 + 1e-5 * x**3 / 6
    u, v = np.round(road_to_image(camera, x, y)).astype(int)
    assert (image[v, u] == line.grey).mean() > 0.95
    u, v = np.round(road_to_image(camera, x, y + 0.5)).astype(int)
    assert (image[v, u] == 95).all()


def test_pictures_are_of_the_drive_whose_lines_are_simulated() -> None:
    road, drive = simulated_road("a2", 3, 50), simulate("a2", 3, 50)
    np.testing.assert_array_equal(road.position_m, drive.position_m)
    assert road.truth.equals(drive.truth)
