"""The search space: a distribution per number, within the bounds that graph and evidence rule
declare and the YAML narrows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from optuna.distributions import (
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from egolane_pgm.parameters import Parameter, Value
from egolane_pgm.types import InputError, suggestion

#: An open end of a range, (0, 3] or (0, 1), begins this far inside, as a share of the range.
OPEN_END = 1e-6

#: A point of the space: a value per dimension, by key.
Point = Mapping[str, float | int | str]


@dataclass(frozen=True)
class SearchSpace:
    """D dimensions, and the values of all other parameters.

    - distributions: as Optuna takes them, a number from low to high, both included, or choices. The
      key is the name of the parameter, or `p3[2]` for the value of lane 2 of a parameter with one
      value per lane.
    - fixed: the other parameters, by name.
    """

    distributions: dict[str, Any]
    fixed: Mapping[str, Value]


def make_space(
    specs: Sequence[Parameter],
    current: Mapping[str, Value],
    given: Mapping[str, Any],
    n_lanes: int,
    where: str,
) -> SearchSpace:
    """Make the search space of the declared parameters.

    - specs: the parameters; those without `is_searched` need bounds in `given` to be searched.
    - current: the value of every parameter, kept unless it is searched.
    - given: by name [low, high], names of a choice, or one value to keep instead.
    - where: the beginning of a message, e.g. the YAML and the key.

    Raises InputError (`<where>.<name>: ...`) for unknown names, for bounds that are empty, inverted
    or not allowed for the parameter's kind, and for a space without dimensions.
    """
    known = {spec.name: spec for spec in specs}
    dimensions: dict[str, Any] = {}
    fixed: dict[str, Value] = {}
    for name in given:
        if name not in known:
            hint = suggestion(str(name), known)
            raise InputError(f"{where}: unknown parameter '{name}'{hint}")
    for name, spec in known.items():
        here = f"{where}.{name}"
        bounds = given.get(name, spec.search_range if spec.is_searched else None)
        is_list = isinstance(bounds, (list, tuple))
        if name in given and (not is_list or (spec.per_lane and len(bounds) != 2)):
            fixed[name] = spec.check(bounds, n_lanes, here)
        elif bounds is None:
            fixed[name] = current[name]
        elif spec.kind == "choice":
            dimensions[name] = _choices(spec, bounds, n_lanes, here)
        else:
            found = _range(spec, bounds, name in given, n_lanes, here)
            # A parameter that is searched only because of its bounds in the YAML moves all lanes.
            is_split = spec.per_lane and spec.is_searched
            keys = [f"{name}[{lane}]" for lane in range(1, n_lanes + 1)] if is_split else [name]
            dimensions |= dict.fromkeys(keys, found)
    if not dimensions:
        raise InputError(f"{where}: every parameter is fixed, there is nothing to search")
    return SearchSpace(dimensions, fixed)


def _choices(
    spec: Parameter, names: Sequence[Any], n_lanes: int, where: str
) -> CategoricalDistribution:
    chosen = tuple(str(spec.check(name, n_lanes, where)) for name in names)
    if len(set(chosen)) < 2:
        raise InputError(
            f"{where}: {list(names)} leaves nothing to search; give one name to fix it"
        )
    return CategoricalDistribution(chosen)


def _range(
    spec: Parameter, bounds: Sequence[Any], is_given: bool, n_lanes: int, where: str
) -> IntDistribution | FloatDistribution:
    """The range of a parameter's numbers. is_given: the bounds are from the YAML."""
    if len(bounds) != 2:
        raise InputError(f"{where}: {list(bounds)} must be [low, high], or one value to fix it")
    is_open_below = spec.kind in ("sigma", "positive", "probability") and bounds[0] == 0
    is_open_above = spec.kind == "probability" and bounds[1] == 1
    low: Any = 0.0 if is_open_below else spec.check(bounds[0], n_lanes, where)
    high: Any = spec.check(bounds[1], n_lanes, where)
    if low >= high:
        raise InputError(f"{where}: [{low}, {high}] is empty; write one value to fix it")
    margin = OPEN_END * (high - low)
    low, high = low + margin * is_open_below, high - margin * is_open_above
    # Whole numbers are searched if the kind, or default and bounds, are declared as whole.
    declared = (0.5,) if spec.search in ("auto", None) else spec.search_range or ()
    if spec.kind == "integer" or all(isinstance(v, int) for v in (spec.default, *declared)):
        if low != int(low) or high != int(high):
            raise InputError(f"{where}: [{low}, {high}] must be whole numbers")
        return IntDistribution(int(low), int(high))
    # The bounds of these are a tenth of the default and ten times it.
    is_tenfold = spec.search == "auto" and spec.kind in ("positive", "non_negative")
    return FloatDistribution(low, high, log=not is_given and is_tenfold and low > 0)


def to_parameters(space: SearchSpace, point: Point) -> dict[str, Value]:
    """Every declared parameter's value at a point."""
    values: dict[str, Value] = dict(space.fixed)
    lanes: dict[str, list[float]] = {}
    for key in space.distributions:
        name, bracket, _ = key.partition("[")
        if bracket:
            lanes.setdefault(name, []).append(float(point[key]))
        else:
            values[name] = point[key]
    return values | {name: tuple(numbers) for name, numbers in lanes.items()}


def coordinates(space: SearchSpace, parameters: Mapping[str, Value]) -> dict[str, Any]:
    """The value of each dimension in a parameter set; it may lie outside of the space."""
    found: dict[str, Any] = {}
    for key in space.distributions:
        name, bracket, lane = key.partition("[")
        value: Any = parameters[name]
        is_one = bracket and isinstance(value, tuple)
        found[key] = value[int(lane[:-1]) - 1] if is_one else value
    return found


def to_point(space: SearchSpace, parameters: Mapping[str, Value]) -> dict[str, Any] | None:
    """The point of a parameter set; None if a value lies outside of the space."""
    point = coordinates(space, parameters)
    for key, d in space.distributions.items():
        if not is_inside(d, point[key]):
            return None
        point[key] = int(point[key]) if isinstance(d, IntDistribution) else point[key]
    return point


def is_inside(d: Any, value: Any) -> bool:
    """Whether a distribution has a value."""
    if isinstance(d, CategoricalDistribution):
        return value in d.choices
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    is_whole = not isinstance(d, IntDistribution) or value == int(value)
    return is_number and d.low <= value <= d.high and is_whole


def describe(space: SearchSpace) -> dict[str, Any]:
    """The space ready for JSON: the range of each dimension, and the fixed values."""
    ends = {
        key: list(d.choices) if isinstance(d, CategoricalDistribution) else [d.low, d.high]
        for key, d in space.distributions.items()
    }
    return {"searched": ends, "fixed": dict(sorted(space.fixed.items()))}
