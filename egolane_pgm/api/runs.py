"""Running experiments: `run` and what it returns."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from egolane_pgm.api.given import path_of, several_of
from egolane_pgm.drive import with_recording
from egolane_pgm.experiment import Experiment, Given, Overrides, load_experiment
from egolane_pgm.report import shown
from egolane_pgm.report.tables import runs_table_rows
from egolane_pgm.results import Result
from egolane_pgm.running import name_runs, plan_runs, run_all, run_experiment, run_in_parts
from egolane_pgm.tools.jobs import Jobs
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False, eq=False)
class RunResults(Sequence[Result]):
    """Several runs, by number or by name.

    - runs: in the order in which they were given.
    - failed: of each experiment that failed its title, and why.

    >>> import egolane_pgm as ego
    >>> short = {"recording.frames": [0, 300]}
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> one = ego.load_experiment(place, short)
    >>> other = ego.load_experiment(one, {"name": "hard", "evidence_reading": "hard"})
    >>> runs = ego.run([one, other])
    >>> runs
    RunResults('quickstart', 'hard')
    >>> runs["hard"]
    Result('hard': 300 frames, accuracy 0.788, detector 0.558; not tuned, causal)
    >>> runs.to_pandas().index.names
    FrozenList(['name', 'frame_id'])
    """

    runs: tuple[Result, ...]
    failed: tuple[tuple[str, str], ...] = ()

    def __len__(self) -> int:
        return len(self.runs)

    @overload
    def __getitem__(self, key: int | str) -> Result: ...

    @overload
    def __getitem__(self, key: slice) -> RunResults: ...

    def __getitem__(self, key: int | str | slice) -> Result | RunResults:
        if isinstance(key, slice):
            return RunResults(self.runs[key])
        if isinstance(key, str):
            found = [run for run in self.runs if run.name == key]
            if not found:
                names = ", ".join(run.name for run in self.runs)
                raise InputError(f"no run has the name {key!r} (there are: {names})")
            return found[0]
        return self.runs[key]

    def __repr__(self) -> str:
        names = [repr(run.name) for run in self.runs[:5]] + ["..."] * (len(self.runs) > 5)
        failed = f"; {len(self.failed)} failed" if self.failed else ""
        return f"RunResults({', '.join(names)}{failed})"

    def _repr_html_(self) -> str:
        # What a comparison held out has its scores in another place.
        summaries = [{**run.run, **run.scores, **shown.scored(run)} for run in self.runs]
        header, rows = runs_table_rows(summaries)
        notes = [f"failed: {title}: {error}" for title, error in self.failed]
        return shown.html_table(repr(self), header, rows, notes)

    def to_pandas(self) -> pd.DataFrame:
        """The frames of all runs, below each other; the index is `name` and `frame_id`."""
        import pandas as pd

        return pd.concat({run.name: run.to_pandas() for run in self.runs}, names=["name"])

    def to_xarray(self) -> xr.Dataset:
        """`to_pandas` as a data set. Raises InputError where xarray is not installed."""
        return shown.as_dataset(self.to_pandas())

    def plot(self) -> Figure:
        """Draw how far off the answers of each run are.

        Raises InputError for a run without ground truth.
        """
        from egolane_pgm.report.dispersion import dispersion_figure
        from egolane_pgm.report.style import inline_figure

        return inline_figure(lambda: dispersion_figure(self.runs))

    def save(self, directory: str | os.PathLike[str], *, figures: bool = True) -> Path:
        """Write a result directory for each run into `directory`, by its name. Raises InputError
        where one cannot be written."""
        for run in self.runs:
            run.save(Path(directory) / run.name, figures=figures)
        return Path(directory)


Several = list[Given] | tuple[Given, ...]


@overload
def run(  # type: ignore[overload-overlap]
    experiment: Given,
    *,
    overrides: Overrides = (),
    recording: str | os.PathLike[str] | None = None,
    ground_truth: str | os.PathLike[str] | None = None,
    n_lanes: int | None = None,
    camera: str | os.PathLike[str] | None = None,
    detector: str | os.PathLike[str] | None = None,
    frame_id: str | None = None,
    jobs: Jobs = 1,
    progress: bool | None = None,
) -> Result: ...


@overload
def run(
    experiment: Given | Several,
    *,
    overrides: Overrides = (),
    recording: Any = None,
    ground_truth: str | os.PathLike[str] | None = None,
    n_lanes: int | None = None,
    camera: str | os.PathLike[str] | None = None,
    detector: str | os.PathLike[str] | None = None,
    frame_id: str | None = None,
    jobs: Jobs = 1,
    progress: bool | None = None,
) -> RunResults: ...


def run(
    experiment: Given | Several,
    *,
    overrides: Overrides = (),
    recording: Any = None,
    ground_truth: str | os.PathLike[str] | None = None,
    n_lanes: int | None = None,
    camera: str | os.PathLike[str] | None = None,
    detector: str | os.PathLike[str] | None = None,
    frame_id: str | None = None,
    jobs: Jobs = 1,
    progress: bool | None = None,
) -> Result | RunResults:
    """Filter a recording, and score it where there is ground truth.

    - experiment: an experiment, the path of its YAML file, or a list of several.
    - overrides: keys of the YAML that get other values, as `load_experiment` takes them.
    - recording: runs on this file instead; a list: on each of them.
    - ground_truth: the annotation of the recording, a file or "none".
    - n_lanes: lanes of its road.
    - camera, detector: of a video or of pictures.
    - frame_id: which number of a bag's messages is the frame id, "way_id" or "seq"; or "count",
      their order.
    - jobs: processes that share several runs.
    - progress: whether a bar shows how far several runs are; None for in a terminal.

    Returns a `Result`, or `RunResults` for a list. Raises InputError, one line, for whatever
    does not fit; of several runs, one that fails does not stop the others, and is warned of.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300], "parameters.sigma1": 0.3})
    >>> frame = run.to_pandas()
    >>> int(frame["Lane=2"].idxmax()) in frame.index
    True
    >>> figure = run.plot()
    """
    changes = (ground_truth, n_lanes, frame_id, camera, detector)
    recordings = several_of(recording, "recording")
    if not isinstance(experiment, (list, tuple)) and not isinstance(recording, (list, tuple)):
        given = recordings[0] if recordings else None
        return run_experiment(choose(experiment, overrides, given, *changes))
    plan = plan_runs(name_all(several_of(experiment, "run"), overrides, recordings, *changes))
    done = run_all(plan, jobs=jobs, keep=True)
    outcomes = list(bar(done, progress, total=len(plan), unit="run"))
    failed = tuple((each.title, each.error) for each in outcomes if each.error is not None)
    runs = tuple(each.result for each in outcomes if each.result is not None)
    if not runs:
        raise InputError(f"{failed[0][0]}: {failed[0][1]}" if failed else "run: no experiment")
    for title, error in failed:
        warnings.warn(f"{title}: {error}", UserWarning, stacklevel=2)
    return RunResults(runs, failed)


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
) -> Result:
    """Filter a long drive: as `run`, with the same numbers, but part after part into a result
    directory, so that the beliefs are never all in memory.

    - experiment: an experiment, or the path of its YAML file.
    - out: the result directory. An older one is replaced; files of your own in it stay. There are
      no figures in it.
    - overrides, recording, ground_truth, n_lanes, frame_id: as in `run`.
    - progress: whether a bar counts the frames; None for in a terminal.

    Returns the result with the belief over lanes; `load_result` reads those over all nodes. Raises
    InputError, one line, for whatever does not fit, and for what needs the whole drive (smoothing,
    a lane width from the whole recording, a road table): it names the key. `out` then stays as it
    was.

    >>> import tempfile
    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     done = ego.run_streamed(place, folder, overrides={"recording.frames": [0, 90]})
    ...     beliefs = ego.load_result(folder).beliefs
    >>> done.beliefs
    Beliefs(90 frames, ids 0 to 89: Lane (4))
    >>> beliefs
    Beliefs(90 frames, ids 0 to 89: Lane (4), SensorState (2))
    """
    chosen = choose(experiment, overrides, recording, ground_truth, n_lanes, frame_id)
    with bar(None, progress, unit="frame", unit_scale=True) as frames:
        return run_in_parts(chosen, Path(out), frames.update)


def choose(
    given: Given,
    overrides: Overrides = (),
    recording: Any = None,
    ground_truth: Any = None,
    n_lanes: int | None = None,
    frame_id: str | None = None,
    camera: Any = None,
    detector: Any = None,
    *,
    name: str | None = None,
) -> Experiment:
    """The experiment that the arguments of `run` mean.

    - name: the name of the run, in which `*` stands for that of the experiment.
    """
    found = load_experiment(given, overrides)
    changes = (recording, ground_truth, n_lanes, frame_id, camera, detector)
    chosen = found
    if changes != (None,) * 6:
        files = (recording, ground_truth, camera, detector)
        names = ("recording", "ground_truth", "camera", "detector")
        recording, ground_truth, camera, detector = (
            None if file is None else path_of(file, name)
            for name, file in zip(names, files, strict=True)
        )
        changes = (recording, ground_truth, n_lanes, frame_id, camera, detector)
        chosen = with_recording(found, *changes, overrides=overrides)
    if name is None:
        return chosen
    return chosen.model_copy(update={"name": name.replace("*", found.name)})


def name_all(
    experiments: Sequence[Given], overrides: Overrides, recordings: Sequence[Any], *changes: Any
) -> list[tuple[str, Callable[[], Experiment]]]:
    """The title of each of several runs, and a function that loads its experiment.

    - changes: arguments of `choose` from `ground_truth` to `detector`.

    Raises InputError for several recordings and several experiments, or one ground truth for them,
    and for a recording that is named twice.
    """
    if len(recordings) > 1 and (len(experiments) > 1 or changes[0] not in (None, "none")):
        raise InputError(
            "run: several --recording go with one experiment and no --ground-truth; write one"
            " experiment per recording that has its own"
        )
    return [
        (title, partial(choose, given, overrides, recording, *changes, name=name))
        for title, given, recording, name in _named(experiments, recordings)
    ]


def _named(
    experiments: Sequence[Given], recordings: Sequence[Any]
) -> Iterator[tuple[str, Given, str | None, str | None]]:
    titles = [
        given.source
        if isinstance(given, Experiment)
        else str(given.get("name", "experiment") if isinstance(given, Mapping) else given)
        for given in experiments
    ]
    for k, (title, _, recording, name) in enumerate(name_runs(titles, recordings)):
        yield title, experiments[k if len(experiments) > 1 else 0], recording, name
