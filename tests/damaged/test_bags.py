"""Bags that lie about sizes: refused in a line, before the memory is taken."""

from __future__ import annotations

import sqlite3
import struct
import subprocess
import sys
from functools import cache
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.rosbag import MOST_DEFINITION, TOPIC
from egolane_pgm.types import InputError

#: What is packed, bytes: zeros.
SIZE = 1 << 29


@cache
def packed(kind: str) -> bytes:
    """So many zeros."""
    part = bytes(1 << 24)
    if kind == "zstd":
        packer = zstandard.ZstdCompressor().compressobj()
    else:
        packer = lz4.frame.LZ4FrameCompressor(block_size=lz4.frame.BLOCKSIZE_MAX4MB)
    begun = packer.begin() if kind == "lz4" else b""
    return begun + b"".join(packer.compress(part) for _ in range(SIZE >> 24)) + packer.flush()


def mcap(path: Path, kind: str, size: int, definition: bytes = b"int64 x\n") -> Path:
    """An MCAP file of one message and, last, a chunk that says it has so many bytes."""
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE, use_chunking=False)
        writer.start()
        schema = writer.register_schema("pkg/msg/Lines", "ros2msg", definition)
        channel = writer.register_channel(TOPIC, "cdr", schema)
        if not kind:
            writer.add_message(channel, 0, b"\0\1\0\0" + bytes(8), 0)
            writer.finish()
            return path
    data = packed(kind)
    body = struct.pack("<QQQI", 0, 1, size, 0) + struct.pack("<I", len(kind)) + kind.encode()
    body += struct.pack("<Q", len(data)) + data
    path.write_bytes(path.read_bytes() + struct.pack("<BQ", 6, len(body)) + body)
    return path


def database(path: Path, data: str, rest: str) -> Path:
    """A ROS 2 bag's database with another column of messages and other statements."""
    with sqlite3.connect(path) as made:
        made.executescript(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT,"
            " serialization_format TEXT, offered_qos_profiles TEXT);"
            f"CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data {data});"
            f"INSERT INTO topics VALUES(1, '{TOPIC}', 'pkg/msg/Lines', 'cdr', '');"
            f"INSERT INTO messages(topic_id, timestamp) VALUES(1, 1); {rest}"
        )
    made.close()
    return path


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_lines(path)
    [line] = caught.value.lines
    return line


def test_chunks_that_unpack_to_much_take_no_memory(tmp_path: Path) -> None:
    made = {
        mcap(tmp_path / "a.mcap", "lz4", SIZE): "a chunk would need 512 MB of memory, more",
        mcap(tmp_path / "b.mcap", "zstd", 1 << 60): "would need 1,099,511,627,776 MB of memory",
        mcap(tmp_path / "c.mcap", "zstd", 100): "a chunk holds more than 100 bytes",
        mcap(tmp_path / "d.mcap", "lz4", 100): "a chunk holds more than 100 bytes",
    }
    if not Path("/proc/self/status").exists():
        pytest.skip("needs Linux, which tells a process's own peak of memory")
    read = """
import re, sys
from pathlib import Path
from egolane_pgm.recordings import read_lines
from egolane_pgm.types import InputError
for path in sys.argv[1:]:
    try:
        read_lines(path)
    except InputError as error:
        print(error)
print(int(re.search(r"VmHWM:\\s*(\\d+)", Path("/proc/self/status").read_text())[1]) >> 10)
"""
    run = subprocess.run(
        [sys.executable, "-c", read, *map(str, made)], capture_output=True, text=True, check=True
    )
    *said, most_mb = run.stdout.splitlines()
    for line, (path, expected) in zip(said, made.items(), strict=True):
        assert line.startswith(f"{path}: the bag is truncated or damaged (")
        assert expected in line
    assert int(most_mb) < 500


def test_a_definition_that_takes_minutes_to_read_is_not_read(tmp_path: Path) -> None:
    path = mcap(tmp_path / "a.mcap", "", 0, b"int64 x\n" * (MOST_DEFINITION // 8 + 1))
    said = f"the definition of pkg/msg/Lines has {MOST_DEFINITION + 8} characters, more than the"
    assert said in refusal(path)


@pytest.mark.parametrize(
    ("data", "rest", "name"),
    [
        ("BLOB AS (zeroblob(900000000))", "", "messages"),
        ("BLOB GENERATED ALWAYS AS (zeroblob(9)) VIRTUAL", "", "messages"),
        (
            "BLOB",
            "CREATE VIEW schema AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x FROM c)"
            " SELECT count(x) AS schema_version FROM c;",
            "schema",
        ),
    ],
)
def test_a_database_that_computes_what_it_holds_is_no_bag(
    data: str, rest: str, name: str, tmp_path: Path
) -> None:
    path = database(tmp_path / "a.db3", data, rest)
    assert refusal(path) == (
        f"{path}: {name} is a view, a computed column or a virtual table, which no recorder writes"
    )
