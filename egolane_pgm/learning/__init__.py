"""Parameters and tables learned from a recording, and their scores on frames that were held out.

An evidence rule that can be learned defines `LEARNED`, the names of the parameters that it learns,
and `fit(log, lane, is_used, n_lanes, parameters) -> parameters`, which is given the lanes of the
used frames only. With `fit_pooled(parts, n_lanes, parameters)`, where each part is a tuple (log,
lane, is_used), it learns from several recordings. With any other rule the tables of the graph are
learned, by EM (`tables`).
"""

from egolane_pgm.learning.held_out import (
    Found,
    Learned,
    check_learnable,
    fit,
    fit_pooled,
    n_learned,
)
from egolane_pgm.learning.output import output_files, write_learned
from egolane_pgm.learning.tables import with_found

__all__ = [
    "Found",
    "Learned",
    "check_learnable",
    "fit",
    "fit_pooled",
    "n_learned",
    "output_files",
    "with_found",
    "write_learned",
]
