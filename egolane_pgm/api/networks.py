"""Networks of one's own: `compile`, and the picture of a network, `draw_network`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from egolane_pgm.inference.compile import Compiled, compile_network
from egolane_pgm.model import Model
from egolane_pgm.types import Observed

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def compile(
    network: Any,
    observed: Sequence[Observed],
    *,
    hidden: Sequence[str] | None = None,
    inputs: Sequence[str] = (),
    transition: Sequence[Any] | None = None,
) -> Compiled:
    """Turn a pgmpy network into the arrays that `filter_beliefs` and its kin take.

    - network: a `DynamicBayesianNetwork`; a `DiscreteBayesianNetwork` of one slice, with
      `transition`, or of two; or the name of a BIF or XMLBIF file.
    - observed: the nodes that there is evidence of; a tuple of nodes is observed jointly.
    - hidden: those whose beliefs are asked for; by default all others, and Lane.
    - inputs: nodes whose values are given in every frame.
    - transition: for one slice, pgmpy's `TabularCPD`s of (name, 1) given (name, 0) and (name, 1).

    Warns of observed nodes without a virtual-evidence child, `<name>_ve`, which is added. Raises
    InputError, naming the node, for what the filters cannot do.

    >>> import warnings
    >>> import numpy as np
    >>> import egolane_pgm as ego
    >>> from pgmpy.factors.discrete import TabularCPD
    >>> from pgmpy.models import DynamicBayesianNetwork
    >>> network = DynamicBayesianNetwork([(("Lane", 0), ("Lane", 1)), (("Lane", 0), ("Line", 0))])
    >>> network.add_cpds(
    ...     TabularCPD(("Lane", 0), 2, [[0.5], [0.5]]),
    ...     TabularCPD(("Lane", 1), 2, [[0.9, 0.1], [0.1, 0.9]], [("Lane", 0)], [2]),
    ...     TabularCPD(("Line", 0), 2, [[0.8, 0.2], [0.2, 0.8]], [("Lane", 0)], [2]),
    ... )
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore")  # Line has no virtual-evidence node
    ...     compiled = ego.compile(network, observed=["Line"])
    >>> compiled
    Compiled(Lane (2): 2 joint states; observes Line)
    >>> seen = ego.Evidence({"Line": np.array([[1.0, 0.0], [1.0, 0.0]])})
    >>> ego.filter_beliefs(compiled, seen, "exact").lane.round(3).tolist()
    [[0.8, 0.2], [0.919, 0.081]]
    """
    return compile_network(network, hidden, observed, inputs, transition=transition)


def draw_network(network: Model | Compiled) -> Figure:
    """Draw the two slices of a network, hidden, observed, input and function nodes as what they
    are.

    - network: the model of a run, or what `compile` gives.

    Raises InputError for a network without nodes or with a cycle.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> figure = ego.draw_network(run.model)
    """
    from egolane_pgm.report.network import network_figure
    from egolane_pgm.report.structure import structure_of
    from egolane_pgm.report.style import inline_figure

    compiled = network if isinstance(network, Compiled) else network.compiled
    return inline_figure(lambda: network_figure(structure_of(compiled)))
