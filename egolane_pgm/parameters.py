"""Declared parameters of graphs, evidence rules and detectors, checked and resolved."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from egolane_pgm.types import InputError, not_one_of, suggestion

#: A parameter's value: a number, a choice by name, or one number per lane.
Value = float | int | str | tuple[float, ...]

#: Values by the parameters' names, checked (`resolve_parameters`).
Parameters = Mapping[str, Value]


#: The largest number; its square is still finite.
LARGEST = 1e100


@dataclass(frozen=True)
class Parameter:
    """A parameter of a graph, an evidence rule or a detector.

    - kind: "sigma" (> 0), "probability" (0 to 1), "positive" (> 0), "non_negative", "integer"
      (>= 0), "choice" (one of `choices`) or "text", parsed by the plugin.
    - doc: meaning and unit.
    - search: the bounds of a search; "auto" for those of the kind (see `search_range`); None for a
      parameter that is searched only if the user gives bounds.
    - choices: for a kind other than "choice", names allowed in place of a number (`auto`).
    - per_lane: whether a list of n values is allowed, too.
    - lowest, highest: the smallest and the largest number, inclusive.
    - shape: the shape of a table for n lanes. It may be given as nested lists or as one row; the
      value is one row, the last axis fastest.
    - smoothed: the default with `filter: smoothed`; None for `default`.

    >>> import egolane_pgm as ego
    >>> ego.Parameter("p1", "probability", 0.9, "how often a working sensor stays so").search_range
    (0.0, 1.0)
    """

    name: str
    kind: str
    default: Value
    doc: str
    search: tuple[float, float] | Literal["auto"] | None = "auto"
    choices: tuple[str, ...] = ()
    per_lane: bool = False
    lowest: float = 0
    highest: float = math.inf
    shape: Callable[[int], tuple[int, ...]] | None = None
    smoothed: Value | None = None

    @property
    def search_range(self) -> tuple[float, float] | None:
        """The bounds (low, high) of a search, declared or derived from the kind.

        A probability has 0 to 1, a sigma 0 to 3, or to ten times a larger default; other numbers a
        tenth of the default to ten times that, or 0 to 1 for a default of 0. None for choices,
        tables and whole numbers, which shape a network.
        """
        if isinstance(self.search, (tuple, list)):
            return (self.search[0], self.search[1])
        values = self.default if isinstance(self.default, (tuple, list)) else (self.default,)
        is_number = all(isinstance(value, (int, float)) for value in values)
        if self.kind in ("choice", "integer", "text") or self.shape is not None or not is_number:
            return None
        least, most = float(min(values)), float(max(values))
        if self.kind == "probability":
            low, high = 0.0, 1.0
        elif self.kind == "sigma":
            low, high = 0.0, 3.0 if most <= 3 else 10 * most
        else:
            low, high = (least / 10, 10 * most) if least > 0 else (0.0, 10 * most or 1.0)
        low, high = max(low, self.lowest), min(high, self.highest)
        return (low, high) if low < high else None

    @property
    def is_searched(self) -> bool:
        """Whether a search moves it if the user gives no bounds."""
        return self.search is not None and self.search_range is not None

    def check(self, value: object, n_lanes: int, where: str) -> Value:
        """Return the value, converted to its type.

        Raises InputError, prefixed with `where`, for another type or a value out of range.
        """
        if self.kind == "text":
            if not isinstance(value, str):
                raise InputError(f"{where}: {value!r} is not text")
            return value
        if self.kind == "choice" or (self.choices and isinstance(value, str)):
            if value not in self.choices:
                number = "" if self.kind == "choice" else ", nor a number"
                raise InputError(f"{where}: {not_one_of(value, self.choices)}{number}")
            return str(value)
        if self.shape is not None:
            return self._check_table(value, self.shape(n_lanes), where)
        if isinstance(value, (list, tuple, np.ndarray)):
            if not self.per_lane:
                raise InputError(f"{where}: needs one number, got a list")
            if len(value) != n_lanes:
                raise InputError(f"{where}: has {len(value)} values for {n_lanes} lanes")
            return tuple(float(self._check_number(v, where)) for v in value)
        return self._check_number(value, where)

    def _check_table(self, value: object, shape: tuple[int, ...], where: str) -> Value:
        needed = f"a list of {' x '.join(map(str, shape))} numbers"
        try:
            numbers = np.asarray(value)
        except ValueError as error:
            raise InputError(f"{where}: needs {needed}, every row of the same length") from error
        if numbers.dtype.kind not in "iuf" or numbers.shape not in (shape, (math.prod(shape),)):
            raise InputError(f"{where}: needs {needed}, got {str(value)[:100]}")
        return tuple(float(self._check_number(v, where)) for v in numbers.ravel().tolist())

    def _check_number(self, value: object, where: str) -> float | int:
        if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
            raise InputError(f"{where}: {value!r} is not a number")
        x = float(value)
        if not np.isfinite(x):
            raise InputError(f"{where}: {x} is not a finite number")
        if self.kind == "probability" and not 0 <= x <= 1:
            raise InputError(f"{where}: {value} is not a probability (0 to 1)")
        if self.kind in ("sigma", "positive") and x <= 0:
            raise InputError(f"{where}: {value} must be greater than 0")
        if self.kind == "integer" and x != int(x):
            raise InputError(f"{where}: {value} is not a whole number")
        if x < self.lowest:
            raise InputError(f"{where}: {value} must be at least {self.lowest}")
        if x > (highest := min(self.highest, LARGEST)):
            raise InputError(f"{where}: {value} must be at most {highest}")
        return int(x) if self.kind == "integer" else x


def not_searched(specs: Iterable[Parameter]) -> tuple[Parameter, ...]:
    """Return the parameters as searched only if the user gives bounds."""
    return tuple(replace(spec, search=None) for spec in specs)


def smoothing_defaults(specs: Iterable[Parameter]) -> tuple[Parameter, ...]:
    """Return the parameters with their defaults for `filter: smoothed`."""
    return tuple(s if s.smoothed is None else replace(s, default=s.smoothed) for s in specs)


def number(parameters: Parameters, name: str) -> float:
    """Return the value of a parameter that is one number."""
    value = parameters[name]
    assert isinstance(value, (int, float))
    return float(value)


def per_lane(parameters: Parameters, name: str, n_lanes: int) -> Sequence[float]:
    """Return the value of a parameter as n numbers, one per lane."""
    value = parameters[name]
    return value if isinstance(value, tuple) else (number(parameters, name),) * n_lanes


def resolve_parameters(
    specs: Iterable[Parameter], given: Mapping[str, object], n_lanes: int, where: str = "parameters"
) -> dict[str, Value]:
    """Return every declared parameter with its given or default value, checked.

    Raises InputError (`<where>.<name>: ...`) for an unknown name and a value out of range.
    """
    known = {spec.name: spec for spec in specs}
    values: dict[str, Value] = {}
    check_names(known, given, where)
    for name, spec in known.items():
        values[name] = spec.check(given.get(name, spec.default), n_lanes, f"{where}.{name}")
    return values


def check_names(known: Iterable[str], given: Iterable[str], where: str) -> None:
    """Raise InputError for an unknown name. One without a near name may be of another graph."""
    names = set(known)
    left = "; `parameters: {}` drops all of another graph" if where.endswith(" parameters") else ""
    for name in given:
        if name not in names:
            hint = suggestion(str(name), names)
            hint += "" if "did you mean" in hint else left
            raise InputError(f"{where}: unknown key '{name}'{hint}")
