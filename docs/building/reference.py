"""The pages of the reference, made from the code when the site is built. They are not kept.

Their text is in the declarations: of a key in its `Field`, of a parameter in its `Parameter`, of a
command in its docstring and options, of a column in its reader, of a plugin in its contract.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, get_type_hints

import click
import yaml
from docstrings import as_markdown
from typing_extensions import is_protocol

import egolane_pgm
from egolane_pgm import contracts, plugins, result
from egolane_pgm.command import COMMANDS, egolane
from egolane_pgm.contracts import Detector, Graph, Plugin, Reader, Rule
from egolane_pgm.graphs import yaml_graph
from egolane_pgm.inference import events
from egolane_pgm.maps import positions, road_table
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.plugins import load_plugin, plugin_names
from egolane_pgm.recordings import FORMATS, ground_truth, reader_of
from egolane_pgm.recordings.columns import COLUMNS
from egolane_pgm.verbs.schema import schema as json_schema
from egolane_pgm.verbs.show import compile_defaults
from egolane_pgm.views.description import describe_detector, describe_graph, describe_rule
from egolane_pgm.vision.camera import model as camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import FrameLines
from egolane_pgm.vision.detectors.networks.description import Network

#: The functions that compute scores, by module, in the order of the page.
METRICS = ("confusion", "events", "bootstrap")


def pages() -> dict[str, str]:
    """The Markdown of each page by its place on the site."""
    return {
        "reference/experiment.md": experiment_page(),
        "reference/yaml.md": yaml_page(),
        "reference/recordings.md": recordings_page(),
        "reference/commands.md": commands_page(),
        "reference/plugins.md": contracts_page(),
        "reference/graphs.md": plugins_page(Graph),
        "reference/evidence.md": plugins_page(Rule),
        "reference/detectors.md": plugins_page(Detector),
        "reference/metrics.md": metrics_page(),
        "reference/results.md": results_page(),
        "reference/python.md": python_page(),
    }


# --- YAML files ----------------------------------------------------------------------------------


def experiment_page() -> str:
    """Every key of an experiment, section by section."""
    return "\n\n".join(
        [
            "# Keys of an experiment",
            "An experiment is a YAML file. Unknown keys are refused, with a suggestion; `egolane"
            " run FILE --dry-run` checks one. Any key can be changed"
            " on the command line, `--set parameters.sigma1=0.3`. Paths are relative to the YAML.",
            "An editor with YAML's language server (VS Code with its YAML extension, Neovim,"
            " JetBrains, ...) completes and checks the keys of a file whose first line names the"
            " schema:",
            "```\negolane show schema > experiment.schema.json\n```",
            "```yaml\n# yaml-language-server: $schema=experiment.schema.json\nname: my_drive\n"
            "recording: {path: drive.csv}\nn_lanes: 3\n```",
            *schema_tables(json_schema("experiment"), "The file"),
        ]
    )


def yaml_page() -> str:
    """Every key of the other YAML files."""
    tuning = json_schema("tuning")
    said = listed(inspect.getdoc(camera.Camera) or "")
    rows = []
    for field in dataclasses.fields(camera.Camera):
        if field.name != "name":
            low_high = camera.RANGES.get(field.name)
            unit = (
                f"{low_high[0]} to {low_high[1]}, {low_high[2]}" if low_high else "list of numbers"
            )
            needed = field.default is dataclasses.MISSING
            rows.append(
                [
                    f"`{field.name}`",
                    unit,
                    "needed" if needed else as_code(field.default),
                    said[field.name],
                ]
            )
    return "\n\n".join(
        [
            "# Keys of the other YAML files",
            "## A tuning file",
            "Several experiments for `egolane tune FILE`. `egolane show schema:tuning` prints its"
            " schema; `fit` has the keys of [an experiment's](experiment.md#fit-settings).",
            keys_table(tuning, {}),
            "## A camera",
            "The file for `camera:` and `--camera`; `egolane calibrate` writes one.",
            markdown(["key", "range", "default", "meaning"], rows),
            "## A graph in YAML",
            "The file for `graph: ./my_graph.yaml`; `egolane learn` writes one.",
            as_markdown(inspect.getdoc(yaml_graph) or ""),
            "## A lane network",
            "The file for the detector `network` (`--set network=net.yaml`).",
            as_markdown(inspect.getdoc(Network) or ""),
        ]
    )


def schema_tables(schema: Mapping[str, Any], title: str, level: int = 2) -> Iterator[str]:
    """A heading and a table of keys for each section of a JSON schema."""
    definitions = schema.get("$defs", {})
    if "properties" in schema:
        yield f"{'#' * level} {title}"
        yield as_markdown(schema.get("description", ""))
        yield keys_table(schema, definitions)
    order = [key for key in order_of(schema, definitions) if key in definitions]
    for name in order + [each for each in definitions if each not in order]:
        section = definitions[name]
        yield f"{'#' * level} {section_title(name)}"
        yield as_markdown(section.get("description", ""))
        yield keys_table(section, definitions)


def order_of(schema: Mapping[str, Any], definitions: Mapping[str, Any]) -> list[str]:
    """The sections in the order in which keys name them."""
    found = re.findall(r'"#/\$defs/(\w+)"', json.dumps(schema.get("properties", {})))
    for name in list(found):
        found += order_of(definitions[name], definitions)
    return list(dict.fromkeys(found))


def section_title(name: str) -> str:
    """`GroundTruth` -> `Ground truth`."""
    return re.sub(r"(?<!^)(?=[A-Z])", " ", name).capitalize()


def keys_table(section: Mapping[str, Any], definitions: Mapping[str, Any]) -> str:
    """Key, type, default, and meaning with examples of each key of a section."""
    rows = []
    for name, key in section.get("properties", {}).items():
        examples = [f"<br>`{name}: {flow(each)}`" for each in key.get("examples", ())]
        default = "needed" if name in needed_keys(section) else as_default(key)
        meaning = escaped(key.get("description", "")) + "".join(examples)
        rows.append([f"`{name}`", kind_of(key, definitions), default, meaning])
    return markdown(["key", "type", "default", "meaning, and example"], rows)


def needed_keys(section: Mapping[str, Any]) -> list[str]:
    """The required keys of a section."""
    if "then" in section:
        return [*section["if"]["required"], *section["then"]["anyOf"][0]["required"]]
    return list(section.get("required", ()))


def as_default(key: Mapping[str, Any]) -> str:
    """The default of a key; empty for a key that is left out."""
    default = key.get("default")
    return "" if default in (None, [], "") else as_code(default)


def kind_of(key: Mapping[str, Any], definitions: Mapping[str, Any]) -> str:
    """The type of a key in words."""
    if "$ref" in key:
        name = key["$ref"].rpartition("/")[2]
        title = section_title(name)
        if name not in definitions:
            return "keys and values"
        return f"section [{title}](#{title.lower().replace(' ', '-')})"
    if "enum" in key:
        return " or ".join(f"`{each}`" for each in key["enum"])
    if "const" in key:
        return f"`{key['const']}`"
    for several in ("anyOf", "oneOf", "allOf"):
        if several in key:
            words = [kind_of(each, definitions) for each in key[several]]
            return " or ".join(dict.fromkeys(word for word in words if word != "nothing"))
    kind = key.get("type")
    if kind == "array":
        if "prefixItems" in key:
            parts = [kind_of(each, definitions) for each in key["prefixItems"]]
            return f"[{', '.join(parts)}]"
        return f"list of {kind_of(key['items'], definitions)}" if "items" in key else "list"
    words = {
        "integer": "whole number",
        "number": "number",
        "string": "text",
        "boolean": "true or false",
        "object": "keys and values",
        "null": "nothing",
    }
    if "pattern" in key and key["pattern"].startswith(r"\.("):
        return "file " + key["pattern"].removeprefix(r"\.(").removesuffix(")$").replace("|", ", ")
    return words.get(str(kind), "any value") + bounds_of(key)


def bounds_of(key: Mapping[str, Any]) -> str:
    """The bounds of a number."""
    signs = {
        "minimum": "at least",
        "exclusiveMinimum": "above",
        "maximum": "at most",
        "exclusiveMaximum": "below",
    }
    found = [f"{sign} {key[name]:g}" for name, sign in signs.items() if name in key]
    return f", {', '.join(found)}" if found else ""


# --- recordings ----------------------------------------------------------------------------------


def recordings_page() -> str:
    """The formats of lines, ground truth, positions and roads."""
    parts = ["# Recordings, ground truth, positions"]
    for name, (endings, _, _) in FORMATS.items():
        reader = reader_of(name)
        ends = ", ".join(f"`{ending}`" for ending in endings) or "a folder"
        options = ", ".join(f"`{option}`" for option in reader.__kwdefaults__ or ())
        parts += [
            f"## {name} ({ends})",
            as_markdown(about(inspect.getmodule(reader))),
        ]
        if name == "table":
            rows = [[f"`{each}`", said] for each, said in COLUMNS.items()]
            parts.append(markdown(["column", "meaning"], rows))
        parts += [as_markdown(inspect.getdoc(reader) or ""), f"Options: {options}."]
    parts += [
        "## Ground truth",
        as_markdown(about(ground_truth)),
        as_markdown(inspect.getdoc(ground_truth.read_ground_truth) or ""),
        "## Positions",
        as_markdown(about(positions)),
        positions_table(),
        "## Road table",
        as_markdown(about(road_table)),
        meanings(road_table.COLUMNS),
    ]
    return "\n\n".join(parts)


def positions_table() -> str:
    """The columns of a table of positions."""
    said = listed(inspect.getdoc(positions.Positions) or "")
    rows = [
        [f"`{name}`", ", ".join(f"`{other}`" for other in others), said[name]]
        for name, (_, *others) in positions.COLUMNS.items()
    ]
    return markdown(["column", "also called", "meaning"], rows)


# --- commands ------------------------------------------------------------------------------------


def commands_page() -> str:
    """Every command with its arguments and options, as `--help` has them."""
    parts = [
        "# Commands",
        "`egolane COMMAND --help` prints the same. An error of the user is one line, and the exit"
        " code is 2.",
        "The tab key completes commands, options and names of files: put `eval"
        ' "$(_EGOLANE_COMPLETE=bash_source egolane)"` into `~/.bashrc`; of other shells [Click]'
        "(https://click.palletsprojects.com/en/stable/shell-completion/) has the line.",
    ]
    for name in COMMANDS:
        context = click.Context(egolane, info_name="egolane")
        command = egolane.get_command(context, name)
        assert command is not None
        parts += list(command_parts(command, context, name))
    return "\n\n".join(parts)


def command_parts(command: click.Command, parent: click.Context, name: str) -> Iterator[str]:
    context = click.Context(command, info_name=name, parent=parent)
    yield f"## {context.command_path}"
    yield f"```text\n{command.get_usage(context).removeprefix('Usage: ')}\n```"
    for text in (command.help, command.epilog):
        if text:
            yield help_text(text)
    rows = []
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None and "--help" not in record[0]:
            rows.append([f"`{record[0]}`", escaped(record[1])])
    if rows:
        yield markdown(["option", "meaning"], rows)


def help_text(text: str) -> str:
    """A help text as Markdown: a paragraph after a line of `\\b`, which click keeps, is code."""
    paragraphs = []
    for paragraph in inspect.cleandoc(text).split("\n\n"):
        if paragraph.startswith("\b\n"):
            paragraphs.append(f"```text\n{paragraph[2:]}\n```")
        else:
            paragraphs.append(escaped(paragraph))
    return "\n\n".join(paragraphs)


# --- contracts of plugins ------------------------------------------------------------------------

#: An example of each kind of plugin, a file of the repository, and the keys that name a plugin.
EXAMPLES: dict[type[Plugin], tuple[str, str]] = {
    Graph: ("examples/my_graph.py", "`graph:` or `--graph`"),
    Rule: ("examples/my_evidence.py", "`evidence:`"),
    Detector: ("examples/my_detector.py", "`recording.detector:` or `--detector`"),
    Reader: ("examples/readers/polynomials.py", "`recording.format:`"),
}

#: Types of arguments and values that the page of Python does not have.
TYPES = (Picture, FrameLines, camera.road_to_image)


def contracts_page() -> str:
    """Fields, functions and an example of each kind of plugin."""
    parts = [
        "# Plugins",
        *inspect.cleandoc(contracts.__doc__ or "").split("\n\n")[1:],
        "A name in capitals that is close to a field's is refused with a suggestion; all others are"
        " ignored. Names of arguments are free. `parameters` maps the names of `PARAMETERS` to"
        " checked values. `egolane show FILE` describes a graph, a rule or a detector;"
        " `egolane run FILE.yaml --dry-run` checks all that the YAML names.",
        "`Parameter`, `LineLog`, `Evidence` and `cpds` are on the page [Python](python.md), the"
        " columns of a recording in [recordings](recordings.md), the fields of a `Camera` in [other"
        " YAML files](yaml.md#a-camera), `Picture` and `FrameLines` [below](#types).",
    ]
    for kind, (example, keys) in EXAMPLES.items():
        summary = (inspect.getdoc(kind) or "").split("\n\n- ")[0]
        parts += [f"## {kind.__name__}", summary, f"Its name goes into {keys}.", fields_table(kind)]
        for function, protocol in plugins._protocols(kind).items():
            parts += [f"### {function}", *signature_parts(function, protocol)]
        source = (Path(__file__).parents[2] / example).read_text()
        parts += [f"### Example: {example}", f"````python\n{source}````"]
    options = {"heading_level": 3, "show_docstring_attributes": False, "members": False}
    names = [f"{each.__module__}.{each.__qualname__}" for each in TYPES]
    parts += ["## Types", *(identifier(name, options) for name in names)]
    return "\n\n".join(parts)


def fields_table(kind: type[Plugin]) -> str:
    """The names that a module of a kind of plugin may define."""
    functions, hints = plugins._protocols(kind), get_type_hints(kind)
    meaning = listed(inspect.getdoc(Plugin) or "") | listed(inspect.getdoc(kind) or "")
    rows = []
    for field in dataclasses.fields(kind):
        if field.name in plugins._OF_FILE:
            continue
        is_function = field.name in functions
        name = field.name if is_function else field.name.upper()
        hint = f"[function](#{field.name})" if is_function else f"`{type_text(hints[field.name])}`"
        needed = "needed" if field.default is dataclasses.MISSING else "optional"
        rows.append([f"`{name}`", hint, needed, escaped(meaning[field.name])])
    return markdown(["name in the module", "type", "", "meaning"], rows)


def type_text(hint: Any) -> str:
    """A type without modules; optional ones without None."""
    text = hint.__name__ if isinstance(hint, type) and not hasattr(hint, "__args__") else str(hint)
    text = re.sub(r"\b[a-z_]+(\.[a-z_]+)*\.(?=[A-Z])", "", text)
    return text.removesuffix(" | None")


def signature_parts(name: str, protocol: Any) -> Iterator[str]:
    """The signature of a function of a protocol, its docstring, and the function it returns."""
    signature = inspect.signature(protocol.__call__)
    parameters = [each for key, each in signature.parameters.items() if key != "self"]
    plain = [
        each.replace(kind=each.POSITIONAL_OR_KEYWORD) if each.kind is each.POSITIONAL_ONLY else each
        for each in parameters
    ]
    text = str(signature.replace(parameters=plain)).replace("'", "")
    yield f"```python\ndef {name}{text}\n```"
    yield as_markdown(inspect.getdoc(protocol.__call__) or "")
    returned = vars(contracts).get(str(signature.return_annotation))
    if returned is not None and is_protocol(returned):
        yield "The function that it returns:"
        yield from signature_parts("step", returned)


# --- graphs, evidence rules, detectors -----------------------------------------------------------

_INTRODUCTIONS: dict[type[Plugin], tuple[str, str]] = {
    Graph: (
        "# Graphs",
        "The names for `graph:`. Tables and sizes are for three lanes and default values;"
        " `egolane show GRAPH --numbers` prints the numbers. A search moves a parameter within its"
        " range; `fit.parameters` gives it another one. [Plugins](plugins.md#graph) documents a"
        " graph of your own.",
    ),
    Rule: (
        "# Evidence rules",
        "The names for `evidence:`. A rule turns the lines of a frame into likelihoods of the"
        " graph's observed nodes. [Plugins](plugins.md#rule) documents a rule of your own.",
    ),
    Detector: (
        "# Detectors",
        "The names for `recording.detector` and `--detector`. A detector finds lines in pictures."
        " [Plugins](plugins.md#detector) documents a detector of your own.",
    ),
}


def plugins_page(kind: type[Plugin]) -> str:
    """The description, as by `egolane show`, of each plugin of a kind."""
    parts = list(_INTRODUCTIONS[kind])
    for name in plugin_names(kind):
        plugin = load_plugin(kind, name, kind.folder)
        parts.append(f"## {name}")
        if isinstance(plugin, Graph):
            compiled = compile_defaults(name, plugin, 3)
            found = describe_graph(plugin, compiled, numbers=False)
            parts += [as_markdown(found["about"]), *graph_parts(found)]
        elif isinstance(plugin, Rule):
            defaults = resolve_parameters(plugin.parameters, {}, 3)
            found = describe_rule(plugin, defaults)
            parts += [as_markdown(found["about"]), *rule_parts(found)]
        else:
            assert isinstance(plugin, Detector)
            found = describe_detector(plugin)
            cameras = "two, as a stereo pair" if found["stereo"] else "one"
            parts += [as_markdown(found["about"]), f"Cameras: {cameras}."]
        parts.append(parameters_table(found["parameters"]))
    return "\n\n".join(parts)


def graph_parts(found: Mapping[str, Any]) -> Iterator[str]:
    nodes = [
        [f"`{node['name']}`", node["role"], shortened(node["values"])]
        for node in found["nodes"]
        if node["role"] != "virtual evidence"
    ]
    yield markdown(["node", "role", "values"], nodes)
    tables = []
    for each in found["tables"]:
        *given, node = each["axes"]
        bar = f" given {', '.join(given)}" if given else ""
        tables.append([f"P({node}{bar})", each["frames"], " x ".join(map(str, each["shape"]))])
    yield markdown(["table", "frames", "size"], tables)


def rule_parts(found: Mapping[str, Any]) -> Iterator[str]:
    gives = [key if isinstance(key, str) else " and ".join(key) for key in found["gives"]]
    lines = [f"Likelihoods of: {', '.join(f'`{each}`' for each in gives)}."] if gives else []
    if found["inputs"]:
        lines.append(f"Inputs: {', '.join(f'`{each}`' for each in found['inputs'])}.")
    if found["looks_ahead"]:
        lines.append(f"Not causal: {found['looks_ahead']}.")
    if found["can_learn"]:
        lines.append("It learns from a recording (`egolane learn`).")
    yield " ".join(lines)


def parameters_table(parameters: Sequence[Mapping[str, Any]]) -> str:
    """Kind, default, range of a search, and meaning with unit of each parameter."""
    if not parameters:
        return "It has no parameters."
    rows = []
    for each in parameters:
        kind = each["kind"] + (", or one per lane" if each["per_lane"] else "")
        if each["choices"]:
            choices = " or ".join(f"`{choice}`" for choice in each["choices"])
            kind = choices if each["kind"] == "choice" else f"{kind}, or {choices}"
        low_high = each["range"]
        searched = f"{low_high[0]:g} to {low_high[1]:g}" if low_high else "held fixed"
        default = each["default"]
        if isinstance(default, tuple) and len(default) > 8:
            default = f"{len(default)} numbers"
        meaning = escaped(each["meaning"])
        rows.append([f"`{each['name']}`", kind, as_code(default), searched, meaning])
    return markdown(["parameter", "kind", "default", "in a search", "meaning"], rows)


def shortened(values: Sequence[str]) -> str:
    """The values of a node; of many the first and the last."""
    return f"{values[0]} to {values[-1]}" if len(values) > 8 else ", ".join(values)


# --- scores, results, Python ---------------------------------------------------------------------


def metrics_page() -> str:
    """Every score, from the docstrings of the functions that compute it."""
    parts = [
        "# Metrics",
        "Scores read beliefs and ground truth, never the filter. Shapes: n lanes, T frames."
        " Results have them in [scores.json](results.md#scoresjson).",
    ]
    options = {
        "heading_level": 2,
        "show_root_heading": False,
        "show_root_toc_entry": False,
        "members_order": "source",
        "filters": ["!^_", "!^[A-Z_]+$"],
        "show_docstring_attributes": False,
    }
    for name in METRICS:
        parts += [
            f"## {name}",
            identifier(f"egolane_pgm.scoring.{name}", {**options, "heading_level": 3}),
        ]
    return "\n\n".join(parts)


def python_page() -> str:
    """The public names of the package."""
    parts = [
        "# Python",
        "`import egolane_pgm as ego` loads nothing heavy; each name is imported when it is used"
        " first. Wrong files and values raise `InputError`, whose text names the file and the key.",
    ]
    options = {"heading_level": 2, "members": False, "inherited_members": False}
    for name in egolane_pgm.__all__:
        public = getattr(egolane_pgm, name)
        if inspect.ismodule(public):
            every = {**options, "members": None, "filters": ["!^_", "!^[A-Z_]+$"]}
            parts.append(identifier(public.__name__, every))
            continue
        known = {"members": public_members(public)} if inspect.isclass(public) else {}
        parts.append(identifier(f"{public.__module__}.{public.__qualname__}", {**options, **known}))
    return "\n\n".join(parts)


def public_members(kind: type) -> list[str]:
    """The methods and properties of a class that have a docstring."""
    return [
        name
        for name, value in vars(kind).items()
        if not name.startswith("_")
        and (inspect.isfunction(value) or isinstance(value, property | classmethod | staticmethod))
    ]


def identifier(path: str, options: Mapping[str, Any]) -> str:
    """The directive of mkdocstrings for an object."""
    lines = yaml.safe_dump({"options": dict(options)}, sort_keys=False).splitlines()
    return "\n".join([f"::: {path}", *(f"    {line}" for line in lines)])


def results_page() -> str:
    """The files of a result directory, and the columns of its tables."""
    return "\n\n".join(
        [
            "# Result directories",
            as_markdown(about(result)),
            "experiment.yaml names a copy of your own graph or rule. graph.yaml is a graph that was"
            " fitted or in memory. So a loaded result has the same model.",
            "## beliefs.parquet",
            "A row per frame, `Result.frames`; the index is `frame_id`. Columns with a `?` are not"
            " always there.",
            meanings(result.COLUMNS),
            "## events.csv",
            "A row per lane change, `Result.events`; with ground truth also `delay_s`, its delay,"
            " and with several drives `drive`.",
            meanings(events.COLUMNS),
            "## scores.json",
            "[The metrics](metrics.md) of `detector` and `model`, with intervals, and of the"
            " lane changes (`events`).",
            "## run.json",
            "Provenance: the experiment with all defaults (`config`), files with checksums"
            " (`data`), versions, git commit, warnings, `tuned_on` and `is_causal`.",
        ]
    )


def meanings(columns: Mapping[str, str]) -> str:
    """The columns of a table and their meanings."""
    rows = [[f"`{name}`", escaped(meaning)] for name, meaning in columns.items()]
    return markdown(["column", "meaning"], rows)


# --- text ----------------------------------------------------------------------------------------


def about(module: ModuleType | None) -> str:
    """The docstring of a module."""
    return inspect.getdoc(module) or ""


def listed(docstring: str) -> dict[str, str]:
    """The list of a docstring, `- name, other (T,): meaning`, by name."""
    found = {}
    for item in re.findall(r"^- (.*?)(?=\n\S|\n\n|\Z)", docstring, flags=re.M | re.S):
        names, _, meaning = re.sub(r"\s+", " ", item).partition(": ")
        for name in re.sub(r"\([^)]*\)", "", names).split(","):
            found[name.strip()] = meaning
    return found


def escaped(text: str) -> str:
    """Text with `<`, `*` and other marks of Markdown escaped, outside of code."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(
        part if part.startswith("`") else re.sub(r"([<*_\[\]|])", r"\\\1", part) for part in parts
    )


def as_code(value: Any) -> str:
    """A value in YAML."""
    return f"`{flow(value)}`"


def flow(value: Any) -> str:
    """A value in one line of YAML."""
    if isinstance(value, float):
        return f"{value:.6g}"
    plain = json.loads(json.dumps(value))
    return yaml.safe_dump(plain, default_flow_style=True, width=1000).removesuffix("...\n").strip()


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table."""
    lines = [header, ["---"] * len(header), *rows]
    cells = [[" ".join(str(cell).split()) for cell in line] for line in lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in cells)
