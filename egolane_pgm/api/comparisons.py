"""Experiments side by side: `compare` and what it returns."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egolane_pgm.api import shown
from egolane_pgm.api.given import bar
from egolane_pgm.comparing import compare_graphs, compare_json
from egolane_pgm.comparing.choose import losses_by_experiment, plan
from egolane_pgm.comparing.groups import Group, Options, compare_groups, document
from egolane_pgm.files import write_json
from egolane_pgm.report.comparison_tables import accuracy_rows, experiment_names
from egolane_pgm.results import SCHEMA_VERSION, read_files, staged, write_files
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

#: The file of a comparison's directory that has the numbers: of all recordings, and of each one.
DOCUMENT = "comparison.json"


@dataclass(frozen=True, repr=False, eq=False)
class CompareResult:
    """Experiments side by side, on one or several recordings.

    - document: what `egolane compare --json` writes.
    - files: a result directory for each recording and experiment, by the names of their files;
      empty for graphs with the paper's parameters.
    - is_whole: whether all recordings were compared; Ctrl-C keeps those before it.
    """

    document: Mapping[str, Any]
    files: Mapping[str, bytes] = field(default_factory=dict, repr=False)
    is_whole: bool = True

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
        header, rows = accuracy_rows(self._as_held_out())
        found = self.document.get("failed", [])
        notes = [f"failed: {each['title']}: {each['error']}" for each in found]
        return shown.html_table(
            self._title(), header, rows, [*notes, "* in-sample, or not known to be held out"]
        )

    def to_pandas(self) -> pd.DataFrame:
        """A row per recording, experiment, subset of frames and score.

        Columns: `value`; `low` and `high` of its 95 % interval; `difference` to the first
        experiment of the recording, `difference_low`, `difference_high`; `tuned_on`.
        """
        import pandas as pd

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

    def to_xarray(self) -> xr.Dataset:
        """`to_pandas` as a data set. Raises InputError where xarray is not installed."""
        return shown.as_dataset(self.to_pandas())

    def plot(self) -> Figure:
        """Draw the accuracy of each experiment on each recording, with its interval."""
        from egolane_pgm.report.comparison_figures import comparison_figure
        from egolane_pgm.report.style import inline_figure

        return inline_figure(lambda: comparison_figure(self._as_held_out()))

    def save(self, directory: str | os.PathLike[str], *, figures: bool = True) -> Path:
        """Write the numbers, and a result directory for each recording and experiment, as
        `egolane compare --out` does; `load_result` reads them.

        - figures: whether accuracy is drawn beside them.

        An older comparison of that name is replaced. Raises InputError where the directory holds
        anything else, or cannot be written.
        """
        place = Path(directory)
        with staged(place, [is_comparison]) as folder:
            write_files(folder, self.files)
            write_json(folder / DOCUMENT, self.document)
            if figures:
                # matplotlib is imported only for figures.
                from egolane_pgm.report.comparison_figures import draw_comparison

                draw_comparison(self._as_held_out(), folder / "figures" / "accuracy.png")
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
    whole = files.pop(DOCUMENT, None)
    try:
        if whole is not None and "title" not in json.loads(whole):
            return CompareResult(json.loads(whole), files)
        if whole is not None:
            files = {f"{directory.name}/{name}": content for name, content in files.items()}
            files[f"{directory.name}/{DOCUMENT}"] = whole
        parts = [json.loads(files[name]) for name in files if name.endswith(f"/{DOCUMENT}")]
        parts = [{k: v for k, v in part.items() if k != "schema_version"} for part in parts]
        found = {
            "schema_version": SCHEMA_VERSION,
            "held_out": True,
            "blocks": parts[0]["blocks"],
            "recordings": parts,
            "together": [],
            "failed": [],
        }
        result = CompareResult(found, files)
        result.to_pandas()
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{directory}: is a damaged comparison; compare again") from error
    return result


def compare_recordings(
    groups: Sequence[Group], settings: Options, *, jobs: int = 1, progress: bool | None = None
) -> CompareResult:
    """Compare the experiments of each recording held out.

    Raises InputError where no recording could be compared; Ctrl-C where none was.
    """

    def show(found: Iterator[Any], total: int, doing: str, unit: str) -> Iterable[Any]:
        shows: Iterable[Any] = bar(
            found, progress if total else False, desc=doing, total=total, unit=unit
        )
        return shows

    tasks = plan([e for group in groups for e in group.experiments], settings.blocks)
    choosing = partial(show, doing="choosing", unit="recording")
    known = losses_by_experiment(tasks, jobs, choosing)
    searching = partial(show, doing="searching", unit="search")
    done = compare_groups(groups, settings, jobs=jobs, known=known, show=searching)
    compared: list[Any] = []
    is_whole = True
    try:
        compared.extend(bar(done, progress, total=len(groups), unit="recording"))
    except KeyboardInterrupt:
        # The recordings that were compared before the interruption are kept.
        if not compared:
            raise
        is_whole = False
    found = document(compared, settings)
    if not found["recordings"]:
        raise InputError(found["failed"][0]["error"])
    return CompareResult(found, is_whole=is_whole)


def compare_on_runs(
    graphs: Sequence[str], numbers: Sequence[int], which: str, *, progress: bool | None = None
) -> CompareResult:
    """Run graphs on the paper's runs with its parameters, in-sample."""
    shows = bar(numbers, progress, desc="runs", unit="run")
    compared = [compare_graphs(number, graphs, which) for number in shows]
    return CompareResult(compare_json(compared, which))
