"""ROS 1 bags: what is read, in which order, and what is refused or warned of."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.experiment import Columns
from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.select import recording_warnings
from egolane_pgm.recordings.topics import read_topic
from egolane_pgm.types import InputError
from tests.kits.bags import (
    PLAIN_LINE,
    Line,
    definition,
    plain_message,
    write_bag,
)

PAPER_FILES = (
    ("special.issue.italy.mono.noClothoid.yesLines.bag", 11738, 5),
    ("special.issue.italy.stereo.noClothoid.yesLines.bag", 11738, 5),
    ("A4-5FULL-MONO.bag", 11739, 5),
    ("A4-5FULL-STEREOv2.bag", 11737, 5),
    ("mldhighway.a4.001_2017-12-18-12-38-52.bag", 10044, 6),
    ("special.issue.spain.mono.noClothoid.yesLines.left._2018-01-13-23-56-11.bag", 9776, 4),
    ("special.issue.spain.stereo.noClothoid.yesLines.left._2018-01-14-23-06-51.bag", 9777, 4),
    ("special.issue.spain.mono.yesClothoid.noLines.left._2018-01-14-11-59-09.bag", 9777, 4),
    ("special.issue.spain.stereo.yesClothoid.noLines.left.bag", 9777, 4),
    ("mldhighway.isislab.001_2017-12-15-17-07-21.bag", 9686, 6),
)

#: Of recordings that leave way_id empty.
SEQ = Columns(frame_id="header.seq")

LINES: list[list[Line]] = [
    [(True, False, 7, -1.75), (False, True, -1, 3e32)],
    [],
    [(True, True, 10, 1.5), (False, False, -2147483648, float("nan")), (True, False, 3, 5.25)],
]


@pytest.fixture(scope="module")
def recordings() -> Path:
    if "EGOLANE_DATA" not in os.environ:
        pytest.skip("the paper's recordings: needs EGOLANE_DATA")
    return Path(os.environ["EGOLANE_DATA"]) / "rle"


def test_a_bag_is_read_into_padded_arrays(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "a.bag", [plain_message(k + 4, ls) for k, ls in enumerate(LINES)])
    log = read_lines(bag, frame_rate=5.0)
    nan = np.nan
    np.testing.assert_array_equal(log.frame_id, [4, 5, 6])
    np.testing.assert_array_equal(log.time_s, [0.8, 1.0, 1.2])
    np.testing.assert_array_equal(
        log.offset_m, [[-1.75, float(np.float32(3e32)), nan], [nan] * 3, [1.5, nan, 5.25]]
    )
    np.testing.assert_array_equal(
        log.is_valid, [[True, False, False], [False] * 3, [True, False, True]]
    )
    np.testing.assert_array_equal(
        log.is_continuous, [[False, True, False], [False] * 3, [True, False, False]]
    )
    np.testing.assert_array_equal(log.lri, [[7, -1, nan], [nan] * 3, [10, -2147483648, 3]])
    assert not log.is_missing.any()
    assert log.source == str(bag)


def test_header_seq_can_be_the_frame_id(tmp_path: Path) -> None:
    raw = [plain_message(0, lines, seq=k + 20) for k, lines in enumerate(LINES)]
    log = read_topic(write_bag(tmp_path / "a.bag", raw), columns=SEQ)
    np.testing.assert_array_equal(log.frame_id, [20, 21, 22])


def refused(path: Path, **options: object) -> str:
    with pytest.raises(InputError) as info:
        read_lines(path, **options)
    text = str(info.value)
    assert "\n" not in text
    assert text.startswith(str(path))
    return text.removeprefix(str(path))


GOOD_MESSAGE = plain_message(0, LINES[0])


def of_ids(*ids: int) -> Callable[[Path], object]:
    return lambda path: write_bag(path, [plain_message(k, []) for k in ids])


def of_type(body: str, line: str = PLAIN_LINE) -> Callable[[Path], object]:
    return lambda path: write_bag(path, [b"\0" * 80], text=definition(body, line))


def of_bytes(content: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content)


def killed(path: Path) -> None:
    """A bag whose recording was killed, before it wrote its index."""
    whole = bytearray(write_bag(path, [GOOD_MESSAGE]).read_bytes())
    at = whole.index(b"index_pos=") + len(b"index_pos=")
    whole[at : at + 8] = bytes(8)
    path.write_bytes(whole)


@pytest.mark.parametrize(
    ("make", "options", "said"),
    [
        (lambda path: None, {}, ": no such file"),
        (of_bytes(b"frame_id,line\n"), {}, "cannot be read as a bag (File magic is invalid)"),
        (killed, {}, "is not indexed, reindex before reading); if it was cut off"),
        (lambda path: write_bag(path, []), {}, "holds no messages on /isis_line"),
        (
            lambda path: write_bag(path, [GOOD_MESSAGE], topic="/my/lines"),
            {"topic": "/x"},
            "no topic /x; the file has /my/lines (pkg/msg/msg_lines)",
        ),
        (
            of_type("int64 way\nuint8[72] rest\n"),
            {},
            "no column offset_m; the table has time_s, way, rest",
        ),
        (lambda path: write_bag(path, [GOOD_MESSAGE, b""]), {}, "message 2 is cut off"),
        (
            of_ids(0, 0, 0),
            {},
            "way_id stays the same from message to message; `columns: {frame_id: null}`",
        ),
        (of_ids(0), {"topik": "/x"}, "no option 'topik' (did you mean 'topic'?)"),
    ],
)
def test_what_cannot_be_read_is_refused(
    tmp_path: Path, make: Callable[[Path], object], options: dict[str, Any], said: str
) -> None:
    make(tmp_path / "a.bag")
    assert said in refused(tmp_path / "a.bag", **options)


@pytest.mark.parametrize(("name", "n_frames", "n_lines"), PAPER_FILES)
def test_every_published_recording_loads_without_an_option(
    recordings: Path, name: str, n_frames: int, n_lines: int
) -> None:
    log = read_topic(recordings / name)
    assert log.offset_m.shape == (n_frames, n_lines)
    assert (np.diff(log.frame_id) > 0).all()


def test_the_oddities_of_the_published_recordings_are_counted(recordings: Path) -> None:
    said = {
        run: recording_warnings(read_topic(recordings / PAPER_FILES[run - 1][0]), n_lanes)
        for run, n_lanes in ((1, 4), (5, 4), (10, 3))
    }
    assert said[1] == []
    assert "30 valid line(s) have an LRI outside 0..10" in said[5][0]
    assert "13 valid line(s) have an LRI outside 0..10" in said[10][0]
