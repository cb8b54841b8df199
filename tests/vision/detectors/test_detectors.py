"""Every detector of the package, and the example of a user's own, on a synthetic drive and on real
pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.contracts import Detector
from egolane_pgm.plugins import plugin_names
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import FrameLines, Step
from egolane_pgm.vision.detectors.runner import ReadyDetector, detect, find_detector, start
from makers.camera import carnd, clips, lane_change
from tests.kits.synthetic_road import CAMERA, PAIR, THREE, Paint, drive
from tests.kits.tiny_network import top_hat_file

OWN = str(Path(__file__).parents[3] / "examples" / "my_detector.py")
NAMES = [*plugin_names(Detector), OWN]
N_FRAMES = 14

#: Detections that make a line valid, and the share of them below which it is not any more.
MOST, UNTIL = 10, 0.5


def load(name: str) -> ReadyDetector:
    given = {}
    if name == "network":
        given["network"] = str(top_hat_file(CAMERA.width, CAMERA.height))
    return find_detector(name, given, "detector")


def begin(name: str) -> Step:
    return start(load(name), camera_for(name))


def camera_for(name: str) -> Camera:
    return PAIR if load(name).is_stereo else CAMERA


@pytest.fixture(scope="module")
def pictures() -> list[Picture]:
    """A drive, both cameras, and behind it the same number of pictures without any line."""
    there = drive(N_FRAMES, stereo=True)
    gone = drive(N_FRAMES, (), stereo=True, first=N_FRAMES)
    return [*there, *gone]


def run(name: str, pictures: Sequence[Picture]) -> list[FrameLines]:
    step = begin(name)
    return [step(picture) for picture in pictures]


@pytest.fixture(scope="module")
def detected(pictures: list[Picture]) -> dict[str, list[FrameLines]]:
    return {name: run(name, pictures) for name in NAMES}


def same(one: FrameLines, other: FrameLines) -> bool:
    names = ("shape", "is_valid", "is_continuous", "lri")
    return all(np.array_equal(getattr(one, n), getattr(other, n)) for n in names)


@pytest.mark.parametrize("name", [n for n in NAMES if n != "mld"])
def test_a_line_is_valid_by_hysteresis(name: str, detected: dict[str, list[FrameLines]]) -> None:
    before: FrameLines | None = None
    for lines in detected[name]:
        for k in range(len(lines.lri)):
            was_valid = False
            if before is not None and len(before.lri):
                nearest = int(np.abs(before.offset_m - lines.offset_m[k]).argmin())
                is_same = abs(before.offset_m[nearest] - lines.offset_m[k]) < 0.6
                was_valid = is_same and bool(before.is_valid[nearest])
            expected = lines.lri[k] == MOST or (was_valid and lines.lri[k] >= UNTIL * MOST)
            assert lines.is_valid[k] == expected
        before = lines


@pytest.mark.parametrize("name", NAMES)
def test_the_lines_next_to_the_car_are_found_and_then_lost(
    name: str, detected: dict[str, list[FrameLines]]
) -> None:
    seen = detected[name][N_FRAMES - 1]
    found = seen.offset_m[seen.is_valid]
    # The example sees no dashes.
    for true in (-5.2, 1.8) if name == OWN else (-5.2, -1.7, 1.8):
        assert np.abs(found - true).min() < 0.15
    assert not detected[name][-1].is_valid.any()


@pytest.mark.parametrize("name", [n for n in NAMES if n not in (OWN, "mld")])
def test_dashed_and_continuous_lines_are_distinguished(
    name: str, detected: dict[str, list[FrameLines]]
) -> None:
    seen = detected[name][N_FRAMES - 1]
    for true, is_continuous in ((-1.7, False), (1.8, True)):
        nearest = int(np.abs(seen.offset_m - true).argmin())
        assert seen.is_continuous[nearest] == is_continuous


@pytest.mark.parametrize("name", NAMES)
def test_the_same_pictures_give_the_same_lines_and_two_drives_share_nothing(
    name: str, pictures: list[Picture], detected: dict[str, list[FrameLines]]
) -> None:
    first, second = begin(name), begin(name)
    for k in range(12):
        assert same(first(pictures[k]), detected[name][k])
        second(pictures[-1 - k])


@pytest.mark.parametrize(
    ("name", "sideways"), [("ml", 0.14), ("mc", -0.14), ("sl", -0.14), ("sc", 0.14)]
)
def test_a_lane_change_is_followed_line_by_line(name: str, sideways: float) -> None:
    """A dashed line passes under the car, faster than a person would steer."""
    lines = (*THREE[:2], Paint(1.8, 4.0, 12.0), Paint(5.4))
    where = []
    for lines_now in run(name, drive(24, lines, sideways_m=sideways, stereo=name in ("sl", "sc"))):
        where.append(lines_now.offset_m[lines_now.is_valid])
    true = np.array([p.offset_m for p in lines]) - 23 * sideways
    for offset in true[np.abs(true) < 5]:
        assert np.abs(where[-1] - offset).min() < 0.3


def test_lines_that_break_the_contract_are_refused(tmp_path: Path) -> None:
    cases = {
        "return 7": "gave int, not FrameLines",
        "return FrameLines(np.zeros((1, 4)) * np.nan, yes, yes, one)": "shape is not finite",
        "return FrameLines(np.array([[1., 0, 0, 0], [-1, 0, 0, 0]]), *[np.ones(2, bool)] * 2,"
        " np.ones(2))": "not sorted left to right",
        "return 1 / 0": "ZeroDivisionError",
    }
    for k, (body, message) in enumerate(cases.items()):
        own = tmp_path / f"own{k}.py"
        own.write_text(
            "import numpy as np\n"
            "from egolane_pgm.vision.detectors import FrameLines\nSTEREO = False\n"
            "yes, one = np.ones(1, bool), np.ones(1)\n"
            f"def start(camera, parameters):\n    def step(picture):\n        {body}\n"
            "    return step\n"
        )
        with pytest.raises(InputError) as caught:
            list(detect(load(str(own)), CAMERA, drive(1, first=31)))
        assert message in str(caught.value)
        assert "frame 31" in str(caught.value)


# --- real pictures -------------------------------------------------------------------------------


def folder_of(module: object, name: str) -> Path:
    found = module.data()  # type: ignore[attr-defined]
    if found is None:
        pytest.skip(f"camera/{name}: needs EGOLANE_DATA with it")
    assert isinstance(found, Path)
    return found


@pytest.mark.parametrize("is_mirrored", [False, True])
def test_the_ego_lane_of_a_real_video(is_mirrored: bool) -> None:
    folder = folder_of(carnd, "carnd")
    lane = carnd.left_to_right(folder) if is_mirrored else carnd.as_it_is(folder)
    assert np.isfinite(lane.width_m).all()
    assert (np.abs(lane.width_m - carnd.LANE_WIDTH_M) < 0.2).all()
    edge, inner = lane.is_left_continuous, lane.is_right_continuous
    if is_mirrored:
        edge, inner = inner, edge
    assert edge.mean() >= 0.95
    assert inner.mean() <= 0.05
    start_at = round(carnd.FROM_S * carnd.RATE)
    own = carnd.N_LANES if is_mirrored else 1
    assert (lane.lane[start_at:] == own).all()
    assert (lane.lane_zero[start_at:] == own).all()


def test_clips_of_a_crowded_motorway_are_followed_as_well_as_by_another_detector() -> None:
    found = clips.look_at(folder_of(clips, "tusimple_clips"), beyond=clips.BEYOND[:1])
    tracked = clips.counts(found, clips.BEYOND[0])
    assert tracked[1] in (29, 30)
    # Reached: 26, precision 86 %.
    assert tracked[0] >= 24
    assert tracked[2] >= 0.8 * tracked[3]
    assert clips.lane_at_the_end(found)[-1] == clips.N_LANES


@pytest.mark.parametrize("curve", ["line", "clothoid"])
def test_a_lane_change_to_the_right_is_one_line_that_crosses_and_one_change_of_lane(
    curve: str,
) -> None:
    folder = folder_of(lane_change, "lane_change_right")
    followed = lane_change.follow_pictures(folder, curve)
    (crossed,) = lane_change.crossings(followed)
    assert crossed.first_m > 1
    assert crossed.last_m < -1
    assert 7530 <= crossed.crossed_at <= 7590
    assert lane_change.changes_and_lanes(followed.log(lane_change.RATE))[0] == "0, 1"
