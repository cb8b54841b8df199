"""The commands `egolane ls`, `egolane show` and `egolane validate`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import click

from egolane_pgm.cli import options
from egolane_pgm.cli.completion import plugins
from egolane_pgm.cli.options import write_json
from egolane_pgm.drive import check_sources
from egolane_pgm.experiment import experiment_path, experiments_folder, load_experiment, load_yaml
from egolane_pgm.inference.compile import Compiled
from egolane_pgm.model import (
    Roles,
    build_network,
    compile_graph,
    fitting_rule,
    graph_roles,
    prepare_model,
)
from egolane_pgm.parameters import Parameters, resolve_parameters
from egolane_pgm.plugins import find_plugin, load_plugin, plugin_names
from egolane_pgm.recordings import FORMATS
from egolane_pgm.report.description import (
    describe_detector,
    describe_graph,
    describe_rule,
    description_text,
)
from egolane_pgm.report.tables import line_width
from egolane_pgm.results import SCHEMA_VERSION
from egolane_pgm.simulation import PRESETS
from egolane_pgm.tools.files import check_not_read
from egolane_pgm.tuning.pictures import make_problem
from egolane_pgm.tuning.plan import PicturePlan, check_plan, check_tuning, load_plan, read_plan
from egolane_pgm.types import InputError, all_problems


@click.command()
def ls() -> None:
    """List graphs, evidence rules, detectors, simulated drives and experiments that come along."""
    formatter = click.HelpFormatter(width=line_width())
    formatter.write_dl(
        [
            ("graphs:", ", ".join(plugin_names("graphs"))),
            ("evidence:", ", ".join(plugin_names("evidence"))),
            ("detectors:", ", ".join(plugin_names("detectors"))),
            ("recordings:", ", ".join(FORMATS)),
            ("simulations:", ", ".join(sorted(PRESETS))),
        ]
    )
    tuning = experiments_folder() / "tuning"
    with formatter.section("experiments"):
        formatter.write_dl(
            [
                (options.shown(path), load_experiment(path).description)
                for path in sorted(experiments_folder().rglob("*.yaml"))
                if path.name != "published.yaml"
                and path.parent.name != "tuning"
                and not path.name.startswith("_")
            ],
            col_max=4,
        )
    with formatter.section("tuning files (for `egolane tune`)"):
        formatter.write_dl(
            [
                (options.shown(path), load_yaml(path).get("description", ""))
                for path in sorted(tuning.glob("*.yaml"))
            ],
            col_max=4,
        )
    click.echo(formatter.getvalue(), nl=False)


@click.command()
@options.experiments(required=True)
@options.overrides()
def validate(experiments: tuple[str, ...], overrides: tuple[str, ...]) -> None:
    """Check experiments, and tuning files with theirs, without computing anything: keys, plugins,
    parameters, files.

    A .py that a YAML names is executed, as by every command: read it before, when somebody else
    wrote it.
    """
    with all_problems() as part:
        for path in experiments:
            with part():
                click.echo(f"{path}: ok ({_validated(path, overrides)})")


def _validated(path: str, overrides: Sequence[str]) -> str:
    """What an experiment or a tuning file has, in a few words. Raises InputError for all that is
    wrong with it."""
    keys = load_yaml(experiment_path(path), overrides)
    if "pictures" in keys:
        seen = read_plan(path, overrides)
        assert isinstance(seen, PicturePlan)
        problem = make_problem(seen)
        return f"{len(problem.clips)} labelled pictures, {len(problem.space)} numbers searched"
    if "experiments" in keys:
        plan = load_plan(path, overrides)
        with all_problems() as part:
            with part():
                n_searched = check_plan(plan)
            for each in plan.experiments:
                with part():
                    check_sources(each)
        return f"{len(plan.experiments)} experiment(s), {n_searched} numbers searched"
    experiment = load_experiment(path, overrides)
    with all_problems() as part:
        with part():
            model = prepare_model(experiment)
            check_tuning(experiment, model)
        with part():
            check_sources(experiment)
    return f"{model.n_lanes} lanes, {model.compiled.n_states} joint states"


#: What `egolane show` knows, and the folder of each.
_KINDS = {"graph": "graphs", "evidence": "evidence", "detector": "detectors"}


@click.command()
@click.argument(
    "name",
    metavar="GRAPH|EVIDENCE|DETECTOR",
    shell_complete=plugins("graphs", "evidence", "detectors"),
)
@options.n_lanes
@click.option("--tables", is_flag=True, help="Print a graph's tables in numbers.")
@options.json_file
def show(name: str, n_lanes: int, tables: bool, json_file: Path | None) -> None:
    """Show what a graph, an evidence rule or a detector is: nodes, edges, tables, parameters.

    A name of `egolane ls`, or a file of your own; `graph:NAME`, `evidence:NAME` or `detector:NAME`
    says which where it is not clear.
    """
    kind, bare = find_plugin(name, _KINDS, Path.cwd())
    if json_file:
        check_not_read(json_file, [Path(bare)])
    module = load_plugin(_KINDS[kind], bare, Path.cwd(), kind)
    found: dict[str, Any] = {"schema_version": SCHEMA_VERSION, "name": bare}
    if kind == "graph":
        compiled = compile_defaults(bare, module, n_lanes)
        found |= describe_graph(module, compiled, numbers=tables)
    elif kind == "evidence":
        found |= describe_rule(module, _defaults(module, n_lanes))
    else:
        found |= describe_detector(module)
    # The file is written before anything is printed, because a reader may close the pipe.
    if json_file:
        write_json(json_file, found)
    click.echo(description_text({**found, "file": options.shown(Path(found["file"]))}))


def compile_defaults(name: str, module: ModuleType, n_lanes: int) -> Compiled:
    """A graph with the default values of its parameters."""
    where = f"graph {name}"
    try:
        declared = build_network(module, n_lanes, _defaults(module, n_lanes), where)
        rule = fitting_rule(module, n_lanes, "counting", Path.cwd(), where)
        try:
            roles = graph_roles(module, load_plugin("evidence", rule, Path.cwd(), where), declared)
        except InputError:
            # A rule of one's own may give what none of the package gives.
            roles = Roles(None, (), (), ())
        return compile_graph(module, roles, declared)
    except InputError as error:
        raise InputError(str(error) if where in str(error) else f"{where}: {error}") from error


def _defaults(module: ModuleType, n_lanes: int) -> Parameters:
    return resolve_parameters(getattr(module, "PARAMETERS", ()), {}, n_lanes)
