"""The verb `online`."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from typing import Annotated

from egolane_pgm.loading import ExperimentLike, load_experiment
from egolane_pgm.online import online as answers
from egolane_pgm.online import read_messages
from egolane_pgm.recordings.columns import column_keys
from egolane_pgm.runs import open_input
from egolane_pgm.tools.options import ColumnNames, Option, Overrides
from egolane_pgm.types import InputError

EXAMPLES = ("egolane online experiments/quickstart.yaml < lines.jsonl",)


def online(
    experiment: ExperimentLike,
    *,
    nodes: Annotated[Sequence[str], Option("NODE", names=("--node",))] = (),
    columns: ColumnNames = None,
    overrides: Overrides = (),
) -> None:
    """Filter frame by frame: a JSON line in, the lane out at once.

    Reads `{"frame_id": 7, "lines": [{"offset_m": -1.8, "is_valid": true, "is_continuous": false,
    "lri": 10}]}` per line on standard input; only `offset_m` is required of a lane line. A time
    stamp, `"time_s": 12.3`, may accompany or replace the frame id. Each answer has the lane, its
    probability, the line crossing probability, and the lane changes since the previous answer. With
    `filter: fixed_lag` it comes `lag` frames later. With `n_lanes: map` frames need the clock of
    the road table.

    - nodes: add the posterior of this hidden node, e.g. Lane.
    - columns: names and units of other messages' fields, e.g. offset_m=c0,left_positive=true.
    - overrides: override a key of the YAML, e.g. parameters.bonus_value=0.
    """
    if sys.stdin is None:
        raise InputError("standard input is closed; give it a message a line")
    # Standard input as an iterator would be read ahead in blocks.
    sys.stdin.reconfigure(encoding="utf-8", errors="replace")  # type: ignore[union-attr]
    messages = iter(sys.stdin.readline, "")
    chosen = open_input(experiment, overrides=overrides).experiment
    if columns is not None:
        chosen = load_experiment(chosen, {"recording": {"columns": column_keys(columns)}})
    for answer in answers(chosen, read_messages(chosen, messages), nodes):
        print(json.dumps(answer), flush=True)
