"""The example node, by its callback: ROS is stood in for."""

from __future__ import annotations

import importlib.util
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

FILE = Path(__file__).parents[1] / "examples/ros2/lane_node.py"


class Node:
    """What the example uses of rclpy's; it keeps what is published by topic."""

    parameters: dict[str, Any] = {}  # noqa: RUF012

    def __init__(self, name: str) -> None:
        self.published: dict[str, list[Any]] = {}
        self.subscribed: dict[str, tuple[Any, Callable[[Any], None]]] = {}
        self.said: list[str] = []

    def declare_parameter(self, name: str, default: Any) -> Any:
        return SimpleNamespace(value=self.parameters.get(name, default))

    def create_publisher(self, kind: type, topic: str, depth: int) -> Any:
        kept = self.published.setdefault(topic, [])
        return SimpleNamespace(publish=lambda message: kept.append(message.data))

    def create_subscription(self, kind: Any, topic: str, callback: Any, depth: int) -> None:
        self.subscribed[topic] = (kind, callback)

    def get_logger(self) -> Any:
        return SimpleNamespace(fatal=self.said.append)


@pytest.fixture
def lane_node(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The example as a module, between modules like those of ROS."""
    parts: dict[str, dict[str, Any]] = {
        "rclpy": {"shutdown": lambda: None},
        "rclpy.node": {"Node": Node},
        "rosidl_runtime_py": {"message_to_ordereddict": dict},
        "rosidl_runtime_py.utilities": {"get_message": lambda name: name},
        "std_msgs": {},
        "std_msgs.msg": dict.fromkeys(("Float32", "Int32", "String"), SimpleNamespace),
    }
    for name, content in parts.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("lane_node", FILE)
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def waited(is_so: Callable[[], bool]) -> bool:
    until = time.monotonic() + 60
    while not is_so() and time.monotonic() < until:
        time.sleep(0.01)
    return is_so()


def message(k: int, left: float) -> dict[str, Any]:
    lanes = [{"c0": left - 3.5 * line, "confidence": 0.9} for line in range(4)]
    return {"header": {"stamp": {"sec": k // 10, "nanosec": k % 10 * 10**8}}, "lanes": lanes}


def test_each_message_is_answered_and_a_lane_change_is_told(
    lane_node: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    columns = "offset_m=c0,left_positive=true"
    monkeypatch.setattr(Node, "parameters", {"columns": columns, "topic": "/seen"})
    node = lane_node.LaneNode()
    kind, callback = node.subscribed["/seen"]
    assert kind == "my_msgs/msg/Lanes"
    # From lane 1 of 3 to lane 2 within 3 s.
    for k in range(200):
        callback(message(k + 1, 1.75 + 3.5 * min(max(0, k - 80) / 30, 1)))
    assert waited(lambda: len(node.published["~/probability"]) == 200), node.said
    assert node.published["~/lane"][60] == 1
    assert node.published["~/lane"][-1] == 2
    assert node.published["~/probability"][-1] > 0.9
    (event,) = map(json.loads, node.published["~/events"])
    assert (event["from_lane"], event["to_lane"]) == (1, 2)


def test_a_message_that_does_not_fit_ends_the_node_with_a_line(lane_node: Any) -> None:
    node = lane_node.LaneNode()
    node.on_lines({"speed": 3.0})
    assert waited(lambda: bool(node.said))
    assert "columns: offset_m: there is no column 'c0'" in node.said[0]
