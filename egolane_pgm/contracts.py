"""The contracts of plugins: graphs, evidence rules, detectors and readers.

Each kind is a frozen dataclass of values and functions. A plugin is a Python module (one of this
package, or a user's file) that defines the fields under these names: a function under its own name
(`tables`), a value in capitals (`OBSERVED`). Names, types and signatures are checked once, when the
module is loaded. A graph may also come from YAML, BIF, or a network in memory.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

from egolane_pgm.parameters import Parameter, Parameters, Value
from egolane_pgm.types import BoolArray, Evidence, IntArray, LineLog, Observed

if TYPE_CHECKING:
    import pandas as pd

    from egolane_pgm.graphs.cpds import Table
    from egolane_pgm.vision.camera.model import Camera
    from egolane_pgm.vision.camera.picture import Picture
    from egolane_pgm.vision.detectors import FrameLines

#: Lines of T frames, lanes (T,) from 1, and the frames to learn from (T,), of one recording.
Marked = tuple[LineLog, IntArray, BoolArray]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Plugin:
    """The fields of all plugins.

    - name: name or path, as in the YAML.
    - file: source file; empty for a plugin in memory.
    - about: docstring of the module.
    - is_ours: whether it belongs to this package.
    - parameters: declared parameters. The functions of a graph, a rule and a detector get their
      values by name; a reader has none.
    """

    #: The folder of this package's plugins of the kind, and the names of which each defines one.
    folder: ClassVar[str]
    marks: ClassVar[str]

    name: str
    file: str = ""
    about: str = ""
    is_ours: bool = False
    parameters: tuple[Parameter, ...] = ()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r})"


# --- graphs --------------------------------------------------------------------------------------


@runtime_checkable
class Tables(Protocol):
    def __call__(self, n_lanes: int, parameters: Parameters, /) -> Sequence[Table]:
        """Return P(node | parents) of each node in two slices: the first frame, and any later one.

        A table's values have an axis for each parent, then one for the node, and sum to 1 over the
        last axis. Lane has `n_lanes` values. `prior`, `dynamics` and `within` of `egolane_pgm.cpds`
        make the tables of a node. Virtual-evidence nodes are left out.
        """


@runtime_checkable
class Build(Protocol):
    def __call__(self, n_lanes: int, parameters: Parameters, /) -> Any:
        """Return a pgmpy `DynamicBayesianNetwork` with a node Lane of `n_lanes` values.

        `declare` of `egolane_pgm.cpds` makes one from tables, with a virtual-evidence node for each
        observed key. Missing ones are added, with a warning.
        """


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Graph(Plugin):
    """A graph: its tables, and the role of each node.

    It needs `build`, or `tables` with `hidden` and `observed`.

    - tables: the tables for a number of lanes and values of the parameters.
    - build: a pgmpy network in place of tables.
    - hidden: nodes with a posterior; by default Lane and all others without evidence or input.
    - observed: nodes, or tuples of nodes, with evidence; by default all for which the rule has
      evidence.
    - inputs: nodes without parents whose value is known in every frame.
    - bounds: for each input that is a column of the recording, the increasing bounds between its
      values: k bounds for k + 1 values.
    - unused: keys of the rule's evidence that the graph ignores.
    - values: names of the values of each node; by default numbers, of lanes from 1, of others from
      0.
    - learned_from: the training frames of fitted tables, or a value of `tuned_on`, as `egolane
      learn` writes it; None if the tables are not fitted.
    - keys: the content of a graph in YAML.
    """

    folder = "graphs"
    marks = "tables|build"

    tables: Tables | None = None
    build: Build | None = None
    hidden: tuple[str, ...] | None = None
    observed: tuple[Observed, ...] | None = None
    inputs: tuple[str, ...] = ()
    bounds: Mapping[str, tuple[float, ...]] | None = None
    unused: tuple[Observed, ...] = ()
    values: Mapping[str, tuple[str, ...]] | None = None
    learned_from: Any = None
    keys: Mapping[str, Any] | None = None


# --- evidence rules ------------------------------------------------------------------------------


@runtime_checkable
class MakeEvidence(Protocol):
    def __call__(self, log: LineLog, n_lanes: int, parameters: Parameters, /) -> Evidence:
        """Return the evidence of a drive.

        - log: its lines, T frames of at most L lines: `offset_m` (T, L), metres, negative on the
          left, NaN for padding; `is_valid`, `is_continuous`, `lri` (T, L).

        The likelihoods of a node of k values are (T, k), of a tuple of nodes (T, k1, k2, ...); a
        row of equal numbers is a frame without evidence.
        """


@runtime_checkable
class Online(Protocol):
    def __call__(self, n_lanes: int, parameters: Parameters, /) -> RuleStep:
        """Start a drive; return a function that remembers its earlier frames."""


class RuleStep(Protocol):
    def __call__(self, log: LineLog, /) -> Evidence:
        """Return the evidence of the next T frames, with the shapes of `evidence`."""


@runtime_checkable
class LooksAhead(Protocol):
    def __call__(self, parameters: Parameters, /) -> str | None:
        """Return why evidence depends on later frames, or None if it does not."""


@runtime_checkable
class FitRule(Protocol):
    def __call__(
        self, recordings: Sequence[Marked], n_lanes: int, parameters: Parameters, /
    ) -> Mapping[str, Value]:
        """Learn parameters from recordings with known lanes; return values by name.

        - recordings: for each, its lines (T frames), its lanes (T,), from 1, and whether to learn
          from each frame (T,).
        """


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Rule(Plugin):
    """An evidence rule: the likelihoods of observed nodes in each frame, from its lines.

    - evidence: the evidence of a whole drive.
    - provides: keys of its likelihoods: nodes, or tuples of nodes observed jointly.
    - inputs: input nodes for which it has values.
    - tentative: the node whose evidence alone is an answer, scored as "detector".
    - online: the rule frame by frame, for a rule that remembers earlier frames; by default
      `evidence` of each frame.
    - looks_ahead: the reason if it is not causal.
    - fit: the learning of parameters from labels.
    - learned: names of the parameters that `fit` learns.
    """

    folder = "evidence"
    marks = "evidence"

    evidence: MakeEvidence
    provides: tuple[Observed, ...] = ()
    inputs: tuple[str, ...] = ()
    tentative: str = ""
    online: Online | None = None
    looks_ahead: LooksAhead | None = None
    fit: FitRule | None = None
    learned: tuple[str, ...] = ()


# --- detectors and readers -----------------------------------------------------------------------


@runtime_checkable
class Start(Protocol):
    def __call__(self, camera: Camera, parameters: Parameters, /) -> DetectorStep:
        """Start a drive; return a function that is called with each picture in turn."""


class DetectorStep(Protocol):
    def __call__(self, picture: Picture, /) -> FrameLines:
        """Return the lines in a picture, from left to right.

        Its `image` is (height, width, 3), uint8, BGR; so is `right`, of a second camera.
        """


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Detector(Plugin):
    """A detector: the lines in each picture of a drive.

    - stereo: whether it needs the pictures of two cameras.
    - start: the start of a drive, before its first picture.
    """

    folder = "detectors"
    marks = "STEREO"

    stereo: bool
    start: Start


@runtime_checkable
class Read(Protocol):
    def __call__(self, path: Any, /, **options: Any) -> LineLog | pd.DataFrame:
        """Read the file or folder at a path (`pathlib.Path`).

        - options: keyword arguments from the YAML: `frame_rate`, Hz; `camera` and `topic` if they
          are given; the keys of `recording.options`.

        Return a `LineLog`, or a DataFrame with the columns of a recording in a table.
        """


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Reader(Plugin):
    """A reader of recordings in another format.

    - read: the lines of a file or folder.
    """

    folder = "recordings"
    marks = "read"

    read: Read
