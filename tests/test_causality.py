"""Evidence rules and results that use later frames say so; no other does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.contracts import Rule
from egolane_pgm.loading import load_experiment
from egolane_pgm.model import compile_model, make_evidence, why_not_causal
from egolane_pgm.plugins import plugin_names
from egolane_pgm.types import LineLog
from tests.conftest import needs_compiler
from tests.kits.drives import run, short_drive, simulated, write_drive

N_FRAMES = 600

#: A graph for each evidence rule.
GRAPHS = {
    "counting": "sensor_failure",
    "line_geometry": "position_in_lane",
}


def growing(n_frames: int) -> LineLog:
    """A drive whose second half is reported in longer metres, so that the lane width of the whole
    is not that of the first half."""
    log = short_drive(n_frames).log
    by = np.where(np.arange(n_frames) < n_frames // 2, 1.0, 1.3)
    return replace(log, offset_m=log.offset_m * by[:, None])


def test_every_evidence_rule_is_tried_here() -> None:
    assert set(GRAPHS) == set(plugin_names(Rule))


@needs_compiler
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(
    ("rule", "width"),
    [
        *((rule, width) for rule in GRAPHS for width in (None, 3.5)),
        ("line_geometry", "auto"),
        ("line_geometry", "causal"),
    ],
)
def test_a_rule_that_looks_ahead_says_so_and_no_other_does(rule: str, width: Any) -> None:
    keys: dict[str, Any] = {} if width is None else {"parameters": {"lane_width_m": width}}
    experiment = simulated(evidence=rule, graph=GRAPHS[rule], **keys)
    model, log = compile_model(load_experiment(experiment, n_lanes=3)), growing(N_FRAMES)
    if width == 3.5:
        # The first half has no flags; whether the detector has any shows in the second.
        is_continuous = log.is_continuous & (np.arange(N_FRAMES) >= N_FRAMES // 2)[:, None]
        log = replace(log, is_continuous=is_continuous)
    whole = make_evidence(model, log)[0]
    half = make_evidence(model, log.take(slice(0, N_FRAMES // 2)))[0]
    is_same = all(
        np.array_equal(values[: len(half)], half.likelihoods[node])
        for node, values in whole.likelihoods.items()
    )
    assert is_same == (rule != "line_geometry" or width in (None, "causal"))
    assert len(why_not_causal(model)) == (not is_same)


def test_a_rule_of_ones_own_says_that_it_looks_ahead(tmp_path: Path) -> None:
    path = write_drive(tmp_path, 60, evidence="./mine.py")
    (tmp_path / "mine.py").write_text(
        "from egolane_pgm.evidence.counting import PARAMETERS, PROVIDES, evidence\n"
        "def looks_ahead(parameters):\n"
        "    return 'its mean is that of the whole recording'\n"
    )
    found = run(path).run
    assert found["is_causal"] is False
    why = f"{tmp_path}/mine.py: not causal, its mean is that of the whole recording"
    assert found["why_not_causal"] == [why]
