"""The containers that pass between the parts, and conventions.

Lane 1 is the leftmost lane. Offsets are metres, negative to the left of the vehicle. A frame is
identified by its recorded frame id; ids strictly increase. Time is frame id over frame rate, or the
recording's time stamp (seconds since 1970). In arrays over lanes, index 0 is lane 1.
"""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd

    from egolane_pgm.inference.compile import Compiled

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

#: The key of an evidence array: one observed node, or several that are observed jointly.
Observed = str | tuple[str, ...]

#: Maxima whose relative difference is less are a tie: no lane is assigned.
TIE_TOLERANCE = 1e-9

#: The largest number of lanes that is accepted.
MAX_LANES = 50

#: Times from here on, seconds, are dates (since 1970).
DATED_S = 1e8

#: The assigned lane of a frame without a unique most probable lane.
UNASSIGNED = 0

#: The true lane of a frame that is not annotated.
NOT_ANNOTATED = 0

#: The prefix of a warning that needs no action.
NOTE = "note: "


class InputError(ValueError):
    """An error in the user's input (a file, a YAML key, an option), in one line.

    >>> import egolane_pgm as ego
    >>> try:
    ...     ego.load_experiment("nowhere.yaml")
    ... except ego.InputError as error:
    ...     print(error)
    nowhere.yaml: cannot be read: No such file or directory
    """

    def __init__(self, problem: object) -> None:
        super().__init__(in_one_line(problem))

    def _render_traceback_(self) -> list[str]:
        # A notebook shows this line without a traceback.
        return [f"InputError: {self}"]


def in_one_line(problem: object) -> str:
    """Format a problem as one printable line."""
    return printable(" ".join(line.strip() for line in str(problem).splitlines()))


def printable(text: str) -> str:
    """Escape characters that a terminal takes for commands; lines stay."""
    return "".join(
        c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in text
    )


@contextlib.contextmanager
def problems_in(where: str) -> Iterator[None]:
    """Prefix an InputError raised in the block with `where`."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def suggestion(word: str, known: Iterable[str]) -> str:
    """End a message with `" (did you mean 'x'?)"`, or with the known words if none is near."""
    names = sorted(known)
    return near_word(word, names) or (f" (known: {', '.join(names)})" if names else "")


def not_one_of(value: object, choices: Sequence[str]) -> str:
    """Return `"'x' is not one of a, b"`, with the nearest choice."""
    meant = near_word(value, choices) if isinstance(value, str) else ""
    return f"{value!r} is not one of {', '.join(choices)}{meant}"


def near_word(word: str, known: Iterable[str]) -> str:
    """End a message with `" (did you mean 'x'?)"`; empty if no known word is near."""
    close = difflib.get_close_matches(word, sorted(known), n=1)
    return f" (did you mean '{close[0]}'?)" if close else ""


def runs_of(marked: BoolArray) -> list[tuple[int, int]]:
    """Return the runs of marked rows (T,): first row, and the one after the last."""
    edge = np.diff(np.concatenate([[0], marked.astype(np.int64), [0]]))
    starts = np.flatnonzero(edge == 1)
    stops = np.flatnonzero(edge == -1)
    return [(int(a), int(b)) for a, b in zip(starts, stops, strict=True)]


def merged_runs(marked: BoolArray, time_s: FloatArray, within_s: float) -> list[tuple[int, int]]:
    """Return the runs of marked rows (T,), merged if at most `within_s` seconds apart."""
    found: list[tuple[int, int]] = []
    for start, stop in runs_of(marked):
        # Runs before and after a jump back of the clock stay apart.
        if found and 0 <= time_s[start] - time_s[found[-1][1] - 1] <= within_s:
            found[-1] = (found[-1][0], stop)
        else:
            found.append((start, stop))
    return found


def clip_slices(clip: NDArray[np.str_]) -> list[slice]:
    """Return the frames of each clip; clip (T,) is the name of each frame's clip."""
    starts = [0, *(np.flatnonzero(clip[1:] != clip[:-1]) + 1).tolist(), len(clip)]
    return [slice(a, b) for a, b in pairwise(starts)]


def pad_and_concat(parts: Sequence[NDArray[Any]], blank: float | bool) -> NDArray[Any]:
    """Concatenate arrays (T_k, L_k) along the frames, padded with `blank` to one width."""
    width = max(part.shape[1] for part in parts)
    return np.concatenate(
        [
            np.pad(part, ((0, 0), (0, width - part.shape[1])), constant_values=blank)
            for part in parts
        ]
    )


