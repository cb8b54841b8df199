"""Running experiments: `run` and what it returns."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from egolane_pgm.api import shown
from egolane_pgm.api.given import path_of, several_of
from egolane_pgm.experiment import Experiment, Given, Overrides, load_experiment
from egolane_pgm.loading import Recorded, with_recording
from egolane_pgm.model import Model, prepare_model
from egolane_pgm.report.comparison_tables import trusted_or_all
from egolane_pgm.report.tables import runs_table_rows, score_rows, with_interval
from egolane_pgm.results import Result, read_result
from egolane_pgm.running import (
    Run,
    name_runs,
    plan_runs,
    result_of,
    run_all,
    run_experiment,
    save_result,
)
from egolane_pgm.tools.jobs import Jobs
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import Beliefs, Evidence, InputError, IntArray, LaneEvents

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False, eq=False)
class RunResult:
    """What an experiment believed, frame by frame.

    - experiment: with the frame rate that was counted with.
    - model: its graph and its evidence rule, compiled.
    - result: everything that its result directory says.
    - evidence: what was filtered, of T frames; None where the result was read from a directory.
    - recorded: the lines of T frames, and the ground truth of some; None likewise.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> run
    RunResult('quickstart': 300 frames, accuracy 0.877, detector 0.558; not tuned, causal)
    >>> run.scores["model"]["frames_scored"]
    260
    >>> run.events.to_pandas()[["time_s", "from_lane", "to_lane", "delay_s"]].round(1)
       time_s  from_lane  to_lane  delay_s
    0     3.7          4        3     -0.4
    1    10.5          3        2     -0.6
    2    18.5          2        1      NaN
    3    20.7          1        2      NaN
    >>> run.to_pandas()[["time_s", "Lane=1", "SensorState=OK", "true_lane"]].shape
    (300, 4)
    """

    experiment: Experiment
    model: Model
    result: Result
    evidence: Evidence | None = None
    recorded: Recorded | None = None

    @classmethod
    def of(cls, run: Run) -> RunResult:
        """The result of a run."""
        return cls(run.experiment, run.model, result_of(run), run.evidence, run.recorded)

    @property
    def name(self) -> str:
        """The name of the experiment."""
        return str(self.result.run["name"])

    @property
    def scores(self) -> dict[str, Any]:
        """What scores.json says: `model` and `detector` with every score, where there is ground
        truth, and how the parameters were tuned; see `egolane_pgm.results`."""
        return dict(self.result.scores)

    @property
    def notes(self) -> list[str]:
        """Warnings, a line each."""
        return list(self.result.run["warnings"])

    @property
    def beliefs(self) -> Beliefs:
        """The belief over the values of each hidden node, of T frames."""
        return self.result.beliefs

    @property
    def events(self) -> LaneEvents:
        """The lane changes that the beliefs tell of, see `egolane_pgm.inference.events`; with
        ground truth, how late each was told."""
        return self.result.events

    @property
    def assigned(self) -> IntArray:
        """(T,): the lane that is answered, from 1; 0 where there is no answer."""
        return self.result.assigned_lane

    def __len__(self) -> int:
        return len(self.result.frame_id)

    def __repr__(self) -> str:
        return f"RunResult({self._title()})"

    def _title(self) -> str:
        return title_of(self.result.run, self._scored())

    def _scored(self) -> dict[str, Any]:
        """The scores of the model, and of the detector alone where they are known."""
        scores = self.scores
        found: dict[str, Any] = {who: scores[who] for who in ("model", "detector") if who in scores}
        if "held_out" in scores:
            # A comparison scores what it held out, over several choices of frames.
            found["model"] = trusted_or_all(scores["held_out"]["scores"])
        return found

    def _repr_html_(self) -> str:
        header, rows = score_rows(self._scored())
        return shown.html_table(self._title(), header, rows if self._scored() else [], self.notes)

    def to_pandas(self) -> pd.DataFrame:
        """A row per frame; the index is `frame_id`.

        Columns: `time_s`, the belief in each value of a hidden node (`Lane=1`, `SensorState=OK`,
        ...), `crossing` (the probability that the car is on a line between two lanes, of graphs
        that have a RoadPosition), `assigned_lane` (0: no answer), the evidence rule's own answer
        (`detector=1`, ..., `detector_lane`) where it has one, `log_evidence`, `is_impossible`, and
        `true_lane` and `is_crossing`, missing where nobody annotated the frame.
        """
        import pandas as pd

        result = self.result
        names = {
            f"{node}_{value}": f"{node}={value}"
            for node, values in result.values.items()
            for value in values
        }
        names |= {f"detector_{k}": f"detector={k}" for k in range(1, result.n_lanes + 1)}
        columns: dict[str, Any] = {}
        for name, column in result.columns().items():
            if isinstance(column, np.ma.MaskedArray):
                kind = "boolean" if column.dtype == bool else "Int64"
                values = pd.array(column.data, dtype=kind)
                values[np.ma.getmaskarray(column)] = pd.NA
                columns[name] = values
            else:
                columns[names.get(name, name)] = column
        return pd.DataFrame(columns).set_index("frame_id")

    def to_xarray(self) -> xr.Dataset:
        """The same with an axis for each hidden node: `belief_Lane` (frame_id, Lane), ...

        Raises InputError where xarray is not installed.
        """
        result, xarray = self.result, shown.xarray()
        frame = self.to_pandas()
        flat = shown.as_dataset(frame[[name for name in frame if "=" not in name]])
        lanes = list(range(1, result.n_lanes + 1))
        for node, values in result.values.items():
            axis = lanes if node == "Lane" else list(values)
            belief = xarray.DataArray(
                result.marginals[node],
                dims=("frame_id", node),
                coords={"frame_id": result.frame_id, node: axis},
            )
            flat[f"belief_{node}"] = belief
        if result.tentative is not None:
            flat["detector"] = (("frame_id", "Lane"), result.tentative)
        flat.attrs["name"] = self.name
        return flat

    def plot(self, first: int | None = None, last: int | None = None) -> Figure:
        """Draw the beliefs over time as strips, the truth below.

        - first, last: frame ids, both included; the whole drive by default.

        Raises InputError for a range without frames.
        """
        from egolane_pgm.report.strips import strips_figure
        from egolane_pgm.report.style import inline_figure

        return inline_figure(lambda: strips_figure(self.result, first, last))

    def report(self, file: str | os.PathLike[str]) -> Path:
        """Write the page that `egolane report` writes: one HTML file with an interactive timeline.

        - file: its name; its folder is made.

        Raises InputError where it cannot be written. What the page lacks is warned of.

        >>> import tempfile
        >>> import egolane_pgm as ego
        >>> place = ego.experiments_folder() / "quickstart.yaml"
        >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     run.report(f"{folder}/page.html").name
        'page.html'
        """
        from egolane_pgm.report.page.document import write_page

        for line in write_page([self.result], Path(file)):
            warnings.warn(line, UserWarning, stacklevel=2)
        return Path(file)

    def save(self, directory: str | os.PathLike[str], *, figures: bool = True) -> Path:
        """Write the result directory that `egolane run --out` writes; `load_result` reads it.

        - figures: whether the belief over time is drawn in it; `egolane plot` draws more.

        An older result of that name is replaced; files of your own in it stay. Raises
        InputError where the directory holds anything else, or cannot be written.
        """
        draw = draw_belief if figures else None
        return save_result(self.result, self.experiment, self.model, Path(directory), draw)


def title_of(run: Mapping[str, Any], scored: Mapping[str, Mapping[str, Any]]) -> str:
    """A run in one line: what run.json says, and the scores of the model and of the detector."""
    parts = [f"{run['name']!r}: {run['frames']} frames"]
    for who, scores in scored.items():
        said = with_interval(scores["accuracy"], scores["intervals"]["accuracy"])
        parts.append(f"{'accuracy' if who == 'model' else who} {said}")
    if len(parts) == 1:
        parts.append("no ground truth")
    return f"{', '.join(parts)}; {shown.how_tuned(run)}"


@dataclass(frozen=True, repr=False, eq=False)
class RunResults(Sequence[RunResult]):
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
    RunResult('hard': 300 frames, accuracy 0.788, detector 0.558; not tuned, causal)
    >>> runs.to_pandas().index.names
    FrozenList(['name', 'frame_id'])
    """

    runs: tuple[RunResult, ...]
    failed: tuple[tuple[str, str], ...] = ()

    def __len__(self) -> int:
        return len(self.runs)

    @overload
    def __getitem__(self, key: int | str) -> RunResult: ...

    @overload
    def __getitem__(self, key: slice) -> RunResults: ...

    def __getitem__(self, key: int | str | slice) -> RunResult | RunResults:
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
        summaries = [{**run.result.run, **run.scores, **run._scored()} for run in self.runs]
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

        return inline_figure(lambda: dispersion_figure([run.result for run in self.runs]))

    def save(self, directory: str | os.PathLike[str], *, figures: bool = True) -> Path:
        """Write a result directory for each run into `directory`, by its name. Raises InputError
        where one cannot be written."""
        for run in self.runs:
            run.save(Path(directory) / run.name, figures=figures)
        return Path(directory)


