"""What a study searches: one dimension per number, within the bounds that graph and evidence rule
declare and the YAML narrows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from optuna.distributions import (
    BaseDistribution,
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
class Dimension:
    """One number, or choice, that is searched.

    - key: `sigma1`, or `p3[2]` for the value of lane 2 of a parameter with one value per lane.
    - parameter: the name that is declared: `p3`.
    - lane: from 1; None for a parameter with one value for all lanes.
    - low, high: the bounds, both included.
    - choices: names instead of numbers; low and high are then the first and last index.
    - is_log: whether the logarithm is searched, as where the bounds are a tenth and ten times.
    """

    key: str
    parameter: str
    lane: int | None
    low: float
    high: float
    is_integer: bool = False
    choices: tuple[str, ...] = ()
    is_log: bool = False

    def value_in(self, parameters: Mapping[str, Value]) -> Any:
        """Its value in a parameter set."""
        value = parameters[self.parameter]
        return value[self.lane - 1] if self.lane is not None and isinstance(value, tuple) else value


@dataclass(frozen=True)
class SearchSpace:
    """D dimensions that are searched, and the values of the parameters that are not."""

    dimensions: tuple[Dimension, ...]
    fixed: Mapping[str, Value]


def make_space(
    specs: Sequence[Parameter],
    current: Mapping[str, Value],
    given: Mapping[str, Any],
    n_lanes: int,
    where: str,
) -> SearchSpace:
    """Make the search space of the declared parameters.

    - specs: the parameters. One that says that it is not searched, is a choice, a whole number or
      a table is searched only where bounds are given (`Parameter.is_searched`).
    - current: the value of every parameter; those that are not searched keep it.
    - given: by name [low, high], names of a choice, or one value to keep instead.
    - where: the beginning of a message, e.g. the YAML and the key.

    Raises InputError (`<where>.<name>: ...`) for unknown names, with a suggestion, empty or
    inverted bounds, bounds that the parameter's kind does not allow, and when nothing is left.
    """
    known = {spec.name: spec for spec in specs}
    dimensions: list[Dimension] = []
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
        else:
            dimensions += _dimensions(spec, bounds, name in given, n_lanes, here)
    if not dimensions:
        raise InputError(f"{where}: every parameter is fixed, there is nothing to search")
    return SearchSpace(tuple(dimensions), fixed)


def _dimensions(
    spec: Parameter, bounds: Sequence[Any], is_given: bool, n_lanes: int, where: str
) -> list[Dimension]:
    """The dimensions of a parameter that is searched. is_given: whether the YAML has the bounds."""
    if spec.kind == "choice":
        return [_choice(spec, bounds, n_lanes, where)]
    low, high = _bounds(spec, bounds, n_lanes, where)
    whole = _is_whole(spec)
    if whole and (low != int(low) or high != int(high)):
        raise InputError(f"{where}: [{low}, {high}] must be whole numbers")
    # The bounds are a tenth of the default and ten times that.
    is_tenfold = spec.search == "auto" and spec.kind in ("positive", "non_negative")
    is_log = not is_given and is_tenfold and low > 0
    # Where the graph itself has it searched, each lane's value is.
    lanes = range(1, n_lanes + 1) if spec.per_lane and spec.is_searched else (None,)
    keys = {lane: spec.name if lane is None else f"{spec.name}[{lane}]" for lane in lanes}
    return [
        Dimension(key, spec.name, lane, low, high, whole, is_log=is_log)
        for lane, key in keys.items()
    ]


def _is_whole(spec: Parameter) -> bool:
    """Whole numbers are searched where kind, or default and bounds, are whole as declared."""
    declared = (0.5,) if spec.search in ("auto", None) else spec.search_range or ()
    numbers = [spec.default, *declared]
    return spec.kind == "integer" or all(isinstance(v, int) for v in numbers)


def _choice(spec: Parameter, names: Sequence[Any], n_lanes: int, where: str) -> Dimension:
    chosen = tuple(str(spec.check(name, n_lanes, where)) for name in names)
    if len(set(chosen)) < 2:
        raise InputError(
            f"{where}: {list(names)} leaves nothing to search; give one name to fix it"
        )
    return Dimension(spec.name, spec.name, None, 0, len(chosen) - 1, True, chosen)


def _bounds(
    spec: Parameter, bounds: Sequence[Any], n_lanes: int, where: str
) -> tuple[float, float]:
    if len(bounds) != 2:
        raise InputError(f"{where}: {list(bounds)} must be [low, high], or one value to fix it")
    is_open_below = spec.kind in ("sigma", "positive", "probability") and bounds[0] == 0
    is_open_above = spec.kind == "probability" and bounds[1] == 1
    low = 0.0 if is_open_below else spec.check(bounds[0], n_lanes, where)
    high = spec.check(bounds[1], n_lanes, where)
    assert isinstance(low, (int, float))
    assert isinstance(high, (int, float))
    if low > high:
        raise InputError(f"{where}: [{low}, {high}] is inverted, the lower bound comes first")
    if low == high:
        raise InputError(f"{where}: [{low}, {high}] is empty; write {low} to fix the parameter")
    margin = OPEN_END * (high - low)
    return low + margin * is_open_below, high - margin * is_open_above


def distributions(space: SearchSpace) -> dict[str, BaseDistribution]:
    """Return the space as Optuna has it: a distribution per dimension."""
    found: dict[str, BaseDistribution] = {}
    for d in space.dimensions:
        if d.choices:
            found[d.key] = CategoricalDistribution(d.choices)
        elif d.is_integer:
            found[d.key] = IntDistribution(int(d.low), int(d.high))
        else:
            found[d.key] = FloatDistribution(d.low, d.high, log=d.is_log)
    return found


def to_parameters(space: SearchSpace, point: Point) -> dict[str, Value]:
    """Every declared parameter's value at a point."""
    values: dict[str, Value] = dict(space.fixed)
    lanes: dict[str, list[float]] = {}
    for d in space.dimensions:
        if d.lane is None:
            values[d.parameter] = point[d.key]
        else:
            lanes.setdefault(d.parameter, []).append(float(point[d.key]))
    for name, numbers in lanes.items():
        values[name] = tuple(numbers)
    return values


def to_point(space: SearchSpace, parameters: Mapping[str, Value]) -> dict[str, Any] | None:
    """The point of a parameter set, or None where a value lies outside of the space. The values of
    parameters that are not searched are not looked at."""
    point: dict[str, Any] = {}
    for d in space.dimensions:
        value = d.value_in(parameters)
        if d.choices:
            if value not in d.choices:
                return None
        elif isinstance(value, (tuple, str)) or not d.low <= value <= d.high:
            return None
        elif d.is_integer:
            if value != int(value):
                return None
            value = int(value)
        point[d.key] = value
    return point


def describe(space: SearchSpace) -> dict[str, Any]:
    """The space as plain JSON: what is searched and what is kept."""
    searched = {d.key: list(d.choices) if d.choices else [d.low, d.high] for d in space.dimensions}
    fixed = {k: list(v) if isinstance(v, tuple) else v for k, v in sorted(space.fixed.items())}
    return {"searched": searched, "fixed": fixed}
