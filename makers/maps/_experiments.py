"""Experiments on simulated drives over maps, written to a folder, and what is needed to believe."""

from __future__ import annotations

from pathlib import Path

from egolane_pgm.drive import Recorded, load_recording
from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.maps.steps import LanesAlong
from egolane_pgm.model import Model, prepare_model, with_map
from egolane_pgm.verbs.simulate import simulate

COUNTING = {"graph": "changing_lanes", "evidence": "counting", "parameters.bonus_value": 7}
POSITIONS = {"graph": "position_in_changing_lanes", "evidence": "line_geometry"}


def simulated(
    folder: Path, seed: int, file: Path | None, is_mirrored: bool, **changes: float
) -> Experiment:
    simulate("interchange", seed=seed, out=folder, map=file, mirror=is_mirrored, overrides=changes)
    return load_experiment(folder / "experiment.yaml")


def prepared(experiment: Experiment) -> tuple[Model, Recorded, LanesAlong]:
    experiment = with_map(experiment)
    model = prepare_model(experiment)
    recorded = load_recording(experiment, model.parameters)
    assert recorded.road is not None
    return model, recorded, recorded.road
