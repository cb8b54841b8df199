"""Simulated drives as a source of lines: on a motorway of one of the presets, or over a map."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from egolane_pgm.experiment import INTERCHANGE, Experiment
from egolane_pgm.parameters import check_names
from egolane_pgm.recordings.source import Read, Source
from egolane_pgm.types import InputError, problems_in, suggestion

if TYPE_CHECKING:
    from egolane_pgm.maps.interchange import InterchangeDrive
    from egolane_pgm.maps.road_table import RoadTable


@dataclass(frozen=True)
class Simulated(Source):
    """A drive of one of the presets."""

    experiment: Experiment

    def check(self) -> None:
        from egolane_pgm.simulation.presets import PRESETS

        experiment, name = self.experiment, str(self.experiment.recording.simulate)
        presets = (*PRESETS, INTERCHANGE)
        if experiment.recording.detector is not None:
            raise InputError(
                f"{experiment.source}: recording.simulate: does not go with a detector, which looks"
                " at a video or pictures (recording.path)"
            )
        if name not in presets:
            raise InputError(
                f"{experiment.source}: recording.simulate: unknown preset"
                f" '{name}'{suggestion(name, presets)}"
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


@dataclass(frozen=True)
class OverMap(Simulated):
    """A drive through interchanges, which brings its road table; see `maps.interchange`."""

    def read(self) -> Read:
        self.check()
        trip = self._trip()
        return Read(trip.log, trip.truth)

    def road(self) -> RoadTable:
        """The road table that the drive brings."""
        return self._trip().road

    def _trip(self) -> InterchangeDrive:
        from egolane_pgm.maps.interchange import Journey, simulate_interchange

        recording = self.experiment.recording
        known, where = [f.name for f in fields(Journey)], f"{self.experiment.source}: recording"
        check_names(known, recording.options, f"{where}.options")
        return simulate_interchange(recording.seed, None, Journey(**recording.options))
