"""Small files of messages, of each kind that cars make, with the same lines: 60 frames, ten a
second, of a car in lane 1 of 3. Each is made by the kind's own library."""

from __future__ import annotations

import bz2
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import asammdf
import can
import cantools
import capnp
import numpy as np
import zstandard
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from mcap.writer import Writer as McapWriter
from mcap_protobuf.writer import Writer as ProtobufWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

#: The lines of each frame, metres to the left, and which is solid.
OFFSETS, SOLID = (1.7, -1.8, -5.3, -8.8), (True, False, False, True)
N_FRAMES, START_S = 60, 1_700_000_000

DBC = "".join(
    f"""
BO_ {number} {name}: 8 CAMERA
 SG_ C0 : 0|16@1- (0.01,0) [-20|20] "m" CAMERA
 SG_ Quality : 16|2@1+ (1,0) [0|3] "" CAMERA
 SG_ Type : 18|3@1+ (1,0) [0|7] "" CAMERA
"""
    for number, name in enumerate(("Lane0", "Lane1", "Lane2", "Lane3"), start=1896)
)

#: What cereal/log.capnp of openpilot has of this.
SCHEMA = """
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
  roadEdges @4 :List(XYZTData);
  roadEdgeStds @5 :List(Float32);
}
"""

LANES_MSG = "std_msgs/Header header\nLane[] lanes\nuint32 sequence\n"
LANE_MSG = "float64 c0\nfloat32 confidence\nbool is_solid\n"


#: How far the car is from where it began, (N_FRAMES,), metres.
SWING = np.round(0.2 * np.sin(np.arange(N_FRAMES) / 8), 2)


def frames() -> Iterator[tuple[float, list[dict[str, Any]]]]:
    """The time and the lines of each frame."""
    for k in range(N_FRAMES):
        yield (
            START_S + k / 10,
            [
                {"c0": round(offset + float(SWING[k]), 2), "confidence": 0.9, "is_solid": solid}
                for offset, solid in zip(OFFSETS, SOLID, strict=True)
            ],
        )


def own_bag(path: Path) -> None:
    """A bag of own messages, of ROS 1 or 2, recorded half a second after their stamps."""
    is_ros1 = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(LANES_MSG, "my_msgs/msg/Lanes"))
    store.register(get_types_from_msg(LANE_MSG, "my_msgs/msg/Lane"))
    types = store.types
    writer = (
        Writer1(path) if is_ros1 else Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP)
    )
    with writer as bag:
        lanes = bag.add_connection("/lanes", "my_msgs/msg/Lanes", typestore=store)
        other = bag.add_connection("/said", "std_msgs/msg/String", typestore=store)
        for k, (time_s, lines) in enumerate(frames()):
            stamp = types["builtin_interfaces/msg/Time"](int(time_s), round(time_s % 1 * 1e9))
            seq = {"seq": k} if is_ros1 else {}
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="car", **seq)
            each = [types["my_msgs/msg/Lane"](**line) for line in lines]
            message = types["my_msgs/msg/Lanes"](header, each, k)
            serialised = store.serialize_ros1 if is_ros1 else store.serialize_cdr
            ns = round((time_s + 0.5) * 1e9)
            bag.write(lanes, ns, bytes(serialised(message, "my_msgs/msg/Lanes")))
            said = types["std_msgs/msg/String"]("hello")
            bag.write(other, ns, bytes(serialised(said, "std_msgs/msg/String")))


def json_mcap(path: Path) -> None:
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="", library="test")
        schema = writer.register_schema("lanes", "jsonschema", b"{}")
        channel = writer.register_channel("/lanes", "json", schema)
        for time_s, lines in frames():
            stamp = {"nsec": round(time_s % 1 * 1e9), "sec": int(time_s)}
            data = json.dumps({"timestamp": stamp, "lanes": lines}).encode()
            writer.add_message(channel, round((time_s + 0.5) * 1e9), data, 0)
        writer.finish()


