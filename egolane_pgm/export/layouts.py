"""Layouts, with which Foxglove and PlotJuggler show an exported drive at once."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as xml

from egolane_pgm.export.drive import Drive
from egolane_pgm.tools.files import write_text

#: The program that a layout is for, by its file's extension.
LAYOUTS = {".json": "Foxglove", ".xml": "PlotJuggler"}


def write_layout(path: Path, drive: Drive) -> None:
    """Write the layout of a drive, by extension (`LAYOUTS`). Raises InputError where it cannot be
    written."""
    made = foxglove_layout if path.suffix.lower() == ".json" else plotjuggler_layout
    write_text(path, made(drive))


def _plots(drive: Drive) -> dict[str, list[tuple[str, str]]]:
    """The plots, from above: the topic and the key of each curve."""
    plots = {
        f"belief: {node}": [("belief", f"{node}_{name}") for name in names]
        for node, (names, _) in drive.beliefs().items()
    }
    plots["lanes"] = [("lanes", name) for name in drive.lane_curves()]
    return plots


def foxglove_layout(drive: Drive) -> str:
    """The JSON of a layout: what is seen on the left, what was believed on the right."""
    seen = {
        "3D!birdseye": {
            "followTf": "car",
            "topics": {"/birdseye": {"visible": True}},
            "cameraState": {
                "perspective": True,
                "distance": 45.0,
                "phi": 50.0,
                "thetaOffset": 90.0,
                "targetOffset": [8.0, 0.0, 0.0],
                "target": [0.0, 0.0, 0.0],
                "targetOrientation": [0.0, 0.0, 0.0, 1.0],
                "fovy": 45.0,
                "near": 0.5,
                "far": 5000.0,
            },
        }
    }
    if drive.pictures is not None:
        seen["Image!picture"] = {"imageMode": {"imageTopic": "/picture"}}
    believed: dict[str, Any] = {
        f"Plot!{k}": {
            "title": title,
            "paths": [
                {
                    "value": f"/{topic}.{key}",
                    "label": key,
                    "enabled": True,
                    "timestampMethod": "receiveTime",
                }
                for topic, key in curves
            ],
            "showLegend": True,
            "isSynced": True,
            "xAxisVal": "timestamp",
        }
        for k, (title, curves) in enumerate(_plots(drive).items())
    }
    believed["RosOut!changes"] = {"topicToRender": "/changes"}
    return (
        json.dumps(
            {
                "configById": seen | believed,
                "globalVariables": {},
                "userNodes": {},
                "playbackConfig": {"speed": 1},
                "layout": {
                    "direction": "row",
                    "first": _column(list(seen)),
                    "second": _column(list(believed)),
                },
            },
            indent=2,
        )
        + "\n"
    )


def _column(panels: list[str]) -> Any:
    if len(panels) == 1:
        return panels[0]
    share = 100 / len(panels)
    return {
        "direction": "column",
        "first": panels[0],
        "second": _column(panels[1:]),
        "splitPercentage": round(share, 1),
    }


def plotjuggler_layout(drive: Drive) -> str:
    """The XML of a layout: a plot below the other."""
    plots = _plots(drive)
    root = xml.Element("root")
    tabs = xml.SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    tab = xml.SubElement(tabs, "Tab", tab_name="drive", containers="1")
    share = ";".join([f"{1 / len(plots):.4f}"] * len(plots))
    split = xml.SubElement(
        xml.SubElement(tab, "Container"),
        "DockSplitter", orientation="-", count=str(len(plots)), sizes=share,
    )  # fmt: skip
    for title, curves in plots.items():
        area = xml.SubElement(split, "DockArea", name=title)
        plot = xml.SubElement(area, "plot", mode="TimeSeries", style="Lines")
        for topic, key in curves:
            xml.SubElement(plot, "curve", name=f"/{topic}/{key}")
    xml.SubElement(tabs, "currentTabIndex", index="0")
    xml.SubElement(root, "use_relative_time_offset", enabled="1")
    xml.indent(root)
    return (
        "<?xml version='1.0' encoding='UTF-8'?>\n" + xml.tostring(root, encoding="unicode") + "\n"
    )
