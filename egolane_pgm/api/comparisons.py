"""Experiments side by side: `compare` and what it returns."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from egolane_pgm.api.given import several_of
from egolane_pgm.comparing import compare_graphs, compare_json
from egolane_pgm.comparing.document import parse_comparison
from egolane_pgm.comparing.graphs import with_graphs
from egolane_pgm.comparing.groups import (
    Group,
    Options,
    by_recording,
    compare_groups,
    document,
    graphs_on_runs,
    on_fleet,
    on_runs,
)
from egolane_pgm.comparing.lags import check_lags
from egolane_pgm.comparing.placing import recording_key
from egolane_pgm.comparing.saving import folder_of
from egolane_pgm.experiment import Given, Overrides, load_experiment
from egolane_pgm.fleet import FleetDrive, read_fleet
from egolane_pgm.paper import Runs, parse_runs
from egolane_pgm.report import shown
from egolane_pgm.report.comparison_tables import (
    accuracy_rows,
    experiment_names,
    lag_curves,
    lag_rows,
    marks_text,
)
from egolane_pgm.results import SCHEMA_VERSION, Result, read_files, read_result, staged, write_files
from egolane_pgm.tools.files import temporary_folder, write_json
from egolane_pgm.tools.jobs import Jobs
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError, not_one_of

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

#: The file of a comparison's directory that has the numbers: of all recordings, and of each one.
DOCUMENT = "comparison.json"

#: The graphs that are compared where none is named.
DEFAULT_GRAPHS = ("sensor_failure", "wor_on_lane", "no_wor", "lane_only")


@dataclass(frozen=True, repr=False, eq=False)
class CompareResult:
    """Experiments side by side, on one or several recordings.

    - document: what `egolane compare --json` writes.
    - files: a result directory for each recording and experiment, by the names of their files;
      empty for graphs with the paper's parameters.
    - stopped: the KeyboardInterrupt that ended it early; the command shows the recordings before.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> one = ego.load_experiment(place, {"recording.frames": [0, 400]})
    >>> other = ego.load_experiment(one, {"name": "exact", "filter": "exact"})
    >>> compared = ego.compare([one, other], blocks=2)
    >>> compared
    CompareResult(quickstart, exact on quickstart, seed 0; not tuned, causal)
    >>> compared["quickstart, seed 0", "exact"].to_pandas().shape[0]
    400
    """

    document: Mapping[str, Any]
    files: Mapping[str, bytes] = field(default_factory=dict, repr=False)
    stopped: KeyboardInterrupt | None = field(default=None, repr=False)

    @property
    def is_held_out(self) -> bool:
        """Whether frames were scored that the parameters have not seen; else the parameters are the
        paper's, in-sample."""
        return bool(self.document.get("held_out"))

    @property
    def names(self) -> list[str]:
        """The names of the experiments, or of the graphs."""
        return experiment_names(self._as_held_out())

    @property
    def recordings(self) -> list[str]:
        """The titles of the recordings."""
        return [str(recording["title"]) for recording in self._as_held_out()["recordings"]]

    def __getitem__(self, key: tuple[str, str]) -> Result:
        """What was believed held out: of a recording, by its title, under an experiment.

        Raises InputError where there is none.
        """
        title, name = key
        prefix = f"{folder_of(title)}/{name}/"
        files = {k.removeprefix(prefix): v for k, v in self.files.items() if k.startswith(prefix)}
        if not files:
            raise InputError(
                f"{title}, {name}: was not held out here; there are {', '.join(self.recordings)}"
                f" with {', '.join(self.names)}"
            )
        with temporary_folder() as folder:
            write_files(folder, files)
            return read_result(folder)

    def _as_held_out(self) -> Mapping[str, Any]:
        """The document in the form of those that hold something out."""
        if self.is_held_out:
            return self.document
        recordings = []
        for entry in self.document["runs"]:
            experiments = [
                {
                    "name": name,
                    "tuned_on": "not_tuned" if name == "detector" else "same_frames",
                    "scores": {"all_frames": scores},
                    "difference": None,
                }
                for name, scores in entry["scores"].items()
            ]
            recordings.append({"title": f"run {entry['run']}", "experiments": experiments})
        return {"recordings": recordings}

    def __repr__(self) -> str:
        return f"CompareResult({self._title()})"

    def _title(self) -> str:
        names = ", ".join(self.names[:6]) + ", ..." * (len(self.names) > 6)
        titles = self.recordings
        on = titles[0] if len(titles) == 1 else f"{len(titles)} recordings"
        return f"{names} on {on}; {self._how()}"

    def _how(self) -> str:
        if not self.is_held_out:
            return "the paper's parameters, in-sample"
        entries = [e for r in self.document["recordings"] for e in r["experiments"]]
        said = dict.fromkeys(shown.how_tuned(entry) for entry in entries)
        return " or ".join(said)

    def _repr_html_(self) -> str:
        document = self._as_held_out()
        header, rows = (lag_rows if lag_curves(document) else accuracy_rows)(document)
        found = self.document.get("failed", [])
        notes = [f"failed: {each['title']}: {each['error']}" for each in found]
        return shown.html_table(
            self._title(), header, rows, [*notes, *marks_text(document).splitlines()]
        )

    def to_pandas(self, table: str = "scores") -> pd.DataFrame:
        """A row per recording, experiment, subset of frames and score.

        Columns: `value`; `low` and `high` of its 95 % interval; `difference` to the first
        experiment of the recording, `difference_low`, `difference_high`; `tuned_on`.

        - table: "scores", or "lags" for how right beliefs are that wait: a row per recording,
          experiment, subset of frames and lag in seconds, with the columns `frames` waited for,
          `accuracy`, its `low` and `high`, `f1`, `log_loss` and `tuned_on`.

        Raises InputError for another table, and for lags where none was asked for.
        """
        import pandas as pd

        if table == "lags":
            return self._lags()
        if table != "scores":
            raise InputError(f"table: {not_one_of(table, ('scores', 'lags'))}")
        rows = [
            (recording["title"], entry["name"], subset, *row, entry["tuned_on"])
            for recording in self._as_held_out()["recordings"]
            for entry in recording["experiments"]
            for subset, scores in entry["scores"].items()
            for row in _score_rows(scores, (entry["difference"] or {}).get(subset) or {})
        ]
        index = ["recording", "experiment", "subset", "score"]
        values = ["value", "low", "high", "difference", "difference_low", "difference_high"]
        return pd.DataFrame(rows, columns=[*index, *values, "tuned_on"]).set_index(index)

    def _lags(self) -> pd.DataFrame:
        import pandas as pd

        rows = []
        for recording in self._as_held_out()["recordings"]:
            for entry in recording["experiments"]:
                for subset, found in (entry.get("lags") or {}).items():
                    intervals = (found["intervals"] or {}).get("accuracy")
                    for k, lag in enumerate(found["lag_s"]):
                        low, high = (intervals and intervals[k]) or (None, None)
                        scores = (found[name][k] for name in ("f1", "log_loss"))
                        row = (found["frames"][k], found["accuracy"][k], low, high, *scores)
                        place = (recording["title"], entry["name"], subset, lag)
                        rows.append((*place, *row, entry["tuned_on"]))
        if not rows:
            raise InputError(
                "table: 'lags' are of comparisons with lags, compare(..., lags=[0, 1])"
            )
        index = ["recording", "experiment", "subset", "lag_s"]
        columns = ["frames", "accuracy", "low", "high", "f1", "log_loss", "tuned_on"]
        return pd.DataFrame(rows, columns=[*index, *columns]).set_index(index)

    def to_xarray(self, table: str = "scores") -> xr.Dataset:
        """`to_pandas` as a data set. Raises InputError where xarray is not installed."""
        return shown.as_dataset(self.to_pandas(table))

    def plot(self, figure: str = "accuracy") -> Figure:
        """Draw the experiments on each recording, with their intervals.

        - figure: "accuracy"; "differences" for how it differs from the first experiment's; or
          "lags" for how it grows with the delay.

        Raises InputError for another figure, and for differences or lags that there are not.
        """
        from egolane_pgm.report import comparison_figures as figures
        from egolane_pgm.report.style import inline_figure

        makes = {
            "accuracy": figures.comparison_figure,
            "differences": figures.differences_figure,
            "lags": figures.lags_figure,
        }
        if figure not in makes:
            raise InputError(f"figure: {not_one_of(figure, list(makes))}")
        if figure == "differences" and not self.is_held_out:
            raise InputError("figure: 'differences' are of comparisons that hold something out")
        return inline_figure(lambda: makes[figure](self._as_held_out()))

    def save(self, directory: str | os.PathLike[str], *, figures: bool = True) -> Path:
        """Write the numbers, and a result directory for each recording and experiment, as
        `egolane compare --out` does; `load_result` reads them.

        - figures: whether accuracy, and that over lags, is drawn beside them.

        An older comparison of that name is replaced; files of your own in it stay. Raises
        InputError where the directory holds anything else, or cannot be written.
        """
        place = Path(directory)
        with staged(place, [is_comparison]) as folder:
            write_files(folder, self.files)
            write_json(folder / DOCUMENT, self.document)
            if figures:
                # matplotlib is imported only for figures.
                from egolane_pgm.report.comparison_figures import draw_comparison, draw_lags

                document = self._as_held_out()
                draw_comparison(document, folder / "figures" / "accuracy.png")
                if lag_curves(document):
                    draw_lags(document, folder / "figures" / "lags.png")
        return place


