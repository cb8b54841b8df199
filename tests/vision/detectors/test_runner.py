"""Detectors with parameters at the ends of their ranges, and users' detectors that break the
contract: they give lines, or one line of text that says what is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from egolane_pgm.parameters import Parameter, resolve_parameters
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import FrameLines, ml, runner, sl
from egolane_pgm.vision.detectors.runner import detect, find_detector
from egolane_pgm.vision.detectors.simple.fit import find_lines, view_for
from tests.kits.drives import command, refused
from tests.kits.synthetic_road import CAMERA, PAIR, drive, images, write_pictures

ONLY_STEREO = tuple(p for p in sl.PARAMETERS if p not in ml.PARAMETERS)

GOOD: dict[str, Any] = {
    "shape": np.zeros((1, 4)),
    "is_valid": np.ones(1, dtype=bool),
    "is_continuous": np.ones(1, dtype=bool),
    "lri": np.ones(1),
}

OWN = """
import numpy as np
from egolane_pgm.vision.detectors import FrameLines
STEREO = False
{more}
def start(camera, parameters):
    def step(picture):
        return FrameLines(np.zeros((1, 4)), np.ones(1, bool), np.ones(1, bool), np.array([{lri}]))
    return step
"""


def ends(spec: Parameter) -> list[Any]:
    """The least and the greatest value that a parameter takes."""
    if spec.kind == "probability":
        return [0.0, 1.0]
    if spec.kind == "integer":
        return [spec.lowest, spec.highest if np.isfinite(spec.highest) else 2**70]
    least = 1e-300 if spec.kind in ("positive", "sigma") else 0.0
    return [spec.lowest or least, spec.highest if np.isfinite(spec.highest) else 1e300]


def one_line(name: str, given: dict[str, Any]) -> None:
    """Lines come out, or an error of one line that is short enough to be read."""
    stereo, said = name == "sl", ""
    try:
        detector = find_detector(name, given, Path.cwd(), "detector")
        list(detect(detector, PAIR if stereo else CAMERA, drive(2, stereo=stereo)))
    except InputError as error:
        said = str(error)
    assert "\n" not in said
    assert len(said) < 400


def lines(count: int, lri: float = 1.0) -> FrameLines:
    shape, flags = np.zeros((count, 4)), np.zeros(count, dtype=bool)
    shape[:, 0] = 3.5 * np.arange(count)
    return FrameLines(shape, flags, flags, np.full(count, lri))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("name", "spec"),
    [("mc", spec) for spec in ml.PARAMETERS if spec.kind != "choice"]
    + [("sl", spec) for spec in ONLY_STEREO if spec.kind != "choice"],
    ids=lambda value: value if isinstance(value, str) else value.name,
)
def test_a_parameter_at_either_end_of_its_range_does_no_harm(name: str, spec: Parameter) -> None:
    for value in ends(spec):
        one_line(name, {spec.name: value})
    if np.isfinite(spec.highest):
        beyond = spec.highest + 1 if spec.kind == "integer" else spec.highest * 1.01
        with pytest.raises(InputError, match=rf"{spec.name}: .* must be at most"):
            find_detector(name, {spec.name: beyond}, Path.cwd(), "detector")


def test_a_number_below_the_lowest_is_refused_whatever_its_kind() -> None:
    spec = Parameter("step_m", "positive", 1.0, "a step", lowest=0.5, highest=2)
    assert spec.check(0.5, 1, "x") == 0.5
    assert spec.check(2, 1, "x") == 2
    for value, said in ((0.4, "must be at least 0.5"), (2.5, "must be at most 2")):
        with pytest.raises(InputError, match=f"^x: {value} {said}$"):
            spec.check(value, 1, "x")


def test_a_line_may_reach_as_far_as_the_view_is_wide() -> None:
    parameters = resolve_parameters(ml.PARAMETERS, {"side_m": 4.0, "reach_m": 9.0}, 1)
    parameters["curve"] = "line"
    view = view_for(CAMERA, parameters)
    found = find_lines(view, drive(1)[0].image, parameters)
    assert np.isfinite(found.shape).all()
    assert len(found.score) >= 1


def test_a_plane_that_may_not_differ_at_all_is_the_calibrated_one() -> None:
    detector = find_detector("sl", {"most_heave": 1e-12}, Path.cwd(), "detector")
    lines = [found for _, found in detect(detector, PAIR, drive(2, stereo=True))]
    assert len(lines[-1].lri) >= 2


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("grey", [0, 255])
def test_two_cameras_that_see_nothing_find_no_lines(grey: int) -> None:
    blank = np.full((PAIR.height, PAIR.width, 3), grey, dtype=np.uint8)
    detector = find_detector("sl", {}, Path.cwd(), "detector")
    pictures = [Picture(k, blank, blank) for k in range(3)]
    assert [len(found.lri) for _, found in detect(detector, PAIR, pictures)] == [0, 0, 0]


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("shape", [[0.0, 0.0, 0.0, 0.0]], "shape is list, needs a NumPy array of numbers"),
        ("shape", np.full((1, 4), "a"), "shape is <U1, needs a NumPy array of numbers"),
        ("shape", np.full((1, 4), 1j), "shape is complex128"),
        ("shape", np.array(3.0), r"shape is \(\), needs \(L, 4\)"),
        ("is_valid", np.array([0.5]), "is_valid is float64, needs a NumPy array of True or False"),
        ("is_valid", np.array(["no"]), "is_valid is <U2"),
        ("is_continuous", None, "is_continuous is NoneType"),
        ("lri", np.array(["a"]), "lri is <U1, needs a NumPy array of numbers"),
        ("slot", np.array([1.0]), "slot is float64, needs a NumPy array of whole numbers"),
        ("slot", np.array([1, 2]), "slot needs one value for each of 1 lines"),
    ],
)
def test_lines_of_another_kind_are_refused(name: str, value: Any, said: str) -> None:
    FrameLines(**GOOD)
    with pytest.raises(InputError, match=f"^lines: {said}"):
        FrameLines(**{**GOOD, name: value})


def test_two_lines_have_two_slots() -> None:
    many = {name: np.repeat(value, 2, axis=0) for name, value in GOOD.items()}
    assert FrameLines(**many).slot is None
    FrameLines(**many, slot=np.array([4, 1]))
    with pytest.raises(InputError, match=r"^lines: slot \[4, 4\] has a number twice$"):
        FrameLines(**many, slot=np.array([4, 4]))


@pytest.mark.parametrize(
    ("more", "lri", "said"),
    [
        ("", "np.nan", "frame 0: a line's lri is not a count of detections"),
        ("", "-1.0", "frame 0: a line's lri is not a count of detections"),
        ("PARAMETERS = None", "1.0", "PARAMETERS is no tuple of Parameter"),
        ("PARAMETERS = ({'contrast': 8},)", "1.0", "PARAMETERS has {'contrast': 8}, which is no"),
    ],
)
def test_an_own_detector_that_keeps_no_promise_is_named(
    place: Path, tmp_path: Path, more: str, lri: str, said: str
) -> None:
    own = tmp_path / "own.py"
    own.write_text(OWN.format(more=more, lri=lri))
    target = tmp_path / "l.csv"
    words = ["detect", place / "drive.avi", "--camera", place / "cam.yaml"]
    message = refused(*words, "--detector", own, "-o", target)
    assert said in message
    assert "own.py" in message
    assert not target.exists()


def test_a_wrong_parameter_is_said_with_the_option_that_gave_it(
    place: Path, tmp_path: Path
) -> None:
    words = [
        "detect",
        place / "drive.avi",
        "--camera",
        place / "cam.yaml",
        "-o",
        tmp_path / "l.csv",
    ]
    said = refused(*words, "--set", "around_m=1e9")
    assert said == "parameters.around_m: 1000000000.0 must be at most 100"
    assert (
        refused(*words, "--set", "around_m=2000") == "parameters.around_m: 2000 must be at most 100"
    )


def test_a_run_that_a_picture_stops_says_how_to_keep_the_lines_before(
    place: Path, tmp_path: Path
) -> None:
    folder = write_pictures(tmp_path / "pictures", images(4))
    (folder / "2.png").write_bytes(b"no picture")
    out = tmp_path / "out"
    words = ["run", place / "run.yaml", "--recording", folder, "--no-figures", "--out", out]
    words += ["--camera", place / "cam.yaml", "--detector", "ml"]
    said = refused(*words)
    why = "is no picture that can be read (another kind of file, or cut off)"
    assert f"2.png: {why}; `egolane detect` writes the lines" in said
    assert not out.exists()
    (folder / "0.png").write_bytes(b"no picture")
    # Nothing came before.
    assert command(*words).stderr.rstrip().endswith(f"0.png: {why}")


@pytest.mark.parametrize("reason", [KeyboardInterrupt(), InputError("picture 4: is torn")])
def test_what_was_detected_before_a_drive_ends_early_is_kept(reason: BaseException) -> None:
    def frames() -> Iterator[tuple[int, FrameLines]]:
        for frame_id in (3, 4, 6):
            yield frame_id, lines(2)
        raise reason

    found = runner.collect(frames(), 10.0, "here")
    assert found.stopped is reason
    assert found.log is not None
    assert found.log.frame_id.tolist() == [3, 4, 6]


def test_a_long_drive_is_packed_in_pieces_and_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "_PACK", 4)
    found = runner.collect(((k, lines(1 + k % 3)) for k in range(10)), 10.0, "here")
    assert found.stopped is None
    assert found.log is not None
    assert found.log.frame_id.tolist() == list(range(10))
    assert np.isfinite(found.log.offset_m).sum(axis=1).tolist() == [1 + k % 3 for k in range(10)]


def test_a_count_of_detections_is_not_negative() -> None:
    runner._check(lines(2, 0.0), "here")
    with pytest.raises(InputError, match="here: a line's lri is not a count of detections"):
        runner._check(lines(2, -1.0), "here")


def test_a_stereo_detector_needs_two_cameras_and_how_far_they_are_apart() -> None:
    one = Camera(width=640, height=360, fx=500, fy=500, cx=320, cy=180, height_m=1.5)
    for is_stereo in (False, True):
        module = ModuleType("mine")
        module.STEREO = is_stereo  # type: ignore[attr-defined]
        detector = runner.Detector("mine", module, {}, "recording.detector")
        if not is_stereo:
            runner.check_pair(detector, one, False, "here")
            with pytest.raises(InputError, match="here: detector mine looks at one camera only"):
                runner.check_pair(detector, one, True, "here")
            continue
        with pytest.raises(InputError, match="here: detector mine needs the pictures of a second"):
            runner.check_pair(detector, replace(one, baseline_m=0.5), False, "here")
        with pytest.raises(InputError, match="baseline_m of the camera"):
            runner.check_pair(detector, one, True, "here")
        runner.check_pair(detector, replace(one, baseline_m=0.5), True, "here")
