"""The contracts of plugins: what graphs, evidence rules, detectors and readers are.

Each kind is a frozen dataclass of values and functions. A plugin is a Python module (one of this
package, or a user's file) that defines the fields under these names: a function under its own name
(`tables`), a value in capitals (`OBSERVED`). `plugins` reads them once and checks names, types and
signatures. A graph may also come from YAML, BIF, or a network in memory.
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
    """What all plugins have.

    - name: as in the YAML.
    - file: source file; empty for a plugin in memory.
    - about: docstring of the module.
    - is_ours: whether it belongs to this package.
    - parameters: declared parameters; a plugin's functions get the value of each.
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
        """Return the tables of all nodes but the virtual-evidence ones, in both slices.

        A table's values have an axis for each parent, then one for the node, and sum to 1 over the
        last axis; `egolane_pgm.cpds` has functions for the usual ones.
        """


@runtime_checkable
class Build(Protocol):
    def __call__(self, n_lanes: int, parameters: Parameters, /) -> Any:
        """Return a pgmpy `DynamicBayesianNetwork` with a node Lane of `n_lanes` values."""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Graph(Plugin):
    """A graph: its tables, and the role of each node. It needs `tables` or `build`.

    - tables: the tables for a number of lanes and parameters.
    - build: a pgmpy network instead.
    - hidden: nodes with a posterior; by default Lane and all that are neither observed nor inputs.
    - observed: nodes, or tuples of nodes, with evidence; by default all that the rule has evidence
      for.
    - inputs: nodes without parents whose value is known in every frame.
    - bounds: for inputs that are columns of the recording, the bounds between their values.
    - unused: evidence of the rule that the graph ignores.
    - values: names of the values of nodes; by default numbers, those of lanes from 1.
    - learned_from: what fitted tables were trained on, see `identity.Origin`; None without a fit.
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
        """Return the evidence of the T frames of a log.

        The likelihoods of each key are (T, k), of a tuple of nodes (T, k1, k2, ...).
        """


@runtime_checkable
class Online(Protocol):
    def __call__(self, n_lanes: int, parameters: Parameters, /) -> RuleStep:
        """Return a function from the next frames of a drive to their evidence; it has a memory."""


class RuleStep(Protocol):
    def __call__(self, log: LineLog, /) -> Evidence:
        """Return the evidence of the next frames."""


@runtime_checkable
class LooksAhead(Protocol):
    def __call__(self, parameters: Parameters, /) -> str | None:
        """Return why evidence depends on later frames, or None if it does not."""


@runtime_checkable
class FitRule(Protocol):
    def __call__(
        self, recordings: Sequence[Marked], n_lanes: int, parameters: Parameters, /
    ) -> Mapping[str, Value]:
        """Learn parameters of these names from recordings with known lanes."""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Rule(Plugin):
    """An evidence rule: the likelihoods of observed nodes in each frame, from its lines.

    - evidence: the evidence of a whole drive.
    - provides: keys of its likelihoods: nodes, or tuples of nodes observed jointly.
    - inputs: input nodes that it gives a value.
    - tentative: the node whose evidence is an answer of its own, scored as "detector".
    - online: the rule for frames as they come, if it has a memory.
    - looks_ahead: why it is not causal, if it is not.
    - fit: learns the parameters `learned` from labels.
    - learned: names of these parameters.
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
        """Prepare the first picture of a drive; return a function that takes each in turn."""


class DetectorStep(Protocol):
    def __call__(self, picture: Picture, /) -> FrameLines:
        """Return the lines in a picture, whose pixels are (height, width, 3), uint8, BGR."""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Detector(Plugin):
    """A detector: the lines in each picture of a drive.

    - stereo: whether it needs the pictures of two cameras.
    - start: makes the function from a picture to its lines.
    """

    folder = "detectors"
    marks = "STEREO"

    stereo: bool
    start: Start


@runtime_checkable
class Read(Protocol):
    def __call__(self, path: Any, /, **options: Any) -> LineLog | pd.DataFrame:
        """Read the file or folder at a path (`pathlib.Path`).

        Options come from the YAML: `camera`, `topic` and `frame_rate` if they are given, and all of
        `recording.options`.
        """


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Reader(Plugin):
    """A reader of recordings in a format of its own.

    - read: the lines of a file, as a LineLog or as a table with the columns of a recording.
    """

    folder = "recordings"
    marks = "read"

    read: Read
