"""The page of the public board: sentences with their numbers, tables and pictures."""

from __future__ import annotations

from egolane_pgm.benchmark.board import Board, on_track, scores_of

POSITION = "position in lane"
NO_SIGHT = "position in lane, one kind of detector"
NO_WIDTH = "position in lane, width not estimated"
NO_MOTION = "position in lane, without motion"
NO_FLAGS = "position in lane, without flags and LRI"
AFTER_1_S = "position in lane, after 1 s"
AFTER_3_S = "position in lane, after 3 s"
SMOOTHED = "position in lane, smoothed"
PUBLISHED = "paper's graph, published (run 1)"
SEARCHED = "paper's graph, searched*"
LEARNED = "paper's graph, learned*"
AUTOREGRESSIVE = "autoregressive, searched*"
WOR_ON_LANE = "WOR on Lane, learned*"
STICKY = "sticky HMM, stay .99"
STICKY_SEARCHED = "sticky HMM, searched*"
RULE = "paper's rule, frame by frame"
COUNTING = "lines on either side, counted"
BOOSTING = "gradient boosting, filtered*"

#: The entries in pictures with a colour for each.
DRAWN = (POSITION, PUBLISHED, SEARCHED, BOOSTING, STICKY_SEARCHED, RULE, COUNTING)

HEAD = """\
# Which lane am I in, from line lists, on drives nobody tuned on

Made by `make benchmark`; no number here was written by hand. An entry sees the lines of a drive and
the number of lanes, and gives a belief for each frame. The **main score is balanced accuracy**: the
mean over the lanes of each drive, on frames that are not lane changes; ties and silence are wrong.
Entries with a star were fitted, for each driver or trip, to the drives of the others.

| track | what is real | recordings here | what it can say | what it cannot |
|---|---|---|---|---|
{tracks}

"""

#: What is said of each track: what is real, what it can say, what it cannot.
TRACKS = {
    "motion": (
        "lateral motion of cars on a motorway of three lanes (UAH-DriveSet), measured by a camera",
        "how methods follow real lane changes, and what more lanes cost",
        "how lines fail on that road: they are a donor's; four and five lanes are a path of three"
        " on a wider road",
    ),
    "rotterdam": (
        "lane changes and number of lanes (2 to 5), annotated by a human (github"
        " tomdries/gps-lane-changes, BSD-2)",
        "roads with other numbers of lanes, and short drives from a cold start",
        "much about one method against another: it is one trip, and its lines are a donor's",
    ),
    "two_lines": (
        "the two lines of the own lane, as a telephone's camera gave them, with its failures",
        "whether a method knows that it does not know",
        "anything about detectors that see more; the lane is inferred from merges and a list of"
        " lane changes",
    ),
    "paper": (
        "everything",
        "nothing that ranks: everybody has looked at it, the constants of position in lane were"
        " chosen with it in sight, and the published parameters were tuned on it",
        "-",
    ),
}

REST = """
## What it cannot say

1. It cannot say how a method does with another detector on another road: the lines of *motion* and
   *rotterdam* are frames of the paper's ten recordings, so that whoever has seen these (position in
   lane, whose constants were chosen with them in sight) has seen how their detectors fail.
2. It cannot tell apart what the ranks leave tied: there are three drivers and one trip, so that an
   interval stands on few draws, and it is a development board, not the held-out one.
3. It cannot say what follows from a wrong belief: a lane that is off by one counts as one that is
   off by three, and nothing here brakes or steers.

## How to enter

`egolane benchmark score ENTRY TRACKS... -o mine.json` scores an experiment, a command, a Python
file ([twenty lines of pandas](../../examples/benchmark_entry.py) are one) or a folder of answers,
and cuts recordings at random frames to see whether a belief looks ahead; `egolane benchmark board
mine.json ...` sets it beside others. An answer is two tables for each NAME.csv of a track, with
semicolons: beliefs, `frame_id;p1;p2;...` (NAME.csv; a frame that is left out is silent), and lane
changes, `told_frame;from;to` (NAME.events.csv), in the frame in which each was reported. A command
is given the lines, the number of lanes and the names of these two files. With `--find-lanes` it has
to find the number of lanes, as columns of its beliefs. Entries that look ahead, or wait, are ranked
apart; how a cold start goes is in the column of the first minute.

`egolane benchmark make DIR` makes the tracks *paper* and
*rotterdam* from the paper's recordings, byte for byte, and says so by their checksums. *motion* and
*two_lines* need your own copy of UAH-DriveSet (`--uah FOLDER`), which may not be handed on, changed
or not. The converter was tested on files of its layout only: without a copy the tracks used here,
which were made earlier, by another program, cannot be remade byte by byte.

Held out are the drivers 4 to 6, the trips 2 and 3, and other seeds. The maintainers run an entry on
them (open an issue with a command or a folder for the public part); its scores come back as JSON.

A track from a traffic simulator (SUMO on OpenStreetMap roads; `eclipse-sumo` is on the package
index) has not been made. It would give stress curves and no ranks: its lines would be those of the
detector of `egolane simulate`, which are not real.
"""


