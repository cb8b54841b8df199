"""The paper's graph without WOR: SensorState is inferred from the detector output alone."""

from __future__ import annotations

from egolane_pgm.graphs import sensor_failure
from egolane_pgm.graphs.cpds import Table, builder
from egolane_pgm.parameters import Parameters

HIDDEN = sensor_failure.HIDDEN
OBSERVED = ("DetectorOutput",)
UNUSED = ("WOR",)
VALUES = {"SensorState": ("OK", "BAD")}
PARAMETERS = tuple(p for p in sensor_failure.PARAMETERS if p.name not in ("p3", "p4"))


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """As `sensor_failure`, without Table `tab:cptri`."""
    return sensor_failure.tables_without_wor(n_lanes, parameters)


build = builder(tables, OBSERVED)
