"""The evidence rule `line_geometry`: likelihoods over the place on the road from where the lines
lie. `rule` has the idea, the other modules its parts."""

from egolane_pgm.evidence.line_geometry.parameters import PARAMETERS
from egolane_pgm.evidence.line_geometry.rule import (
    FIT_IGNORES,
    LEARNED,
    NODES,
    PROVIDES,
    evidence,
    fit,
    fit_pooled,
    looks_ahead,
    online,
)

__all__ = [
    "FIT_IGNORES",
    "LEARNED",
    "NODES",
    "PARAMETERS",
    "PROVIDES",
    "evidence",
    "fit",
    "fit_pooled",
    "looks_ahead",
    "online",
]
