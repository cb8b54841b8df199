"""The network as it is declared: two slices of a dynamic Bayesian network, drawn."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from egolane_pgm.types import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: A node of one slice: its name and 0 (time t) or 1 (time t + 1).
Node = tuple[str, int]

#: What marks a node's virtual-evidence child.
EVIDENCE_SUFFIX = "_ve"

# Told apart by lightness and by outline as well as by hue, so that they are in grey too.
_FILL = {"hidden": "#ffffff", "observed": "#9db7cc", "evidence": "#4d5a66"}
_INK, _TEMPORAL = "#222222", "#b3541e"
_RADIUS = {"hidden": 0.52, "observed": 0.52, "evidence": 0.2}


class TwoSliceNetwork(Protocol):
    """What is needed of a pgmpy DynamicBayesianNetwork."""

    def nodes(self) -> Iterable[Node]: ...

    def edges(self) -> Iterable[tuple[Node, Node]]: ...


@dataclass(frozen=True)
class _Layout:
    """Where each node of a slice goes, and what it is."""

    place: dict[str, tuple[float, float]]
    kind: dict[str, str]
    width: float
    height: float


def _kinds(names: Sequence[str]) -> dict[str, str]:
    """Hidden, observed (has a virtual-evidence child), or evidence (is one)."""
    known = set(names)

    def kind(name: str) -> str:
        if name.endswith(EVIDENCE_SUFFIX):
            return "evidence"
        return "observed" if name + EVIDENCE_SUFFIX in known else "hidden"

    return {name: kind(name) for name in names}


def _layers(names: Sequence[str], edges: Iterable[tuple[str, str]]) -> dict[str, int]:
    """Layer of each node: the longest path to it from a root, within the slice."""
    layer = dict.fromkeys(names, 0)
    inside = list(edges)
    for _ in names:
        before = dict(layer)
        for parent, child in inside:
            layer[child] = max(layer[child], layer[parent] + 1)
        if layer == before:
            return layer
    raise InputError("network: the edges within a slice form a cycle")
