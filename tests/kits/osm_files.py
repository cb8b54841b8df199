"""Small files of OpenStreetMap: roads that are drawn in metres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

#: Where the roads lie, and metres of a degree there (roughly).
LATITUDE, LONGITUDE, NORTH_M, EAST_M = 51.0, 14.0, 111_257.0, 70_200.0

Way = tuple[int, Sequence[int], Mapping[str, object]]


def write_osm(
    path: Path, nodes: Mapping[int, tuple[float, float] | None], ways: Sequence[Way]
) -> Path:
    """Write an extract.

    - nodes: id: metres to the east and to the north, or None for a node without coordinates.
    - ways: id, its nodes, its tags.
    """
    root = ElementTree.Element("osm", version="0.6")
    for number, place in nodes.items():
        given = {"id": str(number)}
        if place is not None:
            given["lat"] = f"{LATITUDE + place[1] / NORTH_M:.7f}"
            given["lon"] = f"{LONGITUDE + place[0] / EAST_M:.7f}"
        ElementTree.SubElement(root, "node", given)
    for number, line, tags in ways:
        way = ElementTree.SubElement(root, "way", id=str(number))
        for node in line:
            ElementTree.SubElement(way, "nd", ref=str(node))
        for key, value in tags.items():
            ElementTree.SubElement(way, "tag", k=key, v=str(value))
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    return path
