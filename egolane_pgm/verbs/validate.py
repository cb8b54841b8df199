"""The verb `validate`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from egolane_pgm.drive import check_sources
from egolane_pgm.experiment import Overrides, experiment_path, load_experiment, load_yaml
from egolane_pgm.model import prepare_model
from egolane_pgm.tuning.plan import check_plan, check_tuning, load_plan
from egolane_pgm.types import all_problems
from egolane_pgm.verbs.given import Option, StrPath, path_of, several_of

EXAMPLES = ("egolane validate drive/experiment.yaml experiments/zero_label.yaml",)


def validate(
    experiments: Annotated[StrPath | Sequence[StrPath], Option(many=True)],
    *,
    overrides: Overrides = (),
) -> Mapping[str, str]:
    """Check experiments, and tuning files with theirs, without computing anything: keys, plugins,
    parameters, files.

    A .py that a YAML names is executed, as by every command: read it before, when somebody else
    wrote it.

    - overrides: override a key of the YAML, e.g. parameters.bonus_value=0.

    Returns what each has, in a few words. Raises InputError, a line for each problem.
    """
    found = {}
    with all_problems() as part:
        for each in several_of(experiments):
            path = path_of(each, "experiments")
            with part():
                found[path] = _has(path, overrides)
    return found


def says(done: Mapping[str, str], given: Mapping[str, Any]) -> str:
    """A line for each."""
    return "\n".join(f"{path}: ok ({has})" for path, has in done.items())


def _has(path: str, overrides: Overrides) -> str:
    keys = load_yaml(experiment_path(path), overrides)
    if "experiments" in keys:
        return check_plan(load_plan(path, overrides))
    experiment = load_experiment(path, overrides)
    with all_problems() as part:
        with part():
            model = prepare_model(experiment)
            check_tuning(experiment, model)
        with part():
            check_sources(experiment)
    return f"{model.n_lanes} lanes, {model.compiled.n_states} joint states"
