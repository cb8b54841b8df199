"""Files of messages, each made by the kind's own library, from the file to the lane."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.recordings.containers import messages, topics_of
from egolane_pgm.types import InputError
from tests.kits.drives import done
from tests.kits.message_files import (
    N_FRAMES,
    OFFSETS,
    START_S,
    SWING,
    can_log,
    json_mcap,
    mdf,
    openpilot_log,
    own_bag,
    protobuf_mcap,
)

#: `--lines` for messages of one's own, and for signals of a message per line.
OWN = ("offset=lanes[].c0", "is_valid=confidence > 0.5", "is_continuous=is_solid")
SIGNALS = ("topic=Lane{}", "each=[0, 1, 2, 3]", "offset=C0", "is_valid=Quality >= 2")
SIGNALS += ("is_continuous=Type == 1",)

#: A file of each kind: what makes it, how its lines are named, what defines its messages.
KINDS: list[tuple[str, Callable[[Path], None], tuple[str, ...], str | None]] = [
    ("own.bag", own_bag, OWN, None),
    ("own", own_bag, OWN, None),
    ("json.mcap", json_mcap, OWN, None),
    ("protobuf.mcap", protobuf_mcap, OWN, None),
    ("d.blf", can_log, SIGNALS, "lanes.dbc"),
    ("d.asc", can_log, SIGNALS, "lanes.dbc"),
    ("d.log", can_log, SIGNALS, "lanes.dbc"),
    ("frames.mf4", can_log, SIGNALS, "lanes.dbc"),
    ("signals.mf4", mdf, SIGNALS, None),
    ("rlog", openpilot_log, ("openpilot",), "log.capnp"),
    ("rlog.zst", openpilot_log, ("openpilot",), "log.capnp"),
    ("qlog.bz2", openpilot_log, ("openpilot",), "log.capnp"),
]


@pytest.mark.parametrize(("name", "make", "lines", "definitions"), KINDS)
def test_each_kind_of_file_goes_from_the_file_to_the_lane(
    tmp_path: Path,
    name: str,
    make: Callable[[Path], None],
    lines: tuple[str, ...],
    definitions: str | None,
) -> None:
    make(tmp_path / name)
    words: list[object] = [tmp_path / name, "--n-lanes", 3]
    for each in lines if definitions == "log.capnp" else (*lines, "left_positive=true"):
        words += ["--lines", each]
    words += ["--topic", "/lanes"] if lines == OWN else []
    words += ["--definitions", tmp_path / definitions] if definitions else []
    done("run", *words, "--no-figures", "--out", tmp_path / "out")
    result = ego.load_result(tmp_path / "out")
    assert (result.assigned_lane == 1).all()
    assert result.config["recording"]["frame_rate"] == 10
    log = result.lines
    assert log is not None
    seen = log.offset_m[:, :4]
    np.testing.assert_allclose(seen, -np.add.outer(SWING, OFFSETS), atol=1e-6)
    np.testing.assert_array_equal(log.frame_id, np.arange(N_FRAMES))
    np.testing.assert_allclose(np.diff(log.time_s), 0.1, atol=1e-5)
    if lines == OWN:
        # The stamps in the messages, and not half a second later.
        np.testing.assert_allclose(log.time_s[0], START_S, atol=1e-6)
        assert "/lanes" in topics_of(tmp_path / name)
    if "Type" in str(lines) or lines == OWN:
        np.testing.assert_array_equal(log.is_continuous[0], [True, False, False, True])


def of_bytes(content: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content)


def cut(make: Callable[[Path], None]) -> Callable[[Path], object]:
    def write(path: Path) -> None:
        make(path)
        path.write_bytes(path.read_bytes()[:600])

    return write


@pytest.mark.parametrize(
    ("name", "make", "options", "said"),
    [
        ("a.blf", lambda path: None, {}, "a.blf: no such file"),
        ("a.blf", can_log, {}, "is a log of CAN frames: name the .dbc that defines"),
        ("a.blf", can_log, {"definitions": "b.dbc"}, "b.dbc: no such file"),
        ("a.blf", can_log, {"definitions": "a.blf"}, "a.blf: cannot be read as a .dbc ("),
        (
            "a.blf",
            of_bytes(b"?" * 200),
            {"definitions": "../lanes.dbc"},
            "as a log of CAN frames (",
        ),
        (
            "a.asc",
            can_log,
            {"definitions": "lanes.dbc", "topics": ["Lane4"]},
            "no topic Lane4 (did you mean 'Lane3'?); the file has Lane0 (CAN 0x768), Lane1",
        ),
        ("a.log", of_bytes(b""), {"definitions": "../lanes.dbc"}, "holds no messages"),
        ("a.mf4", of_bytes(b"MDF     4.10"), {}, "a.mf4: cannot be read as MDF ("),
        ("a.mcap", cut(json_mcap), {}, "if it was cut off or damaged, try `mcap recover`"),
        ("rlog", openpilot_log, {}, "is a log of openpilot: name the cereal/log.capnp"),
        ("rlog.zst", cut(openpilot_log), {"definitions": "rlog.zst"}, "as a schema of Cap'n Proto"),
        ("rlog", of_bytes(b"?" * 80), {"definitions": "../log.capnp"}, "as a log of openpilot ("),
    ],
)
def test_what_cannot_be_read_is_refused_in_a_line_that_says_what_helps(
    tmp_path: Path, name: str, make: Callable[[Path], object], options: dict[str, Any], said: str
) -> None:
    can_log(tmp_path / "b.asc")
    openpilot_log(tmp_path / "b.rlog")
    folder = tmp_path / "in"
    folder.mkdir()
    make(folder / name)
    given = {**options}
    if "definitions" in given:
        given["definitions"] = folder / given["definitions"]
    with pytest.raises(InputError) as info:
        list(messages(folder / name, **given))
    assert said in str(info.value)
    assert "\n" not in str(info.value)


def test_one_of_several_topics_has_to_be_named(tmp_path: Path) -> None:
    own_bag(tmp_path / "a.bag")
    with pytest.raises(InputError, match=r"topic: is missing; the file has /lanes \(my_msgs/msg/L"):
        ego.read_lines(tmp_path / "a.bag")


@pytest.mark.parametrize(("name", "definitions"), [(k[0], k[3]) for k in KINDS])
def test_inspect_gives_a_command_that_finds_the_lines(
    tmp_path: Path, name: str, definitions: str | None
) -> None:
    next(make for kind, make, _, _ in KINDS if kind == name)(tmp_path / name)
    words = ["--definitions", tmp_path / definitions] if definitions else []
    shown = done("inspect", tmp_path / name, *words).stdout
    (command,) = (line for line in shown.splitlines() if line.startswith("  egolane run"))
    given = shlex.split(command.replace("--n-lanes N", "--n-lanes 3"))[1:]
    done(*given, "--no-figures", "--out", tmp_path / "out")
    log = ego.load_result(tmp_path / "out").lines
    assert log is not None
    np.testing.assert_allclose(log.offset_m[:, :4], -np.add.outer(SWING, OFFSETS), atol=1e-6)
    assert log.is_valid[:, :4].all()
