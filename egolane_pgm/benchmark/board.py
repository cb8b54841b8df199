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

from egolane_pgm.benchmark.scored import SCORES, VERSION, resamples, total, whole
from egolane_pgm.tools.files import read_text
from egolane_pgm.types import FloatArray, InputError
from egolane_pgm.views import shown
from egolane_pgm.views.tables import Table, page, with_interval

#: Tracks on which nobody is ranked: everybody has looked at them.
SHOWN_ONLY = ("paper",)

#: The columns of the table of a track: a score, and its format.
_MORE = {
    "frames_right": ("right", ".3f"),
    "log_loss": ("log-loss", ".3f"),
    "sure": ("sure", ".3f"),
    "right_if_sure": ("right if sure", ".3f"),
    "first_minute": ("first 60 s", ".3f"),
    "precision": ("changes: precision", ".2f"),
    "recall": ("recall", ".2f"),
    "false_per_hour": ("false/h", ".1f"),
}

_ABOUT = (
    "Balanced accuracy: the mean over the lanes of each drive; 95 % intervals by resampling"
    " drivers or trips, then drives. In parentheses the rank: as many entries less one are better by"
    " a paired difference whose interval leaves out 0."
)


@dataclass(frozen=True)
class Placed:
    """An entry on a track.

    - accuracy: balanced. interval: 95 %, None for a track of one drive.
    - rank: among the entries of its kind; None where nobody is ranked.
    """

    accuracy: float
    interval: tuple[float, float] | None
    rank: int | None


@dataclass(frozen=True, repr=False, eq=False)
class Board:
    """Entries on tracks.

    - entries: what `scored.score_entry` gave, in the order of the board.
    """

    entries: tuple[Mapping[str, Any], ...]

    def __repr__(self) -> str:
        return f"Board({len(self.entries)} entries on {', '.join(self.tracks)})"

    def _repr_html_(self) -> str:
        table = self._places(self.entries)
        return shown.html_table(repr(self), table.header, table.rows)

    @property
    def tracks(self) -> list[str]:
        """The tracks that any entry was scored on, those where nobody is ranked last."""
        every = dict.fromkeys(r["track"] for each in self.entries for r in each["recordings"])
        return sorted(every, key=lambda track: (track in SHOWN_ONLY, track))

    @cached_property
    def places(self) -> dict[tuple[int, str], Placed]:
        """Each entry, by its number, on each track that it was scored on."""
        found: dict[tuple[int, str], Placed] = {}
        for track in self.tracks:
            drawn: dict[int, FloatArray] = {}
            for k, each in enumerate(self.entries):
                rows = on_track(each, track)
                if rows:
                    weights = np.vstack([np.ones(len(rows)), resamples(rows)])
                    drawn[k] = total(rows, "accuracy", weights)
            for k, mine in drawn.items():
                better = [
                    _bounds(theirs[1:] - mine[1:])[0] > 0
                    for j, theirs in drawn.items()
                    if kind_of(self.entries[j]) == kind_of(self.entries[k])
                ]
                low, high = _bounds(mine[1:])
                several = len({row["drive"] for row in on_track(self.entries[k], track)}) > 1
                rank = None if track in SHOWN_ONLY else 1 + sum(better)
                found[k, track] = Placed(float(mine[0]), (low, high) if several else None, rank)
        return found

    @property
    def document(self) -> dict[str, Any]:
        """What a board says, ready for JSON: of each entry its places and scores per track."""
        return {
            "version": VERSION,
            "entries": [
                {
                    "title": each["title"],
                    "kind": kind_of(each),
                    "check": each["check"],
                    "tracks": {
                        track: {
                            "interval": self.places[k, track].interval,
                            "rank": self.places[k, track].rank,
                            **scores_on(each, track),
                        }
                        for track in self.tracks
                        if (k, track) in self.places
                    },
                }
                for k, each in enumerate(self.entries)
            ],
        }

    def to_text(self, *, style: str = "markdown", wide: bool = False) -> str:
        """The tables: who is where, causal entries apart from others, then each track by itself."""
        parts: list[str | Table] = []
        for kind in dict.fromkeys(map(kind_of, self.entries)):
            of_kind = [each for each in self.entries if kind_of(each) == kind]
            parts += [f"{kind}:", self._places(of_kind)]
        parts.append(_ABOUT)
        for track in self.tracks:
            parts += [f"Track {track}:", self._track(track)]
        return page(parts, style, wide)

    def draw(self, folder: Path, calibrated: int = 5) -> list[Path]:
        """Draw board.png and, of so many entries from the top, calibration.png; returns the files.

        Raises InputError where they cannot be written.
        """
        from egolane_pgm.views.benchmark_figures import calibration_figure, places_figure
        from egolane_pgm.views.style import write_figure

        drawn: dict[str, dict[str, Any]] = {track: {} for track in self.tracks}
        curves: dict[str, dict[str, Any]] = {track: {} for track in self.tracks}
        for (k, track), place in self.places.items():
            each, rows = self.entries[k], on_track(self.entries[k], track)
            wrong = sum(r["sure"] - r["sure_right"] for r in rows) / sum(r["scored"] for r in rows)
            drawn[track][each["title"]] = (place.accuracy, place.interval, wrong)
            if k < calibrated:
                sums = np.sum([row["reliability"] for row in rows], axis=0)
                curves[track][each["title"]] = sums
        titles = [each["title"] for each in self.entries]
        return [
            write_figure(lambda: places_figure(drawn, titles), folder / "board.png"),
            write_figure(lambda: calibration_figure(curves), folder / "calibration.png"),
        ]

    def _places(self, entries: Sequence[Mapping[str, Any]]) -> Table:
        rows = []
        for k, each in enumerate(self.entries):
            if any(each is one for one in entries):
                cells = [self.places.get((k, track)) for track in self.tracks]
                rows.append([each["title"], *map(_place_text, cells)])
        return Table(["entry", *self.tracks], rows)

    def _track(self, track: str) -> Table:
        rows = []
        for each in self.entries:
            said = scores_on(each, track)
            if said:
                cells = ["-" if said[s] is None else f"{said[s]:{form}}" for s, (_, form) in _MORE.items()]
                delay = said["delay_s"]
                late = "-" if delay is None else f"{delay[0]:.1f} ({delay[1]:.1f})"
                fast = "-" if said["ms_per_frame"] is None else f"{said['ms_per_frame']:.3f}"
                rows.append([each["title"], *cells, late, f"{said['wrong_s']:.0f}", fast])
        heads = [title for title, _ in _MORE.values()]
        return Table(["entry", *heads, "delay s (90 %)", "longest wrong s", "ms/frame"], rows)


