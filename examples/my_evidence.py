"""An own evidence rule: the paper's counting rule, tempered.

Lines of neighbouring frames are not independent, so each frame may say less than it seems to.
"""

from egolane_pgm.evidence import counting
from egolane_pgm.parameters import Parameter
from egolane_pgm.types import Evidence

PARAMETERS = (
    *counting.PARAMETERS,
    Parameter("tempering", "probability", 0.5, "exponent of the tentative vector"),
)
PROVIDES = counting.PROVIDES
TENTATIVE = "DetectorOutput"  # this evidence is an answer of its own: scored as "detector"


def evidence(log, n_lanes, parameters):
    given = counting.evidence(log, n_lanes, parameters).likelihoods
    tempered = given["DetectorOutput"] ** parameters["tempering"]
    return Evidence({"DetectorOutput": tempered, "WOR": given["WOR"]})
