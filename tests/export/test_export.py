"""Results as MCAP files, read again by the format's own reader, and as videos."""

from __future__ import annotations

import base64
import json
import math
import textwrap
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import jsonschema
import numpy as np
import pandas as pd
import pytest
from mcap.reader import SeekingReader

from egolane_pgm.export import mcap_file
from egolane_pgm.export.mcap_file import write_mcap
from egolane_pgm.export.video_file import write_video
from egolane_pgm.result import Result
from egolane_pgm.runs import open_input, run_input
from egolane_pgm.types import InputError, LineLog
from egolane_pgm.vision import video
from egolane_pgm.vision.camera.model import road_to_image, write_camera
from egolane_pgm.vision.camera.pictures import images_of, open_source
from egolane_pgm.vision.video import bar_boxes, layout
from tests.kits.drawn_frames import CAMERA, OFFSETS, around, is_colour, road

#: The start of the drive, seconds since 1970.
START_S = 1_515_801_391


@pytest.fixture(scope="module")
def result() -> Result:
    """A drive with time stamps, of which frame 7 is not annotated."""
    overrides = {"recording.frames": [0, 200]}
    simulated = run_input(open_input("quickstart", overrides=overrides))
    frames = simulated.frames.assign(time_s=START_S + simulated.frames.index / 10)
    frames.loc[7, ["true_lane", "is_crossing"]] = pd.NA
    return replace(simulated, frames=frames)


def with_detector(result: Result, path: Path) -> Result:
    recording = result.experiment.recording.model_copy(update={"detector": "ml", "path": str(path)})
    return replace(result, experiment=result.experiment.model_copy(update={"recording": recording}))


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    for k in (10, 11, 40):
        cv2.imwrite(str(folder / f"{k:04d}.png"), np.full((60, 80, 3), k, dtype=np.uint8))
    return folder


