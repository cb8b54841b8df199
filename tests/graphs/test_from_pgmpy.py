"""pgmpy networks of any form, and the files that pgmpy reads, give the same tables."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.graphs.cpds import (
    Table,
    binary,
    declare,
    dynamics,
    lane_normals,
    previous,
    prior,
    quiet,
    uniform,
    within,
)
from egolane_pgm.graphs.from_pgmpy import Declared, read_file, read_network
from egolane_pgm.types import InputError
from tests.conformance.networks import draw_graph

with quiet():
    from pgmpy.factors.continuous import LinearGaussianCPD
    from pgmpy.factors.discrete import TabularCPD
    from pgmpy.models import (
        DiscreteBayesianNetwork,
        DynamicBayesianNetwork,
        LinearGaussianBayesianNetwork,
    )
    from pgmpy.readwrite import BIFWriter, XMLBIFWriter

WITHIN = [("Lane", "Seen"), ("Sensor", "Seen"), ("Sensor", "WOR")]
SEES = np.stack([lane_normals(0.4, 3), uniform(3, 3)])
RIGHT = [
    *prior("Lane", [0.2, 0.5, 0.3]),
    *prior("Sensor", [0.9, 0.1]),
    *dynamics("Lane", [previous("Lane")], lane_normals(0.3, 3)),
    *dynamics("Sensor", [previous("Sensor")], binary(0.95, 0.8)),
    *within("Seen", ["Sensor", "Lane"], SEES),
    *within("WOR", ["Sensor"], binary(0.7, 0.6)),
]
NAMES = {"Lane": ["left", "middle", "right"], "Sensor": ["OK", "BAD"]}


def cpd(table: Table, name: Callable[[tuple[str, int]], Any] = tuple, **names: list[str]) -> Any:
    """A table as pgmpy writes it, its nodes named by `name`."""
    nodes = (table.node, *table.parents)
    sizes = table.values.shape
    return TabularCPD(
        name(table.node),
        sizes[-1],
        table.values.reshape(-1, sizes[-1]).T,
        [name(p) for p in table.parents],
        list(sizes[:-1]),
        state_names={name(n): names[n[0]] for n in nodes} if names else {},
    )


def dynamic(tables: list[Table], **names: list[str]) -> Any:
    """A network in the style of pgmpy's own examples: edges, then the CPDs."""
    edges: list[Any] = [((n, 0), (n, 1)) for n in ("Lane", "Sensor")]
    network = DynamicBayesianNetwork(edges + [((a, 0), (b, 0)) for a, b in WITHIN])
    network.add_cpds(*(cpd(table, **names) for table in tables))
    return network


def without(*left_out: tuple[str, int]) -> list[Table]:
    return [table for table in RIGHT if table.node not in left_out]


def underscored(node: tuple[str, int]) -> str:
    return f"{node[0]}_{node[1]}"


def static(name: Callable[[tuple[str, int]], Any], tables: list[Table] = RIGHT) -> Any:
    edges = [(name(p), name(t.node)) for t in tables for p in t.parents]
    network = DiscreteBayesianNetwork(edges)
    network.add_nodes_from([name(t.node) for t in tables])
    names = {**NAMES, "Seen": ["1", "2", "3"], "WOR": ["OK", "BAD"]}
    network.add_cpds(*(cpd(table, name, **names) for table in tables))
    return network


def one_slice() -> Any:
    network = DiscreteBayesianNetwork(WITHIN)
    network.add_cpds(*(cpd(t, lambda node: node[0]) for t in RIGHT if t.node[1] == 0))
    return network


def initialised(*left_out: tuple[str, int]) -> Any:
    network = dynamic(without(*left_out))
    with quiet():
        network.initialize_initial_state()
    return network


def constant() -> Any:
    with quiet():
        return dynamic(RIGHT).get_constant_bn()


LATER, FIRST = (("Seen", 1), ("WOR", 1)), (("Seen", 0), ("WOR", 0))
FORMS: dict[str, Callable[[], Declared]] = {
    "both slices in full": lambda: read_network(dynamic(RIGHT)),
    "as in the tutorials": lambda: read_network(dynamic(without(*LATER))),
    "given for the second slice": lambda: read_network(dynamic(without(*FIRST))),
    "initialised": lambda: read_network(initialised(*LATER)),
    "initialised from the second": lambda: read_network(initialised(*FIRST)),
    "unrolled": lambda: read_network(constant()),
    "names of two slices": lambda: read_network(static(underscored)),
    "pairs": lambda: read_network(static(tuple)),
}


def assert_right(declared: Declared) -> None:
    assert set(declared.tables) == {table.node for table in RIGHT}
    for table in RIGHT:
        ours = declared.tables[table.node]
        assert set(ours.parents) == set(table.parents)
        order = [ours.parents.index(p) for p in table.parents]
        values = ours.values.transpose(*order, len(order))
        np.testing.assert_allclose(values, table.values, rtol=0, atol=1e-15)


