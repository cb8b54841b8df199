"""Messages as columns."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from egolane_pgm.recordings.decoding import fields_of_objects

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


def test_columns_have_the_values_of_the_messages(store: Any) -> None:
    random = np.random.default_rng(3)
    made = [drawn(store, random) for _ in range(20)]
    found = fields_of_objects(made, "own/msg/Everything", store.fielddefs)
    for name in ("flag", "small", "last"):
        assert found[name].tolist() == [getattr(each, name) for each in made]
    assert found["point.x"].tolist() == [each.point.x for each in made]
    # Texts are left out.
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
    made = [store.types["own/msg/Lists"]([], [])] * 2
    found = fields_of_objects(made, "own/msg/Lists", store.fielddefs)
    assert list(found["points"]) == ["x", "is_there"]
