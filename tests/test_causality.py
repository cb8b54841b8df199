"""What is said to be causal is: beliefs do not change when later frames are cut off. What looks
ahead says so, in every result and table."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.model import causality, make_evidence, prepare_model
from egolane_pgm.plugins import plugin_names
from egolane_pgm.results import read_result
from egolane_pgm.types import LineLog
from tests.conftest import needs_compiler
from tests.kits.drives import done, short_drive, write_drive

N_FRAMES = 600

#: The lane width from the whole recording.
WHOLE: dict[str, Any] = {"lane_width_m": "auto"}

#: A graph for each evidence rule.
GRAPHS = {
    "counting": "sensor_failure",
    "counting_levels": "wor_levels",
    "line_geometry": "position_in_lane",
}

GEOMETRY: dict[str, Any] = {
    "evidence": "line_geometry",
    "graph": "position_in_lane",
    "filter": "exact",
}


def growing(n_frames: int) -> LineLog:
    """A drive whose second half is reported in longer metres, so that the lane width of the whole
    is not that of the first half."""
    log = short_drive(n_frames).log
    by = np.where(np.arange(n_frames) < n_frames // 2, 1.0, 1.3)
    return replace(log, offset_m=log.offset_m * by[:, None])


def experiment_with(folder: Path, rule: str, **keys: Any) -> Experiment:
    path = write_drive(folder, N_FRAMES, evidence=rule, graph=GRAPHS[rule], **keys)
    return load_experiment(path)


def test_every_evidence_rule_is_looked_at_here() -> None:
    assert set(GRAPHS) == set(plugin_names("evidence"))


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
def test_a_rule_that_looks_ahead_says_so_and_no_other_does(
    tmp_path: Path, rule: str, width: Any
) -> None:
    keys: dict[str, Any] = {} if width is None else {"parameters": {"lane_width_m": width}}
    experiment = experiment_with(tmp_path, rule, **keys)
    model, log = prepare_model(experiment), growing(N_FRAMES)
    if width == 3.5:
        # The first half has no flags; whether the detector has any shows in the second.
        is_continuous = log.is_continuous & (np.arange(N_FRAMES) >= N_FRAMES // 2)[:, None]
        log = replace(log, is_continuous=is_continuous)
    whole = make_evidence(model, log).filtered
    half = make_evidence(model, log.take(slice(0, N_FRAMES // 2))).filtered
    is_same = all(
        np.array_equal(values[: len(half)], half.likelihoods[node])
        for node, values in whole.likelihoods.items()
    )
    said = causality(experiment, model)
    assert said["causal"] == {"filter": True, "evidence": is_same}
    assert said["is_causal"] == is_same == (rule != "line_geometry" or width in (None, "causal"))
    assert len(said["why_not_causal"]) == (not is_same)


@needs_compiler
def test_a_whole_recordings_width_is_said_wherever_scores_are(tmp_path: Path) -> None:
    path = write_drive(tmp_path, N_FRAMES, **GEOMETRY, parameters=WHOLE)
    out, document = tmp_path / "out", tmp_path / "out.json"
    ran = done("run", path, "--no-figures", "--out", out, "--json", document)
    why = "line_geometry: not causal, the lane width and what the detector's flags and LRI mean"
    assert why in " ".join(ran.stdout.split())
    result = read_result(out)
    for said in (result.run, result.scores, json.loads(document.read_text())):
        assert said["is_causal"] is False
        assert said["causal"] == {"filter": True, "evidence": False}
        assert said["why_not_causal"][0].startswith(why)
    causal = "parameters.lane_width_m=causal"
    ran = done("run", path, "--no-figures", "--set", causal, "--out", tmp_path / "causal")
    assert "not causal" not in ran.stdout
    assert read_result(tmp_path / "causal").run["is_causal"] is True


@needs_compiler
def test_a_comparison_says_which_side_looks_ahead(tmp_path: Path) -> None:
    path = write_drive(tmp_path, N_FRAMES, **GEOMETRY, parameters=WHOLE)
    other = write_drive(tmp_path / "b", N_FRAMES, **GEOMETRY, name="causal")
    third = write_drive(tmp_path / "c", N_FRAMES, name="smoothed", filter="smoothed")
    target = tmp_path / "all.json"
    said = done("compare", path, other, third, "--json", target, "--out", tmp_path / "out").stdout
    below = said.splitlines()
    assert "causal: causal" in below
    assert "not causal (evidence): drive" in below
    assert "not causal (filter): smoothed" in below
    entries = [r["experiments"][0] for r in json.loads(target.read_text())["recordings"]]
    assert [e["is_causal"] for e in entries] == [False, True, False]
    assert [e["causal"]["evidence"] for e in entries] == [False, True, True]
    for entry in entries:
        saved = read_result(next((tmp_path / "out").glob(f"*/{entry['name']}")))
        for key in ("is_causal", "causal", "why_not_causal"):
            assert saved.run[key] == entry[key]


def test_a_rule_of_ones_own_says_that_it_looks_ahead(tmp_path: Path) -> None:
    path = write_drive(tmp_path, 60, evidence="./mine.py")
    (tmp_path / "mine.py").write_text(
        "from egolane_pgm.evidence.counting import PARAMETERS, PROVIDES, evidence\n"
        "def looks_ahead(parameters):\n"
        "    return 'its mean is that of the whole recording'\n"
    )
    ran = done("run", path, "--no-figures", "--out", tmp_path / "out")
    why = "./mine.py: not causal, its mean is that of the whole recording"
    assert why in " ".join(ran.stdout.split())
    assert read_result(tmp_path / "out").run["why_not_causal"] == [why]