@pytest.fixture(scope="module")
def file(result: Result, pictures: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("written") / "out.mcap"
    write_mcap(path, with_detector(result, pictures))
    return path


#: The times and contents of the messages of each topic.
Messages = dict[str, list[tuple[int, dict[str, Any]]]]


def messages(mcap: Path) -> Messages:
    """The messages of a file; every eighth is checked against its schema."""
    found: Messages = {}
    checks: dict[str, Any] = {}
    with mcap.open("rb") as stream:
        for schema, channel, message in SeekingReader(stream, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            if channel.topic not in checks:
                content = json.loads(schema.data)
                jsonschema.Draft202012Validator.check_schema(content)
                checks[channel.topic] = jsonschema.Draft202012Validator(content)
                assert content["title"] == schema.name
            known = found.setdefault(channel.topic, [])
            if len(known) % 8 == 0:
                checks[channel.topic].validate(json.loads(message.data))
            known.append((message.log_time, json.loads(message.data)))
    return found


def test_each_frame_is_a_message_on_the_clock_of_the_recording(result: Result, file: Path) -> None:
    found = messages(file)
    times = [START_S * 10**9 + int(k) * 10**8 for k in result.frames.index]
    for topic in ("/frame", "/lines"):
        assert [now for now, _ in found[topic]] == times, topic
    table = pd.DataFrame([content for _, content in found["/frame"]]).set_index("frame_id")
    expected = result.frames.astype({"true_lane": float, "is_crossing": float})
    table = table[expected.columns].astype(expected.dtypes)
    pd.testing.assert_frame_equal(table, expected, check_index_type=False)
    assert "true_lane" not in found["/frame"][7][1]
    changes = pd.DataFrame([content for _, content in found["/changes"]])
    pd.testing.assert_frame_equal(changes, result.events, check_dtype=False, check_like=True)
    at = [now for now, _ in found["/changes"]]
    assert at == [times[int(k)] for k in result.events["detected_frame_id"]]


def test_an_mcap_file_is_a_recording_again(result: Result, file: Path) -> None:
    again = run_input(open_input(file, n_lanes=4))
    [lines], [expected] = again.lines.values(), result.lines.values()
    assert isinstance(lines, LineLog)
    for name in ("frame_id", "offset_m", "is_valid", "is_continuous", "lri"):
        np.testing.assert_array_equal(getattr(lines, name), getattr(expected, name), err_msg=name)
    np.testing.assert_array_equal(lines.time_s, result.frames["time_s"])
    shown = open_source(file)
    np.testing.assert_allclose([*shown.stamps.values()], [START_S + k / 10 for k in (10, 11, 40)])
    assert [int(image.mean()) for _, _, (image,) in images_of([shown], None)] == [10, 11, 40]
    jpeg = base64.b64decode(messages(file)["/picture"][0][1]["data"])
    image = cv2.imdecode(np.frombuffer(jpeg, dtype=np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape == (60, 80, 3)


def test_a_part_has_the_messages_of_the_whole(result: Result, file: Path, tmp_path: Path) -> None:
    first = int(result.events["detected_frame_id"].iloc[0])
    write_mcap(tmp_path / "part.mcap", result, frames=(first, first + 9))
    part, whole = messages(tmp_path / "part.mcap"), messages(file)
    now = [START_S * 10**9 + (first + k) * 10**8 for k in range(10)]
    for topic in ("/frame", "/lines", "/changes"):
        assert part[topic] == [each for each in whole[topic] if each[0] in now], topic


def test_missing_lines_and_pictures_are_left_out_with_a_warning(
    result: Result, tmp_path: Path
) -> None:
    gone = replace(with_detector(result, tmp_path / "gone"), lines={})
    with (
        pytest.warns(UserWarning, match="has no lines"),
        pytest.warns(UserWarning, match="shown without pictures"),
    ):
        write_mcap(tmp_path / "out.mcap", gone)
    assert set(messages(tmp_path / "out.mcap")) == {"/frame", "/changes"}


@pytest.mark.parametrize(
    ("change", "frames", "message"),
    [
        ({}, (500, 600), "no frame from 500 to 600; the result has 0 to 199"),
        ({"drive": "a"}, None, "has several drives"),
    ],
)
def test_a_result_that_cannot_be_shown_is_refused(
    result: Result, tmp_path: Path, change: dict[str, Any], frames: Any, message: str
) -> None:
    changed = replace(result, frames=result.frames.assign(**change))
    with pytest.raises(InputError, match=message):
        write_mcap(tmp_path / "out.mcap", changed, frames)
    assert not any(tmp_path.iterdir())


def test_nodes_of_many_values_and_infinite_numbers_are_left_out(result: Result) -> None:
    frames = result.frames.iloc[:1].assign(RoadPosition_1=0.5, log_evidence=-math.inf)
    values = {**result.run["values"], "RoadPosition": list(range(40))}
    changed = replace(result, run={**result.run, "values": values})
    [(_, _, content)] = mcap_file._frame_messages(changed, frames)
    assert set(frames) - set(content) == {"RoadPosition_1", "log_evidence"}


# --- videos --------------------------------------------------------------------------------------

#: A detector with the same lines in every picture.
DETECTOR = """
    import numpy as np
    from egolane_pgm.vision.detectors import FrameLines
    STEREO = False
    def start(camera, parameters):
        def step(picture):
            shape = np.zeros((3, 4))
            shape[:, 0] = -1.9, 1.6, 5.2
            yes = np.ones(3, dtype=bool)
            return FrameLines(shape, yes, np.array([True, False, False]), np.full(3, 10.0))
        return step
"""


def frames_of(path: Path) -> list[np.ndarray]:
    read = cv2.VideoCapture(str(path))
    images = []
    while (found := read.read())[0]:
        images.append(found[1])
    return images


def test_a_video_shows_lines_and_truth_on_the_pictures(tmp_path: Path) -> None:
    (tmp_path / "pictures").mkdir()
    for k in range(10, 16):
        cv2.imwrite(str(tmp_path / "pictures" / f"img_{k:04d}.png"), road())
    write_camera(tmp_path / "cam.yaml", CAMERA)
    (tmp_path / "fake.py").write_text(textwrap.dedent(DETECTOR))
    truth = tmp_path / "truth.txt"
    truth.write_text("".join(f"{k};2;0\n" for k in range(10, 16)))
    recording = {
        "camera": str(tmp_path / "cam.yaml"),
        "detector": str(tmp_path / "fake.py"),
        "frame_rate": 20,
    }
    given = open_input(tmp_path / "pictures", n_lanes=3, ground_truth=truth, recording=recording)
    result = run_input(given)
    write_video(tmp_path / "a.mp4", result)
    found = frames_of(tmp_path / "a.mp4")
    assert len(found) == 6
    assert cv2.VideoCapture(str(tmp_path / "a.mp4")).get(cv2.CAP_PROP_FPS) == 20
    places = layout(CAMERA)
    assert found[0].shape == (places.size[1], places.size[0], 3)
    u, v = road_to_image(CAMERA, 7.0, OFFSETS[0])
    near = around(found[0], float(u), float(v))
    assert any(is_colour(pixel, video.CONTINUOUS, 70) for pixel in near)
    left, upper, _, lower = bar_boxes(places, 3)[1]
    assert is_colour(found[-1][(upper + lower) // 2, left - 3], video.TRUTH, 70)
    write_video(tmp_path / "b.mp4", result, (11, 13))
    assert len(frames_of(tmp_path / "b.mp4")) == 3
    cv2.imwrite(str(tmp_path / "pictures" / "img_0012.png"), road()[:-8])
    with pytest.raises(InputError, match="frame 12: a picture of 640x392 pixels"):
        write_video(tmp_path / "c.mp4", result)
    assert len(frames_of(tmp_path / "c.mp4")) == 2


def test_a_result_without_pictures_cannot_become_a_video(result: Result, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no pictures to draw"):
        write_video(tmp_path / "a.mp4", result)
