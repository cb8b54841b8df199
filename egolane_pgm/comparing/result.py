"""What a comparison found: `Comparison`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egolane_pgm.comparing.document import DOCUMENT, folder_of, read_document
from egolane_pgm.fleet import FleetDrive
from egolane_pgm.results import Result, is_result, read_result, staged
from egolane_pgm.tools.files import write_json
from egolane_pgm.types import InputError, not_one_of, titled
from egolane_pgm.views import comparison_tables as rows_of
from egolane_pgm.views import events as lane_changes
from egolane_pgm.views import shown
from egolane_pgm.views.comparison_tables import entries_of, experiment_names
from egolane_pgm.views.fleet_table import FLEET_LEGEND, fleet_comparison_rows
from egolane_pgm.views.tables import Table, page

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False, eq=False)
class Comparison:
    """Results side by side, on one or several recordings.

    - document: what `egolane compare --json` writes.
    - results: what was believed, by the title of the recording and the name of the experiment;
      empty where `folder` has them.
    - folder: where the results were read.
    - drives: of a fleet, on which the experiments were put.
    - stopped: the KeyboardInterrupt that ended it early; the recordings before it are there.

    >>> import egolane_pgm as ego
    >>> one = ego.load_experiment("quickstart", {"recording.frames": [0, 400]})
    >>> other = ego.load_experiment(one, {"name": "exact", "filter": "exact"})
    >>> compared = ego.compare([one, other], blocks=2)
    >>> compared
    Comparison(quickstart, exact on quickstart, seed 0; not tuned, causal)
    >>> compared["quickstart, seed 0", "exact"].to_pandas().shape[0]
    400
    """

    document: Mapping[str, Any]
    results: Mapping[tuple[str, str], Result] = field(default_factory=dict)
    folder: Path | None = None
    drives: tuple[FleetDrive, ...] = ()
    stopped: KeyboardInterrupt | None = None

    @property
    def names(self) -> list[str]:
        """The names of the experiments, or of the graphs."""
        return experiment_names(self.document)

    @property
    def recordings(self) -> list[str]:
        """The titles of the recordings."""
        return [str(recording["title"]) for recording in self.document["recordings"]]

    def __getitem__(self, key: tuple[str, str]) -> Result:
        """What was believed: of a recording, by its title, under an experiment.

        Raises InputError where there is none.
        """
        title, name = key
        if key in self.results:
            return self.results[key]
        if self.folder is not None and is_result(self.folder / folder_of(title) / name):
            return read_result(self.folder / folder_of(title) / name)
        raise InputError(
            f"{title}, {name}: is not here; there are {', '.join(self.recordings)}"
            f" with {', '.join(self.names)}"
        )

    @property
    def failed(self) -> list[tuple[str, str]]:
        """The title of each recording that failed, and why."""
        return [(each["title"], each["error"]) for each in self.document["failed"]]

    @property
    def notes(self) -> list[str]:
        """Warnings, a line each."""
        return [
            titled(recording["title"], note)
            for recording in self.document["recordings"]
            for note in recording["notes"]
        ]

    def __repr__(self) -> str:
        return f"Comparison({self._title()})"

    def _title(self) -> str:
        names = ", ".join(self.names[:6]) + ", ..." * (len(self.names) > 6)
        titles = self.recordings
        on = titles[0] if len(titles) == 1 else f"{len(titles)} recordings"
        ways = dict.fromkeys(shown.how_tuned(entry) for _, entry in entries_of(self.document))
        return f"{names} on {on}; {' or '.join(ways)}"

    def _repr_html_(self) -> str:
        document = self.document
        header, rows = rows_of.accuracy_rows(document)
        notes = [f"failed: {title}: {error}" for title, error in self.failed]
        return shown.html_table(
            self._title(), header, rows, [*notes, *rows_of.marks_text(document).splitlines()]
        )

    def to_text(self, *, style: str = "markdown", wide: bool = False) -> str:
        """The tables of what was compared; see `DriveTable.to_text`."""
        if self.drives:
            rows = fleet_comparison_rows(self.document, self.drives)
            return page([Table(*rows, labels=2), FLEET_LEGEND], style, wide)
        return page(_parts(self.document, with_all=style != "markdown"), style, wide)

    def to_pandas(self) -> pd.DataFrame:
        """A row per recording, experiment, subset of frames and score.

        Columns: `value`; `low` and `high` of its 95 % interval; `difference` to the first
        experiment of the recording, `difference_low`, `difference_high`; `tuned_on`.
        """
        import pandas as pd

        rows = [
            (title, entry["name"], subset, *row, entry["tuned_on"])
            for title, entry in entries_of(self.document)
            for subset, scores in entry["scores"].items()
            for row in _score_rows(scores, (entry["difference"] or {}).get(subset) or {})
        ]
        index = ["recording", "experiment", "subset", "score"]
        values = ["value", "low", "high", "difference", "difference_low", "difference_high"]
        return pd.DataFrame(rows, columns=[*index, *values, "tuned_on"]).set_index(index)

    def plot(self, figure: str = "accuracy") -> Figure:
        """Draw the experiments on each recording, with their intervals.

        - figure: "accuracy", or "differences" for how it differs from the first experiment's.

        Raises InputError for another figure, and for differences that there are not.
        """
        from egolane_pgm.views import comparison_figures as figures
        from egolane_pgm.views.style import inline_figure

        makes = {
            "accuracy": figures.comparison_figure,
            "differences": figures.differences_figure,
        }
        if figure not in makes:
            raise InputError(f"figure: {not_one_of(figure, list(makes))}")
        return inline_figure(lambda: makes[figure](self.document))

    def save(self, directory: str | os.PathLike[str], *, figures: bool = True) -> Path:
        """Write the numbers, and a result directory for each recording and experiment, as
        `egolane compare --out` does; `load_result` reads them.

        - figures: whether accuracy, and how it differs, are drawn as well.

        An older comparison of that name is replaced; other files are left alone. Raises
        InputError where the directory holds anything else, or cannot be written.
        """
        place = Path(directory)
        with staged(place, is_comparison) as folder:
            for (title, name), result in self.results.items():
                result.save(folder / folder_of(title) / name, figures=False)
            write_json(folder / DOCUMENT, self.document)
            if figures:
                # matplotlib is imported only for figures.
                from egolane_pgm.views.comparison_figures import draw_all

                draw_all(self.document, folder / "figures")
        return place


def _score_rows(
    scores: Mapping[str, Any], differences: Mapping[str, Sequence[float] | None]
) -> Iterator[tuple[Any, ...]]:
    """Per score its name, value, interval, difference and the interval of that."""
    nothing = (None, None, None)
    delays = {f"delay_{name}": value for name, value in (scores.get("delay") or {}).items()}
    for name, value in {**scores, **delays}.items():
        if isinstance(value, (int, float)):
            low, high = (scores.get("intervals") or {}).get(name) or (None, None)
            yield name, float(value), low, high, *(differences.get(name) or nothing)


def is_comparison(directory: Path) -> bool:
    """Whether the directory holds a comparison."""
    return (directory / DOCUMENT).is_file()


def read_comparison(directory: Path) -> Comparison:
    """Read the directory of a comparison. Raises InputError where it is damaged."""
    return Comparison(read_document(directory / DOCUMENT), folder=directory)


# --- what is printed ---------------------------------------------------------------------------


def _parts(found: Mapping[str, Any], *, with_all: bool) -> list[str | Table]:
    """The tables of scores, or instead of them that of events, if asked for.

    - with_all: whether a table of all scores comes first.
    """
    searched = rows_of.search_rows(found)
    parts: list[str | Table] = [Table(*searched)] if searched[1] else []
    if any(entry.get("events") for _, entry in entries_of(found)):
        header, rows = lane_changes.event_comparison_rows(found)
        parts += [Table(header, rows, labels=2, leaves_out=True), rows_of.marks_text(found)]
        legends = [lane_changes.LEGEND]
    else:
        together = rows_of.together_tables(found)
        parts += [*(Table(*each) for each in together), *_score_parts(found)]
        legends = [rows_of.LEGEND, *([rows_of.TOGETHER_LEGEND] if together else [])]
        if with_all:
            parts.insert(0, Table(*rows_of.full_rows(found)))
    # They are wrapped as wide as the terminal is.
    return parts + [" ".join(legend.split()) for legend in legends]


def _score_parts(found: Mapping[str, Any]) -> list[str | Table]:
    parts: list[str | Table] = [Table(*rows_of.accuracy_rows(found)), rows_of.marks_text(found)]
    if rows_of.has_untrusted(found):
        parts.append(
            "Above without the frames of tuning.never_fit, whose labels are not trusted; with them:"
        )
        parts.append(Table(*rows_of.accuracy_rows(found, "all_frames")))
    return [*parts, *rows_of.full_tables(found)]
