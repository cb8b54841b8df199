"""The paper's graph without WOR: SensorState is inferred from the detector output alone."""

from __future__ import annotations

from egolane_pgm.graphs import sensor_failure

HIDDEN = sensor_failure.HIDDEN
OBSERVED = ("DetectorOutput",)
UNUSED = ("WOR",)
VALUES = {"SensorState": ("OK", "BAD")}
PARAMETERS = tuple(p for p in sensor_failure.PARAMETERS if p.name not in ("p3", "p4"))

# As `sensor_failure`, without Table `tab:cptri`.
tables = sensor_failure.tables_without_wor