def text(board: Board, every: int = 1) -> str:
    """The page. every: so many recordings stand for one, where it was only tried."""
    few = f"**Tried on every {every}th recording only: no board yet.**\n\n"
    parts = [
        HEAD.format(tracks="\n".join(_rows(board))),
        few if every > 1 else "",
        "## What it says\n\n" + "\n".join(f"{k}. {s}" for k, s in enumerate(said(board), 1)) + "\n",
        REST,
        "\n## The board\n\n![Accuracy with intervals, and sure but wrong frames](board.png)\n\n",
        "![Calibration of some entries](calibration.png)\n\n",
        "![Accuracy against the number of lanes](lanes.png)\n\n",
        board.to_text(wide=True).replace("Track ", "### Track "),
    ]
    return "".join(parts) + "\n"


def _rows(board: Board) -> list[str]:
    rows = []
    for name, (real, can, cannot) in TRACKS.items():
        names = {
            row["name"]
            for each in board.entries
            for row in each["recordings"]
            if row["track"].split(",")[0] == name
        }
        if names:
            rows.append(f"| {name} | {real} | {len(names)} | {can} | {cannot} |")
    return rows


def said(board: Board) -> list[str]:
    """Five sentences, each with its numbers."""
    ranked = [track for track in board.tracks if track != "paper"]
    main = "motion, 3 lanes" if "motion, 3 lanes" in board.tracks else ranked[0]

    def gap(one: str, other: str, track: str = main) -> str:
        value, interval = board.difference(one, other, track)
        bounds = f" [{interval[0]:+.3f}, {interval[1]:+.3f}]" if interval else ""
        tie = " (a tie)" if interval and interval[0] <= 0 <= interval[1] else ""
        return f"{value:+.3f}{bounds}{tie}"

    def of(title: str, track: str = main) -> dict[str, float | None]:
        [entry] = [each for each in board.entries if each["title"] == title]
        return scores_of(on_track(entry, track))

    by_track = "; ".join(f"*{track}* {gap(POSITION, PUBLISHED, track)}" for track in ranked)
    blind = next((t for t in ranked if t.startswith("two_lines")), main)
    found = of(POSITION, blind)
    return [
        f"**Position in lane against the paper's graph with its published parameters**, in balanced"
        f" accuracy by paired differences: {by_track}.",
        f"**Fitting the paper's graph to other drivers' drives** changes it on *{main}* by"
        f" {gap(SEARCHED, PUBLISHED)} (searched) and {gap(LEARNED, PUBLISHED)} (tables learned);"
        f" its alternatives, fitted in the same way, differ from these by"
        f" {gap(AUTOREGRESSIVE, SEARCHED)} (autoregressive, searched) and"
        f" {gap(WOR_ON_LANE, LEARNED)} (WOR on Lane, learned), the sticky HMM, searched, by"
        f" {gap(STICKY_SEARCHED, SEARCHED)}.",
        f"**Would learning simply do it?** Gradient boosting on line lists with a filter, which"
        f" knows the donors' failures from other drivers' drives, differs on *{main}* from position"
        f" in lane by {gap(BOOSTING, POSITION)}, from the published graph by"
        f" {gap(BOOSTING, PUBLISHED)}.",
        f"**What the parts of position in lane are worth** on *{main}*: without estimating the"
        f" width {gap(NO_WIDTH, POSITION)}, without motion {gap(NO_MOTION, POSITION)}, without"
        f" flags and LRI {gap(NO_FLAGS, POSITION)}, with one kind of detector"
        f" {gap(NO_SIGHT, POSITION)} (on *{blind}* {gap(NO_SIGHT, POSITION, blind)}); an answer"
        f" that waits for 3 s {gap(AFTER_3_S, POSITION)}.",
        f"**Sure and wrong**: on *{blind}* position in lane is sure in {_share(found['sure'])} of"
        f" the frames and right in {_share(found['right_if_sure'])} of these; on *{main}* in"
        f" {_share(of(POSITION)['sure'])} and {_share(of(POSITION)['right_if_sure'])}. Its first"
        f" minute there is right in {_share(of(POSITION)['first_minute'])}, the whole in"
        f" {_share(of(POSITION)['frames_right'])}.",
    ]


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.1%}"
