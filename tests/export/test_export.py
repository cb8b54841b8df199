"""Results as MCAP files, read again by the format's own reader."""

from __future__ import annotations

import base64
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner, Result
from mcap.reader import SeekingReader

import egolane_pgm as ego
from egolane_pgm.command import egolane
from egolane_pgm.export.drive import Drive, open_drive
from egolane_pgm.export.mcap_file import write_mcap
from egolane_pgm.simulation import simulate
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.pictures import images_of, open_source
from tests.kits.rosbag_writer import write_lines

#: When the drive began, seconds since 1970.
START_S = 1_515_801_391


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result of a drive with true time stamps, in a folder beside its recording and its
    pictures."""
    folder = tmp_path_factory.mktemp("export")
    drive = simulate("quickstart", frames=200)
    log = drive.log
    object.__setattr__(log, "time_s", START_S + log.frame_id / 10)
    write_lines(folder / "lines.mcap", log)
    rows = zip(drive.truth.frame_id, drive.truth.lane, drive.truth.is_crossing, strict=True)
    text = "".join(f"{f};{lane};{int(c)}\n" for f, lane, c in rows if f != 7)
    (folder / "truth.txt").write_text(text)
    (folder / "x.yaml").write_text(
        "name: drive\nrecording: {path: lines.mcap}\nground_truth: {path: truth.txt}\n"
        "n_lanes: 4\ntuned_on: not_tuned\n"
    )
    (folder / "pictures").mkdir()
    for k in (10, 11, 40):
        image = np.full((60, 80, 3), k, dtype=np.uint8)
        cv2.imwrite(str(folder / "pictures" / f"{k:04d}.png"), image)
    ego.run(folder / "x.yaml").save(folder / "result", figures=False)
    return folder / "result"


@pytest.fixture(scope="module")
def drive(result: Path) -> Drive:
    return replace(open_drive(result), pictures=open_source(result.parent / "pictures"))


#: Per topic the times and contents of its messages.
Messages = dict[str, list[tuple[int, dict[str, Any]]]]


def messages(mcap: Path) -> Messages:
    """The messages of a file, of which every eighth is held against its schema."""
    found: Messages = {}
    checks: dict[str, Any] = {}
    with mcap.open("rb") as file:
        for schema, channel, message in SeekingReader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            if channel.topic not in checks:
                described = json.loads(schema.data)
                jsonschema.Draft202012Validator.check_schema(described)
                checks[channel.topic] = jsonschema.Draft202012Validator(described)
                assert described["title"] == schema.name
            content = json.loads(message.data)
            known = found.setdefault(channel.topic, [])
            if len(known) % 8 == 0:
                checks[channel.topic].validate(content)
            known.append((message.log_time, content))
    return found


@pytest.fixture(scope="module")
def written(drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> Messages:
    """The messages of the drive, each as many as `write_mcap` says."""
    file = tmp_path_factory.mktemp("written") / "out.mcap"
    counts = write_mcap(file, drive)
    found = messages(file)
    assert {topic: len(each) for topic, each in found.items()} == counts
    return found


def test_an_mcap_file_has_every_frame_on_the_clock_of_the_recording(
    drive: Drive, written: Messages
) -> None:
    found = written
    times = [START_S * 10**9 + int(k) * 10**8 for k in drive.result.frame_id]
    for topic in ("/belief", "/lanes", "/frame", "/lines", "/birdseye", "/detector"):
        assert [now for now, _ in found[topic]] == times, topic
    result = drive.result
    for t, (_, belief) in enumerate(found["/belief"]):
        lanes = [belief[f"Lane_{k + 1}"] for k in range(4)]
        np.testing.assert_array_equal(lanes, result.marginals["Lane"][t])
    assert [m["model"] for _, m in found["/lanes"]] == result.assigned_lane.tolist()
    assert [m["truth"] for _, m in found["/lanes"]] == result.true_lane.tolist()
    assert [m["truth"] for _, m in found["/lanes"]][7] == 0
    assert len(found["/changes"]) == len(result.events)


def test_the_lines_and_the_view_from_above_are_those_of_the_recording(
    drive: Drive, written: Messages
) -> None:
    found = written
    assert drive.result.lines is not None
    for t, ((_, lines), (_, scene)) in enumerate(
        zip(found["/lines"], found["/birdseye"], strict=True)
    ):
        offset = drive.result.lines.offset_m[t]
        there = ~np.isnan(offset)
        assert [line["offset_m"] for line in lines["lines"]] == offset[there].tolist()
        (entity,) = scene["entities"]
        left = [line["points"][0]["y"] for line in entity["lines"]]
        assert sorted(left, reverse=True) == left
        assert [-y for y in left] == sorted(offset[there & (offset != 0)].tolist())
        high = [cube["size"]["z"] for cube in entity["cubes"] if cube["size"]["x"] == 0.8]
        np.testing.assert_allclose(
            high, np.maximum(6 * drive.result.marginals["Lane"][t], 0.02), atol=1e-9
        )
        marked = [text["text"] for text in entity["texts"] if "true" in text["text"]]
        truth = int(drive.result.true_lane[t])
        assert [text.startswith(f"lane {truth}:") for text in marked] == [True] * (truth > 0)


def test_an_exported_drive_is_a_recording_again(result: Path, drive: Drive, tmp_path: Path) -> None:
    write_mcap(tmp_path / "out.mcap", drive)
    out = tmp_path / "again"
    command = ["run", tmp_path / "out.mcap", "--n-lanes", 4, "--no-figures", "--out", out]
    done = CliRunner().invoke(egolane, [*map(str, command)])
    assert done.exit_code == 0, done.output
    lines, again = drive.result.lines, ego.load_result(out).lines
    assert lines is not None
    assert again is not None
    for name in ("frame_id", "time_s", "offset_m", "is_valid", "is_continuous", "lri"):
        np.testing.assert_array_equal(getattr(again, name), getattr(lines, name), err_msg=name)
    shown = open_source(tmp_path / "out.mcap")
    np.testing.assert_allclose(shown.time_s, [START_S + k / 10 for k in (10, 11, 40)])
    assert [int(image.mean()) for _, _, image in images_of(shown, None)] == [10, 11, 40]


def test_pictures_stand_at_the_time_of_their_frame(written: Messages) -> None:
    shown = written["/picture"]
    assert [(now - START_S * 10**9) // 10**8 for now, _ in shown] == [10, 11, 40]
    for (_, picture), grey in zip(shown, (10, 11, 40), strict=True):
        jpeg = np.frombuffer(base64.b64decode(picture["data"]), dtype=np.uint8)
        image = cv2.imdecode(jpeg, cv2.IMREAD_COLOR)
        assert image is not None
        assert image.shape == (60, 80, 3)
        assert abs(float(image.mean()) - grey) < 2


def test_some_frames_alone_are_shown_as_in_the_whole_drive(result: Path, drive: Drive) -> None:
    some = open_drive(result, frames=(20, 29))
    assert some.result.frame_id.tolist() == list(range(20, 30))
    assert drive.result.lines is not None
    assert some.result.lines is not None
    np.testing.assert_array_equal(some.result.lines.frame_id, some.result.frame_id)
    assert some.lines_at(3) == drive.lines_at(23)
    assert some.bars_at(3) == drive.bars_at(23)
    whole = [(row - 20, text) for row, text in drive.event_texts() if 20 <= row < 30]
    assert some.event_texts() == whole
    with pytest.raises(InputError, match="no frame from 500 to 600; its frames are 0 to 199"):
        open_drive(result, frames=(500, 600))


# --- the command ---------------------------------------------------------------------------------


def export(*words: object) -> Result:
    return CliRunner().invoke(egolane, ["plot", *map(str, words)])


def test_the_command_writes_the_file(result: Path, tmp_path: Path) -> None:
    done = export(result, "--out", tmp_path / "out.mcap", "--frames", 10, 19)
    assert done.exit_code == 0, done.output
    assert done.output == f"{tmp_path / 'out.mcap'}\n"
    assert len(messages(tmp_path / "out.mcap")["/belief"]) == 10