def protobuf_mcap(path: Path) -> None:
    file = descriptor_pb2.FileDescriptorProto(name="lanes.proto", package="my", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    line = file.message_type.add(name="Line")
    for number, (name, kind) in enumerate((("c0", 1), ("confidence", 2), ("is_solid", 8)), start=1):
        line.field.add(name=name, number=number, type=kind, label=1)
    lanes = file.message_type.add(name="Lanes")
    stamp = ".google.protobuf.Timestamp"
    lanes.field.add(name="timestamp", number=1, type=11, type_name=stamp, label=1)
    lanes.field.add(name="lanes", number=2, type=11, type_name=".my.Line", label=3)
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    made = message_factory.GetMessageClass(pool.FindMessageTypeByName("my.Lanes"))
    with path.open("wb") as out, ProtobufWriter(out) as writer:
        for time_s, lines in frames():
            message = made(lanes=lines)
            message.timestamp.FromNanoseconds(round(time_s * 1e9))
            ns = round((time_s + 0.5) * 1e9)
            writer.write_message("/lanes", message, log_time=ns, publish_time=ns)


def can_log(path: Path) -> None:
    """A log of CAN frames, each line a message of its own, 2 ms after the one before."""
    path.with_name("lanes.dbc").write_text(f'VERSION ""\nBU_: CAMERA\n{DBC}')
    known = cantools.database.load_file(path.with_name("lanes.dbc"))
    kind = can.MF4Writer if path.suffix == ".mf4" else can.Logger
    with kind(path) as log:
        for time_s, lines in frames():
            for k, line in enumerate(lines):
                values = {"C0": line["c0"], "Quality": 3, "Type": int(line["is_solid"])}
                data = known.encode_message(f"Lane{k}", values)
                log.on_message_received(
                    can.Message(
                        timestamp=time_s + k * 0.002,
                        arbitration_id=1896 + k,
                        data=data,
                        is_extended_id=False,
                    )
                )
            unknown = can.Message(timestamp=time_s, arbitration_id=5, data=b"?")
            log.on_message_received(unknown)


def mdf(path: Path) -> None:
    """A measurement, each line a channel group of its own, 2 ms after the one before."""
    file = asammdf.MDF()
    for k, (offset, solid) in enumerate(zip(OFFSETS, SOLID, strict=True)):
        time_s = np.arange(N_FRAMES) / 10 + k * 0.002
        signals = {"C0": offset + SWING, "Quality": 3, "Type": int(solid)}
        file.append(
            [asammdf.Signal(np.full(N_FRAMES, v), time_s, name=n) for n, v in signals.items()],
            acq_name=f"Lane{k}",
        )
    file.save(path)


def openpilot_log(path: Path) -> None:
    schema = path.with_name("log.capnp")
    schema.write_text(SCHEMA)
    known = capnp.SchemaParser().load(str(schema))
    event = known.Event
    raw = b""
    for k, (time_s, lines) in enumerate(frames()):
        ns = round((time_s - START_S + 100) * 1e9)
        made = event.new_message(logMonoTime=ns)
        model = made.init("modelV2")
        model.frameId, model.timestampEof = k, ns
        model.laneLines = [{"x": [0.0, 9.0], "y": [-line["c0"]] * 2} for line in lines]
        model.laneLineProbs = [line["confidence"] for line in lines]
        model.roadEdges = [{"x": [0.0, 9.0], "y": [y, y]} for y in (-4.0, 11.0)]
        model.roadEdgeStds = [2.0, 2.0]
        raw += made.to_bytes()
        raw += event.new_message(logMonoTime=ns + 5, carState={"vEgo": 30.0}).to_bytes()
    packed = {".zst": zstandard.compress, ".bz2": bz2.compress}.get(path.suffix, bytes)
    path.write_bytes(packed(raw))


def write_logs(folder: Path) -> None:
    """The files that docs/howto/sensors.md names."""
    own_bag(folder / "own.bag")
    json_mcap(folder / "json.mcap")
    protobuf_mcap(folder / "protobuf.mcap")
    can_log(folder / "frames.blf")
    mdf(folder / "signals.mf4")
    openpilot_log(folder / "rlog.zst")
