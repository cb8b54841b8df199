"""Messages decoded into columns, held against rosbags' own decoding."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from egolane_pgm.recordings.decoding import Decoder

POINT = "float64 x\nstring name\nbool is_there\n"
EVERYTHING = """\
uint8 A_CONSTANT=3
bool flag
string text
int16 small
Point point
uint8[3] bytes
float64[] numbers
string[] words
Point[] points
Point[2] ends
builtin_interfaces/Time stamp
uint64 last
"""


@pytest.fixture(scope="module")
def store() -> Any:
    made = get_typestore(Stores.ROS2_HUMBLE)
    made.register(get_types_from_msg(POINT, "own/msg/Point"))
    made.register(get_types_from_msg(EVERYTHING, "own/msg/Everything"))
    return made


def drawn(store: Any, random: np.random.Generator) -> Any:
    """A message with lists of 0 to 3 entries."""
    types = store.types

    def text() -> str:
        return "äb" * int(random.integers(3))

    def point() -> Any:
        return types["own/msg/Point"](random.normal(), text(), bool(random.integers(2)))

    def several() -> range:
        return range(random.integers(4))

    return types["own/msg/Everything"](
        bool(random.integers(2)),
        text(),
        int(random.integers(-999, 999)),
        point(),
        random.integers(0, 255, 3).astype(np.uint8),
        random.normal(size=random.integers(4)),
        [text() for _ in several()],
        [point() for _ in several()],
        [point(), point()],
        types["builtin_interfaces/msg/Time"](int(random.integers(2**31)), 250_000_000),
        2**63 + 1,
    )


@pytest.mark.parametrize("kind", ["ros1", "cdr"])
def test_columns_have_what_the_messages_have(store: Any, kind: str) -> None:
    random = np.random.default_rng(3)
    made = [drawn(store, random) for _ in range(20)]
    if kind == "ros1":
        raw = [bytes(store.serialize_ros1(each, "own/msg/Everything")) for each in made]
    else:
        raw = [bytes(store.serialize_cdr(each, "own/msg/Everything")) for each in made]
    found = Decoder(store.fielddefs, raw, kind != "ros1").decode("own/msg/Everything")
    for name in ("flag", "small", "last"):
        assert found[name].tolist() == [getattr(each, name) for each in made]
    assert found["point.x"].tolist() == [each.point.x for each in made]
    # Texts are skipped.
    assert not {"text", "words", "point.name"} & found.keys()
    assert found["stamp"].tolist() == [each.stamp.sec + 0.25 for each in made]
    for name in ("bytes", "numbers"):
        for one, other in zip(found[name], made, strict=True):
            np.testing.assert_array_equal(one, getattr(other, name))
    for name in ("points", "ends"):
        wanted = pd.DataFrame(
            [{"at": k, **vars(one)} for k, each in enumerate(made) for one in getattr(each, name)]
        )
        assert found[name].index.tolist() == wanted["at"].tolist()
        for of in ("x", "is_there"):
            assert found[name][of].tolist() == wanted[of].tolist()


def test_a_list_that_is_always_empty_has_its_fields(store: Any) -> None:
    store.register(get_types_from_msg("own/Point[] points\nstring[] words\n", "own/msg/Lists"))
    found = Decoder(store.fielddefs, [bytes(8)] * 2, False).decode("own/msg/Lists")
    assert list(found["points"]) == ["x", "is_there"]


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        ([bytes(8), bytes(7)], "message 2 is cut off"),
        ([bytes(8), bytes(9)], "message 2 is longer than a own/msg/Lists"),
        ([b"\xff" * 8], "message 1 is cut off"),
        ([bytes(4) + b"\1\0\0\0\xff\0\0\0"], "message 1 is cut off"),
    ],
)
def test_bytes_of_another_type_are_refused(store: Any, raw: list[bytes], said: str) -> None:
    store.register(get_types_from_msg("own/Point[] points\nstring[] words\n", "own/msg/Lists"))
    with pytest.raises(ValueError, match=said):
        Decoder(store.fielddefs, raw, False).decode("own/msg/Lists")
