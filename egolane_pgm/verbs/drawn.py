"""The picture of a network."""

from __future__ import annotations

from typing import TYPE_CHECKING

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.model import Model

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_network(network: Model | Compiled) -> Figure:
    """Draw the two slices of a network: hidden, observed, input and function nodes.

    - network: the model of a run, or a network as `compile` returns it.

    Raises InputError for a network without nodes or with a cycle.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> figure = ego.draw_network(run.model)
    """
    from egolane_pgm.views.network import network_figure, structure_of
    from egolane_pgm.views.style import inline_figure

    compiled = network if isinstance(network, Compiled) else network.compiled
    return inline_figure(lambda: network_figure(structure_of(compiled)))
