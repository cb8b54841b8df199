"""The verb `online`."""

from __future__ import annotations

import json
import sys

from egolane_pgm.experiment import Given, Overrides, load_experiment
from egolane_pgm.online import filter_stream

EXAMPLES = ("egolane online experiments/quickstart.yaml < lines.jsonl",)


def online(experiment: Given, *, overrides: Overrides = ()) -> None:
    """Filter frame by frame: a JSON line in, the belief for it out at once.

    Reads `{"frame_id": 7, "lines": [{"offset_m": -1.8, "is_valid": true, "is_continuous": false,
    "lri": 10}]}` per line on standard input; of a line of the road only `offset_m` is needed. With
    `filter: fixed_lag` the belief comes `lag` frames later.

    - overrides: override a key of the YAML, e.g. parameters.bonus_value=0.
    """
    # Standard input as an iterator would be read ahead in blocks.
    sys.stdin.reconfigure(encoding="utf-8", errors="replace")  # type: ignore[union-attr]
    messages = iter(sys.stdin.readline, "")
    for belief in filter_stream(load_experiment(experiment, overrides), messages):
        print(json.dumps(belief), flush=True)
