"""The table functions of graphs that are written in YAML; `_yaml_graph` says what they mean."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from egolane_pgm.graphs.cpds import binary, discretised_normal, lane_edges, lane_normals, uniform
from egolane_pgm.types import FloatArray, InputError, Parameters, suggestion


@dataclass(frozen=True)
class Place:
    """Where a table function is evaluated: the node's size, the parents it may use with their
    sizes and value names, the parameters, the lane of the enclosing stack, and which parents have
    n_lanes values."""

    where: str
    size: int
    parents: Mapping[str, int]
    names: Mapping[str, Sequence[str]]
    parameters: Parameters
    n_lanes: int
    lane: int | None
    lanes: frozenset[str]


#: A conditional table: the parents that it uses, and an array with an axis for each and the node's.
Made = tuple[tuple[str, ...], FloatArray]


def check_keys(section: Any, known: Iterable[str], where: str) -> None:
    if not isinstance(section, Mapping):
        raise InputError(f"{where}: needs keys and values, got {section!r}")
    for key in section:
        if key not in known:
            raise InputError(f"{where}: unknown key '{key}'{suggestion(str(key), known)}")


def evaluate(spec: Any, place: Place) -> Made:
    """The table of a spec: a function's name, or {name: arguments}."""
    if isinstance(spec, Mapping) and len(spec) == 1:
        [(function, arguments)] = spec.items()
    else:
        function, arguments = spec, None
    if not isinstance(function, str) or function not in FUNCTIONS:
        shown = function if isinstance(function, str) else repr(function)
        raise InputError(
            f"{place.where}: unknown table function '{shown}'{suggestion(str(function), FUNCTIONS)}"
        )
    make, needed, optional = FUNCTIONS[function]
    arguments = {} if arguments is None else arguments
    where = f"{place.where}: {function}"
    if optional != ("*",):
        check_keys(arguments, (*needed, *optional), where)
    for key in needed:
        if not isinstance(arguments, Mapping) or key not in arguments:
            raise InputError(f"{where} needs {', '.join(needed)}; {key} is missing")
    return make(arguments, place)


def _parent(name: Any, place: Place, size: int | None = None) -> str:
    """The parent of that name; `size`: the number of values that it has to have."""
    if name not in place.parents:
        raise InputError(
            f"{place.where}: '{name}' is no parent by the edges"
            f"{suggestion(str(name), place.parents)}"
        )
    if size is not None and place.parents[name] != size:
        raise InputError(
            f"{place.where}: {name} has {place.parents[name]} values, here it needs {size}"
        )
    return str(name)


def _number(given: Any, place: Place) -> float:
    """A number, a parameter's name, or 1 - a parameter's name."""
    if isinstance(given, (int, float)) and not isinstance(given, bool):
        return float(given)
    match = re.fullmatch(r"(1\s*-\s*)?([^\W\d]\w*)", str(given).strip())
    if match is None:
        raise InputError(f"{place.where}: {given!r} is no number and no parameter")
    value = _parameter(match[2], place)
    if isinstance(value, tuple):
        if place.lane is None:
            raise InputError(
                f"{place.where}: {match[2]} has a value per lane; use it in a stack over the lanes"
            )
        value = value[place.lane]
    if isinstance(value, str):
        raise InputError(f"{place.where}: {match[2]} is a choice, not a number")
    return 1 - float(value) if match[1] else float(value)


def _parameter(name: str, place: Place) -> Any:
    if name not in place.parameters:
        raise InputError(
            f"{place.where}: no parameter '{name}'{suggestion(name, place.parameters)}"
        )
    return place.parameters[name]


def _uniform(_: Mapping[str, Any], place: Place) -> Made:
    return (), uniform(place.size)


