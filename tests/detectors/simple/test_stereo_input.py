"""Stereo matchers by name and by file, and pairs, cameras and parameters that cannot be used."""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest

from egolane_pgm.camera.model import Camera
from egolane_pgm.camera.picture import Picture
from egolane_pgm.detectors import ml, sc, sl
from egolane_pgm.detectors.runner import detect, find_detector, start
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.types import FloatArray, InputError
from tests.kits.stereo_pairs import PAIR, empty, picture, plane_of, scene

# --- matchers ------------------------------------------------------------------------------------

OWN = """
import cv2

def match(left, right, n_disparities):
    matcher = cv2.StereoBM.create(n_disparities, 9)
    return matcher.compute(left, right) / 16
"""


def test_an_own_matcher_is_a_file_beside_the_experiment(tmp_path: Path) -> None:
    (tmp_path / "my_matcher.py").write_text(OWN)
    given_ = {"matcher": "./my_matcher.py"}
    detector = find_detector("sl", given_, tmp_path, "detector")
    lines = start(detector, scene().camera)(picture(empty()))
    assert len(lines.lri) >= 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def mach(left, right, n): return left", "does not define match"),
        ("def match(left, right, n): return left[::2]", r"match gave uint8 .* needs one number"),
        ("def match(left, right, n): return 1 / 0", "line 1: ZeroDivisionError"),
        ("def match(left, right, n): return None", "match gave object"),
    ],
)
def test_an_own_matcher_that_does_not_work_is_named(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "my_matcher.py"
    path.write_text(text)
    detector = find_detector("sl", {"matcher": str(path)}, tmp_path, "detector")
    with pytest.raises(InputError, match=message) as error:
        start(detector, scene().camera)(picture(empty()))
    assert "my_matcher.py" in str(error.value)
    assert "\n" not in str(error.value)


def test_elas_is_used_where_it_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    class Elas:
        disp_max = 255

        def process(self, left: Any, right: Any) -> tuple[FloatArray, FloatArray]:
            assert left.shape == right.shape
            found = cv2.StereoBM.create(self.disp_max + 1, 9).compute(left, right) / 16
            return found, found

    module = ModuleType("elas")
    module.Elas = Elas  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "elas", module)
    _, plane, _ = plane_of(empty(), scene().camera, matcher="elas")
    assert plane.is_sure


def test_elas_that_is_not_installed_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "elas", None)
    with pytest.raises(InputError, match="pip install pyelas"):
        sl.start(scene().camera, resolve_parameters(sl.PARAMETERS, {"matcher": "elas"}, 1))


# --- bad input -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given_", "message"),
    [
        ({"matcher": "sgmb"}, r"matcher: unknown matcher 'sgmb' \(did you mean 'sgbm'\?\)"),
        ({"matcher": 3}, "matcher: 3 is not the name of a matcher"),
        ({"matcher": "./none.py"}, "matcher: no file .*none.py"),
        ({"block_px": 4}, "block_px: 4 must be odd"),
        ({"block_px": 3, "matcher": "bm"}, "block_px: 3 must be odd; bm needs an odd side of 5"),
        ({"match_scale": 40}, "match_scale: 40 leaves"),
        ({"nearest_m": 0.1}, "nearest_m: what is 0.1 m away is .* pixels apart"),
        ({"pitch_from": "plan"}, r"pitch_from: 'plan' is not one of .* \(did you mean 'plane'"),
        ({"off_plan_m": 1.0}, r"unknown key 'off_plan_m' \(did you mean 'off_plane_m'\?\)"),
    ],
)
def test_bad_parameters_are_named(given_: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        start(find_detector("sl", given_, Path.cwd(), "detector"), scene().camera)


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (replace(PAIR, baseline_m=None), "baseline_m: is missing"),
        (replace(PAIR, distortion=(0.1, 0.0, 0.0, 0.0, 0.0)), "must be rectified"),
        (replace(PAIR, pitch_deg=40.0), "pitch_deg: 40: the camera looks at the sky"),
    ],
)
def test_a_camera_that_is_no_rectified_pair_on_a_road_is_named(
    camera: Camera, message: str
) -> None:
    for name in ("sl", "sc"):
        with pytest.raises(InputError, match=message):
            start(find_detector(name, {}, Path.cwd(), "detector"), camera)


@pytest.mark.parametrize("name", ["sl", "sc"])
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("no right one", "the picture of the second camera is missing"),
        ("right one smaller", "the right picture has 1312x500 pixels"),
        ("left one smaller", "the left picture has 656x540 pixels"),
        ("swapped", "the pictures of left and right are swapped"),
    ],
)
def test_pictures_that_are_no_pair_are_named(name: str, wrong: str, message: str) -> None:
    image, right = empty().image, empty().right
    assert right is not None
    left, other = {
        "no right one": (image, None),
        "right one smaller": (image, right[:500]),
        "left one smaller": (image[:, ::2], right),
        "swapped": (right, image),
    }[wrong]
    detector = find_detector(name, {}, Path.cwd(), "detector")
    with pytest.raises(InputError) as error:
        list(detect(detector, scene().camera, [Picture(7, left, other)]))
    assert str(error.value).startswith(f"detector: {name}: frame 7: {message}")


@pytest.mark.parametrize("kind", ["the same picture twice", "black", "another place"])
def test_pairs_without_a_plane_are_told_of_once_and_lines_go_on(kind: str) -> None:
    parameters = resolve_parameters(sl.PARAMETERS, {"unsure_after": 3, "match_scale": 4}, 1)
    step = sl.start(scene().camera, parameters)
    image = empty().image
    other = {"black": np.zeros_like(image), "another place": image[::-1, ::-1]}
    right = np.ascontiguousarray(other.get(kind, image))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        for k in range(8):
            # A picture that moves, or the camera counts as frozen.
            step(Picture(k, np.roll(image, 7 * k, axis=1), np.roll(right, 7 * k, axis=1)))
    told = [str(w.message) for w in said if "no road plane" in str(w.message)]
    assert len(told) == 1
    assert told[0].startswith("frame 2: ")


def test_values_that_opencv_refuses_are_one_line() -> None:
    given_ = {"matcher": "bm", "most_gradient": 200, "block_px": 9}
    step = sl.start(scene().camera, resolve_parameters(sl.PARAMETERS, given_, 1))
    with pytest.raises(InputError, match=r"most_gradient: preFilterCap must be") as error:
        step(picture(empty()))
    assert "\n" not in str(error.value)


def test_one_camera_is_enough_for_the_mono_detectors_only() -> None:
    assert not ml.STEREO
    assert sl.STEREO
    assert sc.STEREO
