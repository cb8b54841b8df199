"""The search space: what is declared, narrowed, fixed; and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from egolane_pgm.contracts import Detector, Graph, Rule
from egolane_pgm.evidence import counting
from egolane_pgm.graphs import sensor_failure, wor_on_lane
from egolane_pgm.parameters import Parameter, not_searched, resolve_parameters
from egolane_pgm.plugins import load_plugin, plugin_names
from egolane_pgm.studies.space import (
    SearchSpace,
    make_space,
    to_parameters,
    to_point,
)
from egolane_pgm.types import InputError
from tests.kits.studies import points_at

CHOICE = Parameter("noise", "choice", "even", "", search=None, choices=("even", "ignore"))
SPECS = (*counting.PARAMETERS, *sensor_failure.PARAMETERS, CHOICE)
CURRENT = resolve_parameters(SPECS, {}, 3)


def space(**given: Any) -> SearchSpace:
    return make_space(SPECS, CURRENT, given, 3, "x.yaml: fit.parameters")


PAPER = {"sigma1", "sigma2", "p1", "p2", "p3", "p4"}

#: What a search of the package's plugins moves; studies and results were made with it.
SEARCHED: dict[str, set[str]] = {
    "lane_only": {"sigma1", "sigma2"},
    "no_wor": PAPER - {"p3", "p4"},
    "position_in_lane": {"motion_sigma", "motion_sigma_wide", "wide_share"} | {"p1", "p2"},
    "sensor_dynamics": PAPER | {"sigma1_bad"},
    "sensor_failure": PAPER,
    "wor_on_lane": PAPER,
    "counting": {"bonus_value"},
    "line_geometry": {"alpha", "beta"},
    **{key: set() for key in ("ml", "mc", "sl", "sc")},
}


@pytest.mark.parametrize("name", SEARCHED)
def test_what_is_searched_in_the_packages_plugins_stays_as_it_was(name: str) -> None:
    kinds: list[Any] = [k for k in (Graph, Rule, Detector) if name in plugin_names(k)]
    (module,) = [load_plugin(kind, name, "x") for kind in kinds]
    assert {spec.name for spec in module.parameters if spec.is_searched} == SEARCHED[name]


@pytest.mark.parametrize(
    ("kind", "default", "keys", "expected"),
    [
        ("probability", 0.95, {}, (0, 1)),
        ("probability", 0.95, {"lowest": 0.5}, (0.5, 1)),
        ("sigma", 0.35, {}, (0, 3)),
        ("sigma", 20.0, {}, (0, 200)),
        ("positive", 3.5, {}, (0.35, 35)),
        ("positive", 3.5, {"highest": 10}, (0.35, 10)),
        ("non_negative", 0, {}, (0, 1)),
        ("positive", (1.0, 2.0, 4.0), {"per_lane": True}, (0.1, 40)),
        ("integer", 3, {}, None),
        ("integer", 3, {"search": (1, 5)}, (1, 5)),
        ("choice", "a", {"choices": ("a", "b")}, None),
        ("positive", "auto", {"choices": ("auto",)}, None),
        ("probability", (0.5, 0.5), {"shape": lambda n: (2,)}, None),
    ],
)
def test_without_declared_bounds_a_parameter_is_searched_within_those_of_its_kind(
    kind: str, default: Any, keys: dict[str, Any], expected: tuple[float, float] | None
) -> None:
    spec = Parameter("x", kind, default, "a number", **keys)
    assert spec.search_range == (expected and pytest.approx(expected))
    assert spec.is_searched == (expected is not None)
    (kept,) = not_searched([spec])
    assert not kept.is_searched
    assert kept.search_range == spec.search_range or spec.search != "auto"


def test_a_graph_of_ones_own_is_searched_without_saying_so() -> None:
    specs = [
        Parameter("stay", "probability", 0.95, "a probability"),
        Parameter("width", "positive", 2, "a width"),
        Parameter("p3", "probability", 0.6, "by lane", per_lane=True),
        Parameter("kept", "positive", 2.0, "not searched", search=None),
    ]
    found = make_space(specs, resolve_parameters(specs, {}, 3), {}, 3, "x")
    assert tuple(found.distributions) == ("stay", "width", "p3[1]", "p3[2]", "p3[3]")
    assert found.fixed == {"kept": 2.0}
    width = found.distributions["width"]
    assert (width.low, width.high, width.log) == (0.2, 20, True)  # type: ignore[attr-defined]
    middle = points_at(found, np.full((1, 5), 0.5))[0]
    assert middle["width"] == pytest.approx(2)
    given = make_space(specs, resolve_parameters(specs, {}, 3), {"width": [1, 3]}, 3, "x")
    assert not given.distributions["width"].log  # type: ignore[attr-defined]


def test_the_lanes_of_a_parameter_keep_their_order_there_and_back() -> None:
    specs = (*counting.PARAMETERS, *wor_on_lane.PARAMETERS)
    current = resolve_parameters(specs, {}, 3)
    found = make_space(specs, current, {}, 3, "x")
    mine = {**current, "p3": (0.2, 0.4, 0.6)}
    point = to_point(found, mine)
    assert point is not None
    assert [point[f"p3[{lane}]"] for lane in (1, 2, 3)] == [0.2, 0.4, 0.6]
    assert to_parameters(found, point)["p3"] == (0.2, 0.4, 0.6)
    fixed = make_space(specs, current, {"p3": [0.2, 0.4, 0.6]}, 3, "x")
    assert fixed.fixed["p3"] == (0.2, 0.4, 0.6)
    assert not any(key.startswith("p3") for key in fixed.distributions)
    narrow = make_space(specs, current, {"p3": [0.2, 0.4]}, 3, "x")
    assert [narrow.distributions[f"p3[{k}]"].high for k in (1, 2, 3)] == [0.4] * 3  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sigma_1": [0, 1]}, "unknown parameter 'sigma_1' \\(did you mean 'sigma1'\\?\\)"),
        ({"sigma1": [1, 1]}, "sigma1: .* is empty"),
        ({"sigma1": [2, 1]}, "sigma1: .* is empty"),
        ({"p1": [0.5, 1.5]}, "p1: 1.5 is not a probability"),
        ({"sigma1": [-1, 1]}, "sigma1: -1 must be greater than 0"),
        ({"p1": [0.1, 0.2, 0.3]}, "p1: .* must be \\[low, high\\]"),
        ({"p1": ["a", "b"]}, "p1: 'a' is not a number"),
        ({"bonus_value": [0.5, 3]}, "bonus_value: .* whole numbers"),
        ({"noise": ["ignore"]}, "noise: .* leaves nothing to search"),
        ({"noise": ["ignore", "ignor"]}, "did you mean 'ignore'"),
        (dict.fromkeys(("sigma1", "sigma2", "p1", "p2", "p3", "p4", "bonus_value"), 0.5), "to"),
    ],
)
def test_bounds_that_make_no_sense_are_refused_with_their_name(
    given: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message) as caught:
        space(**given)
    assert str(caught.value).startswith("x.yaml: fit.parameters")
    assert "\n" not in str(caught.value)


def test_a_point_outside_of_the_bounds_is_none() -> None:
    parameters = {**CURRENT, "sigma1": 2.0}
    assert to_point(space(), parameters) is not None
    assert to_point(space(sigma1=[0.1, 1.0]), parameters) is None
    assert to_point(space(), {**CURRENT, "bonus_value": 2.5}) is None
    names = space(noise=["even", "ignore"])
    assert to_point(names, {**CURRENT, "noise": "ignore"}) is not None
    assert to_point(names, {**CURRENT, "noise": "neither"}) is None
