"""Reads from the tags of one way of OpenStreetMap its lanes, in each direction of travel.

Keys and values are those of https://wiki.openstreetmap.org/wiki/Lanes.
"""

from __future__ import annotations

from dataclasses import dataclass

#: Roads whose lanes are read, and the links between them.
KINDS = ("motorway", "motorway_link", "trunk", "trunk_link")

#: The tags that list the lanes of a direction, which tell their number too.
LISTS = ("turn:lanes", "change:lanes", "width:lanes")

#: Every key that is read, in the order in which `directions` takes their values.
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

#: More lanes than this in one direction are a typing error; the widest toll plazas have about 25.
MOST_LANES = 30


@dataclass(frozen=True)
class Direction:
    """One direction of travel of a way.

    - is_backward: against the direction in which the way is drawn.
    - n_lanes: 0 where unknown.
    """

    is_backward: bool
    n_lanes: int


def directions(
    values: tuple[str | None, ...],
) -> tuple[tuple[Direction, ...], tuple[str, ...]]:
    """The directions in which a way is driven, and a line for each mistake in its tags.

    - values: of KEYS, None where the way has no such tag.

    A tag with a mistake is left out: a number of lanes is then unknown (0). Nothing is raised.
    """
    tags = {key: value.strip() for key, value in zip(KEYS, values, strict=True) if value}
    problems: list[str] = []
    oneway = tags.get("oneway", "")
    # A motorway is a oneway where nothing is said, and so is a link without lanes against it.
    is_oneway = oneway in ("yes", "true", "1", "-1", "reverse") or (
        oneway == ""
        and (
            tags["highway"] == "motorway"
            or tags.get("junction") in ("roundabout", "circular")
            or (tags["highway"] == "motorway_link" and "lanes:backward" not in tags)
        )
    )
    if is_oneway:
        ways: tuple[Direction, ...] = (_oneway(tags, oneway in ("-1", "reverse"), problems),)
    else:
        ways = _both_ways(tags, problems)
    return ways, tuple(dict.fromkeys(problems))


def _oneway(tags: dict[str, str], is_backward: bool, problems: list[str]) -> Direction:
    keys = ("", ":backward" if is_backward else ":forward")
    n_lanes = _count(tags, ["lanes" + key for key in keys], problems)
    return Direction(is_backward, _or_listed(tags, keys, n_lanes, problems))


def _both_ways(tags: dict[str, str], problems: list[str]) -> tuple[Direction, ...]:
    middle = _count(tags, ["lanes:both_ways"], problems)
    total = _count(tags, ["lanes"], problems)
    number = [_count(tags, ["lanes" + key], problems) for key in (":forward", ":backward")]
    if total and not any(number):
        # As the wiki's Key:lanes has it, an even number is half for each direction.
        share, odd = divmod(max(total - middle, 0), 2)
        number = [0, 0] if odd else [share, share]
    elif total and not all(number):
        number = [max(total - middle - sum(number), 0) if n == 0 else n for n in number]
    return tuple(
        Direction(bool(k), _or_listed(tags, (key,), number[k], problems))
        for k, key in enumerate((":forward", ":backward"))
    )


def _first(tags: dict[str, str], keys: list[str]) -> str:
    """The value of the first of the keys that is there, or ""."""
    return next((tags[key] for key in keys if key in tags), "")


def _count(tags: dict[str, str], keys: list[str], problems: list[str]) -> int:
    """A number of lanes; 0 where it is not said, or is no number that a road can have."""
    key = next((key for key in keys if key in tags), None)
    if key is None:
        return 0
    text = tags[key]
    if text.isdecimal() and 1 <= int(text) <= MOST_LANES:
        return int(text)
    # A road may well have no lanes in one direction or in the middle.
    if text != "0" or key == "lanes":
        problems.append(f"{key}={text} is no number from 1 to {MOST_LANES}, the lanes are unknown")
    return 0


def _or_listed(
    tags: dict[str, str], keys: tuple[str, ...], n_lanes: int, problems: list[str]
) -> int:
    """The number of lanes, by default that of the tags that list lanes."""
    found = {name: _first(tags, [name + key for key in keys]) for name in LISTS}
    listed = [text.count("|") + 1 for text in found.values() if "|" in text]
    if n_lanes == 0 and listed and len(set(listed)) == 1 and listed[0] <= MOST_LANES:
        # A number that is wrong stays unknown: nobody knows which of both was meant.
        n_lanes = 0 if problems else listed[0]
    for name, text in found.items():
        if text and n_lanes and text.count("|") + 1 != n_lanes:
            problems.append(f"{name} lists {text.count('|') + 1} lanes of {n_lanes}, it is ignored")
    return n_lanes