def _score_rows(
    scores: Mapping[str, Any], differences: Mapping[str, Sequence[float] | None]
) -> Iterator[tuple[Any, ...]]:
    """Per score its name, value, interval, difference and the interval of that."""
    nothing = (None, None, None)
    for name, value in {**scores, **_delays(scores)}.items():
        if isinstance(value, (int, float)):
            low, high = (scores.get("intervals") or {}).get(name) or (None, None)
            yield name, float(value), low, high, *(differences.get(name) or nothing)


def _delays(scores: Mapping[str, Any]) -> dict[str, Any]:
    return {f"delay_{name}": value for name, value in (scores.get("delay") or {}).items()}


def is_comparison(directory: Path) -> bool:
    """Whether the directory holds a comparison: of several recordings, or of one."""
    if (directory / DOCUMENT).is_file():
        return True
    return directory.is_dir() and any((child / DOCUMENT).is_file() for child in directory.iterdir())


def read_comparison(directory: Path) -> CompareResult:
    """Read the directory of a comparison. Raises InputError where it is damaged."""
    files = read_files(directory)
    if DOCUMENT in files:
        found = parse_comparison(files[DOCUMENT], directory / DOCUMENT)
        if "title" not in found:
            del files[DOCUMENT]
            return CompareResult(found, files)
        files = {f"{directory.name}/{file}": content for file, content in files.items()}
        directory = directory.parent
    parts = [
        parse_comparison(content, directory / file)
        for file, content in files.items()
        if file.endswith(f"/{DOCUMENT}")
    ]
    found = {
        "schema_version": SCHEMA_VERSION,
        "held_out": True,
        "blocks": parts[0]["blocks"],
        "recordings": [{k: v for k, v in p.items() if k != "schema_version"} for p in parts],
        "together": [],
        "failed": [],
    }
    return CompareResult(found, files)


