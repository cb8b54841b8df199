"""What a search found: `Study`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egolane_pgm.experiment import Experiment, make_experiment
from egolane_pgm.results import SCHEMA_VERSION, staged
from egolane_pgm.tools.files import read_yaml, without_version, write_json, write_yaml
from egolane_pgm.tuning.study_directory import write_trials
from egolane_pgm.types import InputError, not_one_of
from egolane_pgm.views import shown, study_tables
from egolane_pgm.views.fleet_table import fleet_table_rows
from egolane_pgm.views.study_trials import (
    STUDY_FILE,
    Trials,
    is_study,
    quiet,
    read_study_files,
    trials_of,
)
from egolane_pgm.views.tables import Table, page

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class One:
    """One study.

    - study: the content of its study.json.
    - trials: the columns of trials.parquet.
    - experiments: the best parameters as experiments, by the names of their files.
    """

    study: Mapping[str, Any]
    trials: Mapping[str, Sequence[Any]]
    experiments: Mapping[str, Mapping[str, Any]]

    @property
    def name(self) -> str:
        """Its name."""
        return str(self.study["name"])


@dataclass(frozen=True, repr=False, eq=False)
class Study:
    """One or several searches: every trial, the best parameters, and what they are worth held out.

    - studies: in their order.

    >>> import egolane_pgm as ego
    >>> experiment = ego.load_experiment("quickstart", {"recording.frames": [0, 200]})
    >>> study = ego.tune(experiment, trials=4, sampler="random", in_sample_only=True)
    >>> study
    Study('quickstart': 4 trials, accuracy 0.969 in-sample)
    >>> sorted(study.best)[:2]
    ['bonus_value', 'p1']
    >>> len(study.to_pandas())
    4
    """

    studies: tuple[One, ...]

    @property
    def names(self) -> list[str]:
        """The names of the studies."""
        return [each.name for each in self.studies]

    def __len__(self) -> int:
        return len(self.studies)

    def __iter__(self) -> Iterator[Study]:
        return (Study((each,)) for each in self.studies)

    def __getitem__(self, key: int | str) -> Study:
        """One of several studies, by number or by name. Raises InputError for another name."""
        if isinstance(key, str):
            if key not in self.names:
                raise InputError(f"study: {not_one_of(key, self.names)}")
            key = self.names.index(key)
        return Study((self.studies[key],))

    def _one(self) -> One:
        if len(self.studies) != 1:
            raise InputError(f"there are {len(self)} studies, take one: study[{self.names[0]!r}]")
        return self.studies[0]

    @property
    def document(self) -> dict[str, Any]:
        """What `egolane tune --json` writes."""
        return {"schema_version": SCHEMA_VERSION, "studies": [each.study for each in self.studies]}

    @property
    def notes(self) -> list[str]:
        """Warnings, a line each."""
        return list(dict.fromkeys(n for each in self.studies for n in each.study["notes"]))

    @property
    def best(self) -> dict[str, Any]:
        """What the best trial has for each number that was searched. Raises InputError for several
        studies."""
        return dict(self._one().study["best"]["point"])

    @property
    def experiments(self) -> dict[str, Experiment]:
        """The experiments with the best parameters, by name; of several studies all."""
        made = [
            make_experiment(without_version(keys, file), Path.cwd(), f"{each.name}/{file}")
            for each in self.studies
            for file, keys in each.experiments.items()
        ]
        return {experiment.name: experiment for experiment in made}

    def __repr__(self) -> str:
        return f"Study({self._title()})"

    def _title(self) -> str:
        if len(self) > 1:
            return ", ".join(map(repr, self.names[:5])) + ", ..." * (len(self) > 5)
        study = self.studies[0].study
        score, best = next(iter(study["best"]["values"].items()))
        said = [f"{study['best']['trials']} trials, {score} {best:.3f} in-sample"]
        if study["held_out"] is not None and score in study["held_out"]["all_frames"]:
            said.append(f"{study['held_out']['all_frames'][score]:.3f} held out")
        return f"{study['name']!r}: {', '.join(said)}"

    def _repr_html_(self) -> str:
        documents = [each.study for each in self.studies]
        one = len(self) == 1
        rows = (
            study_tables.score_rows(documents[0]) if one else study_tables.parameter_rows(documents)
        )
        return shown.html_table(self._title(), *rows, [*self.notes, study_tables.legend(documents)])

    def to_text(self, *, style: str = "markdown", wide: bool = False) -> str:
        """The best parameters and their scores, in-sample and held out; see
        `DriveTable.to_text`."""
        documents = [each.study for each in self.studies]
        parts: list[str | Table] = []
        by_title = {"": documents} if style == "csv" else study_tables.by_country(documents)
        for title, mine in by_title.items():
            score = next(iter(mine[0]["best"]["values"]))
            seen = score if score in study_tables.SHOWN else "accuracy"
            parts += [title, Table(*study_tables.parameter_rows(mine, seen), labels=2)]
        if len(documents) == 1:
            parts.append(Table(*study_tables.score_rows(documents[0])))
        for document in documents:
            rows = study_tables.drive_rows(document)
            if rows:
                parts += [f"{document['name']}, held out:", Table(*fleet_table_rows(rows))]
        parts.append(study_tables.legend(documents))
        said = (study_tables.importance_line(each.trials()) for each in self)
        return page([*parts, *filter(None, said)], style, wide)

    def to_pandas(self) -> pd.DataFrame:
        """A row per trial; the index is `study` and `number`.

        Columns: `state`, `<score>_in_sample`, and one for each number that was searched.
        """
        import pandas as pd

        frames = {each.name: pd.DataFrame(dict(each.trials)) for each in self.studies}
        return (
            pd.concat(frames, names=["study", None])
            .reset_index(level=1, drop=True)
            .set_index("number", append=True)
        )

    def trials(self) -> Trials:
        """The finished trials as arrays. Raises InputError for several studies."""
        one = self._one()
        return trials_of(one.study, one.trials, one.name)

    def plot(self, figure: str = "history") -> Figure:
        """Draw a figure of the study.

        - figure: "history", "profile" (the score over each parameter), and, where there are trials
          enough, "importances".

        Raises InputError for another one, and for several studies: `study[name].plot()`.
        """
        from egolane_pgm.views.study_figures import figures_of
        from egolane_pgm.views.style import inline_figure

        makes = figures_of(self.trials())
        if figure not in makes:
            raise InputError(f"figure: {not_one_of(figure, list(makes))}")
        with quiet():
            return inline_figure(makes[figure])

    def save(self, directory: str | os.PathLike[str], *, figures: bool = True) -> Path:
        """Write the directory of the study; of several, one by each name into `directory`.

        - figures: whether figures are drawn in it.

        An older study of that name is replaced; other files are left alone. Raises
        InputError where the directory holds anything else, or cannot be written.
        """
        # matplotlib is imported only for figures.
        from egolane_pgm.views.study_figures import draw_study

        place = Path(directory)
        for each in self.studies:
            with staged(place if len(self) == 1 else place / each.name, is_study) as folder:
                write_json(folder / STUDY_FILE, each.study)
                write_trials(folder, each.trials)
                for file, content in each.experiments.items():
                    write_yaml(folder / file, content)
                if figures:
                    draw_study(folder)
        return place


def read_study(directory: Path) -> Study:
    """Read the directory of a study. Raises InputError where it is damaged."""
    content, table = read_study_files(directory)
    trials_of(content, table, str(directory))
    experiments = {
        file.name: read_yaml(file, "name: tuned") for file in sorted(directory.glob("best*.yaml"))
    }
    return Study((One(content, table, experiments),))
