"""The verb `show`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import yaml
from annotated_types import Ge, Le

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.loading import experiment_path, load_yaml
from egolane_pgm.model import compile_graph, matching_evidence_rule
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.plugins import find_plugin, load_plugin, plugin_names
from egolane_pgm.recordings import format_of
from egolane_pgm.runs import open_input
from egolane_pgm.tools.files import check_not_read, plain
from egolane_pgm.types import MAX_LANES, InputError, problems_in, suggestion
from egolane_pgm.verbs import listing
from egolane_pgm.verbs.given import Option, StrPath, path_of, shown
from egolane_pgm.views.description import (
    describe_detector,
    describe_graph,
    describe_rule,
    description_text,
)
from egolane_pgm.views.network import check_ending, write_network
from egolane_pgm.views.tables import box_text, wrapped

EXAMPLES = (
    "egolane show",
    "egolane show sensor_failure --tables",
    "egolane show sensor_failure --out network.png",
    "egolane show drive.csv",
    "egolane show lstr_360x640.onnx",
    "egolane show schema > experiment.schema.json",
)

NLanes = Annotated[int, Ge(1), Le(MAX_LANES)]

#: The plugins that are described, and the folder of each kind.
_KINDS = {"graph": "graphs", "evidence": "evidence", "detector": "detectors"}


def show(
    name: Annotated[StrPath | None, Option("[NAME|FILE|KIND]")] = None,
    *,
    n_lanes: NLanes = 3,
    tables: bool = False,
    frame: int | None = None,
    out: Annotated[StrPath | None, Option("FILE")] = None,
) -> dict[str, Any]:
    """Show what there is, or describe one thing.

    Without NAME, or with a KIND (graphs, evidence, detectors, experiments, ...), the names are
    listed. NAME is one of these or a file of your own: a graph, an evidence rule, a detector or an
    experiment. `graph:NAME`, `evidence:NAME`, `detector:NAME` and `experiment:NAME` tell apart what
    has the same name. `schema` is the JSON Schema of experiments, `schema:tuning` that of tuning
    files.

    For a recording (a table or a bag), print its content and, if names and signs are clear, the
    command that runs it. For a lane network (FILE.onnx), print its inputs, its outputs and the
    layouts that fit.

    - n_lanes: number of lanes of the road.
    - tables: print a graph's tables in numbers.
    - frame: print the lines of this frame of an experiment's recording, as in the paper's Box 1.
    - out: write a graph: a picture (.png, .svg, .pdf), or both slices with their tables for
      other programs (.bif).

    Returns the description. Raises InputError, one line, for whatever does not fit.
    """
    given = "" if name is None else path_of(name, "name")
    if out is not None:
        check_ending(path_of(out, "out"))
    if not given or given in listing.KINDS:
        found = listing.listed(given or None)
    elif given.partition(":")[0] == "schema":
        found = _schema(given.partition(":")[2] or "experiment")
    elif given.endswith(".onnx"):
        found = _onnx(Path(given))
    elif _is_recording(Path(given)):
        found = _recording(Path(given))
    elif _is_yaml(given):
        found = _yaml(given.removeprefix("experiment:"), frame)
    else:
        found = _plugin(given, n_lanes, tables, out)
    if out is not None and found.get("kind") != "graph":
        raise InputError(f"out: {out}: only a graph is written to a file")
    if frame is not None and "keys" not in found:
        raise InputError("frame: goes with an experiment")
    return found


def says(done: Mapping[str, Any], given: Mapping[str, Any]) -> str:
    """The description as text, or the name of the file that was written."""
    if given.get("out") is not None:
        return str(given["out"])
    if "text" in done:
        return str(done["text"])
    if "$schema" in done:
        return json.dumps(done, indent=1)
    if "kind" not in done:
        return listing.list_text(done)
    if "keys" in done:
        return _yaml_text(done)
    return description_text({**done, "file": shown(done["file"])})


def _onnx(path: Path) -> dict[str, Any]:
    # OpenCV is imported only if it is needed.
    from egolane_pgm.vision.detectors.networks.checking import describe_onnx

    return {"name": str(path), "text": describe_onnx(path)}


def _is_recording(path: Path) -> bool:
    """Whether a name is that of a table or a bag."""
    try:
        return format_of(path) in ("table", "rosbag")
    except InputError:
        return False


def _recording(path: Path) -> dict[str, Any]:
    from egolane_pgm.recordings.showing import show_recording

    return {"name": str(path), "text": show_recording(path)}


def _schema(kind: str) -> dict[str, Any]:
    # It imports whatever has a schema.
    from egolane_pgm.verbs.schema import KINDS, schema

    if kind not in KINDS:
        raise InputError(f"schema:{kind}: unknown kind{suggestion(kind, KINDS)}")
    return schema(kind)


# --- experiments -------------------------------------------------------------------------------


def _is_yaml(name: str) -> bool:
    """Whether a name is that of an experiment, or a YAML file that is no graph."""
    if name.startswith("experiment:"):
        return True
    if name.lower().endswith((".yaml", ".yml")):
        path = experiment_path(name)
        return path.is_file() and "nodes" not in load_yaml(path)
    if any(name in plugin_names(folder) for folder in _KINDS.values()):
        return False
    return any(path.stem == name for path in listing.yaml_files())


def _yaml(name: str, frame: int | None) -> dict[str, Any]:
    """The keys of an experiment or of a tuning file, and the lines of a frame."""
    path = experiment_path(name)
    keys = load_yaml(path)
    found: dict[str, Any] = {
        "kind": "tuning file" if "experiments" in keys else "experiment",
        "name": keys.get("name", path.stem),
        "file": str(path),
        "keys": plain(keys),
    }
    if frame is not None:
        [drive] = open_input(path).drives()
        found["text"] = box_text(drive.log, frame)
    return found


def _yaml_text(found: Mapping[str, Any]) -> str:
    """The keys of a YAML file, with those of the files that it includes."""
    keys = {
        key: value for key, value in found["keys"].items() if key not in ("name", "description")
    }
    about = found["keys"].get("description")
    lines = [f"{found['kind']} {found['name']}", shown(found["file"])]
    lines += ["", wrapped(str(about))] if about else []
    text = yaml.safe_dump(keys, sort_keys=False, allow_unicode=True, default_flow_style=None)
    return "\n".join([*lines, "", text.rstrip("\n")])


# --- graphs, evidence rules, detectors ---------------------------------------------------------


def _plugin(name: str, n_lanes: int, tables: bool, out: StrPath | None) -> dict[str, Any]:
    """The description of a plugin; a graph is also written to `out`."""
    kind, bare = find_plugin(name, _KINDS, Path.cwd())
    if out is not None:
        check_not_read(Path(out), [Path(bare)])
    module = load_plugin(_KINDS[kind], bare, kind)
    found: dict[str, Any] = {"name": bare}
    if kind == "evidence":
        return found | describe_rule(module, _defaults(module, n_lanes))
    if kind == "detector":
        return found | describe_detector(module)
    compiled = compile_defaults(bare, module, n_lanes)
    if out is not None:
        write_network(compiled, path_of(out, "out"))
    return found | describe_graph(module, compiled, numbers=tables)


def compile_defaults(name: str, module: ModuleType, n_lanes: int) -> Compiled:
    """A graph with the default values of its parameters."""
    where = f"graph {name}"
    parameters = _defaults(module, n_lanes)
    with problems_in(where):
        rule = matching_evidence_rule(module, n_lanes, "counting", where)
        evidence = load_plugin("evidence", rule, where)
        return compile_graph(evidence, module, n_lanes, parameters)[0]


def _defaults(module: ModuleType, n_lanes: int) -> Parameters:
    return resolve_parameters(getattr(module, "PARAMETERS", ()), {}, n_lanes)
