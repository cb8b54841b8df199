"""The line geometry, shown neither continuous flags nor LRI."""

from dataclasses import replace

import numpy as np

from egolane_pgm.evidence import line_geometry
from egolane_pgm.evidence.line_geometry import INPUTS, PARAMETERS, PROVIDES, looks_ahead  # noqa: F401


def evidence(log, n_lanes, parameters):
    return line_geometry.evidence(_bare(log), n_lanes, parameters)


def online(n_lanes, parameters):
    given = line_geometry.online(n_lanes, parameters)
    return lambda log: given(_bare(log))


def _bare(log):
    unknown = np.full_like(log.lri, np.nan)
    return replace(log, is_continuous=np.zeros_like(log.is_continuous), lri=unknown)
