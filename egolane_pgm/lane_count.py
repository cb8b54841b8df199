"""Whether a recording's lines fit the number of lanes that the road is said to have."""

from __future__ import annotations

from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.loading import Recorded
from egolane_pgm.model import make_evidence, prepare_model
from egolane_pgm.types import MAX_LANES, InputError

#: By how much the logarithm of the evidence of another road has to be higher to be worth a word.
#: On the paper's ten recordings that of the right number of lanes is higher by 23 or more.
WORTH_A_WORD = 5.0


def log_evidence_by_lanes(experiment: Experiment, recorded: Recorded) -> dict[int, float]:
    """How well the lines of a whole recording fit a road with as many lanes as the experiment says,
    with one less and with one more: the log evidence, by the number of lanes.

    Each frame's likelihood is scaled to 1 at its largest, so that this is no Bayes factor: it says
    how well one drive explains what each frame says by itself. On a road of one lane any frame
    explains any other, so that this road is not compared. The number of lanes was the one that fits
    best of 2 to 6 in simulated drives on 2, 3, 4 and 5 lanes, and of its neighbours in each of the
    paper's ten.

    Only graphs that follow the car's position across the road have likelihoods of the lines
    themselves. For all others the answer is empty, and so it is where parameters are those of this
    number of lanes (learned ones).
    """
    found: dict[int, float] = {}
    said = experiment.n_lanes
    if said == 1:
        return found
    for n_lanes in range(max(said - 1, 2), min(said + 1, MAX_LANES) + 1):
        try:
            model = prepare_model(
                load_experiment(experiment, {"n_lanes": n_lanes, "ground_truth": None})
            )
        except InputError:
            return {}
        if "RoadPosition" not in model.compiled.hidden:
            return {}
        evidence = make_evidence(model, recorded.log, experiment.evidence_reading).filtered
        beliefs = filter_beliefs(model.compiled, evidence, "exact")
        found[n_lanes] = float(beliefs.log_evidence.sum())
    return found


def doubt_of_lanes(experiment: Experiment, recorded: Recorded) -> str | None:
    """A line that says which number of lanes the lines fit better; None where there is none."""
    found = log_evidence_by_lanes(experiment, recorded)
    if not found:
        return None
    said, best = experiment.n_lanes, max(found, key=found.__getitem__)
    more = found[best] - found[said]
    if more < WORTH_A_WORD:
        return None
    return (
        f"{recorded.log.source}: the lines fit a road of {best} lanes better than one of {said}"
        f" (log evidence {more:.0f} higher); is n_lanes right?"
    )
