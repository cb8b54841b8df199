"""The figure of a network shows the nodes and edges that were declared."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch
from matplotlib.path import Path as Curve

from egolane_pgm.report.network import draw_network, network_figure
from egolane_pgm.types import InputError

PAPER = [("Lane", "DetectorOutput"), ("SensorState", "DetectorOutput"), ("SensorState", "WOR")]
PAPER_EVIDENCE = [("DetectorOutput", "DetectorOutput_ve"), ("WOR", "WOR_ve")]


class Declared:
    """The two methods of a pgmpy network that the drawing needs."""

    def __init__(self, within: list[tuple[str, str]], temporal: list[tuple[str, str]]) -> None:
        self._edges = [((a, t), (b, t)) for t in (0, 1) for a, b in within]
        self._edges += [((a, 0), (b, 1)) for a, b in temporal]

    def nodes(self) -> list[tuple[str, int]]:
        return list(dict.fromkeys(node for edge in self._edges for node in edge))

    def edges(self) -> list[tuple[tuple[str, int], tuple[str, int]]]:
        return self._edges


def circles(figure: Figure) -> dict[tuple[str, int], Circle]:
    drawn = {}
    for patch in figure.axes[0].patches:
        if isinstance(patch, Circle) and patch.get_gid():
            _, name, time = str(patch.get_gid()).split()
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


def paper() -> Declared:
    return Declared(PAPER + PAPER_EVIDENCE, [("Lane", "Lane"), ("SensorState", "SensorState")])


def test_every_node_is_labelled_in_both_slices_and_every_edge_has_one_arrow() -> None:
    network = paper()
    figure = network_figure(network)
    names = {name for name, _ in network.nodes()}
    shown = labels(figure)
    assert {name: shown[name] for name in names} == dict.fromkeys(names, 2)
    assert set(circles(figure)) == set(network.nodes())
    assert sorted(arrows(figure)) == sorted(network.edges())


def test_a_pgmpy_network_is_drawn_edge_for_edge() -> None:
    from pgmpy.models import DynamicBayesianNetwork

    network = DynamicBayesianNetwork()
    network.add_edges_from([((a, 0), (b, 0)) for a, b in PAPER + PAPER_EVIDENCE])
    network.add_edges_from([((a, 0), (a, 1)) for a in ("Lane", "SensorState")])
    assert sorted(arrows(network_figure(network))) == sorted(paper().edges())


def test_hidden_observed_and_evidence_nodes_look_different() -> None:
    figure = network_figure(paper())
    drawn = circles(figure)
    face = {name: to_hex(drawn[name, 0].get_facecolor()) for name, t in drawn if t == 0}
    assert face["Lane"] == face["SensorState"] == "#ffffff"
    assert face["DetectorOutput"] == face["WOR"] != face["Lane"]
    assert face["WOR_ve"] not in (face["WOR"], face["Lane"])
    assert drawn["WOR_ve", 0].radius < drawn["WOR", 0].radius / 2
    outlines = Counter(
        patch.center for patch in figure.axes[0].patches if isinstance(patch, Circle)
    )
    assert outlines[drawn["WOR", 1].center] == 2
    assert outlines[drawn["Lane", 1].center] == 1


def test_evidence_on_two_nodes_jointly_makes_both_observed() -> None:
    network = Declared(
        [("Lane", "A"), ("Lane", "B"), ("A", "A_and_B_ve"), ("B", "A_and_B_ve")],
        [("Lane", "Lane")],
    )
    drawn = circles(network_figure(network))
    assert drawn["A", 0].get_facecolor() == drawn["B", 0].get_facecolor()
    assert drawn["A", 0].get_facecolor() != drawn["Lane", 0].get_facecolor()


WIDE = Declared(
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
)


@pytest.mark.parametrize("network", [paper(), WIDE], ids=["paper", "wide"])
def test_children_are_below_their_parents_and_the_next_frame_to_the_right(
    network: Declared,
) -> None:
    drawn = circles(network_figure(network))
    for start, end in network.edges():
        (x0, y0), (x1, y1) = drawn[start].center, drawn[end].center
        assert y1 < y0 if start[1] == end[1] else x1 > x0
    for name, time in drawn:
        assert drawn[name, time].center[1] == drawn[name, 0].center[1]


@pytest.mark.parametrize("network", [paper(), WIDE], ids=["paper", "wide"])
def test_no_arrow_runs_through_a_node_and_no_two_nodes_touch(network: Declared) -> None:
    figure = network_figure(network)
    figure.draw_without_rendering()
    drawn = circles(figure)
    nodes = list(drawn)
    for i, a in enumerate(nodes):
        for b in nodes[:i]:
            (x0, y0), (x1, y1) = drawn[a].center, drawn[b].center
            gap = ((x0 - x1) ** 2 + (y0 - y1) ** 2) ** 0.5
            assert gap > drawn[a].radius + drawn[b].radius + 0.1
    to_data = figure.axes[0].transData.inverted()
    for patch in figure.axes[0].patches:
        if not isinstance(patch, FancyArrowPatch):
            continue
        _, a, s, b, t = str(patch.get_gid()).split()
        path = patch.get_transform().transform_path(patch.get_path())
        parts = [Curve(part) for part in path.to_polygons(closed_only=False)]
        drawn_at = np.concatenate([part.interpolated(20).vertices for part in parts])
        points = to_data.transform(drawn_at)
        for node, circle in drawn.items():
            if node not in ((a, int(s)), (b, int(t))):
                distance = ((points - circle.center) ** 2).sum(axis=1) ** 0.5
                assert distance.min() > circle.radius, (patch.get_gid(), node)


@pytest.mark.parametrize(
    ("suffix", "begins"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")]
)
def test_the_extension_chooses_the_format(tmp_path: Path, suffix: str, begins: bytes) -> None:
    path = tmp_path / f"network{suffix}"
    draw_network(paper(), path)
    assert path.read_bytes().startswith(begins)


def test_another_extension_is_refused_and_nothing_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"network\.jpg: a figure ends in \.png, \.svg, \.pdf"):
        draw_network(paper(), tmp_path / "network.jpg")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("network", "message"),
    [
        (Declared([], []), "it has no nodes"),
        (Declared([("A", "B"), ("B", "A")], []), "form a cycle"),
    ],
)
def test_what_cannot_be_drawn_is_refused(network: Declared, message: str) -> None:
    with pytest.raises(InputError, match=message):
        network_figure(network)


def test_a_third_slice_is_refused() -> None:
    network = paper()
    network._edges.append((("Lane", 1), ("Lane", 2)))
    with pytest.raises(InputError, match="node Lane is in slice 2"):
        network_figure(network)
