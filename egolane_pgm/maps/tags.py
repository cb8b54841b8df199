"""Lanes of a way of OpenStreetMap in each direction of travel, from its tags.

Keys and values: https://wiki.openstreetmap.org/wiki/Lanes.
"""

from __future__ import annotations

from functools import cache

#: Roads whose lanes are read, and the links between them.
KINDS = ("motorway", "motorway_link", "trunk", "trunk_link")

#: The keys whose values `read_lanes` takes, in order.
KEYS = (
    "highway",
    "oneway",
    "junction",
    "lanes",
    "lanes:forward",
    "lanes:backward",
)

#: A greater number in one direction is a mistake; the widest toll plazas have about 25 lanes.
MOST_LANES = 30


@cache
def read_lanes(values: tuple[str | None, ...]) -> tuple[tuple[int, int], tuple[str, ...]]:
    """The lanes of a way forward and backward, and a line for each mistake in its tags.

    - values: of KEYS, None for a missing tag.

    A number of lanes is 0 if unknown, and -1 for a direction that is not travelled. A tag with a
    mistake is ignored.
    """
    tags = {key: value.strip() for key, value in zip(KEYS, values, strict=True) if value}
    problems: list[str] = []
    oneway = tags.get("oneway", "")
    # By default a motorway is a oneway, and so is a link without lanes against it.
    is_oneway = oneway in ("yes", "true", "1", "-1", "reverse") or (
        oneway == ""
        and (
            tags["highway"] == "motorway"
            or tags.get("junction") in ("roundabout", "circular")
            or (tags["highway"] == "motorway_link" and "lanes:backward" not in tags)
        )
    )
    if oneway in ("reversible", "alternating"):
        # The direction changes with the time of day.
        lanes = 0, 0
    elif not is_oneway:
        lanes = _both_ways(tags, problems)
    elif oneway in ("-1", "reverse"):
        lanes = -1, _count(tags, ["lanes", "lanes:backward"], problems)
    else:
        lanes = _count(tags, ["lanes", "lanes:forward"], problems), -1
    return lanes, tuple(dict.fromkeys(problems))


def _both_ways(tags: dict[str, str], problems: list[str]) -> tuple[int, int]:
    total = _count(tags, ["lanes"], problems)
    there, back = (_count(tags, ["lanes" + key], problems) for key in (":forward", ":backward"))
    if total and not there and not back:
        # Key:lanes of the wiki: an even number is half for each direction.
        share, odd = divmod(total, 2)
        there = back = 0 if odd else share
    elif total and not (there and back):
        rest = max(total - there - back, 0)
        there = there or rest
        back = back or rest
    return there, back


def _count(tags: dict[str, str], keys: list[str], problems: list[str]) -> int:
    """Return a number of lanes; 0 if there is no valid tag."""
    key = next((key for key in keys if key in tags), None)
    if key is None:
        return 0
    text = tags[key]
    if text.isdecimal() and 1 <= int(text) <= MOST_LANES:
        return int(text)
    # Zero lanes are valid in one direction.
    if text != "0" or key == "lanes":
        problems.append(f"{key}={text} is not a number from 1 to {MOST_LANES}")
    return 0