def read_run(directory: Path) -> RunResult:
    """Read the result directory of a run. Raises InputError where it is damaged."""
    result = read_result(directory)
    experiment = load_experiment(directory / "experiment.yaml")
    return RunResult(experiment, prepare_model(experiment), result)


def draw_belief(result: Result, directory: Path) -> None:
    """Draw the belief over time into a result directory."""
    # matplotlib is imported only for figures.
    from egolane_pgm.report.strips import draw_strips

    draw_strips(result, directory / "figures" / "strips.png")


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
) -> RunResult: ...


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
) -> RunResult | RunResults:
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

    Returns a `RunResult`, or `RunResults` for a list. Raises InputError, one line, for whatever
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
        return RunResult.of(run_experiment(choose(experiment, overrides, given, *changes)))
    plan = plan_runs(name_all(several_of(experiment, "run"), overrides, recordings, *changes))
    done = run_all(plan, jobs=jobs, keep=True)
    outcomes = list(bar(done, progress, total=len(plan), unit="run"))
    failed = tuple((each.title, each.error) for each in outcomes if each.error is not None)
    runs = tuple(RunResult.of(each.run) for each in outcomes if each.run is not None)
    if not runs:
        raise InputError(f"{failed[0][0]}: {failed[0][1]}" if failed else "run: no experiment")
    for title, error in failed:
        warnings.warn(f"{title}: {error}", UserWarning, stacklevel=2)
    return RunResults(runs, failed)


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