def kind_of(entry: Mapping[str, Any]) -> str:
    """What an entry is ranked among."""
    if entry["lanes"] == "unknown":
        return "Finds the number of lanes itself"
    return {
        True: "Causal, as checked",
        False: "Not causal (offline, or answers that wait), ranked apart",
        None: "Causality not checked",
    }[entry["check"]["is_causal"]]


def on_track(entry: Mapping[str, Any], track: str) -> list[Mapping[str, Any]]:
    """The recordings of a track that an entry was scored on."""
    return [each for each in entry["recordings"] if each["track"] == track]


def scores_on(entry: Mapping[str, Any], track: str) -> dict[str, Any]:
    """All scores of an entry on a track; None where one is not defined. Empty without recordings."""
    rows = on_track(entry, track)
    if not rows:
        return {}
    values = {score: whole(rows, score) for score in SCORES}
    delays = [delay for row in rows for delay in row["delays_s"]]
    return {
        **{score: None if math.isnan(value) else value for score, value in values.items()},
        "wrong_s": max(row["wrong_s"] for row in rows),
        "delay_s": np.percentile(delays, [50, 90]).tolist() if delays else None,
    }


def read_board(files: Sequence[str | Path]) -> Board:
    """The board of files of scores, the entries by their mean accuracy over the ranked tracks.

    Raises InputError for what is no such file, a title that occurs twice, and an entry that was
    scored on other recordings of a track than another one.
    """
    entries = []
    for file in files:
        try:
            content = json.loads(read_text(Path(file)))
        except ValueError as error:
            raise InputError(f"{file}: is not JSON: {error}") from error
        if not isinstance(content, dict) or content.get("version") != VERSION:
            raise InputError(f"{file}: holds no scores that `egolane benchmark score` wrote")
        entries.append(content)
    titles: dict[str, str] = {}
    known: dict[str, tuple[str, list[str]]] = {}
    for file, each in zip(map(str, files), entries, strict=True):
        if each["title"] in titles:
            raise InputError(f"{file}: has the title of {titles[each['title']]}; score it as another")
        titles[each["title"]] = file
        for track in dict.fromkeys(row["track"] for row in each["recordings"]):
            names = sorted(row["name"] for row in on_track(each, track))
            first, others = known.setdefault(track, (file, names))
            if names != others:
                raise InputError(f"{file}: has other recordings of {track} than {first}")
    return Board(tuple(sorted(entries, key=_mean, reverse=True)))


def _mean(entry: Mapping[str, Any]) -> float:
    tracks = dict.fromkeys(row["track"] for row in entry["recordings"])
    ranked = [track for track in tracks if track not in SHOWN_ONLY] or list(tracks)
    return float(np.mean([whole(on_track(entry, track), "accuracy") for track in ranked]))


def _bounds(values: FloatArray) -> tuple[float, float]:
    low, high = np.nanquantile(values, [0.025, 0.975])
    return float(low), float(high)


def _place_text(place: Placed | None) -> str:
    if place is None:
        return "-"
    rank = "" if place.rank is None else f" ({place.rank})"
    return with_interval(place.accuracy, place.interval) + rank