def compare_recordings(
    groups: Sequence[Group], settings: Options, *, jobs: Jobs = 1, progress: bool | None = None
) -> CompareResult:
    """Compare the experiments of each recording held out.

    Raises InputError where no recording could be compared; Ctrl-C where none was.
    """

    def show(found: Iterator[Any], total: int) -> Iterable[Any]:
        shows: Iterable[Any] = bar(found, progress, desc="searching", total=total, unit="search")
        return shows

    done = compare_groups(groups, settings, jobs=jobs, show=show)
    compared: list[Any] = []
    stopped = None
    try:
        compared.extend(bar(done, progress, total=len(groups), unit="recording"))
    except KeyboardInterrupt as reason:
        # The recordings that were compared before the interruption are kept.
        if not compared:
            raise
        stopped = reason
    found = document(compared, settings)
    if not found["recordings"]:
        raise InputError(found["failed"][0]["error"])
    return CompareResult(found, stopped=stopped)


def compare_on_runs(
    graphs: Sequence[str], numbers: Sequence[int], which: str, *, progress: bool | None = None
) -> CompareResult:
    """Run graphs on the paper's runs with its parameters, in-sample."""
    shows = bar(numbers, progress, desc="runs", unit="run")
    compared = [compare_graphs(number, graphs, which) for number in shows]
    return CompareResult(compare_json(compared, which))


