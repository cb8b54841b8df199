"""A network over frames as an ordinary pgmpy network, in which every node of every frame is a node
of its own: `Lane@17`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from egolane_pgm.graphs.cpds import Table, quiet

if TYPE_CHECKING:
    from pgmpy.models import DiscreteBayesianNetwork


def flat_network(
    tables: Iterable[Table], values: Mapping[str, Sequence[str]], between: str = "@"
) -> DiscreteBayesianNetwork:
    """Declares tables of any number of frames as a pgmpy network without time.

    - tables: the second part of their nodes is a frame, of any number, not a slice
    - values: the names of each node's values; a node without names has pgmpy's own, 0, 1, ...
    - between: what stands between a node's name and its frame
    """
    with quiet():
        from pgmpy.factors.discrete import TabularCPD
        from pgmpy.models import DiscreteBayesianNetwork

        network = DiscreteBayesianNetwork()
        for table in tables:
            axes = zip((*table.parents, table.node), table.values.shape, strict=True)
            names = {
                f"{name}{between}{frame}": list(values.get(name, range(size)))
                for (name, frame), size in axes
            }
            *parents, node = names
            network.add_node(node)
            network.add_edges_from([(parent, node) for parent in parents])
            columns = table.values.reshape(-1, table.values.shape[-1]).T
            shape = table.values.shape[:-1]
            network.add_cpds(TabularCPD(node, len(columns), columns, parents, shape, names))
        return network
