"""ROS 1 bags: what is read, in which order, and what is refused."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings import rosbag as rosbag_module
from egolane_pgm.recordings.rosbag import TOPIC, read_rosbag
from egolane_pgm.recordings.select import recording_warnings
from egolane_pgm.types import InputError, LineLog
from tests.kits.bags import PLAIN_BODY, PLAIN_LINE, Line, definition, plain_message, write_bag

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
    log = read_rosbag(write_bag(tmp_path / "a.bag", raw), frame_id="seq")
    np.testing.assert_array_equal(log.frame_id, [20, 21, 22])


@pytest.mark.parametrize("package", ["road_layout_estimation", "msgline", "anything"])
def test_the_package_of_the_message_type_does_not_matter(tmp_path: Path, package: str) -> None:
    raw = [plain_message(k, lines) for k, lines in enumerate(LINES)]
    bag = write_bag(
        tmp_path / "a.bag",
        raw,
        msgtype=f"{package}/msg/msg_lines",
        text=definition(package=package),
    )
    log = read_rosbag(bag)
    np.testing.assert_array_equal(log.is_valid.sum(axis=1), [1, 0, 2])


@pytest.mark.parametrize("frame_id", ["way_id", "seq"])
def test_another_layout_with_the_needed_fields_gives_the_same_arrays(
    tmp_path: Path, frame_id: str
) -> None:
    plain = [plain_message(k + 3, lines, seq=2 * k) for k, lines in enumerate(LINES)]
    extended = [extended_message(k + 3, lines, seq=2 * k) for k, lines in enumerate(LINES)]
    one = read_rosbag(write_bag(tmp_path / "a.bag", plain), frame_id=frame_id)
    other = read_rosbag(write_bag(tmp_path / "b.bag", extended, text=EXTENDED), frame_id=frame_id)
    assert_same(one, other)


def test_the_fast_parser_and_the_generated_deserialiser_agree_on_random_messages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(0)
    raw = []
    for k in range(200):
        n = int(rng.integers(0, 8))
        lines: list[Line] = [
            (bool(v), bool(c), int(lri), float(off))
            for v, c, lri, off in zip(
                *rng.integers(0, 2, (2, n)),
                rng.integers(-(2**31), 2**31, n),
                rng.normal(0, 10, n),
                strict=True,
            )
        ]
        raw.append(plain_message(3 * k, lines, seq=k, frame=b"x" * int(rng.integers(0, 9))))
    bag = write_bag(tmp_path / "a.bag", raw)
    fast = read_rosbag(bag)
    monkeypatch.setattr(rosbag_module, "_parse_plain", lambda *a: pytest.fail("not generic"))
    monkeypatch.setattr(rosbag_module, "_is_plain", lambda *a: False)
    assert_same(fast, read_rosbag(bag))


def test_messages_are_taken_in_file_order_whatever_their_stamps(tmp_path: Path) -> None:
    raw = [plain_message(k, [(True, False, 5, float(k))]) for k in range(60)]
    stamps = [int(s) for s in np.random.default_rng(1).permutation(60) // 3]
    bag = write_bag(tmp_path / "a.bag", raw, stamps=stamps, chunk_bytes=300)
    log = read_rosbag(bag)
    np.testing.assert_array_equal(log.frame_id, np.arange(60))
    np.testing.assert_array_equal(log.offset_m[:, 0], np.arange(60.0))


def test_a_topic_with_two_connections_is_read_in_file_order_each_by_its_definition(
    tmp_path: Path,
) -> None:
    from rosbags.rosbag1 import Writer

    with Writer(tmp_path / "a.bag") as bag:
        one = bag.add_connection(TOPIC, "pkg/msg/msg_lines", msgdef=definition(), md5sum="0" * 32)
        two = bag.add_connection(
            TOPIC, "pkg/msg/msg_lines", msgdef=EXTENDED, md5sum="1" * 32, callerid="/again"
        )
        for k in range(9):
            lines: list[Line] = [(True, False, 5, float(k))]
            if k < 4:
                bag.write(one, 100 - k, plain_message(k, lines))
            else:
                bag.write(two, 50 - k, extended_message(k, lines))
    log = read_rosbag(tmp_path / "a.bag")
    np.testing.assert_array_equal(log.frame_id, np.arange(9))
    np.testing.assert_array_equal(log.offset_m[:, 0], np.arange(9.0))


def test_compressed_bags_are_read(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer

    raw = [plain_message(k, lines) for k, lines in enumerate(LINES)]
    plain = read_rosbag(write_bag(tmp_path / "plain.bag", raw))
    for kind in (Writer.CompressionFormat.BZ2, Writer.CompressionFormat.LZ4):
        path = tmp_path / f"{kind.name}.bag"
        writer = Writer(path)
        writer.set_compression(kind)
        with writer as bag:
            connection = bag.add_connection(
                TOPIC, "pkg/msg/msg_lines", msgdef=definition(), md5sum="0" * 32
            )
            for k, message in enumerate(raw):
                bag.write(connection, k, message)
        assert_same(plain, read_rosbag(path))


def refused(path: Path, **options: object) -> str:
    with pytest.raises(InputError) as info:
        read_rosbag(path, **options)  # type: ignore[arg-type]
    text = str(info.value)
    assert "\n" not in text
    assert text.startswith(str(path))
    return text.removeprefix(str(path))


def test_what_is_not_a_bag_is_refused(tmp_path: Path) -> None:
    assert refused(tmp_path / "absent.bag") == ": no such file"
    (tmp_path / "empty.bag").write_bytes(b"")
    assert refused(tmp_path / "empty.bag") == ": the file is empty"
    (tmp_path / "text.bag").write_text("frame_id,line\n")
    assert refused(tmp_path / "text.bag") == ": not a ROS bag nor an MCAP file"
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V1.2\n")
    assert "version 2.0" in refused(tmp_path / "old.bag")


def test_a_bag_cut_anywhere_is_refused(tmp_path: Path) -> None:
    raw = [plain_message(k, [(True, False, 5, 1.0)]) for k in range(40)]
    whole = write_bag(tmp_path / "a.bag", raw, chunk_bytes=900).read_bytes()
    cut = tmp_path / "cut.bag"
    points = {13, 40, 4096, 4117, len(whole) - 1, *range(4117, len(whole), 97)}
    for n in sorted(points):
        cut.write_bytes(whole[:n])
        assert "truncated or damaged" in refused(cut), n


def test_a_bag_whose_recording_was_killed_is_refused(tmp_path: Path) -> None:
    whole = bytearray(write_bag(tmp_path / "a.bag", [plain_message(0, [])]).read_bytes())
    at = whole.index(b"index_pos=") + len(b"index_pos=")
    whole[at : at + 8] = bytes(8)
    (tmp_path / "a.bag").write_bytes(whole)
    text = refused(tmp_path / "a.bag")
    assert "not indexed" in text
    assert "rosbag reindex" in text


def test_an_index_that_lost_messages_is_refused(tmp_path: Path) -> None:
    whole = bytearray(write_bag(tmp_path / "a.bag", [plain_message(0, [])]).read_bytes())
    whole[-4:] = struct.pack("<I", 2)  # the chunk is said to hold two messages
    (tmp_path / "a.bag").write_bytes(whole)
    assert "the index has 1 of 2 messages" in refused(tmp_path / "a.bag")


def test_a_bag_without_messages_is_refused(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer

    with Writer(tmp_path / "a.bag"):
        pass
    assert "the bag is empty" in refused(tmp_path / "a.bag")
    write_bag(tmp_path / "b.bag", [])
    assert "no messages" in refused(tmp_path / "b.bag")


def test_a_topic_that_is_not_there_is_refused_with_those_that_are(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "a.bag", [plain_message(0, [])], topic="/my/lines")
    text = refused(bag)
    assert TOPIC in text
    assert "/my/lines (pkg/msg/msg_lines)" in text
    assert len(read_rosbag(bag, topic="my/lines")) == 1


@pytest.mark.parametrize(
    ("body", "line", "lacks"),
    [
        (PLAIN_BODY.replace("int64 way_id\n", ""), PLAIN_LINE, "way_id"),
        (PLAIN_BODY.replace("int64 way_id", "string way_id"), PLAIN_LINE, "way_id"),
        (PLAIN_BODY, PLAIN_LINE.replace("offset", "position"), "lines[].offset"),
        (PLAIN_BODY, PLAIN_LINE.replace("bool isValid\n", ""), "lines[].isValid"),
        ("int64 way_id\nfloat32[] lines\n", PLAIN_LINE, "lines[].counter"),
    ],
)
def test_a_type_that_lacks_a_field_is_refused_by_name(
    tmp_path: Path, body: str, line: str, lacks: str
) -> None:
    bag = write_bag(tmp_path / "a.bag", [b"\0" * 80], text=definition(body, line))
    text = refused(bag)
    assert "pkg/msg/msg_lines" in text
    assert lacks in text


def test_seq_is_only_needed_where_it_is_asked_for(tmp_path: Path) -> None:
    text = definition(PLAIN_BODY.replace("Header header\n", ""))
    raw = plain_message(5, LINES[0])[19:]
    bag = write_bag(tmp_path / "a.bag", [raw], text=text)
    np.testing.assert_array_equal(read_rosbag(bag).lri, [[7, -1]])
    assert "header.seq" in refused(bag, frame_id="seq")


def test_a_definition_that_cannot_be_parsed_is_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "a.bag", [b"\0" * 80], text="int32[ way_id\n")
    assert "definition" in refused(bag)


@pytest.mark.parametrize("damage", [lambda raw: raw[:-1], lambda raw: raw + b"\0", lambda raw: b""])
def test_a_message_of_the_wrong_size_is_refused(tmp_path: Path, damage: object) -> None:
    assert callable(damage)
    good = plain_message(0, LINES[0])
    bag = write_bag(tmp_path / "a.bag", [good, damage(plain_message(1, LINES[0]))])
    assert "message 2" in refused(bag)


def test_a_damaged_message_of_another_layout_is_refused(tmp_path: Path) -> None:
    raw = [extended_message(0, LINES[0]), extended_message(1, LINES[0])[:20]]
    bag = write_bag(tmp_path / "a.bag", raw, text=EXTENDED)
    assert "message 2" in refused(bag)


def test_frame_id_zero_in_every_message_is_refused_and_seq_offered(tmp_path: Path) -> None:
    raw = [plain_message(0, lines, seq=k) for k, lines in enumerate(LINES)]
    bag = write_bag(tmp_path / "a.bag", raw)
    text = refused(bag)
    assert "all 3 messages have frame id 0" in text
    assert "--frame-id seq" in text
    assert len(read_rosbag(bag, frame_id="seq")) == 3


@pytest.mark.parametrize(
    ("ids", "said"),
    [([1, 2, 2, 5], "frame id 2 occurs more than once"), ([1, 5, 4], "5 is followed by 4")],
)
def test_frame_ids_that_do_not_increase_are_refused(
    tmp_path: Path, ids: list[int], said: str
) -> None:
    bag = write_bag(tmp_path / "a.bag", [plain_message(i, []) for i in ids])
    assert said in refused(bag)


@pytest.mark.parametrize("offset", [float("nan"), float("inf"), float("-inf")])
def test_an_offset_that_is_no_number_is_refused_on_a_valid_line_only(
    tmp_path: Path, offset: float
) -> None:
    good = [plain_message(0, []), plain_message(7, [(False, False, 0, offset)])]
    log = read_rosbag(write_bag(tmp_path / "good.bag", good))
    np.testing.assert_array_equal(log.offset_m, [[np.nan], [offset]])
    bad = [plain_message(0, []), plain_message(7, [(True, False, 0, offset)])]
    text = refused(write_bag(tmp_path / "bad.bag", bad))
    assert "frame 7" in text
    assert str(offset) in text


def test_a_message_with_thousands_of_lines_is_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "a.bag", [plain_message(3, [(False, False, 0, 0.0)] * 1001)])
    assert "frame 3 has 1001 lines" in refused(bag)


def test_bad_options_are_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "a.bag", [plain_message(0, [])])
    assert "way_id, seq" in refused(bag, frame_id="id")
    assert "greater than 0" in refused(bag, frame_rate=0.0)
    with pytest.raises(InputError, match=r"no option 'topik' \(did you mean 'topic'\?\)"):
        read_lines(bag, topik="/x")
    with pytest.raises(InputError, match=r"\.csv, \.parquet"):
        read_lines(tmp_path / "a.txt")
    with pytest.raises(InputError, match="did you mean 'rosbag'"):
        read_lines(bag, format="rosbg")
    renamed = bag.rename(tmp_path / "a.recording")
    assert len(read_lines(renamed, format="rosbag")) == 1


@pytest.mark.parametrize(("name", "n_frames", "n_lines"), PAPER_FILES)
def test_every_published_recording_loads_without_an_option(
    recordings: Path, name: str, n_frames: int, n_lines: int
) -> None:
    log = read_rosbag(recordings / name)
    assert log.offset_m.shape == (n_frames, n_lines)
    assert (np.diff(log.frame_id) > 0).all()


def test_the_fast_parser_agrees_with_the_deserialiser_on_a_published_recording(
    recordings: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = recordings / PAPER_FILES[9][0]
    fast = read_rosbag(path)
    monkeypatch.setattr(rosbag_module, "_is_plain", lambda *a: False)
    assert_same(fast, read_rosbag(path))


def test_the_oddities_of_the_published_recordings_are_counted(recordings: Path) -> None:
    said = {
        run: recording_warnings(read_rosbag(recordings / PAPER_FILES[run - 1][0]), n_lanes)
        for run, n_lanes in ((1, 4), (5, 4), (6, 3), (8, 3), (10, 3))
    }
    assert said[1] == []
    assert "30 valid line(s) have an LRI outside 0..10" in said[5][0]
    assert "13 valid line(s) have an LRI outside 0..10" in said[10][0]
    assert "11 line(s) that are not valid have an offset beyond 100 m" in said[6][0]
    assert "10 line(s) that are not valid have an offset beyond 100 m" in said[8][0]