def compare(
    experiments: Given | Sequence[Given] = (),
    *,
    graphs: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | None = None,
    runs: Runs | None = None,
    held_out: bool = False,
    with_paper: bool = False,
    parameters: str = "recovered",
    health: bool = False,
    events: bool = False,
    lags: ArrayLike = (),
    blocks: int = 5,
    trials: int | None = None,
    trials_per_number: int | None = None,
    seeds: int | Sequence[int] = (),
    fleet: str | os.PathLike[str] | None = None,
    jobs: Jobs = 1,
    overrides: Overrides = (),
    out: str | os.PathLike[str] | None = None,
    progress: bool | None = None,
) -> CompareResult:
    """Put experiments side by side on frames that their parameters have not seen.

    - experiments: one, or a list; the `fit` of each says how its parameters are found. Each is on
      its own recording, or, with `runs`, on those of the paper's runs.
    - graphs: names or files of graphs, in a list or with commas: each experiment once with each of
      them. Without experiments: on the paper's runs, and with its parameters, in-sample, unless
      `held_out`.
    - runs: runs of the paper, e.g. "1-5,7", or numbers.
    - held_out: whether each graph is tuned without the block that is scored.
    - with_paper: whether the paper's model comes first, with `runs`.
    - parameters: of the paper's model, "recovered" or "published".
    - health: whether to score how well each tells that the detector is wrong.
    - events: whether to score the lane changes that each tells of.
    - lags: seconds; how right beliefs are that wait for later frames, for each of them. See
      `CompareResult.to_pandas("lags")`.
    - blocks: how many blocks are held out in turn.
    - trials: of each block's search (`fit: tune`).
    - trials_per_number: instead, trials for each number that is searched.
    - seeds: how many seeds each search has, or which.
    - fleet: a table of drives, on each of which the experiments are put, see `egolane_pgm.fleet`.
    - jobs: processes that share the work; or a Dask cluster, as `run_fleet` takes it.
    - overrides: keys of the YAMLs that get other values.
    - out: a folder in which the result directories are written as soon as they are done.
    - progress: whether a bar shows how far it is; None for in a terminal.

    Raises InputError for whatever does not fit. A recording that fails does not stop the others;
    it is in `document["failed"]`.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> one = ego.load_experiment(place, {"recording.frames": [0, 400]})
    >>> other = ego.load_experiment(one, {"name": "exact", "filter": "exact"})
    >>> compared = ego.compare([one, other], blocks=2)
    >>> compared.to_pandas()["value"].xs("f1", level="score").round(3).to_list()
    [0.728, 0.727]
    >>> late = ego.compare(one, blocks=2, lags=[0, 1]).to_pandas("lags")
    >>> late["accuracy"].round(3).to_list()
    [0.902, 0.911]
    """
    given = several_of(experiments, "compare")
    names = graph_names(graphs, bool(given))
    check_options(bool(given), runs, with_paper, trials, trials_per_number)
    drives = fleet_of(fleet, bool(given), runs)
    waits = check_lags(lags)
    if not given and not held_out:
        if waits:
            raise InputError("lags: go with experiments or with held_out")
        if events:
            raise InputError("events: go with experiments or with held_out")
        return compare_on_runs(names, parse_runs(runs or "1-10"), parameters, progress=progress)
    fit = "tune" if held_out else None
    numbers = parse_runs(runs) if runs else None
    groups = groups_of(given, names, fit, numbers, with_paper, parameters, overrides, drives)
    with temporary_folder() as temporary:
        folder = temporary if out is None else Path(out)
        searched = (trials_per_number, _seeds(seeds))
        settings = Options(blocks, trials, health, folder, *searched, events, waits)
        found = compare_recordings(groups, settings, jobs=jobs, progress=progress)
        if found.stopped is not None:
            raise found.stopped
        files = {
            f"{place}/{name}": content
            for place in map(folder_of, found.recordings)
            for name, content in read_files(folder / place).items()
        }
        return replace(found, files=files)


