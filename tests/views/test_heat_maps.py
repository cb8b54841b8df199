"""Heat maps have the numbers of the tables, and no two of them overlap."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.views.heat_maps import tables_figure
from tests.conformance.networks import template
from tests.kits.drives import run
from tests.kits.tiny_result import texts


def test_each_table_is_drawn_with_its_numbers() -> None:
    compiled = template("sensor_failure", 3)
    *panels, bar = tables_figure(compiled).axes
    titles = [ax.get_title(loc="left") for ax in panels]
    assert titles == [
        "P(Lane), first frame",
        "P(Lane given Lane before)",
        "P(SensorState), first frame",
        "P(SensorState given SensorState before)",
        "P(DetectorOutput given SensorState, Lane)",
        "P(WOR given SensorState)",
    ]
    nodes = [("Lane", 0), ("Lane", 1), ("SensorState", 0), ("SensorState", 1)]
    for ax, node in zip(panels, [*nodes, ("DetectorOutput", 1), ("WOR", 1)], strict=True):
        values = compiled.tables[node].values
        flat = values.reshape(-1, values.shape[-1])
        np.testing.assert_array_equal(ax.images[0].get_array(), flat)
        assert [t.get_text() for t in ax.texts] == [f"{p:.3f}" for p in flat.ravel()]
        assert ax.get_xlabel() == node[0]
    rows = [label.get_text() for label in panels[4].get_yticklabels()]
    assert rows == ["0, 1", "0, 2", "0, 3", "1, 1", "1, 2", "1, 3"]
    assert bar.get_ylabel() == "probability "


@pytest.mark.parametrize(
    ("graph", "n_lanes", "n_drawn"),
    [
        ("sensor_failure", 2, 6),
        ("autoregressive", 8, 7),
        ("wor_on_lane", 4, 6),
        ("position_in_lane", 3, 4),
    ],
)
def test_no_two_tables_overlap(graph: str, n_lanes: int, n_drawn: int) -> None:
    figure = tables_figure(template(graph, n_lanes))
    figure.draw_without_rendering()
    boxes = [ax.get_tightbbox() for ax in figure.axes] + [figure.texts[0].get_window_extent()]
    assert len(boxes) == n_drawn + 2
    assert not [pair for pair in combinations(boxes, 2) if pair[0].overlaps(pair[1])]
    for box in boxes:
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1
    for ax in figure.axes[:-1]:
        values = ax.images[0].get_array()
        fits = values.shape[0] <= 32 and values.shape[1] <= 10
        assert len(ax.texts) == (values.size if fits else 0)


def test_a_table_that_is_too_long_is_named() -> None:
    compiled = template("position_in_lane", 4)
    note = texts(tables_figure(compiled))[0].splitlines()[1]
    size = compiled.tables["RoadPosition", 1].values.size
    name = "P(RoadPosition given RoadPosition before, LineMotion)"
    assert note == f"not drawn, {size:,} numbers: {name}"


def test_a_network_is_drawn_in_any_form() -> None:
    result = run("quickstart", {"recording.frames": [0, 9]})
    for draw in (ego.draw_tables, ego.draw_network):
        for form in (result, result.model, result.model.compiled):
            assert draw(form).axes
        with pytest.raises(ego.InputError, match="str is not a model"):
            draw("sensor_failure")  # type: ignore[arg-type]
