"""How often a run warns of the number of lanes, told right and wrong by one."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence

from egolane_pgm.experiment import experiments_folder, load_experiment
from egolane_pgm.lane_count import doubt_of_lanes
from egolane_pgm.model import make_evidence
from makers.beyond.strangers import zero_label
from tests.kits.strangers import STRANGERS, Drive, paper_drive

#: The strangers that are tried here.
TRIED = (
    "as recorded",
    "like run 5",
    "like run 5, scale off by 15 % for 20 s",
    "offsets x 0.5",
    "offsets alone, of valid lines",
    "nearest 2 lines",
    "the nearest line only",
    "60 % of lines missing",
    "every 5th frame, ids jump",
    "a line of clutter, for 2 s each",
    "noise of .3 m",
    "camera .6 m off",
    "double lines, 20 cm apart",
    "a line .9 lanes right of the road",
    "blind for 2 s, 30 % of the time",
    "mirrored",
    "half of the lines mirrored",
    "half of the middle lines missing, for 5 s each",
    "stands still for ten minutes",
)

TEXT = """\
# A number of lanes that is wrong by one, and a scale that changes

`egolane run`, `ego.run` and `egolane label` warn in one line where a graph follows the car across
the road (`position_in_lane`) and the whole recording shows another number of lanes than `n_lanes`
(`egolane_pgm.lane_count`). Streams do not.

- *More lanes* show in the place inside the lane and the motion of the lines, without any
  evidence of which lane it is: a car that crosses n lines to one side has no place on a road of n
  lanes. The warning needs log odds of 15, and lines that do not speak against one more lane (by
  less than 30). On the ten recordings motion has 41 to 103 if one too few was told, and up to 3 if
  the right number was. Without the second condition a long drive is enough: motion that is misread
  while the detector fails finds room on a wider road, every time.
- *Fewer lanes* show in the lines, in how well one drive explains each frame. The warning needs log
  odds of 25, and motion that does not speak for the given number of lanes (by less than 7). Without
  the second condition, noise or lines beside the road are enough. On the ten recordings the lines
  have 28 to 120 if one too many was told; motion has 40 to 103 for the right number.

In a drive of more than 10,000 frames the 30, the 25 and the 7 are in proportion to its length.

Five minutes of a drive tell less: motion has 8 to 33 for a lane that was left out, the lines have 5
to 27 against one that is not there. On simulated drives of ten minutes on a road with a lane that
the car is never in, which motion does not miss, the lines have up to 22 against it.

| | drives | right number told: warned | one too few: warned rightly, wrongly | one too many |
|---|--:|--:|--:|--:|"""

SCALE = """
A warning of a change of scale is given if the lane widths of the two halves of a recording differ
by more than 10 % and each has log odds of 20 or more. It is right on all ten recordings with a
scale of 0.6 from the middle on. In 700 stretches of the ten, 30 seconds to ten minutes long, it is
never given; with 5 % and widths that are sure (log odds of 3), it would be wrong in 76."""


def verdict(drive: Drive, n_lanes: int, overrides: tuple[str, ...] = ()) -> int:
    """1 if a warning says that there are more lanes than told, -1 if fewer, 0 if there is none."""
    model = zero_label(n_lanes, overrides)
    experiment = load_experiment(
        experiments_folder() / "zero_label.yaml", (*overrides, f"n_lanes={n_lanes}")
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        evidence = make_evidence(model, drive.log).filtered
    said = doubt_of_lanes(experiment, model, drive.log, evidence)
    return 0 if said is None else 1 if "too small" in said else -1


def measure(runs: Sequence[int], only: str, overrides: Sequence[str]) -> Iterator[str]:
    """How often a warning is given if n, n - 1 and n + 1 lanes are told."""
    yield TEXT
    for name in TRIED:
        if only not in name:
            continue
        drives = [drive for run in runs for drive in STRANGERS[name](paper_drive(run))]
        right, few, many = (
            [verdict(drive, drive.n_lanes + told, tuple(overrides)) for drive in drives]
            for told in (0, -1, 1)
        )
        cells = [
            f"{len(drives)}",
            f"{len(right) - right.count(0)}",
            f"{few.count(1)}, {few.count(-1)}",
            f"{many.count(-1)}, {many.count(1)}",
        ]
        yield f"| {name} | {' | '.join(cells)} |"
    yield SCALE
