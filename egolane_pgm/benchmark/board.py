"""The board: entries side by side on each track, with intervals and ties."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.benchmark.scored import SCORES, VERSION, resamples, total
from egolane_pgm.benchmark.tracks import SHOWN_ONLY
from egolane_pgm.scoring.bootstrap import with_bounds
from egolane_pgm.tools.files import read_text
from egolane_pgm.types import FloatArray, InputError
from egolane_pgm.views.benchmark_tables import ABOUT, Place, places_table, track_table
from egolane_pgm.views.tables import Table, page

#: An entry's scores, as `scored.score_entry` gives them, and those of one of its recordings.
Scores = Mapping[str, Any]

_KINDS = {
    True: "Causal, as checked",
    False: "Not causal (offline, or answers that wait), ranked apart",
    None: "Causality not checked",
}


@dataclass(frozen=True, repr=False, eq=False)
class Board:
    """Entries on tracks.

    - entries: in the order of the board.
    """

    entries: tuple[Scores, ...]

    def __repr__(self) -> str:
        return f"Board({len(self.entries)} entries on {', '.join(self.tracks)})"

    @property
    def tracks(self) -> list[str]:
        """The tracks that any entry was scored on, those where nobody is ranked last."""
        every = dict.fromkeys(r["track"] for each in self.entries for r in each["recordings"])
        return sorted(every, key=lambda track: (track in SHOWN_ONLY, track))

    @cached_property
    def drawn(self) -> dict[tuple[str, str], FloatArray]:
        """The balanced accuracy of each entry, by its title, on each track: that of all recordings,
        then that of each resample. Recordings and resamples are the same for all entries."""
        return {
            (each["title"], track): total(rows, "accuracy", resamples(rows))
            for each in self.entries
            for track in self.tracks
            if (rows := on_track(each, track))
        }

    def place(self, title: str, track: str) -> Place | None:
        """Balanced accuracy of an entry on a track, its 95 % interval (None for a track of one
        drive) and its rank among entries of its kind (None where nobody is ranked); None where it
        was not scored."""
        if (title, track) not in self.drawn:
            return None
        kind = {each["title"]: kind_of(each) for each in self.entries}
        rivals = [
            other
            for other in kind
            if kind[other] == kind[title] and (other, track) in self.drawn and other != title
        ]
        gaps = [self.difference(other, title, track)[1] for other in rivals]
        better = sum(gap is not None and gap[0] > 0 for gap in gaps)
        mine = self.drawn[title, track]
        return float(mine[0]), _interval(mine), None if track in SHOWN_ONLY else 1 + better

    def difference(
        self, title: str, other: str, track: str
    ) -> tuple[float, tuple[float, float] | None]:
        """By how much an entry is more accurate than another one on a track, and the 95 % interval
        of the paired difference; None for a track of one drive."""
        gained = self.drawn[title, track] - self.drawn[other, track]
        return float(gained[0]), _interval(gained)

    def to_text(self, *, style: str = "markdown", wide: bool = False) -> str:
        """The tables: who is where, causal entries apart from others, then each track by itself."""
        parts: list[str | Table] = []
        for kind in dict.fromkeys(map(kind_of, self.entries)):
            titles = [each["title"] for each in self.entries if kind_of(each) == kind]
            places = {t: [self.place(t, track) for track in self.tracks] for t in titles}
            parts += [f"{kind}:", places_table(self.tracks, places)]
        parts.append(ABOUT)
        for track in self.tracks:
            on = {e["title"]: scores_of(rows) for e in self.entries if (rows := on_track(e, track))}
            parts += [f"Track {track}:", track_table(on)]
        return page(parts, style, wide)

    def draw(self, folder: Path, chosen: Sequence[str] = ()) -> list[Path]:
        """Draw board.png, and of some entries calibration.png and lanes.png; returns the files.

        - chosen: titles of these entries, seven at most; by default the first ones.

        Raises InputError where a file cannot be written.
        """
        from egolane_pgm.views import benchmark_figures as figures
        from egolane_pgm.views.style import write_figure

        titles = [each["title"] for each in self.entries]
        on = {
            track: {e["title"]: rows for e in self.entries if (rows := on_track(e, track))}
            for track in self.tracks
        }
        places = {
            track: {title: self.place(title, track) for title in entries}
            for track, entries in on.items()
        }
        return [
            write_figure(lambda: figures.places_figure(places, on, titles), folder / "board.png"),
            write_figure(
                lambda: figures.calibration_figure(on, chosen or titles), folder / "calibration.png"
            ),
            write_figure(lambda: figures.lanes_figure(on, chosen or titles), folder / "lanes.png"),
        ]


def kind_of(entry: Scores) -> str:
    """What an entry is ranked among."""
    if entry["lanes"] == "unknown":
        return "Finds the number of lanes itself"
    return _KINDS[entry["check"]["is_causal"]]


def on_track(entry: Scores, track: str) -> list[Scores]:
    """The recordings of a track that an entry was scored on, by name."""
    rows = [each for each in entry["recordings"] if each["track"] == track]
    return sorted(rows, key=lambda row: str(row["name"]))


def scores_of(rows: Sequence[Scores]) -> dict[str, float | None]:
    """All scores of recordings; None where one is not defined."""
    everything = np.ones((1, len(rows)))
    values = {score: float(total(rows, score, everything)[0]) for score in SCORES}
    delays = [delay for row in rows for delay in row["delays_s"]] or [math.nan]
    values["wrong_s"] = max(row["wrong_s"] for row in rows)
    values["delay_s"], values["late_s"] = np.percentile(delays, [50, 90]).tolist()
    return {score: None if math.isnan(value) else value for score, value in values.items()}


def read_board(files: Sequence[Path]) -> Board:
    """The board of files of scores: entries by their mean accuracy over the ranked tracks, with
    those that look ahead last.

    Raises InputError for what is no such file, a title that occurs twice, and an entry that was
    scored on other recordings of a track than another one.
    """
    entries: dict[str, Scores] = {}
    known: dict[str, tuple[Path, list[str]]] = {}
    for file in files:
        try:
            content = json.loads(read_text(file))
        except ValueError as error:
            raise InputError(f"{file}: is not JSON: {error}") from error
        if not isinstance(content, dict) or content.get("version") != VERSION:
            raise InputError(f"{file}: holds no scores that `egolane benchmark score` wrote")
        if content["title"] in entries:
            raise InputError(f"{file}: its title, {content['title']}, occurs twice")
        entries[content["title"]] = content
        for track in dict.fromkeys(row["track"] for row in content["recordings"]):
            names = [row["name"] for row in on_track(content, track)]
            first, others = known.setdefault(track, (file, names))
            if names != others:
                raise InputError(f"{file}: has other recordings of {track} than {first}")
    return Board(tuple(sorted(entries.values(), key=_order)))


def _order(entry: Scores) -> tuple[bool, float]:
    tracks = dict.fromkeys(row["track"] for row in entry["recordings"])
    ranked = [track for track in tracks if track not in SHOWN_ONLY] or list(tracks)
    mean = np.mean([scores_of(on_track(entry, track))["accuracy"] for track in ranked])
    return entry["check"]["is_causal"] is False, -float(mean)


def _interval(values: FloatArray) -> tuple[float, float] | None:
    """Of all recordings and each resample, (1 + R,); None where they are all alike."""
    _, low, high = with_bounds(values)
    return (low, high) if np.ptp(values) else None
