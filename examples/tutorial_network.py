"""A network as pgmpy's own examples declare one: edges, a table for each node, nothing else.

The nodes Lane, DetectorOutput and WOR carry the names that the counting rule's evidence has; every
other node is hidden.
"""

from pgmpy.factors.discrete import TabularCPD
from pgmpy.models import DynamicBayesianNetwork

network = DynamicBayesianNetwork(
    [
        (("Lane", 0), ("Lane", 1)),
        (("Sensor", 0), ("Sensor", 1)),
        (("Lane", 0), ("DetectorOutput", 0)),
        (("Sensor", 0), ("DetectorOutput", 0)),
        (("Sensor", 0), ("WOR", 0)),
    ]
)

lane_first = TabularCPD(("Lane", 0), 4, [[0.25], [0.25], [0.25], [0.25]])
lane_next = TabularCPD(
    ("Lane", 1),
    4,
    [
        [0.98, 0.01, 0.00, 0.00],
        [0.02, 0.98, 0.01, 0.00],
        [0.00, 0.01, 0.98, 0.02],
        [0.00, 0.00, 0.01, 0.98],
    ],
    evidence=[("Lane", 0)],
    evidence_card=[4],
)
sensor_first = TabularCPD(("Sensor", 0), 2, [[0.5], [0.5]])
sensor_next = TabularCPD(
    ("Sensor", 1),
    2,
    [[0.95, 0.05], [0.05, 0.95]],
    evidence=[("Sensor", 0)],
    evidence_card=[2],
)
detector = TabularCPD(
    ("DetectorOutput", 0),
    4,
    [
        # Sensor 0, lanes 1 to 4; then Sensor 1.
        [0.85, 0.10, 0.02, 0.02, 0.25, 0.25, 0.25, 0.25],
        [0.11, 0.78, 0.10, 0.02, 0.25, 0.25, 0.25, 0.25],
        [0.02, 0.10, 0.78, 0.11, 0.25, 0.25, 0.25, 0.25],
        [0.02, 0.02, 0.10, 0.85, 0.25, 0.25, 0.25, 0.25],
    ],
    evidence=[("Sensor", 0), ("Lane", 0)],
    evidence_card=[2, 4],
)
wor = TabularCPD(
    ("WOR", 0), 2, [[0.7, 0.3], [0.3, 0.7]], evidence=[("Sensor", 0)], evidence_card=[2]
)

network.add_cpds(lane_first, lane_next, sensor_first, sensor_next, detector, wor)
network.initialize_initial_state()
