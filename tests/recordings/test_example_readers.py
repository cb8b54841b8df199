"""The readers in examples/readers, each on a small file that its container's own library writes."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import egolane_pgm as ego
from egolane_pgm.types import LineLog
from tests.kits.drives import done

EXAMPLES = Path(__file__).parents[2] / "examples" / "readers"

N_FRAMES, START_S = 60, 1_700_000_000
TIMES = START_S + np.arange(N_FRAMES) / 10

#: The left and the right line of each frame (N_FRAMES, 2), metres to the right, in centimetres.
OFFSETS = np.round([-1.8, 1.7] + 0.2 * np.sin(np.arange(N_FRAMES) / 8)[:, None], 2)


def run(file: Path, name: str, *options: object) -> LineLog:
    """The lines of a file as a run with an example reads them."""
    reader = EXAMPLES / f"{name}.py"
    assert f"recording.format=examples/readers/{name}.py" in reader.read_text()
    assert len(reader.read_text().splitlines()) <= 40
    words = ("--n-lanes", 3, "--set", f"recording.format={reader}", *options)
    done("run", file, *words, "--no-figures", "--out", file.parent / "out")
    result = ego.load_result(file.parent / "out")
    assert result.frame_rate == 10
    [log] = result.lines.values()
    np.testing.assert_allclose(log.offset_m[:, :2], OFFSETS, atol=1e-6)
    np.testing.assert_array_equal(log.frame_id, np.arange(N_FRAMES))
    np.testing.assert_allclose(np.diff(log.time_s), 0.1, atol=1e-5)
    return log


def test_every_example_has_a_test() -> None:
    tested = re.findall(r'run\(\s*\w[^,]*, "(\w+)"', Path(__file__).read_text())
    assert sorted(tested) == sorted(path.stem for path in EXAMPLES.glob("*.py"))


OPENPILOT = """
@0xf3b1f17e25a4285b;
struct Event {
  logMonoTime @0 :UInt64;
  union { carState @1 :CarState; modelV2 @2 :ModelDataV2; }
}
struct CarState { vEgo @0 :Float32; }
struct XYZTData { x @0 :List(Float32); y @1 :List(Float32); }
struct ModelDataV2 {
  frameId @0 :UInt32;
  timestampEof @1 :UInt64;
  laneLines @2 :List(XYZTData);
  laneLineProbs @3 :List(Float32);
}
"""


def test_openpilot(tmp_path: Path) -> None:
    capnp = pytest.importorskip("capnp", reason="needs pycapnp")
    zstandard = pytest.importorskip("zstandard")
    (tmp_path / "log.capnp").write_text(OPENPILOT)
    event = capnp.SchemaParser().load(str(tmp_path / "log.capnp")).Event
    raw = b""
    for k in range(N_FRAMES):
        ns = 10**11 + k * 10**8
        made = event.new_message(logMonoTime=ns)
        model = made.init("modelV2")
        model.frameId, model.timestampEof = k, ns
        model.laneLines = [{"x": [0.0, 9.0], "y": [y, y + 1]} for y in (*OFFSETS[k].tolist(), 5.2)]
        model.laneLineProbs = [0.9, 0.9, 0.2]
        raw += made.to_bytes() + event.new_message(logMonoTime=ns, carState={}).to_bytes()
    file = tmp_path / "rlog.zst"
    file.write_bytes(zstandard.compress(raw))
    schema = f"recording.options.schema={tmp_path / 'log.capnp'}"
    log = run(file, "openpilot", "--set", schema)
    assert log.is_valid[0].tolist() == [True, True, False]


DBC = """VERSION ""
BU_: CAMERA
BO_ 1 BROKEN: 1 CAMERA
 SG_ TooLong : 0|16@1- (1,0) [0|0] "" CAMERA
"""
DBC += "".join(
    f"""
BO_ {number} {side}_A: 8 CAMERA
 SG_ Position : 0|16@1- (0.01,0) [-20|20] "m" CAMERA
 SG_ Quality : 16|2@1+ (1,0) [0|3] "" CAMERA

BO_ {number + 1} {side}_B: 8 CAMERA
 SG_ Type : 0|3@1+ (1,0) [0|7] "" CAMERA