def fleet_of(
    fleet: str | os.PathLike[str] | None, has_experiments: bool, runs: Any
) -> tuple[FleetDrive, ...]:
    """The drives of `fleet`. Raises InputError for what does not go with one."""
    if fleet is None:
        return ()
    if not has_experiments or runs:
        raise InputError("--fleet: goes with experiments, without --runs")
    return read_fleet(os.fspath(fleet))


def _seeds(given: Any) -> tuple[int, ...]:
    if isinstance(given, int) and given > 0:
        return tuple(range(given))
    if isinstance(given, Sequence) and all(isinstance(seed, int) for seed in given):
        return tuple(dict.fromkeys(given))
    raise InputError(f"seeds: {given!r} is neither how many, 5, nor a list of which, [3, 7]")


def graph_names(graphs: Any, has_experiments: bool) -> list[str]:
    """The graphs that are named, in a list or with commas; without experiments by default some."""
    if isinstance(graphs, str):
        names = [name.strip() for name in graphs.split(",") if name.strip()]
    else:
        names = [os.fspath(graph) for graph in several_of(graphs, "graphs")]
    return names if names or has_experiments else list(DEFAULT_GRAPHS)


def check_options(
    has_experiments: bool,
    runs: Runs | None,
    with_paper: bool,
    trials: int | None,
    trials_per_number: int | None,
) -> None:
    """Raise InputError for arguments of `compare` that do not go together."""
    if with_paper and not (has_experiments and runs):
        raise InputError("--with-paper: goes with experiments and --runs")
    if trials and trials_per_number:
        raise InputError("--trials-per-number: goes instead of --trials, not with it")


def groups_of(
    experiments: Sequence[Given],
    graphs: Sequence[str],
    fit: str | None,
    numbers: Sequence[int] | None,
    with_paper: bool,
    which: str,
    overrides: Overrides,
    drives: Sequence[FleetDrive] = (),
) -> list[Group]:
    """The experiments that `compare` compares, by recording.

    - graphs: each experiment once with each of them; without experiments, on the paper's runs.
    - fit: of the experiments with these graphs, None for their own.
    - numbers: of the paper's runs; None for the experiments' own recordings.
    - which: the parameters of the paper's model.
    - drives: of a fleet, on each of which the experiments are put.
    """
    if not experiments:
        return graphs_on_runs(graphs, numbers or range(1, 11), "tune", overrides)
    models = [load_experiment(given, overrides) for given in experiments]
    if graphs:
        is_placed = numbers is not None or bool(drives)
        places = 1 if is_placed else len({recording_key(model) for model in models})
        models = with_graphs(models, graphs, fit=fit, is_shared=places < len(models))
    if drives:
        return on_fleet(models, drives, overrides)
    if numbers is None:
        return by_recording(models)
    return on_runs(models, numbers, with_paper=with_paper, which=which)
