"""Read and write YAML 1.2, where it differs from PyYAML's 1.1.

- Numbers are decimal (`010` is ten; `0o10`, `0x10` are octal, hexadecimal), `1e3` is a number,
  `1:30` and dates are text.
- Keys are text (`no: 1` has the key `no`) and unique.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import yaml

from egolane_pgm.types import InputError

_TAG = "tag:yaml.org,2002:"

#: The pattern of the values of each type, in this order; others are text.
_PLAIN = {
    "null": r"~|null|Null|NULL|",
    "bool": r"yes|Yes|YES|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON|off|Off|OFF",
    "int": r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+",
    "float": r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
    r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
    "merge": r"<<",
}


def parse_yaml(text: str, source: str) -> Any:
    """Parse YAML. Raises InputError, starting with `source`, for bad YAML and repeated keys."""
    try:
        return yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        at = f"line {mark.line + 1}: " if mark is not None else ""
        hint = "; indent with spaces" if "'\\t'" in str(error.problem) else ""
        raise InputError(f"{source}: is not YAML: {at}{error.problem}{hint}") from error
    except (yaml.YAMLError, ValueError) as error:
        raise InputError(f"{source}: is not YAML: {' '.join(str(error).split())}") from error


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
    """Takes keys as text and refuses repeated ones."""

    def compose_mapping_node(self, anchor: Any) -> Any:
        node = super().compose_mapping_node(anchor)
        lines: dict[str, int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag == f"{_TAG}merge":
                continue
            key.tag, mark = f"{_TAG}str", key.start_mark
            if key.value in lines:
                problem = f"key '{key.value}' was given in line {lines[key.value]}"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
            lines[key.value] = mark.line + 1
        return node


class _Dumper(yaml.SafeDumper):
    """Quotes text that `_Loader` would read as another type."""


_Loader.add_constructor(
    f"{_TAG}int", lambda _, node: int(node.value, {"0o": 8, "0x": 16}.get(node.value[:2], 10))
)
_Loader.add_constructor(
    f"{_TAG}float",
    lambda _, node: float(node.value.lower().replace(".inf", "inf").replace(".nan", "nan")),
)

for _class in (_Loader, _Dumper):
    # Without those of YAML 1.1.
    _class.yaml_implicit_resolvers = {}
    for _name, _pattern in _PLAIN.items():
        _class.add_implicit_resolver(_TAG + _name, re.compile(rf"(?:{_pattern})\Z"), None)
