"""Learning from several recordings together, by a rule that can, and the prior that allows none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.drive import Drive, load_drive
from egolane_pgm.evidence import line_geometry
from egolane_pgm.experiment import load_experiment
from egolane_pgm.learning import fit, fit_pooled, with_found
from egolane_pgm.recordings.table import write_table
from egolane_pgm.types import InputError
from tests.conftest import needs_compiler
from tests.kits.drives import short_drive, write_drive, write_experiment

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*no frame to learn from:UserWarning"),
    needs_compiler,
]
N_FRAMES = 700
SMALL = {"cells": 4, "motion_bins": 9}

GEOMETRY: dict[str, Any] = {
    "evidence": "line_geometry",
    "graph": "position_in_lane",
    "filter": "exact",
    "parameters": SMALL,
}


def loaded(path: Path) -> Drive:
    return load_drive(load_experiment(path), needs_truth="what is learned has labels")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    return loaded(write_drive(tmp_path_factory.mktemp("drive"), N_FRAMES, **GEOMETRY))


def test_pooled_parts_of_a_recording_come_to_the_whole(drive: Drive) -> None:
    parts = np.array_split(np.arange(len(drive)), 2)
    whole = fit(drive, np.arange(len(drive)))
    pooled = fit_pooled([drive, drive], parts)
    for name, value in whole.items():
        np.testing.assert_allclose(np.asarray(pooled[name]), np.asarray(value), rtol=1e-6)


def test_detectors_with_other_metres_are_pooled_in_lane_widths(tmp_path: Path) -> None:
    """The same drive, of which another detector reports longer metres and sees 7 frames less."""
    first = loaded(write_drive(tmp_path, N_FRAMES, **GEOMETRY))
    log = short_drive(N_FRAMES).log.take(slice(7, None))
    write_table(tmp_path / "other.csv", replace(log, offset_m=log.offset_m * 1.1))
    keys = {**GEOMETRY, "recording": {"path": "other.csv"}}
    drives = [first, loaded(write_experiment(tmp_path / "other.yaml", **keys))]
    train = [np.arange(len(each)) for each in drives]
    alone, pooled = fit_pooled(drives[:1], train[:1]), fit_pooled(drives, train)
    assert pooled["fallback_width_m"] == alone["fallback_width_m"]
    np.testing.assert_allclose(np.asarray(pooled["sigmas_m"]), alone["sigmas_m"], atol=0.02)


def test_recordings_are_pooled_from_the_first_guess_whatever_was_learned_before(
    drive: Drive,
) -> None:
    """Else what is held out would be known by way of the parameters given."""
    train = [np.arange(300)] * 2
    found = fit_pooled([drive, drive], train)
    again = replace(drive, model=with_found(drive.model, found, drive.experiment))
    assert dict(fit_pooled([again, again], train)) == dict(found)


def test_a_rule_that_learns_from_one_recording_cannot_be_pooled(
    drive: Drive, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(line_geometry, "fit_pooled")
    with pytest.raises(InputError, match="it has no fit_pooled"):
        fit_pooled([drive, drive], [np.arange(9)] * 2)


def test_nothing_is_learned_where_the_prior_is_infinite(tmp_path: Path) -> None:
    parameters = {**SMALL, "prior_frames": "infinite", "sigmas_m": [0.1] * 6}
    drive = loaded(write_drive(tmp_path, 300, **{**GEOMETRY, "parameters": parameters}))
    found = fit(drive, np.arange(len(drive)))
    # What the experiment has learned before may be from frames that are scored.
    assert set(found) == set(line_geometry.LEARNED)
    assert found["rates"] == found["sigmas_m"] == "generic"
