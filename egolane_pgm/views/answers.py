"""What figures and pages show of a result: titles, answers with the truth, and colours that
colour-blind readers can tell apart."""

from __future__ import annotations

from egolane_pgm.results import Result
from egolane_pgm.types import UNASSIGNED, BoolArray, FloatArray, InputError, IntArray

INK, FAINT, CROSSING = "#222222", "#b8b8b8", "#8c8c8c"

#: The colours of detector and model where a figure shows both: Okabe and Ito's vermillion and blue.
DETECTOR_COLOUR, MODEL_COLOUR = "#d55e00", "#0072b2"

#: From white to dark blue. The lightness falls all the way, so that a print in grey shows it too.
PROBABILITY_COLOURS = ("#ffffff", "#bcd7ec", "#5fa5d6", "#0072b2", "#00355c")

#: Right answers are blue; the further off an answer, the darker its orange-brown. All common kinds
#: of colour blindness keep the contrast between blue and orange.
RIGHT_COLOUR, UNASSIGNED_COLOUR = "#0072b2", "#1a1a1a"


#: What is believed of a lane that the map does not have is shown from this probability.
UNSEEN = 0.02


def title_of(result: Result) -> str:
    """The run's name, marked where its parameters were tuned on the frames that are scored."""
    mark = " (in-sample)" if result.run.get("tuned_on") == "same_frames" else ""
    return f"{result.run['name']}{mark}"


def title_with_frames(result: Result) -> str:
    """A title with the number of scored frames. Raises InputError if there are none."""
    return f"{title_of(result)}: {int(is_scored(result).sum()):,} frames"


def is_known(result: Result) -> BoolArray:
    """Which frames, (T,), are annotated and not crossing: an answer is right or wrong."""
    known: BoolArray = (result.true_lane != UNASSIGNED) & ~result.is_crossing
    return known


def is_scored(result: Result) -> BoolArray:
    """`is_known`. Raises InputError if there are none."""
    scored = is_known(result)
    if not scored.any():
        raise InputError(
            f"{result.directory}: has no ground truth to compare with (no annotated frame that is"
            " not crossing); run the experiment with a ground_truth"
        )
    return scored


def answers(result: Result) -> dict[str, tuple[FloatArray, IntArray]]:
    """The belief (T, n) and the assigned lane (T,) of "Detector only" and "Model". The detector is
    absent without a tentative vector."""
    both = {}
    if result.tentative is not None and result.detector_lane is not None:
        both["Detector only"] = (result.tentative, result.detector_lane)
    both["Model"] = (result.marginals["Lane"], result.assigned_lane)
    return both


def scored_answers(
    result: Result,
) -> dict[str, tuple[FloatArray, IntArray, IntArray, BoolArray]]:
    """As `answers`, over the scored frames only: belief, assigned lane, true lane and crossing of
    each. Raises InputError if there are none."""
    chosen = is_scored(result)
    truth = result.true_lane[chosen], result.is_crossing[chosen]
    return {
        name: (belief[chosen], assigned[chosen], *truth)
        for name, (belief, assigned) in answers(result).items()
    }


def lane_names(n_lanes: int) -> list[str]:
    """Names for axes that tell the order of the lanes: "lane 1 (leftmost)", "lane 2", ..."""
    return [f"lane {k}{' (leftmost)' if k == 1 else ''}" for k in range(1, n_lanes + 1)]


def percent(share: float) -> str:
    """A share as a percentage, with one decimal; without for exactly 0 and 1."""
    value = 100 * float(share)
    if 0 < value < 0.05:
        return "<0.1"
    if 99.95 <= value < 100:
        return ">99.9"
    return f"{value:.0f}" if value in (0.0, 100.0) else f"{value:.1f}"
