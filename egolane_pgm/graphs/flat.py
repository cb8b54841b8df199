"""A network over frames as an ordinary pgmpy network, in which every node of every frame is a node
with its frame: `Lane@17`, or `Lane_0` and `Lane_1` of two slices in a BIF file."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from egolane_pgm.graphs.cpds import Table, quiet, tabular_cpd
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    from pgmpy.models import DiscreteBayesianNetwork

#: The characters that pgmpy's reader of BIF files does not take for a part of a value's name.
_BIF_SYNTAX = set(',;(){}"/\n')


def flat_network(
    tables: Iterable[Table], values: Mapping[str, Sequence[str]], between: str = "@"
) -> DiscreteBayesianNetwork:
    """Declares tables of any number of frames as a pgmpy network without time.

    - tables: the second part of their nodes is a frame, of any number, not a slice
    - values: the names of each node's values; a node without names has pgmpy's own, 0, 1, ...
    - between: what stands between a node's name and its frame
    """
    with quiet():
        from pgmpy.models import DiscreteBayesianNetwork

        network = DiscreteBayesianNetwork()
        for table in tables:
            cpd = tabular_cpd(table, values, lambda node: f"{node[0]}{between}{node[1]}")
            network.add_node(cpd.variable)
            network.add_edges_from([(p, cpd.variable) for p in cpd.variables[1:]])
            network.add_cpds(cpd)
        return network


def bif(tables: Iterable[Table], values: Mapping[str, Sequence[str]]) -> str:
    """The two slices of a network in the Bayesian interchange format: the nodes are `Lane_0` and
    `Lane_1`, the numbers are exact.

    Raises InputError, naming the node, for names that the format cannot hold.
    """
    network = flat_network(tables, values, between="_")
    for cpd in network.cpds:
        if not re.fullmatch(r"[\w.-]+", cpd.variable):
            raise InputError(f"{cpd.variable}: a BIF file cannot hold this name of a node")
        for name in map(str, cpd.state_names[cpd.variable]):
            if not name or name != name.strip() or set(name) & _BIF_SYNTAX:
                raise InputError(f"{cpd.variable}: a BIF file cannot hold the value name {name!r}")
    with quiet():
        from pgmpy.readwrite import BIFWriter

        return str(BIFWriter(network))