def _normal(given: Mapping[str, Any], place: Place) -> Made:
    parent = _parent(given["around"], place, place.size)
    if place.size != place.n_lanes:
        raise InputError(f"{place.where}: normal is for nodes with n_lanes values")
    sigma = _number(given["sigma"], place)
    if sigma <= 0:
        raise InputError(f"{place.where}: sigma {sigma} must be greater than 0")
    how = given.get("how", "density")
    how = how if how in ("density", "integral") else _parameter(str(how), place)
    if how not in ("density", "integral"):
        raise InputError(f"{place.where}: how: '{how}' is neither density nor integral")
    widths: Any = given.get("widths", 1.0)
    widths = _parameter(widths, place) if isinstance(widths, str) else widths
    widths = widths if isinstance(widths, (tuple, list)) else (float(widths),) * place.n_lanes
    if "shift" not in given:
        return (parent,), lane_normals(sigma, place.n_lanes, how, widths)
    shift = _number(given["shift"], place)
    _, centres = lane_edges(place.n_lanes, widths)
    rows = [discretised_normal(c + shift, sigma, place.n_lanes, how, widths) for c in centres]
    return (parent,), np.stack(rows)


def _binary(given: Mapping[str, Any], place: Place) -> Made:
    if place.size != 2:
        raise InputError(f"{place.where}: binary is for nodes with 2 values, not {place.size}")
    parent = _parent(given["of"], place, 2)
    return (parent,), binary(_number(given["ok"], place), _number(given["bad"], place))


def _identity(given: Mapping[str, Any], place: Place) -> Made:
    return (_parent(given["of"], place, place.size),), np.eye(place.size)


def _rows(given: Mapping[str, Any], place: Place) -> Made:
    of = given.get("of", [])
    parents = tuple(_parent(p, place) for p in (of if isinstance(of, list) else [of]))
    shape = (*(place.parents[p] for p in parents), place.size)

    def read(values: Any, shape: tuple[int, ...]) -> Any:
        if not isinstance(values, list) or len(values) != shape[0]:
            raise InputError(
                f"{place.where}: rows needs {' x '.join(map(str, shape))} numbers, got {values!r}"
            )
        if len(shape) > 1:
            return [read(row, shape[1:]) for row in values]
        *first, last = values
        numbers = [_number(v, place) for v in first]
        return [*numbers, 1 - sum(numbers) if last == "rest" else _number(last, place)]

    return parents, np.array(read(given["values"], shape), dtype=np.float64)


def _stack(given: Mapping[str, Any], place: Place) -> Made:
    over = _parent(given["over"], place)
    names = place.names[over]
    branches = {str(key): table for key, table in given.items() if key != "over"}
    for key in branches:
        if key not in names and key != "else":
            raise InputError(
                f"{place.where}: stack: {over} has no value '{key}'{suggestion(key, names)}"
            )
    made = []
    for k, name in enumerate(names):
        if name not in branches and "else" not in branches:
            raise InputError(f"{place.where}: stack: no table for {over} {name}, and no else")
        inner = Place(
            f"{place.where}.{name}",
            place.size,
            {p: size for p, size in place.parents.items() if p != over},
            place.names,
            place.parameters,
            place.n_lanes,
            k if over in place.lanes else place.lane,
            place.lanes,
        )
        made.append(evaluate(branches.get(name, branches.get("else")), inner))
    parents = tuple(dict.fromkeys(p for used, _ in made for p in used))
    shape = (*(place.parents[p] for p in parents), place.size)
    return (over, *parents), np.stack([_spread(one, parents, shape) for one in made])


def _spread(made: Made, parents: Sequence[str], shape: tuple[int, ...]) -> FloatArray:
    """A table with an axis for each of `parents`, also for those that it does not depend on."""
    used, values = made
    order = [used.index(p) for p in parents if p in used]
    ordered = values.transpose(*order, len(used))
    kept = [size if p in used else 1 for p, size in zip(parents, shape, strict=False)]
    return np.broadcast_to(ordered.reshape(*kept, shape[-1]), shape)


#: Table functions: how each is made, the arguments it needs and those it may have.
FUNCTIONS: Mapping[
    str, tuple[Callable[[Mapping[str, Any], Place], Made], tuple[str, ...], tuple[str, ...]]
] = {
    "uniform": (_uniform, (), ()),
    "normal": (_normal, ("around", "sigma"), ("shift", "how", "widths")),
    "binary": (_binary, ("of", "ok", "bad"), ()),
    "identity": (_identity, ("of",), ()),
    "rows": (_rows, ("values",), ("of",)),
    "stack": (_stack, ("over",), ("*",)),
}
