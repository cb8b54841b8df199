"""A benchmark of ego-lane estimation from line lists: tracks, entries, the board."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from runpy import run_path
from typing import Annotated

from annotated_types import Ge

from egolane_pgm.benchmark import making
from egolane_pgm.benchmark.board import Board, read_board
from egolane_pgm.benchmark.causality import CUTS
from egolane_pgm.benchmark.entries import by_command, by_experiment, by_folder, command_words
from egolane_pgm.benchmark.scored import Entry, score_entry
from egolane_pgm.benchmark.tracks import read_tracks
from egolane_pgm.experiment import Overrides, load_experiment
from egolane_pgm.tools.files import check_place, read_text, write_json
from egolane_pgm.types import InputError
from egolane_pgm.verbs.given import Jobs, Option, Seed, StrPath, several_of

EXAMPLES = (
    "egolane benchmark make tracks",
    "egolane benchmark score zero_label tracks -o scores/zero_label.json",
    "egolane benchmark score my_entry.py tracks/rotterdam -o scores/mine.json",
    "egolane benchmark board scores/mine.json scores/zero_label.json",
)


def make(
    out: Annotated[StrPath, Option("DIR")],
    *,
    uah: Annotated[StrPath | None, Option("DIR")] = None,
) -> str:
    """Make the tracks, into new folders in DIR: the paper's recordings (paper), and annotated lane
    changes near Rotterdam with the lines of these recordings (rotterdam).

    - uah: your copy of UAH-DriveSet, which may not be handed on: two_lines and motion are made too.

    Returns what was made, with checksums. Raises InputError, one line, for whatever does not fit.
    """
    return "\n".join(making.make_tracks(Path(out), None if uah is None else Path(uah)))


def score(
    entry: Annotated[str, Option("ENTRY")],
    tracks: Annotated[StrPath | Sequence[StrPath], Option("TRACKS...", many=True)],
    *,
    out: Annotated[StrPath | None, Option("FILE.json", names=("-o",))] = None,
    title: str | None = None,
    overrides: Overrides = (),
    find_lanes: bool = False,
    checked: Annotated[int, Ge(0)] = 5,
    cuts: Annotated[int, Ge(1)] = CUTS,
    seed: Seed = 0,
    jobs: Jobs = 1,
) -> Board:
    """Score what answers for the drives of tracks, and check that it does not look ahead.

    ENTRY is an experiment with its own parameters (a YAML file, or a name that `egolane show`
    prints), a command with {lines}, {n}, {beliefs} and {events} in it or a Python file that takes
    these four, a Python file with `fit`, which is given the other drivers' drives, or a folder of
    answers NAME.csv and NAME.events.csv. TRACKS are folders of NAME.csv and NAME.txt.

    - out: write the scores, from which the board is made.
    - title: what the board calls the entry; by default ENTRY.
    - overrides: override a key of the experiment.
    - find_lanes: do not tell a command the number of lanes ({n} is 0): it has to find it.
    - checked: on how many recordings it is checked that no belief looks ahead.
    - cuts: how often each of them is cut there.
    - seed: of the cuts, and which recordings those are.
    - jobs: processes that share the recordings.

    Returns the board of this entry. Raises InputError, one line, for whatever does not fit.
    """
    file = None if out is None else Path(out)
    if file is not None:
        check_place(file)
    chosen = entry_of(str(entry), title, overrides)
    found = score_entry(
        chosen,
        read_tracks([Path(track) for track in several_of(tracks)]),
        checked=checked,
        cuts=cuts,
        seed=seed,
        find_lanes=find_lanes,
        jobs=jobs,
    )
    if file is not None:
        write_json(file, found)
    return Board((found,))


def entry_of(given: str, title: str | None, overrides: Overrides) -> Entry:
    """What an ENTRY means."""
    name, words = title or given, command_words(given)
    if words is None and not Path(given).is_dir():
        experiment = load_experiment(given, overrides)
        return Entry(name, partial(by_experiment, experiment))
    if overrides:
        raise InputError(f"overrides: {given} is no experiment")
    if words is None:
        return Entry(name, partial(by_folder, Path(given)), can_rerun=False)
    if given.endswith(".py") and "\ndef fit(" in read_text(Path(given)):
        return Entry(name, None, run_path(given)["fit"])
    return Entry(name, partial(by_command, words))


def board(
    scores: Annotated[StrPath | Sequence[StrPath], Option("SCORES...", many=True)],
    *,
    figures: Annotated[StrPath | None, Option("DIR")] = None,
) -> Board:
    """Set entries side by side that were scored on the same tracks.

    - figures: draw accuracy with intervals, sure but wrong frames, and calibration into a folder.

    Returns the board. Raises InputError, one line, for whatever does not fit.
    """
    found = read_board([Path(each) for each in several_of(scores)])
    if figures is not None:
        found.draw(Path(figures))
    return found


benchmark = {"make": make, "score": score, "board": board}
