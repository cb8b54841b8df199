"""Running an experiment on a recording of any length: `run_streamed` and what it returns."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from egolane_pgm.api import shown
from egolane_pgm.api.runs import choose, title_of
from egolane_pgm.experiment import Experiment, Given, Overrides
from egolane_pgm.report.tables import score_rows
from egolane_pgm.streaming import StreamedRun
from egolane_pgm.streaming import run_streamed as run_experiment
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import FloatArray, LaneEvents


@dataclass(frozen=True, repr=False, eq=False)
class StreamedResult:
    """What was said of a drive whose beliefs are in a result directory only.

    >>> import tempfile
    >>> from pathlib import Path
    >>> import egolane_pgm as ego
    >>> from egolane_pgm.recordings import write_lines
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> drive = ego.run(place, overrides={"recording.frames": [0, 90]}).recorded.log
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_lines(f"{folder}/long.parquet", drive)
    ...     done = ego.run_streamed(place, f"{folder}/out", recording=f"{folder}/long.parquet")
    ...     beliefs = ego.load_result(f"{folder}/out").beliefs
    >>> done
    StreamedResult('long': 90 frames, no ground truth; not tuned, causal)
    >>> beliefs
    Beliefs(90 frames, ids 0 to 89: Lane (4), SensorState (2))
    """

    done: StreamedRun

    @property
    def directory(self) -> Path:
        """Where the result is; `load_result` reads it, all of it at once."""
        return self.done.directory

    @property
    def experiment(self) -> Experiment:
        """What was run."""
        return self.done.experiment

    @property
    def scores(self) -> dict[str, Any]:
        """What scores.json says."""
        return dict(self.done.scores)

    @property
    def notes(self) -> list[str]:
        """Warnings, a line each; one of them says what a stream leaves out."""
        return list(self.done.run["warnings"])

    @property
    def events(self) -> LaneEvents:
        """The lane changes that the beliefs tell of; with ground truth, how late each was told."""
        return self.done.events

    @property
    def last(self) -> FloatArray:
        """(n,): the belief over lanes in the last frame."""
        return self.done.last

    def __len__(self) -> int:
        return int(self.done.run["frames"])

    def __repr__(self) -> str:
        return f"StreamedResult({title_of(self.done.run, self._scored())})"

    def _scored(self) -> dict[str, Any]:
        return {who: self.scores[who] for who in ("model", "detector") if who in self.scores}

    def _repr_html_(self) -> str:
        header, rows = score_rows(self._scored())
        title = title_of(self.done.run, self._scored())
        return shown.html_table(title, header, rows if self._scored() else [], self.notes)


def run_streamed(
    experiment: Given,
    out: str | os.PathLike[str],
    *,
    overrides: Overrides = (),
    recording: str | os.PathLike[str] | None = None,
    ground_truth: str | os.PathLike[str] | None = None,
    n_lanes: int | None = None,
    frame_id: str | None = None,
    progress: bool | None = None,
) -> StreamedResult:
    """Filter a recording of any length, a table or a bag, in constant memory: as `run`, with the
    same numbers, but part after part into a result directory.

    - experiment: an experiment, or the path of its YAML file.
    - out: the result directory. An older one is replaced; files of your own in it stay. There are
      no figures in it.
    - overrides, recording, ground_truth, n_lanes, frame_id: as in `run`.
    - progress: whether a bar counts the frames; None for in a terminal.

    Raises InputError, one line, for whatever does not fit, and for what needs the whole drive
    (smoothing, a lane width from the whole recording, a road table): it names the key. `out` then
    stays as it was.

    >>> import egolane_pgm as ego
    >>> try:
    ...     ego.run_streamed(ego.experiments_folder() / "quickstart.yaml", "out")
    ... except ego.InputError as error:
    ...     print(str(error).partition(": ")[2])
    recording.simulate: is not streamed; `egolane simulate` writes the lines to a file that is
    """
    chosen = choose(experiment, overrides, recording, ground_truth, n_lanes, frame_id)
    with bar(None, progress, unit="frame", unit_scale=True) as frames:
        return StreamedResult(run_experiment(chosen, Path(out), frames.update))
