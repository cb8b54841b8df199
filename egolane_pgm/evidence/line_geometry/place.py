"""Where in its lane the car is, whichever lane that is, from the lines alone.

Lines lie on a lattice whose step is the lane width, so each reliable one says the place as an
angle: a car in the middle of a lane has lines half a step to either side. The place is the mean of
these angles over the lines of late. That takes no belief: it serves graphs without RoadPosition.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable

import numpy as np

from egolane_pgm.evidence.line_geometry.habits import FULL_LRI, Habits, translated
from egolane_pgm.evidence.line_geometry.model import LANE_M, line_classes
from egolane_pgm.evidence.line_geometry.scale import follow, new_belief
from egolane_pgm.parameters import Parameters
from egolane_pgm.types import FloatArray, LineLog

#: Lines farther away, in lane widths, do not count: an error of the width moves them the more.
REACH = 1.5

#: The mean is over about this time, seconds. A car that changes lane in 5 s goes a tenth of a lane
#: meanwhile, which is how well the place is known.
MEAN_S = 0.5

#: The place is not known where the mean is shorter (1: one line, always at the same place). It is
#: so about a second after the last line.
DEFINITE = 0.1


def place_finder(parameters: Parameters) -> Callable[[LineLog], FloatArray]:
    """A function that gives the place in T frames, (T,): lane widths right of the lane's middle,
    -.5 to .5, NaN where it is not known. It knows the frames so far, however they are grouped.

    - parameters: of any rule; those that are numbers of `lane_width_m` (expected) and `max_lri`.
    """
    given = {name: value for name, value in parameters.items() if isinstance(value, int | float)}
    detector = Habits(given.get("max_lri", FULL_LRI), says_valid=True, says_continuous=True)
    width, mean, last_s = new_belief(given.get("lane_width_m", LANE_M)), 0j, -math.inf

    def places_of(recorded: LineLog) -> FloatArray:
        nonlocal mean, last_s
        log = translated(recorded, detector)
        _, is_strong = line_classes(log)
        widths = follow(width, log.offset_m, is_strong)
        away = log.offset_m / widths[:, widths.shape[1] // 2, None]
        near = is_strong & (np.abs(away) < REACH)
        seen = np.exp(-2j * math.pi * away, where=near, out=np.zeros(near.shape, dtype=complex))
        place = np.full(len(log), np.nan)
        for t, time_s in enumerate(log.time_s.tolist()):
            kept = math.exp(-max(time_s - last_s, 0.0) / MEAN_S)
            mean, last_s = kept * mean - (1 - kept) * sum(seen[t].tolist()), time_s
            if abs(mean) >= DEFINITE:
                place[t] = cmath.phase(mean) / (2 * math.pi)
        return place

    return places_of
