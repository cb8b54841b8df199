"""Lanes of a way of OpenStreetMap in each direction of travel, from its tags.

Keys and values: https://wiki.openstreetmap.org/wiki/Lanes.
"""

from __future__ import annotations

from functools import cache

#: Roads whose lanes are read, and the links between them.
KINDS = ("motorway", "motorway_link", "trunk", "trunk_link")

#: The tags that list the lanes of a direction.
LISTS = ("turn:lanes", "change:lanes", "width:lanes")

#: The keys whose values `read_lanes` takes, in order.
KEYS = (
    "highway",
    "oneway",
    "junction",
    "lanes",
    "lanes:forward",
    "lanes:backward",
    "lanes:both_ways",
    *(key + direction for key in LISTS for direction in ("", ":forward", ":backward")),
)

#: A greater number in one direction is a mistake; the widest toll plazas have about 25 lanes.
MOST_LANES = 30


@cache
def read_lanes(values: tuple[str | None, ...]) -> tuple[tuple[int, int], tuple[str, ...]]:
    """The lanes of a way forward and backward, and a line for each mistake in its tags.

    - values: of KEYS, None for a missing tag.

    A number of lanes is 0 if unknown, and -1 if there is no travel in that direction. A tag with a
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
        lanes = -1, _oneway(tags, ":backward", problems)
    else:
        lanes = _oneway(tags, ":forward", problems), -1
    return lanes, tuple(dict.fromkeys(problems))


def _oneway(tags: dict[str, str], direction: str, problems: list[str]) -> int:
    n_lanes = _count(tags, ["lanes", "lanes" + direction], problems)
    return _or_listed(tags, ("", direction), n_lanes, problems)


def _both_ways(tags: dict[str, str], problems: list[str]) -> tuple[int, int]:
    middle = _count(tags, ["lanes:both_ways"], problems)
    total = _count(tags, ["lanes"], problems)
    there, back = (_count(tags, ["lanes" + key], problems) for key in (":forward", ":backward"))
    if total and not there and not back:
        # Key:lanes of the wiki: an even number is half for each direction.
        share, odd = divmod(max(total - middle, 0), 2)
        there = back = 0 if odd else share
    elif total and not (there and back):
        rest = max(total - middle - there - back, 0)
        there, back = there or rest, back or rest
    return (
        _or_listed(tags, (":forward",), there, problems),
        _or_listed(tags, (":backward",), back, problems),
    )


def _count(tags: dict[str, str], keys: list[str], problems: list[str]) -> int:
    """A number of lanes; 0 without a valid one."""
    key = next((key for key in keys if key in tags), None)
    if key is None:
        return 0
    text = tags[key]
    if text.isdecimal() and 1 <= int(text) <= MOST_LANES:
        return int(text)
    # Zero lanes are valid in one direction and in the middle.
    if text != "0" or key == "lanes":
        problems.append(f"{key}={text} is not a number from 1 to {MOST_LANES}")
    return 0


def _or_listed(
    tags: dict[str, str], keys: tuple[str, ...], n_lanes: int, problems: list[str]
) -> int:
    """The number of lanes, or if unknown the length of the lists of lanes."""
    tagged = {name: [tags[name + key] for key in keys if name + key in tags] for name in LISTS}
    found = {name: texts[0].count("|") + 1 for name, texts in tagged.items() if texts}
    listed = {n for n in found.values() if n > 1}
    # After a mistake the number stays unknown.
    if n_lanes == 0 and len(listed) == 1 and max(listed) <= MOST_LANES and not problems:
        (n_lanes,) = listed
    problems += [
        f"{name} lists {n} lanes of {n_lanes}"
        for name, n in found.items()
        if n_lanes and n != n_lanes
    ]
    return n_lanes
