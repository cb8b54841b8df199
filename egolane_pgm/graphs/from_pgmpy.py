"""Read a pgmpy network, or a file that pgmpy reads, into tables with named axes.

Axes go by the names of the nodes, and where a CPD names the values of a node, by these names too;
never by position. A network is one of

- a `DynamicBayesianNetwork`, before or after its `initialize_initial_state()`;
- a `DiscreteBayesianNetwork` of two slices, whose nodes are named `Lane_0` and `Lane_1`, or
  ("Lane", 0) and ("Lane", 1), as `get_constant_bn()` and BIF files have them.

A table missing in one slice is copied from the other one, if the node has the same parents.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from egolane_pgm.contracts import Graph
from egolane_pgm.graphs.cpds import SliceNode, Table, check_tables, quiet, spell
from egolane_pgm.plugins import same
from egolane_pgm.tools.files import read_text
from egolane_pgm.types import FloatArray, InputError, problems_in

#: The suffixes of the files that pgmpy reads: BIF and XMLBIF.
NETWORK_FILES = (".bif", ".xmlbif", ".xml")

#: A half-open or closed interval, as R's `cut` names the values of a node.
_INTERVAL = re.compile(r"([\[(])\s*([-+.\w]+)\s*,\s*([-+.\w]+)\s*([\])])")

#: A row whose sum is off by no more than this was rounded, and is divided by its sum; pgmpy's own
#: check allows as much.
ROUNDED = 0.01


@dataclass(frozen=True)
class Declared:
    """The tables of a network, and the names of its nodes' values.

    - tables: the table of every node in both slices
    - values: the names of each node's values, if they are not pgmpy's default, 0, 1, ...
    """

    tables: Mapping[SliceNode, Table]
    values: Mapping[str, tuple[Any, ...]]


def read_network(network: Any) -> Declared:
    """Read a pgmpy network, or a file that pgmpy reads.

    - network: one of those above, or the name of a BIF or XMLBIF file.

    Raises InputError, naming the node, for what is not discrete, has no tables or tables that do
    not fit its edges or each other, and for edges that form a cycle or lead back in time.
    """
    if isinstance(network, (str, Path)):
        read = read_file(Path(network))
        with problems_in(str(network)):
            return read_network(read)
    _check_discrete(network)
    parents = {_of_slice(n): list(map(_of_slice, network.predecessors(n))) for n in network}
    for name, s in list(parents):
        # A node that is not declared in one slice has the parents that it has within the other.
        parents.setdefault((name, 1 - s), [(p, 1 - s) for p, q in parents[name, s] if q == s])
    cpds = list(map(_read_cpd, network.cpds))
    if not cpds:
        raise InputError("the network has no tables: give each node a TabularCPD with add_cpds")
    # Names of values from a node's own CPD go before those from a child's.
    values: dict[str, tuple[Any, ...]] = {}
    for axes in (slice(0, 1), slice(1, None)):
        for cpd in cpds:
            for (name, _), names in zip(cpd.nodes[axes], cpd.names[axes], strict=True):
                if not _is_numbered(names):
                    values.setdefault(name, names)
    tables = _tables(cpds, values, parents)
    check_tables(tables.values())
    return Declared(tables, values)


def node_names(network: Any) -> set[str]:
    """Return the names of the nodes of a network of two slices.

    Raises InputError as `read_network`.
    """
    _check_discrete(network)
    return {_of_slice(node)[0] for node in network}


# --- networks -----------------------------------------------------------------------------------


class _Cpd(NamedTuple):
    """A CPD of pgmpy: an axis of `values` and the names of its values for each node, its own first.

    - is_filled_in: whether pgmpy itself may have made it; its nodes are not the user's pairs then.
    """

    nodes: tuple[SliceNode, ...]
    names: tuple[tuple[Any, ...], ...]
    values: FloatArray
    is_filled_in: bool


def _check_discrete(network: Any) -> None:
    """Raise InputError unless this is a discrete Bayesian network of pgmpy."""
    with quiet():
        from pgmpy.models import DiscreteBayesianNetwork, DynamicBayesianNetwork

    if not isinstance(network, (DynamicBayesianNetwork, DiscreteBayesianNetwork)):
        raise InputError(
            f"{type(network).__name__} is no discrete Bayesian network of pgmpy; cut continuous"
            " nodes into intervals, so that each has a TabularCPD"
        )


def _read_cpd(cpd: Any) -> _Cpd:
    if not hasattr(cpd, "state_names"):
        raise InputError(
            f"{_of_slice(cpd.variable)[0]}: has a {type(cpd).__name__}, not a TabularCPD; a"
            " continuous node has to be cut into intervals"
        )
    return _Cpd(
        tuple(map(_of_slice, cpd.variables)),
        tuple(tuple(cpd.state_names[v]) for v in cpd.variables),
        np.asarray(cpd.values, dtype=np.float64),
        hasattr(cpd.variable, "time_slice"),
    )


def _of_slice(node: Any) -> SliceNode:
    """Return the name and the slice of a node of two slices."""
    # R writes a dot where BIF has an underscore.
    match = re.fullmatch(r"(.+)[_.]([01])", node) if isinstance(node, str) else None
    if match is not None:
        return match[1], int(match[2])
    # A tuple, or pgmpy's `DynamicNode`.
    is_pair = hasattr(node, "time_slice") or (isinstance(node, tuple) and len(node) == 2)
    if is_pair and node[1] in (0, 1):
        return str(node[0]), int(node[1])
    raise InputError(f"{node}: is of neither slice; name the nodes {node}_0 and {node}_1")


# --- tables -------------------------------------------------------------------------------------


def _is_numbered(names: Sequence[Any]) -> bool:
    """Whether these are the names that pgmpy gives itself, 0, 1, ..., in any order."""
    return set(names) == set(range(len(names))) and not any(isinstance(n, bool) for n in names)


def _table(cpd: _Cpd, values: Mapping[str, tuple[Any, ...]]) -> Table:
    """Return the CPD's numbers with every axis in the order of the node's values."""
    array = cpd.values
    for axis, ((name, _), given) in enumerate(zip(cpd.nodes, cpd.names, strict=True)):
        is_numbered = _is_numbered(given)
        here: list[Any] = list(given if is_numbered else map(str, given))
        ours: list[Any] = sorted(here) if is_numbered else list(map(str, values[name]))
        if here == ours or len(here) != len(ours):
            continue  # The sizes are checked later.
        if set(here) != set(ours):
            raise InputError(
                f"{cpd.nodes[0][0]}: its table calls the values of {name} {', '.join(here)};"
                f" elsewhere they are {', '.join(ours)}"
            )
        array = array.take([here.index(v) for v in ours], axis=axis)
    array = np.moveaxis(array, 0, -1)
    total = array.sum(axis=-1, keepdims=True)
    if 1e-9 < np.abs(total - 1).max() <= ROUNDED:
        array = array / total
    return Table(cpd.nodes[0], cpd.nodes[1:], array)


def _tables(
    cpds: Sequence[_Cpd],
    values: Mapping[str, tuple[Any, ...]],
    parents: Mapping[SliceNode, Sequence[SliceNode]],
) -> dict[SliceNode, Table]:
    """Return the table of every node in both slices."""
    tables: dict[SliceNode, Table] = {}
    written = {cpd.nodes[0]: cpd for cpd in cpds if not cpd.is_filled_in}
    for cpd in cpds:
        node, given = cpd.nodes[0], cpd.nodes[1:]
        other = written.get((node[0], 1 - node[1]))
        if cpd.is_filled_in and other and {(n, 1 - s) for n, s in other.nodes} == {*cpd.nodes}:
            # A copy by `initialize_initial_state`, which copies the numbers of P(D | B, A), but
            # names the axes in the order of the edges, which may be P(D | A, B).
            continue
        if node not in parents or set(given) != set(parents[node]):
            raise InputError(
                f"{spell(node)}: its table is given {_names(given)}, its edges come from"
                f" {_names(parents.get(node, ()))}"
            )
        tables[node] = _table(cpd, values)
    for (name, s), edges in parents.items():
        if (name, s) in tables:
            continue
        table = tables.get((name, 1 - s))
        if table is None:
            raise InputError(f"{name}: has no table (a TabularCPD)")
        shifted = tuple((p, 1 - q) for p, q in table.parents)
        if set(shifted) != set(edges):
            raise InputError(
                f"{spell((name, s))}: has no table, and its edges come from {_names(edges)}; the"
                f" table of the other slice is given {_names(table.parents)}"
            )
        tables[name, s] = Table((name, s), shifted, table.values)
    return tables


def _names(nodes: Iterable[SliceNode]) -> str:
    return ", ".join(sorted(map(spell, nodes))) or "nothing"


# --- files --------------------------------------------------------------------------------------


def read_file(path: Path) -> Any:
    """Read a BIF (.bif) or XMLBIF (.xmlbif, .xml) file as pgmpy's `DiscreteBayesianNetwork`.

    Raises InputError, naming the file, if it cannot be read or is truncated.
    """
    if path.suffix not in NETWORK_FILES:
        raise InputError(f"{path}: a network is read from {', '.join(NETWORK_FILES)}")
    # pgmpy skips what it does not find: a last block without a line's end, spaces after a block.
    text = "".join(f"{line.rstrip()}\n" for line in read_text(path).splitlines())
    if not text.strip():
        raise InputError(f"{path}: is empty")
    if path.suffix == ".bif":
        text = _without_commas(text)
    text = _with_slices(text)
    with quiet():
        from pgmpy.readwrite import BIFReader, XMLBIFReader

        reader, kind = (BIFReader, "BIF") if path.suffix == ".bif" else (XMLBIFReader, "XMLBIF")
        try:
            network = reader(string=text).get_model()
        except Exception as error:
            # pgmpy's readers raise any error for a file that is no network.
            why = " ".join(f"{type(error).__name__}: {error}".split())
            raise InputError(f"{path}: is no {kind} file that pgmpy can read ({why})") from error
    if not len(network):
        raise InputError(f"{path}: has no variable; is it a {kind} file?")
    return network


def _without_commas(text: str) -> str:
    """Return a BIF file with intervals such as `(-1.5,1.5]`, whose brackets and commas pgmpy takes
    for its own, as `-1.5_to_1.5`.

    Only names that a variable's values have are changed.
    """
    named = {
        match[0]: f"{match[2]}_to_{match[3]}"
        for values in re.findall(r"type\s+discrete\s*\[[^\]]*\]\s*\{([^}]*)\}", text)
        for match in _INTERVAL.finditer(values)
    }
    for name, plain in named.items():
        text = text.replace(name, plain)
    return text


def _with_slices(text: str) -> str:
    """Return a file with pyAgrum's names of two slices, `Lane0` and `Lanet`, as `Lane_0` and
    `Lane_1`."""
    names = {*re.findall(r"variable\s+(\w+)", text), *re.findall(r"<NAME>\s*(\w+)", text)}
    for name in names:
        stem = name.removesuffix("0")
        if stem != name and f"{stem}t" in names:
            text = re.sub(rf"\b{stem}0\b", f"{stem}_0", text)
            text = re.sub(rf"\b{stem}t\b", f"{stem}_1", text)
    return text


def load_graph_file(path: Path, name: str, where: str) -> Graph:
    """Read a BIF or XMLBIF file of two slices. Its numbers may come from any frames."""
    with problems_in(where):
        network = read_file(path)
    build = functools.partial(same, network)
    return Graph(name=name, file=str(path), build=build, learned_from="unknown")