def _span(frame_id: IntArray) -> str:
    """Describe frame ids: number, first and last."""
    ends = f", ids {int(frame_id[0])} to {int(frame_id[-1])}" if len(frame_id) else ""
    return f"{len(frame_id)} frames{ends}"


def _node(key: Observed, shape: tuple[int, ...]) -> str:
    """Describe a node, or several observed jointly, with their cardinalities."""
    return f"{key if isinstance(key, str) else ', '.join(key)} ({' x '.join(map(str, shape))})"


def check_frame_ids(frame_id: IntArray, what: str) -> None:
    """Raise InputError, prefixed with `what`, for frame ids that do not strictly increase."""
    if frame_id.ndim != 1:
        raise InputError(f"{what}: frame_id has shape {frame_id.shape}, needs one id per frame")
    later = frame_id[1:] > frame_id[:-1]
    if not later.all():
        before, after = frame_id[int(later.argmin()) :][:2]
        raise InputError(f"{what}: frame ids must increase, {before} is followed by {after}")


class _Frames:
    """A dataclass of arrays, and dicts of arrays, whose first axis is the frames."""

    def take(self, frames: slice | IntArray | BoolArray) -> Self:
        """Return some frames, in order."""
        return self._each([self], lambda parts: parts[0][frames])

    @classmethod
    def concat(cls, parts: Sequence[Self]) -> Self:
        """Concatenate containers with the same keys; lines are padded to one width."""
        return parts[0] if len(parts) == 1 else parts[-1]._each(parts, _concat)

    def _each(self, parts: Sequence[Self], change: Callable[[list[Any]], Any]) -> Self:
        """Return a container whose arrays are made from those of the parts."""
        changed: dict[str, Any] = {}
        for name in (each.name for each in fields(self)):  # type: ignore[arg-type]
            of_parts = [getattr(part, name) for part in parts]
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                changed[name] = change(of_parts)
            elif isinstance(value, Mapping) and name != "values":
                changed[name] = {k: change([each[k] for each in of_parts]) for k in value}
        return replace(self, **changed)  # type: ignore[type-var]


def _concat(parts: list[NDArray[Any]]) -> NDArray[Any]:
    if parts[0].ndim != 2:
        return np.concatenate(parts)
    return pad_and_concat(parts, False if parts[0].dtype == bool else np.nan)


