"""What happens to the lanes of a road from one frame to the next, as the values of an input node.

A road of n lanes goes on as one of n' lanes; lane i continues as lane i + shift. What the map says
of a frame is a step, and the steps of a drive are written as one text, with blanks between them:

    3          n is 3, and nothing changes
    3>4+0      from 3 lanes to 4, lane i goes on as lane i (the new lane is at the right)
    3>4+1      the same, but lane 1 goes on as lane 2 (the new lane is at the left)
    3>4?       it is not known at which side the new lane is
    3>4+0@7    the change may be here: at the seventh of the PLACES around the join of the map
    hold       between two of these places
    3~         n is a guess, which may be wrong; 3>4+0~ is a change to a guess, 3>3?~ the begin of a
               stretch with a guess of the same number, 3>3? its end
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from egolane_pgm.parameters import Parameter
from egolane_pgm.types import FloatArray, InputError

#: The parameters of the graphs of roads whose lanes change.
TOLD_STEPS = Parameter(
    "steps",
    "text",
    "",
    "the values of Step, with blanks between them, such as `3 3>4+0 4`; empty for a road that"
    " does not change. With `n_lanes: map` they are those of the drive",
    search=None,
)
CHANGE_AT_RIGHT = Parameter(
    "change_at_right",
    "probability",
    0.95,
    "P(lanes begin and end at the right), where the map does not give the side",
    search=None,
)

GUESS_WRONG = Parameter(
    "guess_wrong",
    "probability",
    0.25,
    "P(there is a lane less or more than was guessed from the road around, where the map does not"
    " tell the number), both equally likely; 0 for a guess that counts as the map does",
    search=None,
)
MAP_STAYS = Parameter(
    "map_stays",
    "probability",
    0.9999,
    "P(the map, or a guess, stays as right or wrong as it is) from frame to frame",
    search=None,
)

#: How far before (negative) or behind the join of the map a change of lanes may be, in standard
#: deviations of the map's error along the road.
PLACES = tuple(np.arange(-2.0, 2.01, 0.5).tolist())

_STEP = re.compile(r"(\d+)(?:>(\d+)(?:([+-]\d+)|\?)(?:@([1-9]))?)?(~)?")


@dataclass(frozen=True)
class Step:
    """One step.

    - before, after: lanes of the road before and after; 0 and 0 between two places of a change.
    - shift: lane i goes on as lane i + shift; None unknown.
    - place: at which of PLACES (from 1) this is; None for a step that is known to happen in its
      frame.
    - is_guess: whether `after` is one.
    """

    before: int
    after: int
    shift: int | None = 0
    place: int | None = None
    is_guess: bool = False

    @property
    def is_change(self) -> bool:
        """Whether the road is another one after it."""
        return self != Step(self.before, self.before, is_guess=self.is_guess)

    def __str__(self) -> str:
        if not self.before:
            return "hold"
        guess = "~" if self.is_guess else ""
        if not self.is_change:
            return f"{self.before}{guess}"
        shift = "?" if self.shift is None else f"{self.shift:+d}"
        place = "" if self.place is None else f"@{self.place}"
        return f"{self.before}>{self.after}{shift}{place}{guess}"


HOLD = Step(0, 0)


def read_steps(text: str, n_lanes: int) -> tuple[Step, ...]:
    """The steps of a text; of an empty one the step of a road of n lanes on which nothing changes.

    Raises InputError for a word that is no step, and for lanes outside of 1..n_lanes.
    """
    return tuple(_read(word, n_lanes) for word in text.split()) or (Step(n_lanes, n_lanes),)


def _read(word: str, n_lanes: int) -> Step:
    if word == str(HOLD):
        return HOLD
    found = _STEP.fullmatch(word)
    if found is None:
        raise InputError(f"steps: '{word}' is no step such as 3, 3>4+0, 3>4? or 3>4+0@5")
    before, after, shift, place, guess = found.groups()
    if after is None:
        step = Step(int(before), int(before), is_guess=bool(guess))
    else:
        # A change of unknown shift has a question mark in its place.
        step = Step(
            int(before),
            int(after),
            None if shift is None else int(shift),
            None if place is None else int(place),
            bool(guess),
        )
    if not 1 <= min(step.before, step.after) <= max(step.before, step.after) <= n_lanes:
        raise InputError(f"steps: '{word}': lanes are outside 1..{n_lanes}")
    return step


def passing() -> FloatArray:
    """(K,): for each of PLACES the probability that the lanes change there, if they did not at the
    places before: a normal around the join of the map, cut off at the ends."""
    mass = np.exp(-0.5 * np.square(PLACES))
    left = mass[::-1].cumsum()[::-1]
    return np.asarray(mass / left)


def survivors(
    before: int, after: int, shift: int | None, change_at_right: float = 1.0
) -> FloatArray:
    """Where the lanes of a road go: (before, after), each row sums to 1.

    Lane i goes on as lane i + shift; a lane that ends goes to the nearest that goes on.

    - shift: None where it is not known at which side lanes begin or end.
    - change_at_right: P(at the right) then.
    """
    if shift is None:
        at_right = survivors(before, after, 0)
        at_left = survivors(before, after, after - before)
        return change_at_right * at_right + (1 - change_at_right) * at_left
    onto = np.clip(np.arange(before) + shift, 0, after - 1)
    return np.asarray(np.eye(after)[onto])