@pytest.mark.parametrize("form", FORMS)
def test_a_network_gives_its_tables_by_name_whatever_its_form(form: str) -> None:
    assert_right(FORMS[form]())


@pytest.mark.parametrize(("ending", "writer"), [("bif", BIFWriter), ("xmlbif", XMLBIFWriter)])
def test_a_file_gives_the_tables_and_the_names_of_the_values(
    tmp_path: Path, ending: str, writer: Any
) -> None:
    path = tmp_path / f"network.{ending}"
    with quiet():
        writer(static(underscored)).write(path)
    declared = read_network(path)
    assert_right(declared)
    assert declared.values["Lane"] == ("left", "middle", "right")
    # As other programs write it: no end of the last line, spaces after a brace, Windows' lines.
    path.write_bytes(path.read_bytes().replace(b"}\n", b"} \r\n").rstrip())
    assert_right(read_network(str(path)))


def test_intervals_and_dots_as_r_writes_them_are_read(tmp_path: Path) -> None:
    """bnlearn names the values of a node that was cut into intervals by these."""
    path = tmp_path / "network.bif"
    names = {"left": "[-9,-1.5]", "middle": "(-1.5,1.5]", "right": "(1.5,9]"}
    with quiet():
        BIFWriter(static(underscored)).write(path)
    text = path.read_text()
    for plain, interval in names.items():
        text = text.replace(plain, interval)
    path.write_text(re.sub(r"(\w)_([01])\b", r"\1.\2", text))
    declared = read_network(path)
    assert_right(declared)
    assert declared.values["Lane"] == ("-9_to_-1.5", "-1.5_to_1.5", "1.5_to_9")


def test_values_go_by_their_numbers_too() -> None:
    names: dict[tuple[str, int], list[Any]] = {("WOR", 0): [1, 0], ("Sensor", 0): ["BAD", "OK"]}
    network = dynamic(without(("WOR", 0), *LATER), **NAMES, Seen=["1", "2", "3"])
    columns = binary(0.7, 0.6)[::-1, ::-1].T  # both the sensor's and WOR's values backwards
    network.add_cpds(TabularCPD(("WOR", 0), 2, columns, [("Sensor", 0)], [2], names))
    declared = read_network(network)
    assert declared.values["Sensor"] == ("OK", "BAD")
    for s in (0, 1):
        np.testing.assert_array_equal(declared.tables["WOR", s].values, binary(0.7, 0.6))


def rewritten(table: Table, rng: np.random.Generator, named: bool) -> Any:
    """A CPD that says the same, its parents and, where they have names, all values in any order."""
    order = rng.permutation(len(table.parents))
    nodes = [*(table.parents[k] for k in order), table.node]
    values = table.values.transpose(*order, len(order))
    names = {}
    for axis, (node, size) in enumerate(zip(nodes, values.shape, strict=True)):
        numbers = rng.permutation(size) if named else np.arange(size)
        values = values.take(numbers, axis=axis)
        names[node] = [f"{node[0]} {k}" for k in numbers] if named else list(range(size))
    columns = values.reshape(-1, values.shape[-1]).T
    return TabularCPD(nodes[-1], len(columns), columns, nodes[:-1], list(values.shape[:-1]), names)


@pytest.mark.parametrize("seed", range(30))
def test_any_network_is_read_the_same_however_it_was_written(seed: int) -> None:
    rng = np.random.default_rng(seed)
    right = {table.node: table for table in draw_graph(rng).tables}
    network = declare(right.values(), ())
    network.cpds = []
    is_named, is_initialised = seed % 3 == 0, seed % 3 == 1
    for name in dict.fromkeys(name for name, _ in right):
        first, later = right[name, 0], right[name, 1]
        is_one = first.parents and later.parents == tuple((p, 1) for p, _ in first.parents)
        if is_one and np.array_equal(first.values, later.values):
            slices = [(0,), (1,), (0, 1)][rng.integers(3)]
        else:
            slices = (0, 1)
        network.add_cpds(*(rewritten(right[name, s], rng, is_named) for s in slices))
    if is_initialised:
        with quiet():
            network.initialize_initial_state()
    declared = read_network(network)
    assert set(declared.tables) == set(right)
    for node, ours in declared.tables.items():
        assert set(ours.parents) == set(right[node].parents)
        order = [ours.parents.index(p) for p in right[node].parents]
        values = ours.values.transpose(*order, len(order))
        for axis, (name, _) in enumerate((*right[node].parents, node)):
            if is_named:
                values = values.take(np.argsort(declared.values[name]), axis=axis)
        np.testing.assert_array_equal(values, right[node].values)


def test_rows_that_were_rounded_sum_to_one() -> None:
    network = dynamic(without(("Lane", 0)))
    network.add_cpds(TabularCPD(("Lane", 0), 3, [[0.333]] * 3))
    np.testing.assert_allclose(read_network(network).tables["Lane", 0].values, uniform(3))
    network.remove_cpds(("Lane", 0))
    network.add_cpds(TabularCPD(("Lane", 0), 3, [[0.3]] * 3))
    with pytest.raises(InputError, match=r"Lane at t .*: the rows of the table must sum to one"):
        read_network(network)