"""
    for number, side in ((1894, "LEFT"), (1896, "RIGHT"))
)


def test_mobileye_on_can_with_a_fault_in_a_message_that_is_not_needed(tmp_path: Path) -> None:
    can = pytest.importorskip("can", reason="needs python-can")
    cantools = pytest.importorskip("cantools")
    (tmp_path / "lanes.dbc").write_text(DBC)
    known = cantools.database.load_file(tmp_path / "lanes.dbc", strict=False)
    file = tmp_path / "drive.blf"
    with can.Logger(file) as log:
        for time_s, offsets in zip(TIMES, OFFSETS, strict=True):
            for k, (side, offset) in enumerate(zip(("LEFT", "RIGHT"), offsets, strict=True)):
                position = {"Position": offset, "Quality": 3 if side == "LEFT" else 1}
                for late, (name, values) in enumerate((("A", position), ("B", {"Type": 1 - k}))):
                    message = known.get_message_by_name(f"{side}_{name}")
                    log.on_message_received(
                        can.Message(
                            timestamp=time_s + 0.004 * k + 0.002 * late,
                            arbitration_id=message.frame_id,
                            data=message.encode(values, padding=True),
                            is_extended_id=False,
                        )
                    )
            unknown = can.Message(timestamp=time_s + 0.02, arbitration_id=5, data=b"?")
            log.on_message_received(unknown)
    dbc = f"recording.options.dbc={tmp_path / 'lanes.dbc'}"
    log = run(file, "mobileye_can", "--set", dbc)
    np.testing.assert_array_equal(log.is_valid, [[True, False]] * N_FRAMES)
    np.testing.assert_array_equal(log.is_continuous, [[True, False]] * N_FRAMES)


def test_measurement_file(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf", reason="needs asammdf")
    file = asammdf.MDF()
    for k, side in enumerate(("Left", "Right")):
        # Channel groups have times of their own; the sign is of ISO 8855.
        signals = {f"{side}_C0": -OFFSETS[:, k], f"{side}_Quality": np.full(N_FRAMES, 3 - 2 * k)}
        file.append(
            [asammdf.Signal(v, np.arange(N_FRAMES) / 10, name=n) for n, v in signals.items()]
        )
    file.save(tmp_path / "drive.mf4")
    log = run(tmp_path / "drive.mf4", "mdf4", "--columns", "left_positive=true")
    np.testing.assert_array_equal(log.is_valid, [[True, False]] * N_FRAMES)


@pytest.mark.parametrize("name", ["drive.bag", "drive"])
def test_a_path_per_line(tmp_path: Path, name: str) -> None:
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    is_ros1 = name.endswith(".bag")
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    made = {kind.rpartition("/")[2]: each for kind, each in store.types.items()}
    seq = {"seq": 0} if is_ros1 else {}
    file = tmp_path / name
    kind = "nav_msgs/msg/Path"
    with rosbag1.Writer(file) if is_ros1 else rosbag2.Writer(file, version=9) as bag:
        topics = [
            bag.add_connection(f"/lane/{side}", kind, typestore=store) for side in ("left", "right")
        ]
        for k, offsets in enumerate(OFFSETS):
            stamp = store.types["builtin_interfaces/msg/Time"](START_S + k // 10, k % 10 * 10**8)
            header = made["Header"](stamp=stamp, frame_id="base_link", **seq)
            for topic, offset in zip(topics, offsets, strict=True):
                points = [made["Point"](x, -offset + 0.1 * x, 0.0) for x in (-2.0, 3.0)]
                turn = made["Quaternion"](0.0, 0.0, 0.0, 1.0)
                poses = [made["PoseStamped"](header, made["Pose"](p, turn)) for p in points]
                serialised = store.serialize_ros1 if is_ros1 else store.serialize_cdr
                raw = serialised(store.types[kind](header, poses), kind)
                bag.write(topic, START_S * 10**9 + k * 10**8, bytes(raw))
    run(file, "path")


def test_polynomials(tmp_path: Path) -> None:
    table: dict[str, object] = {"time": TIMES}
    for k, side in enumerate(("left", "right")):
        table |= {f"{side}_c0": OFFSETS[:, k], f"{side}_quality": 3 - 2 * k}
        table |= {f"{side}_c{power}": 0.1 for power in (1, 2, 3)}
    pd.DataFrame(table).to_csv(tmp_path / "drive.csv", index=False)
    log = run(tmp_path / "drive.csv", "polynomials")
    np.testing.assert_array_equal(log.is_valid, [[True, False]] * N_FRAMES)
