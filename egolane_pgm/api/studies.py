"""Searching parameters: `tune` and what it returns."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from egolane_pgm.api.fleets import experiments_of
from egolane_pgm.api.given import keys_of, several_of
from egolane_pgm.comparing.placing import parts_of_fleet
from egolane_pgm.drive import as_name
from egolane_pgm.experiment import (
    Experiment,
    Given,
    Overrides,
    Tuning,
    load_experiment,
    make_experiment,
)
from egolane_pgm.fleet import drives_of
from egolane_pgm.paper import Runs, parse_runs
from egolane_pgm.report import shown
from egolane_pgm.report.study_tables import legend, parameter_rows, score_rows
from egolane_pgm.report.study_trials import (
    TRIALS_FILE,
    Trials,
    is_study,
    read_document,
    read_trials,
    trials_of,
)
from egolane_pgm.results import read_files, staged, write_files
from egolane_pgm.tools.files import read_parquet, temporary_folder, without_version
from egolane_pgm.tools.jobs import Jobs
from egolane_pgm.tools.progress import bar
from egolane_pgm.tools.yaml import parse_yaml
from egolane_pgm.tuning import pictures as on_pictures
from egolane_pgm.tuning import plan as planning
from egolane_pgm.tuning import study as studies
from egolane_pgm.types import InputError, not_one_of

T = TypeVar("T")

#: What is searched on: recordings, or labelled pictures.
AnyPlan = planning.Plan | planning.PicturePlan
Search = studies.Search | on_pictures.PictureSearch

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False, eq=False)
class TuneResult:
    """One or several searches: every trial, the best parameters, and what they are worth held out.

    - documents: per study the content of its study.json.
    - files: per study the other files of its directory, by name.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> experiment = ego.load_experiment(place, {"recording.frames": [0, 200]})
    >>> tuned = ego.tune(experiment, trials=4, sampler="random", in_sample_only=True)
    >>> tuned
    TuneResult('quickstart': 4 trials, accuracy 0.969 in-sample)
    >>> sorted(tuned.best)[:2]
    ['bonus_value', 'p1']
    >>> len(tuned.to_pandas())
    4
    """

    documents: tuple[Mapping[str, Any], ...]
    files: Mapping[str, Mapping[str, bytes]] = field(repr=False)

    @property
    def names(self) -> list[str]:
        """The names of the studies."""
        return [str(document["name"]) for document in self.documents]

    def __len__(self) -> int:
        return len(self.documents)

    def __getitem__(self, key: int | str) -> TuneResult:
        """One of several studies, by number or by name."""
        if isinstance(key, str):
            if key not in self.names:
                raise InputError(f"no study has the name {key!r} (there are: {self._names()})")
            key = self.names.index(key)
        document = self.documents[key]
        return TuneResult((document,), {document["name"]: self.files[document["name"]]})

    def _names(self) -> str:
        return ", ".join(self.names)

    def _one(self) -> Mapping[str, Any]:
        if len(self.documents) != 1:
            raise InputError(f"there are {len(self)} studies, take one: result[{self.names[0]!r}]")
        return self.documents[0]

    @property
    def best(self) -> dict[str, Any]:
        """What the best trial has for each number that was searched. Raises InputError for several
        studies."""
        return dict(self._one()["best"]["point"])

    @property
    def experiments(self) -> dict[str, Experiment]:
        """The experiments with the best parameters, by name; of several studies all."""
        found = {}
        for name, files in self.files.items():
            for file, content in files.items():
                if file.startswith("best") and file.endswith(".yaml"):
                    source = f"{name}/{file}"
                    keys = without_version(parse_yaml(content.decode(), source), source)
                    experiment = make_experiment(keys, Path.cwd(), source)
                    found[experiment.name] = experiment
        return found

    def __repr__(self) -> str:
        return f"TuneResult({self._title()})"

    def _title(self) -> str:
        if len(self) > 1:
            return ", ".join(map(repr, self.names[:5])) + ", ..." * (len(self) > 5)
        document = self.documents[0]
        score, best = next(iter(document["best"]["values"].items()))
        said = [f"{document['best']['trials']} trials, {score} {best:.3f} in-sample"]
        if document["held_out"] is not None:
            held_out = document["held_out"]["all_frames"]
            if score in held_out:
                said.append(f"{held_out[score]:.3f} held out")
        return f"{document['name']!r}: {', '.join(said)}"

    def _repr_html_(self) -> str:
        table = score_rows(self.documents[0]) if len(self) == 1 else parameter_rows(self.documents)
        notes = dict.fromkeys(note for document in self.documents for note in document["notes"])
        return shown.html_table(self._title(), *table, [*notes, legend(self.documents)])

    def to_pandas(self) -> pd.DataFrame:
        """A row per trial; the index is `study` and `number`.

        Columns: `state`, `<score>_in_sample`, and one for each number that was searched.
        """
        import pandas as pd

        frames = {name: pd.DataFrame(self._table(name)) for name in self.names}
        return (
            pd.concat(frames, names=["study", None])
            .reset_index(level=1, drop=True)
            .set_index("number", append=True)
        )

    def _table(self, name: str) -> dict[str, list[Any]]:
        table = read_parquet(Path(name, TRIALS_FILE), self.files[name][TRIALS_FILE])
        found: dict[str, list[Any]] = table.to_pydict()
        return found

    def to_xarray(self) -> xr.Dataset:
        """`to_pandas` as a data set. Raises InputError where xarray is not installed."""
        return shown.as_dataset(self.to_pandas())

    def trials(self) -> Trials:
        """The finished trials as arrays. Raises InputError for several studies."""
        document = self._one()
        return trials_of(document, self._table(document["name"]), document["name"])

    def plot(self, figure: str = "history") -> Figure:
        """Draw a figure of the study.

        - figure: "history", "slices", "flatness", and, where there are trials enough,
          "importances" and "pairs".

        Raises InputError for another one, and for several studies: `result[name].plot()`.
        """
        from egolane_pgm.report.study_figures import figures_of
        from egolane_pgm.report.study_trials import quiet
        from egolane_pgm.report.style import inline_figure

        makes = figures_of(self.trials())
        if figure not in makes:
            raise InputError(f"figure: {not_one_of(figure, list(makes))}")
        with quiet():
            return inline_figure(makes[figure])

    def save(self, directory: str | os.PathLike[str], *, figures: bool = True) -> Path:
        """Write the directory of the study; of several, one by each name into `directory`.

        - figures: whether figures are drawn in it.

        An older study of that name is replaced; files of your own in it stay. Raises
        InputError where the directory holds anything else, or cannot be written.
        """
        place = Path(directory)
        for name in self.names:
            target = place if len(self) == 1 else place / name
            with staged(target, [is_study]) as folder:
                write_files(folder, self.files[name])
                if figures:
                    _draw(folder)
        return place


def read_study(directory: Path) -> TuneResult:
    """Read the directory of a study. Raises InputError where it is damaged."""
    read_trials(directory)
    document = read_document(directory)
    return TuneResult((document,), {document["name"]: read_files(directory)})


def _draw(directory: Path) -> None:
    # matplotlib is imported only for figures.
    from egolane_pgm.report.study_figures import draw_study

    draw_study(directory)


def tune(
    experiments: Given | Sequence[Given] = (),
    *,
    runs: Runs | None = None,
    trials: int | None = None,
    objective: str | Sequence[str] = (),
    sampler: str | None = None,
    seed: int | None = None,
    from_scratch: bool = False,
    parameter: Mapping[str, Any] | None = None,
    blocks: int | None = None,
    whole_recordings: bool = False,
    test_on: Given | None = None,
    in_sample_only: bool = False,
    together: bool = False,
    fleet: str | os.PathLike[str] | None = None,
    by_tag: str | None = None,
    out: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    jobs: Jobs = 1,
    storage: str | None = None,
    overrides: Overrides = (),
    progress: bool | None = None,
) -> TuneResult:
    """Search parameters; tell what they are worth on frames that they have not seen.

    - experiments: one, or a list: experiments, or paths of experiments and of tuning files.
    - runs: instead, runs of the paper, e.g. "1-10", or numbers.
    - trials: the total of a study.
    - objective: a score by name; several for a Pareto front.
    - sampler: "evolution", "tpe", "cma-es", "random"; "nsga2" for several objectives.
    - seed: of the sampler.
    - from_scratch: whether the known values are not tried first.
    - parameter: ranges and values by name, `{"p1": [0.5, 1], "p2": 0.9}`: to narrow or to fix.
    - blocks: how many blocks are held out in turn.
    - whole_recordings: whether each recording is held out in turn instead.
    - test_on: an experiment that takes no part, and is scored with what is found.
    - in_sample_only: whether nothing is held out.
    - together: whether all the experiments get one parameter set.
    - fleet: a table of drives, see `egolane_pgm.fleet`, for all of which one parameter set is
      searched; all their frames count alike, and `blocks` parts of the drives are held out in turn.
    - by_tag: of a fleet: instead, the drives with each value of this tag.
    - out: a folder for the directory of each study. The same call goes on there where it was
      stopped; without it the trials of a search that is stopped are lost.
    - workers: processes that share the trials of one study.
    - jobs: processes that share the studies.
    - storage: URL of a database that machines share.
    - overrides: keys of the YAML that get other values.
    - progress: whether a bar shows how far it is; None for in a terminal.

    Raises InputError for whatever does not fit, before anything is searched.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> experiment = ego.load_experiment(place, {"recording.frames": [0, 200]})
    >>> only = {"sigma1": [0.2, 0.5], "bonus_value": 3}
    >>> tuned = ego.tune(experiment, trials=3, in_sample_only=True, parameter=only)
    >>> "bonus_value" in tuned.best
    False
    """
    with temporary_folder() as temporary:
        searches = prepare_searches(
            experiments,
            folder=temporary if out is None else Path(out),
            runs=runs,
            trials=trials,
            objective=objective,
            sampler=sampler,
            seed=seed,
            from_scratch=from_scratch,
            parameter=parameter,
            blocks=blocks,
            whole_recordings=whole_recordings,
            test_on=test_on,
            in_sample_only=in_sample_only,
            together=together,
            fleet=fleet,
            by_tag=by_tag,
            workers=workers,
            jobs=jobs if workers is None else None,
            storage=storage,
            overrides=overrides,
        )
        documents = search_all(searches, jobs=jobs, workers=workers, progress=progress)
        files = {made.directory.name: read_files(made.directory) for made in searches}
        return TuneResult(tuple(documents), files)


def prepare_searches(
    experiments: Given | Sequence[Given],
    *,
    folder: Path,
    runs: Runs | None = None,
    trials: int | None = None,
    objective: str | Sequence[str] = (),
    sampler: str | None = None,
    seed: int | None = None,
    from_scratch: bool = False,
    parameter: Mapping[str, Any] | None = None,
    blocks: int | None = None,
    whole_recordings: bool = False,
    test_on: Given | None = None,
    in_sample_only: bool = False,
    together: bool = False,
    fleet: str | os.PathLike[str] | None = None,
    by_tag: str | None = None,
    workers: int | None = None,
    jobs: Jobs | None = None,
    storage: str | None = None,
    overrides: Overrides = (),
) -> list[Search]:
    """Read the recordings of the searches that the arguments of `tune` mean, and check everything.

    - folder: of the studies' directories.
    """
    if in_sample_only and (whole_recordings or blocks is not None):
        raise InputError("--in-sample-only: goes with neither --blocks nor --whole-recordings")
    if whole_recordings and blocks is not None:
        raise InputError("--whole-recordings: a recording is the block, leave --blocks away")
    if workers is not None and jobs is not None:
        raise InputError("--workers: shares one study, --jobs several; take one of the two")
    changed = {
        "trials": trials,
        "objective": (objective,) if isinstance(objective, str) else tuple(objective) or None,
        "sampler": sampler,
        "seed": seed,
        "blocks": blocks,
        "from_scratch": from_scratch or None,
        "parameters": keys_of(parameter, "parameter", "{'p1': [0.5, 1], 'p2': 0.9}"),
    }
    given = several_of(experiments, "tune")
    plans = [planning.with_options(p, changed) for p in _plans(given, runs, overrides)]
    if fleet is not None:
        if runs or together or whole_recordings:
            raise InputError(
                "--fleet: its drives are tuned together, and held out whole; leave away --runs,"
                " --together and --whole-recordings"
            )
        plans = [_on_fleet(p, fleet, by_tag, overrides) for p in _of_recordings(plans, "--fleet")]
    elif by_tag is not None:
        raise InputError("--by-tag: goes with --fleet")
    if together:
        plans = [planning.together(_of_recordings(plans, "--together"))]
    held_out = "none" if in_sample_only else "recordings" if whole_recordings else "blocks"
    test = None if test_on is None else _plan(test_on, ())
    _check_names(plans)
    if workers is not None:
        _of_recordings(plans, "--workers")
    made: list[Search] = []
    for plan in plans:
        place = folder / plan.name
        if isinstance(plan, planning.PicturePlan):
            seen = _alike(test, planning.PicturePlan)
            made.append(on_pictures.prepare(plan, place, held_out, seen, storage))
        else:
            driven = _alike(test, planning.Plan)
            parts = "recordings" if plan.fleet and not in_sample_only else held_out
            made.append(studies.prepare(plan, place, parts, driven, storage))
    return made


def _of_recordings(plans: Sequence[AnyPlan], option: str) -> list[planning.Plan]:
    """The plans, which must all be of recordings."""
    for plan in plans:
        if isinstance(plan, planning.PicturePlan):
            raise InputError(f"{plan.source}: {option}: does not go with labelled pictures")
    return [plan for plan in plans if isinstance(plan, planning.Plan)]


def _on_fleet(
    plan: planning.Plan, fleet: str | os.PathLike[str], by_tag: str | None, overrides: Overrides
) -> planning.Plan:
    """The plan for one parameter set for all drives of a fleet; for a fleet of one drive that of
    its recording."""
    if len(plan.experiments) > 1:
        raise InputError(f"{plan.source}: --fleet: goes with one experiment; the table has drives")
    (base,) = plan.experiments
    drives, experiments = experiments_of(base, fleet, overrides)
    # The ids of frames that are never fitted are those of the base's own recording.
    found = replace(
        plan,
        name=as_name(f"{plan.name}_{Path(fleet).stem}"),
        experiments=tuple(experiments),
        tuning=plan.tuning.model_copy(update={"never_fit": ()}),
    )
    if len(drives) == 1:
        return found
    of = drives_of(drives, experiments)
    parts = parts_of_fleet(drives, of, plan.tuning.blocks, by_tag)
    written = base.model_copy(update={"n_lanes": experiments[0].n_lanes})
    tags = tuple(drive.tags for drive in drives)
    return replace(found, fleet=planning.Fleet(written, parts, tags, tuple(of)))


def _alike(test: AnyPlan | None, kind: type[T]) -> T | None:
    if test is None or isinstance(test, kind):
        return test
    raise InputError(
        f"{test.source}: --test-on: labelled pictures test a search on labelled pictures, and"
        " recordings one on recordings"
    )


def _plans(experiments: Sequence[Any], runs: Runs | None, overrides: Overrides) -> list[AnyPlan]:
    if bool(experiments) == bool(runs):
        raise InputError("tune: name experiments, or runs of the paper with --runs 1-10")
    if runs:
        if overrides:
            raise InputError("--set: goes with an experiment's YAML, not with --runs")
        return list(planning.paper_plans(parse_runs(runs)))
    return [_plan(given, overrides) for given in experiments]


def _plan(given: Any, overrides: Overrides) -> AnyPlan:
    if isinstance(given, (str, os.PathLike)):
        return planning.read_plan(Path(given), overrides)
    experiment = load_experiment(given, overrides)
    tuning = experiment.tuning or Tuning()
    found = (experiment,)
    return planning.Plan(experiment.name, experiment.description, found, tuning, experiment.source)


def _check_names(plans: Sequence[AnyPlan]) -> None:
    names = [plan.name for plan in plans]
    for plan in plans:
        if names.count(plan.name) > 1:
            raise InputError(f"{plan.source}: another experiment has the name {plan.name} too")


def search_all(
    searches: Sequence[Search],
    *,
    jobs: Jobs = 1,
    workers: int | None = None,
    progress: bool | None = None,
) -> list[dict[str, Any]]:
    """Do searches that were prepared. Returns what is in the study.json of each, those on
    labelled pictures last."""
    driven = [made for made in searches if isinstance(made, studies.Search)]
    seen = [made for made in searches if isinstance(made, on_pictures.PictureSearch)]
    with bar(None, progress, total=studies.n_trials(searches), unit="trial") as shows:

        def advance(label: str, more: int, best: float) -> None:
            shows.set_description(label, refresh=False)
            shows.set_postfix(best=f"{best:.4f}", refresh=False)
            shows.update(more)

        done = list(studies.tune(driven, jobs=jobs, workers=workers, progress=advance))
        return done + [on_pictures.tune(made, jobs=jobs, progress=advance) for made in seen]
