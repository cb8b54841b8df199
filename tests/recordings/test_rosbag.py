"""ROS 1 bags: what is read, in which order, and what is refused or warned of."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.experiment import Columns
from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.select import recording_warnings
from egolane_pgm.recordings.topics import TOPICS, read_topic
from egolane_pgm.types import InputError, LineLog
from tests.kits.bags import (
    PLAIN_BODY,
    PLAIN_CHECKSUM,
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


def extended_message(way_id: int, lines: list[Line], seq: int = 0) -> bytes:
    """The same content with other fields around it, and in another order."""
    raw = struct.pack("<I", len(lines))
    raw += b"".join(struct.pack("<df?i?", 0.5, off, c, lri, v) for v, c, lri, off in lines)
    raw += struct.pack("<i", way_id) + struct.pack("<IIII", seq, 0, 0, 2) + b"ab"
    return raw + struct.pack("<I", 5) + b"hello"


EXTENDED = definition(
    "msg_lineInfo[] lines\nint32 way_id\nHeader header\nstring remark\n",
    "float64 width\nfloat32 offset\nbool continuous\nint32 counter\nbool isValid\n",
)


def assert_same(one: LineLog, other: LineLog) -> None:
    for name in ("frame_id", "time_s", "offset_m", "is_valid", "is_continuous", "lri"):
        a, b = getattr(one, name), getattr(other, name)
        assert a.dtype == b.dtype, name
        np.testing.assert_array_equal(a, b, err_msg=name)


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


@pytest.mark.parametrize("columns", [None, SEQ])
def test_another_layout_with_the_needed_fields_gives_the_same_arrays(
    tmp_path: Path, columns: Columns | None
) -> None:
    plain = [plain_message(k + 3, lines, seq=2 * k) for k, lines in enumerate(LINES)]
    extended = [extended_message(k + 3, lines, seq=2 * k) for k, lines in enumerate(LINES)]
    one = read_topic(write_bag(tmp_path / "a.bag", plain), columns=columns)
    other = read_topic(write_bag(tmp_path / "b.bag", extended, text=EXTENDED), columns=columns)
    assert_same(one, other)


def test_messages_are_taken_in_the_order_of_recording(tmp_path: Path) -> None:
    raw = [plain_message(k, [(True, False, 5, float(k))]) for k in range(60)]
    later = np.random.default_rng(1).permutation(60)
    # Of two that were recorded at the same time the first in the file comes first.
    stamps, messages = [int(k) // 2 for k in sorted(later, key=lambda k: k // 2)], raw
    bag = write_bag(tmp_path / "a.bag", messages, stamps=stamps, chunk_bytes=300)
    np.testing.assert_array_equal(read_topic(bag).frame_id, np.arange(60))
    bag = write_bag(
        tmp_path / "b.bag", [raw[k] for k in later], stamps=later.tolist(), chunk_bytes=300
    )
    log = read_topic(bag)
    np.testing.assert_array_equal(log.frame_id, np.arange(60))
    np.testing.assert_array_equal(log.offset_m[:, 0], np.arange(60.0))


def two_nodes(path: Path, text: str) -> Path:
    """A topic that a second node went on with; text: its definition."""
    from rosbags.rosbag1 import Writer

    with Writer(path) as bag:
        for k, message in enumerate((plain_message(0, LINES[0]), plain_message(1, LINES[0]))):
            connection = bag.add_connection(
                TOPICS[0],
                "pkg/msg/msg_lines",
                msgdef=text if k else definition(),
                md5sum=PLAIN_CHECKSUM,
                callerid=f"/node{k}",
            )
            bag.write(connection, k, message)
    return path


def test_a_topic_of_two_nodes_is_read_if_they_have_one_definition(tmp_path: Path) -> None:
    assert len(read_topic(two_nodes(tmp_path / "a.bag", definition()))) == 2
    commented = definition(PLAIN_BODY + "# once more\n")
    assert "several definitions" in refused(two_nodes(tmp_path / "b.bag", commented))


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
            "0 is followed by 0; split the file there, or, where it does not fill in way_id, take"
            " `columns: {frame_id: header.seq}` (ROS 1)",
        ),
        (of_ids(1, 5, 4), {}, "frame ids must increase, but 5 is followed by 4"),
        (of_ids(0), {"topik": "/x"}, "no option 'topik' (did you mean 'topic'?)"),
    ],
)
def test_what_cannot_be_read_is_refused(
    tmp_path: Path, make: Callable[[Path], object], options: dict[str, Any], said: str
) -> None:
    make(tmp_path / "a.bag")
    assert said in refused(tmp_path / "a.bag", **options)


def test_a_bag_that_says_it_has_more_messages_is_warned_of(tmp_path: Path) -> None:
    whole = bytearray(write_bag(tmp_path / "a.bag", [GOOD_MESSAGE]).read_bytes())
    whole[-4:] = struct.pack("<I", 2)  # the chunk is said to hold two messages
    (tmp_path / "a.bag").write_bytes(whole)
    with pytest.warns(
        UserWarning, match=f"1 messages were read of the 2 that it says are on {TOPICS[0]}"
    ):
        assert len(read_topic(tmp_path / "a.bag")) == 1


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
        for run, n_lanes in ((1, 4), (5, 4), (6, 3), (8, 3), (10, 3))
    }
    assert said[1] == []
    assert "30 valid line(s) have an LRI outside 0..10" in said[5][0]
    assert "13 valid line(s) have an LRI outside 0..10" in said[10][0]
    assert "11 line(s) that are not valid have an offset beyond 100 m" in said[6][0]
    assert "10 line(s) that are not valid have an offset beyond 100 m" in said[8][0]
