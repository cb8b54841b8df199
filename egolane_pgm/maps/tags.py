"""Reads from the tags of one way of OpenStreetMap its lanes, in each direction of travel.

Keys and values are those of https://wiki.openstreetmap.org/wiki/Lanes and of
https://wiki.openstreetmap.org/wiki/Key:placement. Lane by lane they count from the left in the
direction of travel.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

#: Roads whose lanes are read, and the links between them.
KINDS = ("motorway", "motorway_link", "trunk", "trunk_link")

#: Every key that is read, in the order in which `directions` takes their values.
KEYS = (
    "highway",
    "oneway",
    "junction",
    "lanes",
    "lanes:forward",
    "lanes:backward",
    "lanes:both_ways",
    *(
        key + direction
        for key in ("placement", "turn:lanes", "change:lanes", "width:lanes")
        for direction in ("", ":forward", ":backward")
    ),
    "placement:start",
    "placement:end",
)

#: More lanes than this in one direction are a typing error; the widest toll plazas have about 25.
MOST_LANES = 30

_PLACE = re.compile(r"(left|middle|right)_of:(\d+)")
_SHARE = {"left": -1.0, "middle": -0.5, "right": 0.0}


@dataclass(frozen=True)
class Direction:
    """One direction of travel of a way.

    - is_backward: against the direction in which the way is drawn.
    - n_lanes: 0 where unknown.
    - placement: lanes from the left edge to the way's line, where one enters and where one leaves;
      NaN unknown.
    - is_placed: whether a tag says so; otherwise the line is taken to be in the middle.
    - turn, change, width: the tags `turn:lanes`, `change:lanes`, `width:lanes`; "" without.
    """

    is_backward: bool
    n_lanes: int
    placement: tuple[float, float]
    is_placed: bool
    turn: str
    change: str
    width: str


def directions(
    values: tuple[str | None, ...], drives_left: bool = False
) -> tuple[tuple[Direction, ...], tuple[str, ...]]:
    """The directions in which a way is driven, and a line for each mistake in its tags.

    - values: of KEYS, None where the way has no such tag.
    - drives_left: traffic keeps to the left, so that the lanes against the way's direction lie at
      the right of the others.

    A tag with a mistake is left out: a number of lanes is then unknown (0), and so is a placement
    (NaN). Nothing is raised.
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
        ways = _both_ways(tags, drives_left, problems)
    return ways, tuple(dict.fromkeys(problems))


def _oneway(tags: dict[str, str], is_backward: bool, problems: list[str]) -> Direction:
    keys = ("", ":backward" if is_backward else ":forward")
    n_lanes = _count(tags, ["lanes" + key for key in keys], problems)
    n_lanes, by_lane = _by_lane(tags, keys, n_lanes, problems)
    placement = _first(tags, ["placement" + key for key in keys])
    ends = [tags.get(f"placement:{end}", placement) for end in ("start", "end")]
    places = [_place(text, n_lanes, n_lanes / 2, problems) for text in ends]
    if is_backward:
        places.reverse()
    return Direction(is_backward, n_lanes, (places[0], places[1]), any(ends), *by_lane)


def _both_ways(
    tags: dict[str, str], drives_left: bool, problems: list[str]
) -> tuple[Direction, ...]:
    middle = _count(tags, ["lanes:both_ways"], problems)
    total = _count(tags, ["lanes"], problems)
    number = [_count(tags, ["lanes" + key], problems) for key in (":forward", ":backward")]
    if total and not any(number):
        # As the wiki's Key:lanes has it, an even number is half for each direction.
        share, odd = divmod(max(total - middle, 0), 2)
        number = [0, 0] if odd else [share, share]
    elif total and not all(number):
        number = [max(total - middle - sum(number), 0) if n == 0 else n for n in number]
    ways = []
    for n, key in zip(number, (":forward", ":backward"), strict=True):
        n_lanes, by_lane = _by_lane(tags, (key,), n, problems)
        ways.append((n_lanes, tags.get("placement" + key, ""), by_lane))
    (n_forward, *_), (n_backward, *_) = ways
    # The lines of both directions are one line, so that one's place gives the other's: with traffic
    # at the right the lanes of both lie at the right of what divides them.
    between = n_forward + n_backward + middle if drives_left else -middle
    known = bool(n_forward and n_backward)
    half = (n_forward + n_backward + middle) / 2
    default = half if drives_left else half - n_backward - middle
    forward = _place(ways[0][1], n_forward, math.nan, problems)
    backward = _place(ways[1][1], n_backward, math.nan, problems)
    is_placed = bool(ways[0][1] or ways[1][1])
    if known and not is_placed:
        forward, backward = default, between - default
    elif known and not ways[1][1]:
        backward = between - forward
    elif known and not ways[0][1]:
        forward = between - backward
    return tuple(
        Direction(is_backward, n_lanes, (place, place), is_placed, *by_lane)
        for is_backward, place, (n_lanes, _, by_lane) in zip(
            (False, True), (forward, backward), ways, strict=True
        )
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


def _by_lane(
    tags: dict[str, str], keys: tuple[str, ...], n_lanes: int, problems: list[str]
) -> tuple[int, tuple[str, str, str]]:
    """The number of lanes, by default that of the tags that list lanes; and these tags, "" where
    they list another number."""
    names = ("turn:lanes", "change:lanes", "width:lanes")
    found = {name: _first(tags, [name + key for key in keys]) for name in names}
    listed = [text.count("|") + 1 for text in found.values() if "|" in text]
    if n_lanes == 0 and listed and len(set(listed)) == 1 and listed[0] <= MOST_LANES:
        # A number that is wrong stays unknown: nobody knows which of both was meant.
        n_lanes = 0 if problems else listed[0]
    for name, text in found.items():
        if text and n_lanes and text.count("|") + 1 != n_lanes:
            problems.append(f"{name} lists {text.count('|') + 1} lanes of {n_lanes}, it is ignored")
            found[name] = ""
    return n_lanes, (found["turn:lanes"], found["change:lanes"], found["width:lanes"])


def _place(text: str, n_lanes: int, otherwise: float, problems: list[str]) -> float:
    """Lanes from the left edge to the way's line: k for right_of:k, k - 1 for left_of:k, k - 1/2
    for middle_of:k."""
    if not text:
        return otherwise if n_lanes else math.nan
    if text == "transition":
        return math.nan
    match = _PLACE.fullmatch(text)
    if match is None or not 1 <= int(match[2]) <= (n_lanes or MOST_LANES):
        what = f"of {n_lanes} lanes " if n_lanes else ""
        problems.append(f"placement={text} {what}is no place, it is ignored")
        return math.nan
    return int(match[2]) + _SHARE[match[1]]
