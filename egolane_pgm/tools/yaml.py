"""Read and write YAML by PyYAML, except that keys are text and unique, and `1e3` is a number."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import yaml

from egolane_pgm.types import InputError

_TAG = "tag:yaml.org,2002:"


def parse_yaml(text: str, source: str) -> Any:
    """Parse YAML. Raises InputError, starting with `source`, for bad YAML and repeated keys."""
    try:
        return yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        at = f"line {mark.line + 1}: " if mark is not None else ""
        raise InputError(f"{source}: is not YAML: {at}{error.problem}") from error
    except RecursionError:
        raise InputError(f"{source}: is not YAML: is nested too deeply") from None
    except Exception as error:
        # PyYAML raises almost any error for a tag that does not fit its value.
        problem = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{source}: is not YAML: {problem}") from error


def dump_yaml(content: Mapping[str, Any]) -> str:
    """Format as YAML, keys in their order, innermost lists in one line."""
    text: str = yaml.dump(
        content,
        Dumper=_Dumper,
        sort_keys=False,
        allow_unicode=True,
        default_flow_style=None,
        width=100,
    )
    return text


class _Loader(yaml.SafeLoader):
    """Takes keys as text; refuses repeated ones, and texts with a NUL character."""

    def compose_scalar_node(self, anchor: Any) -> Any:
        node = super().compose_scalar_node(anchor)
        if "\0" in node.value:
            problem = "a text contains a NUL character"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)
        return node

    def compose_mapping_node(self, anchor: Any) -> Any:
        node = super().compose_mapping_node(anchor)
        lines: dict[str, int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag == f"{_TAG}merge":
                continue
            key.tag = f"{_TAG}str"
            mark = key.start_mark
            if key.value in lines:
                problem = f"key '{key.value}' was given in line {lines[key.value]}"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
            lines[key.value] = mark.line + 1
        return node


class _Dumper(yaml.SafeDumper):
    """Quotes text that `_Loader` would read as another type."""


for _class in (_Loader, _Dumper):
    _class.add_implicit_resolver(
        f"{_TAG}float", re.compile(r"[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+\Z"), [*"-+0123456789"]
    )
