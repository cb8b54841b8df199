"""Parameters and tables learned from a recording, and what they are worth on frames not looked at.

An evidence rule that can be learned defines `LEARNED`, the names of the parameters that it learns,
and `fit(log, lane, is_used, n_lanes, parameters) -> parameters`, which may look at the lanes of the
used frames only. With any other rule the tables of the graph are learned, by EM (`tables`).
Everything else is the same for all.
"""

from egolane_pgm.learn.learning import (
    Found,
    Learned,
    check_learnable,
    fit,
    fit_pooled,
    held_out_belief,
    learn,
    n_learned,
)
from egolane_pgm.learn.output import output_files, write_learned
from egolane_pgm.learn.tables import with_found

__all__ = [
    "Found",
    "Learned",
    "check_learnable",
    "fit",
    "fit_pooled",
    "held_out_belief",
    "learn",
    "n_learned",
    "output_files",
    "with_found",
    "write_learned",
]
