"""Whether a recording's lines fit the number of lanes that the road is said to have.

Only graphs that follow the car's position across the road can show it. The place inside the lane
and the motion of the lines show that there are more lanes, without any evidence of which lane it
is: a car that crosses n lines to one side has no place on a road of n lanes. Lanes that it was
never in cost nothing, so that motion cannot show that there are fewer lanes; the lines seen beside
the car do.

Motion that is misread (the car changes lane while the detector fails, all lines jump) finds more
room on a wider road, every time. Its log odds for one lane more therefore grow with a drive: on
simulated ones by up to 1.4 in 1,000 frames, as fast as those for a lane that is there and seldom
driven. So the lines decide in both cases: their log odds against a lane that is not there are 3.5
or more in 1,000 frames.
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.graphs.cpds import declare
from egolane_pgm.inference.compile import compile
from egolane_pgm.inference.smoothing import pass_forward
from egolane_pgm.model import Model, make_evidence, prepare_model
from egolane_pgm.types import MAX_LANES, Evidence, FloatArray, InputError, LineLog

#: A warning says that there are more lanes if motion has at least the first log odds (natural) for
#: one more, and the lines have less than the second against it. On the paper's ten recordings
#: motion has 40 or more if n_lanes is one too small, and up to 3 if it is right.
MORE, AGAINST = 15.0, 30.0

#: A warning says that there are fewer lanes if motion has less than the first log odds against one
#: less, and the lines have at least the second ones for it. On the ten recordings motion has up to
#: 3 and the lines 28 or more if n_lanes is one too large; motion has 40 or more if it is right. On
#: simulated roads with a lane that the car is never in, the lines have up to 22.
ALIKE, FEWER = 7.0, 25.0

#: AGAINST, ALIKE and FEWER hold for drives of up to this many frames, and in proportion for more.
FRAMES = 10_000

_JOINT = ("RoadPosition", "SensorState")


def doubt_of_lanes(
    experiment: Experiment, model: Model, log: LineLog, evidence: Evidence
) -> str | None:
    """A line that says which number of lanes a whole recording shows, if that is not `n_lanes`;
    None where there is nothing to say, for a clip and where a map gives the lanes.

    - model, evidence: of the experiment; evidence of the T frames of the log.
    """
    if log.clip is not None or experiment.follows_map or experiment.evidence_reading != "soft":
        return None
    n, longer = model.n_lanes, max(len(log) / FRAMES, 1.0)
    motion = motion_by_lanes(model, evidence)
    more = motion.get(n + 1, -np.inf) - motion.get(n, 0.0)
    of_lines = (experiment, model, log, evidence)
    if more >= MORE and odds_of(n + 1, *of_lines) > -AGAINST * longer:
        return (
            f"{log.source}: the car moves across {n + 1} lanes or more, n_lanes is {n} (log"
            f" odds {more:.0f}); is it too small?"
        )
    if motion.get(n - 1, -np.inf) <= motion.get(n, 0.0) - ALIKE * longer:
        return None
    fewer = odds_of(n - 1, *of_lines)
    if fewer < FEWER * longer:
        return None
    return (
        f"{log.source}: the lines fit a road of {n - 1} lanes better, n_lanes is {n} (log"
        f" odds {fewer:.0f}); is it too large?"
    )


def motion_by_lanes(model: Model, evidence: Evidence) -> dict[int, float]:
    """The log evidence of the place inside the lane and the motion of the lines, by the number of
    lanes of the road: the model's, one less and one more.

    It is empty for graphs and evidence that do not separate these from the lane.
    """
    compiled = model.compiled
    places = _places(model, evidence)
    if places is None or not hasattr(model.graph, "tables"):
        return {}
    kept = {"RoadPosition", "Lane", *compiled.inputs}
    found = {}
    for n_lanes in range(max(model.n_lanes - 1, 1), min(model.n_lanes + 1, MAX_LANES) + 1):
        tables = (
            compiled.tables.values()
            if n_lanes == model.n_lanes
            else model.graph.tables(n_lanes, model.parameters)
        )
        # The sensor does not matter where there is no evidence of the lane.
        road = compile(
            declare([t for t in tables if t.node[0] in kept], ["RoadPosition"]),
            hidden=("RoadPosition", "Lane"),
            observed=["RoadPosition"],
            inputs=compiled.inputs,
        )
        seen = Evidence({"RoadPosition": np.tile(places, n_lanes)}, evidence.inputs)
        found[n_lanes] = float(pass_forward(road, seen).log_evidence.sum())
    return found


def _places(model: Model, evidence: Evidence) -> FloatArray | None:
    """The likelihood of each place inside the lane, (T, cells), given a failing sensor. None where
    that depends on the lane too."""
    joint = evidence.likelihoods.get(_JOINT)
    bad = model.compiled.values.get("SensorState", ())
    if joint is None or "BAD" not in bad or joint.shape[1] % model.n_lanes:
        return None
    of_road = joint[..., bad.index("BAD")]
    first = of_road[:, : joint.shape[1] // model.n_lanes]
    if not np.array_equal(of_road, np.tile(first, model.n_lanes)):
        return None
    largest = first.max(axis=1, keepdims=True, initial=0.0)
    return np.asarray(np.where(largest > 0, first / np.where(largest > 0, largest, 1.0), 1.0))


def odds_of(
    n_lanes: int, experiment: Experiment, model: Model, log: LineLog, evidence: Evidence
) -> float:
    """The log odds of a road of another number of lanes, given the lines.

    Each frame's likelihood is scaled to 1 at its largest, so that this is no Bayes factor: it says
    how well one drive explains each frame. On a road of one lane any frame explains any other, so
    that this road is not compared; nor is one for which parameters do not fit (learned ones). The
    odds are 0 then.
    """
    if min(n_lanes, model.n_lanes) < 2:
        return 0.0
    try:
        other = prepare_model(
            load_experiment(experiment, {"n_lanes": n_lanes, "ground_truth": None})
        )
    except InputError:
        return 0.0
    pairs = ((other, make_evidence(other, log).filtered), (model, evidence))
    found = [pass_forward(m.compiled, e).log_evidence.sum() for m, e in pairs]
    return float(found[0] - found[1])