@dataclass(frozen=True)
class LineLog(_Frames):
    """The output of a line detector: T frames of at most L lines each, padded.

    - frame_id (T,): strictly increasing; gaps are allowed and kept.
    - time_s (T,): seconds: frame id over frame rate, or the recording's time stamps.
    - offset_m (T, L): lateral offset of each line, metres, negative left; NaN in padding.
    - is_valid (T, L): lines that the detector trusts; False in padding.
    - is_continuous (T, L): lines that are not dashed; False if unknown.
    - lri (T, L): line reliability index as recorded; NaN if unknown.
    - is_missing (T,): frames that were filled in (`missing_frames: predict`).
    - source: the file, for messages.
    - clip (T,): the name of each frame's clip; None for a recording of one drive.
    - covariates: further columns by name, such as rain (T,); NaN if empty.

    >>> import numpy as np
    >>> import egolane_pgm as ego
    >>> yes, offset_m = np.ones(3, dtype=bool), np.array([-1.8, 1.7, -1.9])
    >>> ego.LineLog.from_rows(
    ...     np.array([7, 8]), 10.0, np.array([0, 0, 1]), offset_m, yes, ~yes, np.full(3, 10.0)
    ... )
    LineLog('line log': 2 frames, ids 7 to 8, at most 2 lines each)
    """

    frame_id: IntArray
    time_s: FloatArray
    offset_m: FloatArray
    is_valid: BoolArray
    is_continuous: BoolArray
    lri: FloatArray
    is_missing: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    source: str = "line log"
    clip: NDArray[np.str_] | None = None
    covariates: Mapping[str, FloatArray] = field(default_factory=dict)

    def __repr__(self) -> str:
        width = self.offset_m.shape[1]
        return f"LineLog({self.source!r}: {_span(self.frame_id)}, at most {width} lines each)"

    def __post_init__(self) -> None:
        n_frames = len(self.frame_id)
        if self.is_missing.size == 0 and n_frames:
            object.__setattr__(self, "is_missing", np.zeros(n_frames, dtype=bool))
        check_frame_ids(self.frame_id, self.source)
        lines = (n_frames, self.offset_m.shape[-1])
        of_lines = dict.fromkeys(("offset_m", "is_valid", "is_continuous", "lri"), lines)
        of_frames = dict.fromkeys(("time_s", "is_missing", "clip", *self.covariates), (n_frames,))
        for name, shape in {**of_frames, **of_lines}.items():
            array = self.covariates[name] if name in self.covariates else getattr(self, name)
            if array is not None and array.shape != shape:
                raise InputError(f"{self.source}: {name} has shape {array.shape}, needs {shape}")
        if not np.isfinite(self.offset_m[self.is_valid]).all():
            frame, line = np.argwhere(self.is_valid & ~np.isfinite(self.offset_m))[0]
            raise InputError(
                f"{self.source}: frame {int(self.frame_id[frame])}: line {int(line) + 1} is valid"
                f" but its offset is {self.offset_m[frame, line]}; drop it or mark it not valid"
            )

    def __len__(self) -> int:
        return len(self.frame_id)

    @classmethod
    def from_rows(
        cls,
        frame_id: IntArray,
        frame_rate: float,
        row_frame: IntArray,
        offset_m: FloatArray,
        is_valid: BoolArray,
        is_continuous: BoolArray,
        lri: FloatArray,
        *,
        row_line: IntArray | None = None,
        source: str = "line log",
    ) -> LineLog:
        """Make a log from N lines, frame by frame.

        - frame_id (T,): the ids of all frames, including those without lines.
        - frame_rate: frames per second.
        - row_frame (N,): the index of each line's frame, 0 to T - 1, never decreasing.
        - offset_m, is_valid, is_continuous, lri (N,): the values of the log.
        - row_line (N,): the column of each line in its frame, from 0; by default 0, 1, 2, ...

        Raises InputError for frame ids that do not increase and for a valid line without an offset.
        """
        if row_line is None:
            row_line = np.arange(len(row_frame)) - np.searchsorted(row_frame, row_frame)
        shape = (len(frame_id), int(row_line.max(initial=-1)) + 1)

        def padded(values: NDArray[Any], kind: type, blank: float | bool) -> NDArray[Any]:
            array: NDArray[Any] = np.full(shape, blank, dtype=kind)
            array[row_frame, row_line] = values
            return array

        return cls(
            frame_id,
            frame_id / frame_rate,
            padded(offset_m, float, np.nan),
            padded(is_valid, bool, False),
            padded(is_continuous, bool, False),
            padded(lri, float, np.nan),
            source=source,
        )

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with a row per line, as `ego.run` takes it.

        The index is `frame_id` and `line`, from 1; columns `time_s`, `offset_m` (negative left),
        `is_valid`, `is_continuous`, `lri`, and the covariates. A frame without lines has one row
        with empty cells.
        """
        # pandas is imported for tables only.
        import pandas as pd

        is_placed = ~np.isnan(self.offset_m) | ~np.isnan(self.lri)
        is_line = self.is_valid | self.is_continuous | is_placed
        frame, line = np.nonzero(np.column_stack([is_line, ~is_line.any(axis=1)]))

        def column(values: NDArray[Any], blank: float | bool) -> NDArray[Any]:
            padded = np.pad(values, ((0, 0), (0, 1)), constant_values=blank)
            return np.asarray(padded[frame, line])

        number = pd.array(line + 1, dtype="Int64")
        number[line == is_line.shape[1]] = pd.NA
        columns = {
            "time_s": self.time_s[frame],
            "offset_m": column(self.offset_m, np.nan),
            "is_valid": column(self.is_valid, False),
            "is_continuous": column(self.is_continuous, False),
            "lri": column(self.lri, np.nan),
            **{name: values[frame] for name, values in self.covariates.items()},
        }
        index = pd.MultiIndex.from_arrays([self.frame_id[frame], number])
        return pd.DataFrame(columns, index.set_names(["frame_id", "line"]))


@dataclass(frozen=True)
class Evidence(_Frames):
    """Soft evidence of T frames.

    - likelihoods: per observed node, or tuple of nodes observed jointly, an array or lists
      (T, *cardinalities): non-negative, finite, need not sum to one.
    - inputs: per input node the index of its value in each frame (T,).

    `hard` makes evidence from observed values.

    >>> import egolane_pgm as ego
    >>> ego.Evidence({"DetectorOutput": [[0.9, 0.1, 0.0], [0.3, 0.4, 0.3]]})
    Evidence(2 frames: DetectorOutput (3))
    """

    likelihoods: Mapping[Observed, FloatArray]
    inputs: Mapping[str, IntArray] = field(default_factory=dict)

    def __repr__(self) -> str:
        nodes = [_node(key, values.shape[1:]) for key, values in self.likelihoods.items()]
        nodes += [f"{name}, an input" for name in self.inputs]
        return f"Evidence({len(self)} frames: {', '.join(nodes)})"

    def __post_init__(self) -> None:
        for name, kind in (("likelihoods", np.float64), ("inputs", np.int64)):
            arrays: dict[Any, NDArray[Any]] = {}
            for node, values in getattr(self, name).items():
                try:
                    array = np.atleast_1d(values)
                    casting: Any = "same_kind" if array.size else "unsafe"
                    arrays[node] = array.astype(kind, casting=casting, copy=False)
                except (TypeError, ValueError) as error:
                    what = "numbers" if name == "likelihoods" else "indices, see hard"
                    raise InputError(f"evidence for {node}: needs an array of {what}") from error
            object.__setattr__(self, name, arrays)
        given = [*self.likelihoods.items(), *self.inputs.items()]
        if len({len(values) for _, values in given}) > 1:
            lengths = ", ".join(f"{node} {len(values)}" for node, values in given)
            raise InputError(f"evidence: different numbers of frames: {lengths}")
        for node, values in self.likelihoods.items():
            # NaN is neither.
            is_fine = (values >= 0) & (values < np.inf)
            if not is_fine.all():
                frame = int(np.argwhere(~is_fine)[0][0])
                raise InputError(f"evidence for {node}: frame {frame} has a negative or NaN value")

    def __len__(self) -> int:
        arrays = (*self.likelihoods.values(), *self.inputs.values())
        return len(arrays[0]) if arrays else 0

    @classmethod
    def hard(cls, rows: Mapping[str, Iterable[Any]] | pd.DataFrame, compiled: Compiled) -> Evidence:
        """Make evidence from observed values: likelihoods of one and zero.

        - rows: a DataFrame with a column per node, or per node its value in each frame, by name (a
          number for a name of digits); None, NaN or pd.NA if missing.

        An observed node without a column is missing in all frames; an input node is needed in every
        frame. Soft evidence for another node can be added:
        `Evidence({**hard.likelihoods, "Noise": likelihood}, hard.inputs)`.

        Raises InputError, naming node and row, for a node that is neither observed nor an input,
        for an unknown value, and for columns of different lengths.

        >>> import egolane_pgm as ego
        >>> place = ego.experiments_folder() / "quickstart.yaml"
        >>> model = ego.run(place, overrides={"recording.frames": [0, 9]}).model
        >>> seen = ego.Evidence.hard({"WOR": ["OK", "BAD", None]}, model.compiled)
        >>> seen.likelihoods["WOR"].tolist()
        [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
        """
        # pandas is imported only for such evidence.
        import pandas as pd

        try:
            table = pd.DataFrame({node: np.asarray(rows[node], dtype=object) for node in rows})
        except ValueError as error:
            raise InputError(f"evidence: needs a list of values for each node: {error}") from error
        observed = [(key,) if isinstance(key, str) else key for key in compiled.observed]
        known = {*(node for nodes in observed for node in nodes), *compiled.inputs}
        given: dict[str, IntArray] = {}
        for node, column in table.items():
            if node not in known:
                meant = suggestion(str(node), known)
                raise InputError(f"evidence for {node}: no such observed node or input{meant}")
            name = str(node)
            names = compiled.values[name]
            given[name] = pd.Index(names).get_indexer(column.convert_dtypes().astype("string"))
            unknown = np.flatnonzero((given[name] < 0) & column.notna())
            if len(unknown):
                row = unknown[0]
                value = column[row]
                meant = f"{value!r} is not the name of a value{suggestion(str(value), names)}"
                raise InputError(f"evidence for {node}: row {row}: {meant}")
        for node in compiled.inputs:
            if node not in given or (given[node] < 0).any():
                raise InputError(f"evidence for {node}: is missing, an input must be known")
        missing = np.full(len(table), -1)
        likelihoods: dict[Observed, FloatArray] = {}
        for key, nodes in zip(compiled.observed, observed, strict=True):
            likelihood = np.ones(len(table))
            for node in nodes:
                value = given.get(node, missing)[:, None]
                shown = (value == np.arange(compiled.cardinality[node])) | (value < 0)
                likelihood = np.einsum("t...,tk->t...k", likelihood, shown)
            likelihoods[key] = likelihood
        return cls(likelihoods, {node: given[node] for node in compiled.inputs})


@dataclass(frozen=True)
class Beliefs(_Frames):
    """The posterior of a filter after each frame.

    - frame_id (T,).
    - marginals: per hidden node P(node | evidence so far), (T, cardinality).
    - log_evidence (T,): natural log of P(evidence of the frame | earlier frames); 0 in impossible
      frames.
    - is_impossible (T,): frames whose evidence has joint likelihood zero; the belief there is the
      prediction.
    - values: the names of the nodes' values; by default numbers from 0, for Lane from 1.

    `beliefs["Gear"]` is the posterior of one node.

    >>> import numpy as np
    >>> import egolane_pgm as ego
    >>> lane = np.array([[0.2, 0.8], [0.1, 0.9]])
    >>> beliefs = ego.Beliefs(np.array([7, 8]), {"Lane": lane}, np.zeros(2), np.zeros(2, bool))
    >>> beliefs
    Beliefs(2 frames, ids 7 to 8: Lane (2))
    >>> beliefs.lane[-1]
    array([0.1, 0.9])
    >>> beliefs.to_pandas().columns.tolist()
    ['Lane=1', 'Lane=2']
    """

    frame_id: IntArray
    marginals: Mapping[str, FloatArray]
    log_evidence: FloatArray
    is_impossible: BoolArray
    values: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __repr__(self) -> str:
        nodes = [_node(name, values.shape[1:]) for name, values in self.marginals.items()]
        return f"Beliefs({_span(self.frame_id)}: {', '.join(nodes)})"

    def __len__(self) -> int:
        return len(self.frame_id)

    def __getitem__(self, node: str) -> FloatArray:
        if node not in self.marginals:
            meant = suggestion(str(node), self.marginals)
            raise InputError(f"the beliefs are about no node '{node}'{meant}")
        return self.marginals[node]

    @property
    def lane(self) -> FloatArray:
        """(T, n): the posterior over lanes. Raises InputError without a node Lane."""
        return self["Lane"]

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with a row per frame and a column `Node=value` per value, Lane first."""
        # pandas is imported only for a table.
        import pandas as pd

        columns: dict[str, FloatArray] = {}
        for node, belief in sorted(self.marginals.items(), key=lambda each: each[0] != "Lane"):
            first = int(node == "Lane")
            names = self.values.get(node, range(first, first + belief.shape[1]))
            columns |= {f"{node}={name}": belief[:, k] for k, name in enumerate(names)}
        return pd.DataFrame(columns, index=pd.Index(self.frame_id, name="frame_id"))


#: The directions of lane changes in words.
SIDES = {-1: "to the left", 1: "to the right"}


def lane_truth(
    frame_id: Any, lane: Any, is_crossing: Any, source: str = "ground truth"
) -> pd.DataFrame:
    """Make the ground truth of K annotated frames: a row each, with index `frame_id`.

    - frame_id (K,): strictly increasing.
    - lane (K,): 1 (leftmost) to n; the column `true_lane`.
    - is_crossing (K,): frames in which the car changes lanes: their label is ambiguous.
    - source: the file, for messages; kept in `attrs`.

    Raises InputError for frame ids that do not increase.
    """
    # pandas is imported for tables only.
    import pandas as pd

    ids = np.asarray(frame_id, dtype=np.int64)
    check_frame_ids(ids, source)
    columns = {
        "true_lane": np.asarray(lane, dtype=np.int64),
        "is_crossing": np.asarray(is_crossing, dtype=bool),
    }
    truth = pd.DataFrame(columns, index=pd.Index(ids, name="frame_id"))
    truth.attrs["source"] = source
    return truth
