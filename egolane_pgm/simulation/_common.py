"""Checks of settings, and correlated noise, which the modules of the simulation share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, get_type_hints

import numpy as np

from egolane_pgm.parameters import Parameter
from egolane_pgm.types import FloatArray, InputError

#: Kinds of numbers, as of `parameters.Parameter`; "count" is a whole number of at least 1.
Positive = Annotated[float, "positive"]
NotNegative = Annotated[float, "non_negative"]
Share = Annotated[float, "probability"]
Count = Annotated[int, "count"]
Whole = Annotated[int, "integer"]


def check_fields(instance: object, most: Mapping[str, float] | None = None) -> None:
    """Checks the numbers of a frozen dataclass by the kinds in its annotations and converts them in
    place, in `__post_init__`.

    - most: the largest value of some fields; it is a million for the others, which is a slip of
      the finger in any unit

    Raises InputError (`simulation.<field>: ...`) for a value that is not of its kind.
    """
    for name, hint in get_type_hints(type(instance), include_extras=True).items():
        where, kind = f"simulation.{name}", hint.__metadata__[0]
        highest = (most or {}).get(name, 1_000_000)
        spec = Parameter(name, "integer" if kind == "count" else kind, 0, "", highest=highest)
        value = spec.check(getattr(instance, name), 1, where)
        if kind == "count" and value == 0:
            raise InputError(f"{where}: 0 must be at least 1")
        object.__setattr__(instance, name, value)


def check_seed(seed: object) -> int:
    """The seed. Raises InputError unless it is a whole number of at least 0."""
    return int(Parameter("seed", "integer", 0, "").check(seed, 1, "simulation.seed"))  # type: ignore[arg-type]


def slow_noise(
    rng: np.random.Generator, n_frames: int, n_series: int, correlation_frames: float
) -> FloatArray:
    """Stationary first-order autoregressive noise, (T, K), with mean 0 and standard deviation 1.

    correlation_frames: frames over which the correlation falls to 1/e; 0 gives white noise.
    """
    keep = float(np.exp(-1.0 / correlation_frames)) if correlation_frames > 0 else 0.0
    noise = rng.standard_normal((n_frames, n_series))
    noise[1:] *= np.sqrt(1.0 - keep * keep)
    for t in range(1, n_frames):
        noise[t] += keep * noise[t - 1]
    return noise
