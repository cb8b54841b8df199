"""Simulated drives as a source of lines: on a motorway of one of the presets."""

from __future__ import annotations

from dataclasses import dataclass

from egolane_pgm.experiment import Experiment
from egolane_pgm.recordings.source import Read, Source
from egolane_pgm.types import InputError, problems_in, suggestion


@dataclass(frozen=True)
class Simulated(Source):
    """A drive of one of the presets."""

    experiment: Experiment

    def check(self) -> None:
        from egolane_pgm.simulation.presets import PRESETS

        experiment, name = self.experiment, str(self.experiment.recording.simulate)
        if experiment.recording.detector is not None:
            raise InputError(
                f"{experiment.source}: recording.simulate: does not go with a detector, which looks"
                " at a video or pictures (recording.path)"
            )
        if name not in PRESETS:
            raise InputError(
                f"{experiment.source}: recording.simulate: unknown preset"
                f" '{name}'{suggestion(name, PRESETS)}"
            )

    def read(self) -> Read:
        from egolane_pgm.simulation.presets import simulate

        self.check()
        recording = self.experiment.recording
        with problems_in(f"{self.experiment.source}: recording"):
            drive = simulate(
                str(recording.simulate), seed=recording.seed, n_lanes=self.experiment.n_lanes
            )
        return Read(drive.log, drive.truth)

    def key(self) -> str:
        recording = self.experiment.recording
        return repr((recording.simulate, recording.seed, self.experiment.n_lanes))