def changed(*cpds: Any) -> Any:
    """The network with these CPDs in the place of its own, unchecked."""
    found = dynamic(RIGHT)
    nodes = [tuple(c.variable) for c in cpds]
    found.cpds = [c for c in found.cpds if tuple(c.variable) not in nodes] + list(cpds)
    return found


def halves(*nodes: tuple[str, int], sizes: tuple[int, ...] = ()) -> Any:
    size = {"Lane": 3, "Seen": 3}.get(nodes[0][0], 2)
    sizes = sizes or tuple(3 if n in ("Lane", "Seen") else 2 for n, _ in nodes[1:])
    values = np.full((size, int(np.prod(sizes))), 1 / size)
    return TabularCPD(nodes[0], size, values, list(nodes[1:]), list(sizes))


REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "no CPDs": (
        lambda: DynamicBayesianNetwork([(("Lane", 0), ("Lane", 1))]),
        "the network has no tables: give each node a TabularCPD with add_cpds",
    ),
    "one CPD missing": (lambda: dynamic(without(*FIRST, *LATER)), "Seen: has no table (a Tab"),
    "prior missing": (
        lambda: dynamic(without(("Lane", 0))),
        "Lane at t: has no table, and its edges come from nothing; the table of the other slice is"
        " given Lane at t",
    ),
    "another parent": (
        lambda: changed(halves(("WOR", 1), ("Lane", 1))),
        "WOR at t+1: its table is given Lane at t+1, its edges come from Sensor at t+1",
    ),
    "too many rows": (
        lambda: changed(halves(("WOR", 1), ("Sensor", 1), sizes=(3,))),
        "WOR: its table has 3 rows for Sensor, which has 2 values",
    ),
    "other names": (
        lambda: changed(
            cpd(RIGHT[4], Sensor=["good", "bad"], Lane=["1", "2", "3"], Seen=["1", "2", "3"]),
            cpd(RIGHT[1], Sensor=["OK", "BAD"]),
        ),
        "Seen: its table calls the values of Sensor good, bad; elsewhere they are OK, BAD",
    ),
    "continuous CPD": (
        lambda: changed(LinearGaussianCPD(("Lane", 0), [0], 1)),
        "Lane: has a LinearGaussianCPD, not a TabularCPD; a continuous node has to be cut into",
    ),
    "continuous network": (
        lambda: LinearGaussianBayesianNetwork([("Lane_0", "Lane_1")]),
        "LinearGaussianBayesianNetwork is no discrete Bayesian network of pgmpy; cut continuous",
    ),
    "no network": (lambda: {"Lane": 3}, "dict is no discrete Bayesian network of pgmpy"),
    "one slice only": (one_slice, "Lane: is of neither slice; name the nodes Lane_0 and Lane_1"),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_a_network_with_a_fault_is_refused_naming_the_node(fault: str) -> None:
    make, said = REFUSED[fault]
    with quiet():
        network = make()
    with pytest.raises(InputError) as error:
        read_network(network)
    assert str(error.value).startswith(said)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.bif", "", "is empty"),
        ("a.bif", "frame,lane\n1,2\n", "has no variable; is it a BIF file?"),
        ("a.xmlbif", "\n", "is empty"),
        ("a.xmlbif", "<BIF", "is no XMLBIF file that pgmpy can read (ParseError"),
        ("a.xml", "<html></html>", "is no XMLBIF file that pgmpy can read ("),
        ("a.net", "net {}", "a network is read from .bif, .xmlbif, .xml"),
    ],
)
def test_a_file_that_is_no_network_is_refused(
    tmp_path: Path, name: str, text: str, said: str
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as error:
        read_file(tmp_path / name)
    assert str(error.value).startswith(f"{tmp_path / name}: {said}")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("suffix", [".bif", ".xmlbif"])
def test_the_slices_of_pyagrum_are_read(suffix: str, tmp_path: Path) -> None:
    network = DiscreteBayesianNetwork([("Lane0", "Lanet"), ("Lane0", "Det0"), ("Lanet", "Dett")])
    rows = [[0.9, 0.2], [0.1, 0.8]]
    network.add_cpds(
        TabularCPD("Lane0", 2, [[0.3], [0.7]]),
        TabularCPD("Lanet", 2, rows, ["Lane0"], [2]),
        TabularCPD("Det0", 2, rows, ["Lane0"], [2]),
        TabularCPD("Dett", 2, rows, ["Lanet"], [2]),
    )
    writer = BIFWriter if suffix == ".bif" else XMLBIFWriter
    writer(network).write(tmp_path / f"g{suffix}")
    compiled = ego.compile(tmp_path / f"g{suffix}", observed=["Det"])
    np.testing.assert_allclose(compiled.transition[0], np.transpose(rows))
