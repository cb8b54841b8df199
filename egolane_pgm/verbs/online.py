"""The verb `online`."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from typing import Annotated

from egolane_pgm.experiment import Given, Overrides, load_experiment
from egolane_pgm.online import filter_stream
from egolane_pgm.recordings.columns import column_keys
from egolane_pgm.verbs.given import ColumnNames, Option

EXAMPLES = ("egolane online experiments/quickstart.yaml < lines.jsonl",)


def online(
    experiment: Given,
    *,
    nodes: Annotated[Sequence[str], Option("NODE", names=("--node",), many=True)] = (),
    columns: ColumnNames = None,
    overrides: Overrides = (),
) -> None:
    """Filter frame by frame: a JSON line in, the lane out at once.

    Reads `{"frame_id": 7, "lines": [{"offset_m": -1.8, "is_valid": true, "is_continuous": false,
    "lri": 10}]}` per line on standard input; of a line of the road only `offset_m` is needed. A
    time stamp, `"time_s": 12.3`, may stand beside the frame id or in its place. Each answer has the
    lane, its probability, how probable it is that the car is on a line, and the lane changes that
    are told with this frame. With `filter: fixed_lag` it comes `lag` frames later.

    - nodes: answer with the whole belief of this hidden node, too, e.g. Lane.
    - columns: what other messages call our fields, and how they write them, e.g.
      offset_m=c0,left_positive=true.
    - overrides: override a key of the YAML, e.g. parameters.bonus_value=0.
    """
    # Standard input as an iterator would be read ahead in blocks.
    sys.stdin.reconfigure(encoding="utf-8", errors="replace")  # type: ignore[union-attr]
    messages = iter(sys.stdin.readline, "")
    wanted = [nodes] if isinstance(nodes, str) else nodes
    chosen = load_experiment(experiment, overrides)
    if columns is not None:
        chosen = load_experiment(chosen, {"recording": {"columns": column_keys(columns)}})
    for answer in filter_stream(chosen, messages, wanted):
        print(json.dumps(answer), flush=True)
