"""The evidence rule `line_geometry`: the places of the lines give likelihoods of the car's place on
the road. `rule` explains and computes them; the other modules are its parts."""

from egolane_pgm.evidence.line_geometry.parameters import PARAMETERS
from egolane_pgm.evidence.line_geometry.rule import (
    INPUTS,
    LEARNED,
    NODES,
    PROVIDES,
    evidence,
    fit,
    looks_ahead,
    online,
)

__all__ = [
    "INPUTS",
    "LEARNED",
    "NODES",
    "PARAMETERS",
    "PROVIDES",
    "evidence",
    "fit",
    "looks_ahead",
    "online",
]
