"""Health scores side by side: how well each experiment notices that the detector is wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from egolane_pgm.comparing.placing import load_for_scoring
from egolane_pgm.comparing.side import Side
from egolane_pgm.drive import Recorded, evidence_on
from egolane_pgm.experiment import Experiment
from egolane_pgm.scoring.health import DetectorErrors, doubt, roc_auc
from egolane_pgm.types import UNASSIGNED, BoolArray, FloatArray


def detector_answers(candidates: Sequence[Experiment], recorded: Recorded) -> FloatArray:
    """The tentative vector (K, n) in the annotated frames: by the first of the experiments whose
    evidence rule gives one, else by the default rule with its default parameters."""
    default = {
        key: Experiment.model_fields[key].default
        for key in ("evidence", "graph", "filter", "evidence_reading", "lag", "fit")
    }
    if candidates[0].follows_map:
        default["graph"] = "changing_lanes"
    fallback = candidates[0].model_copy(update={**default, "parameters": {}})
    for experiment in (*candidates, fallback):
        drive = load_for_scoring(experiment, recorded)
        tentative = evidence_on(drive, drive.model).tentative
        if tentative is not None:
            return tentative[recorded.scored]
    raise AssertionError("the default evidence rule gives a tentative vector")


def detector_health(errors: DetectorErrors, keep: BoolArray) -> dict[str, Any]:
    """The baseline that health scores are compared with: "the detector says Unassigned" as the
    score for "the detector is not right", over all non-crossing frames among those kept (K,).

    Keys: `frames` (non-crossing), `committed` (those with a lane), `wrong` (committed and wrong),
    `auc_unassigned`.
    """
    scored, committed = errors.is_scored & keep, errors.is_committed & keep
    return {
        "frames": int(scored.sum()),
        "committed": int(committed.sum()),
        "wrong": int((committed & errors.is_wrong).sum()),
        "auc_unassigned": roc_auc(errors.assigned[scored] == UNASSIGNED, errors.is_wrong[scored]),
    }


def model_health(side: Side, errors: DetectorErrors, keep: BoolArray) -> Mapping[str, Any]:
    """The areas under the ROC curve of an experiment's health scores for "the detector alone is
    wrong", over the kept frames (K,) in which it commits to a lane.

    Keys: `auc_doubt` (score: 1 - P(the detector's lane)), `auc_bad` (P(SensorState = BAD), None
    without that node), `auc_doubt_all` (doubt over all non-crossing frames; 1 where Unassigned).
    """
    committed, scored = errors.is_committed & keep, errors.is_scored & keep
    score = doubt(side.beliefs.lane, errors.assigned)
    wrong = errors.is_wrong
    return {
        "auc_doubt": roc_auc(score[committed], wrong[committed]),
        "auc_bad": None if side.bad is None else roc_auc(side.bad[committed], wrong[committed]),
        "auc_doubt_all": roc_auc(score[scored], wrong[scored]),
    }
