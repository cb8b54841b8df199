"""The figure of a network shows the nodes and edges that were declared."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, Rectangle
from matplotlib.path import Path as Curve

from egolane_pgm.graphs.cpds import Table, bif, quiet
from egolane_pgm.types import InputError
from egolane_pgm.views.network import (
    Structure,
    network_figure,
    structure_of,
    write_network,
)
from tests.conformance.networks import random_network, template

PAPER = [("Lane", "DetectorOutput"), ("SensorState", "DetectorOutput"), ("SensorState", "WOR")]
PAPER_EVIDENCE = [("DetectorOutput", "DetectorOutput_ve"), ("WOR", "WOR_ve")]


def declared(
    within: list[tuple[str, str]], temporal: list[tuple[str, str]], **kinds: str
) -> Structure:
    """Nodes are hidden, observed where they have a `_ve` child, or of the kind that is given."""
    names = dict.fromkeys(name for edge in (*within, *temporal) for name in edge)
    observed = {parent for parent, child in within if child.endswith("_ve")}
    kind = {
        name: "virtual evidence"
        if name.endswith("_ve")
        else kinds.get(name, "observed" if name in observed else "hidden")
        for name in names
    }
    return Structure(kind, within, temporal)


def edges(network: Structure) -> list[tuple[tuple[str, int], tuple[str, int]]]:
    within = [((a, t), (b, t)) for t in (0, 1) for a, b in network.within]
    return [*within, *(((a, 0), (b, 1)) for a, b in network.across)]


def circles(figure: Figure) -> dict[tuple[str, int], Circle]:
    """Every node, as the circle around its shape."""
    drawn = {}
    for patch in figure.axes[0].patches:
        if str(patch.get_gid()).startswith("node "):
            _, name, time = str(patch.get_gid()).split()
            if isinstance(patch, Rectangle):
                patch = Circle(tuple(patch.get_center()), patch.get_width() / 2)
            assert isinstance(patch, Circle)
            drawn[name, int(time)] = patch
    return drawn


def arrows(figure: Figure) -> list[tuple[tuple[str, int], tuple[str, int]]]:
    drawn = []
    for patch in figure.axes[0].patches:
        if isinstance(patch, FancyArrowPatch):
            _, a, s, b, t = str(patch.get_gid()).split()
            drawn.append(((a, int(s)), (b, int(t))))
    return drawn


def labels(figure: Figure) -> Counter[str]:
    return Counter(text.get_text().replace("\n", "") for text in figure.axes[0].texts)


def paper() -> Structure:
    return declared(PAPER + PAPER_EVIDENCE, [("Lane", "Lane"), ("SensorState", "SensorState")])


def nodes(structure: Structure) -> set[tuple[str, int]]:
    return {(name, s) for name in structure.kind for s in (0, 1)}


def test_every_node_is_labelled_in_both_slices_and_every_edge_has_one_arrow() -> None:
    network = paper()
    figure = network_figure(network)
    shown = labels(figure)
    assert {name: shown[name] for name in network.kind} == dict.fromkeys(network.kind, 2)
    assert set(circles(figure)) == nodes(network)
    assert sorted(arrows(figure)) == sorted(edges(network))


def test_nodes_have_the_kinds_of_the_compiled_network() -> None:
    assert structure_of(template("sensor_failure", 3)).kind == paper().kind
    assert sorted(edges(structure_of(template("sensor_failure", 3)))) == sorted(edges(paper()))
    assert structure_of(template("position_in_lane", 3)).kind == {
        "LineMotion": "input",
        # Evidence about both does not make them observed: the belief is about them.
        "RoadPosition": "hidden",
        "SensorState": "hidden",
        "Lane": "function",
        "RoadPosition+SensorState_ve": "virtual evidence",
    }


WIDE = declared(
    [
        ("Position", "Lane"),
        ("Position", "Lines"),
        ("Lane", "Lines"),
        ("SensorState", "Lines"),
        ("SensorState", "WOR"),
        ("Lane", "WOR"),
        ("Lines", "Lines_ve"),
        ("WOR", "WOR_ve"),
        ("Motion", "Motion_ve"),
    ],
    [("Position", "Position"), ("SensorState", "SensorState"), ("Motion", "Position")],
    Position="input",
)


@pytest.mark.parametrize("network", [paper(), WIDE], ids=["paper", "wide"])
def test_children_are_below_their_parents_and_the_next_frame_to_the_right(
    network: Structure,
) -> None:
    drawn = circles(network_figure(network))
    for start, end in edges(network):
        (x0, y0), (x1, y1) = drawn[start].center, drawn[end].center
        assert y1 > y0 if start[1] == end[1] else x1 > x0
    for name, time in drawn:
        assert drawn[name, time].center[1] == drawn[name, 0].center[1]


@pytest.mark.parametrize(
    "network",
    [paper(), WIDE, *(structure_of(random_network(seed)[1]) for seed in (1, 5, 14))],
    ids=["paper", "wide", "random 1", "random 5", "random 14"],
)
def test_no_arrow_runs_through_a_node_and_no_two_nodes_touch(network: Structure) -> None:
    figure = network_figure(network)
    figure.draw_without_rendering()
    drawn = circles(figure)
    names = list(drawn)
    for i, a in enumerate(names):
        for b in names[:i]:
            (x0, y0), (x1, y1) = drawn[a].center, drawn[b].center
            gap = ((x0 - x1) ** 2 + (y0 - y1) ** 2) ** 0.5
            assert gap > drawn[a].radius + drawn[b].radius + 0.1
    to_data = figure.axes[0].transData.inverted()
    for patch in figure.axes[0].patches:
        if not isinstance(patch, FancyArrowPatch):
            continue
        _, start, s, end, t = str(patch.get_gid()).split()
        path = patch.get_transform().transform_path(patch.get_path())
        parts = [Curve(part) for part in path.to_polygons(closed_only=False)]
        drawn_at = np.concatenate([part.interpolated(20).vertices for part in parts])
        points = to_data.transform(drawn_at)
        for node, circle in drawn.items():
            if node not in ((start, int(s)), (end, int(t))):
                distance = ((points - circle.center) ** 2).sum(axis=1) ** 0.5
                assert distance.min() > circle.radius, (patch.get_gid(), node)


@pytest.mark.parametrize("name", ["sensor_failure", "autoregressive"])
def test_pgmpy_reads_the_network_from_a_bif_file(tmp_path: Path, name: str) -> None:
    compiled = template(name, 2)
    write_network(compiled, tmp_path / "network.bif")
    with quiet():
        from pgmpy.readwrite import BIFReader

        read = BIFReader(str(tmp_path / "network.bif")).get_model()
    assert set(read.nodes()) == {f"{n}_{s}" for n, s in compiled.tables}
    for (node, s), table in compiled.tables.items():
        cpd = read.get_cpds(f"{node}_{s}")
        assert cpd.variables == [f"{node}_{s}", *(f"{p}_{ps}" for p, ps in table.parents)]
        np.testing.assert_array_equal(np.moveaxis(cpd.values, 0, -1), table.values)
        assert tuple(cpd.state_names[f"{node}_{s}"]) == compiled.values[node]


def test_a_name_that_bif_does_not_allow_is_refused() -> None:
    tables = template("lane_only", 2).tables.values()
    for name in ("a,b", "a}", " a", 'say "a"', "a // b", ""):
        with pytest.raises(InputError, match="Lane_0: a BIF file cannot hold the value name"):
            bif(tables, {"Lane": ("1", name)})
    with pytest.raises(InputError, match=r"A\+B_0: a BIF file cannot hold this name of a node"):
        bif([Table(("A+B", 0), (), np.ones(1))], {})
