"""YAML as this package reads and writes it: the one place that knows the language.

It is YAML as its version 1.2 means it, where that differs from what PyYAML takes (1.1):

- A number is decimal (`010` is ten, `0o10` and `0x10` are written out), `1e3` is a number, `1:30`
  is text. Whole numbers have at most 18 digits.
- A date is text.
- A key is the text that stands there: `no: 1` has the key `no`, and a key may stand only once.

And it is refused, with its line, what only damage or malice writes: a tag (`!!python/...`,
`!!set`) other than those of plain values, a value that is not what its tag says, text that no file
or name can have (NUL), a nesting of more than 50, aliases (`*name`) that repeat more than 10,000
values.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import yaml

from egolane_pgm.types import InputError

#: Brackets in brackets. A graph of ours has eight.
MAX_DEPTH = 50

#: Values that aliases may put in beside those that are written.
MAX_REPEATED = 10_000

_TAG = "tag:yaml.org,2002:"

#: The types that a value may have, and the text that a plain one is recognised by, in this order.
_PLAIN = {
    "null": r"~|null|Null|NULL|",
    "bool": r"yes|Yes|YES|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON|off|Off|OFF",
    "int": r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+",
    "float": r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
    r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
    "merge": r"<<",
}
_TYPES = frozenset(_TAG + name for name in (*_PLAIN, "str", "seq", "map"))


def parse_yaml(text: str, source: str) -> Any:
    """What a text in YAML says. Raises InputError, which begins with `source`, for what is no YAML
    and for what is refused here; for every key that a mapping has twice."""
    try:
        loader = _Loader(text)
        content = loader.get_single_data()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        at = f"line {mark.line + 1}: " if mark is not None else ""
        hint = "; indent with spaces" if "'\\t'" in str(error.problem) else ""
        raise InputError(f"{source}: is not YAML: {at}{error.problem}{hint}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InputError(f"{source}: is not YAML: {' '.join(str(error).split())}") from error
    if loader.twice:
        raise InputError(*(f"{source}: {problem}" for problem in loader.twice))
    return content


def dump_yaml(content: Mapping[str, Any]) -> str:
    """A text that `parse_yaml` reads as it was; keys in their order, innermost lists in one
    line."""
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
    """Notes the keys that a mapping has twice, of which YAML takes the last."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.twice: list[str] = []
        self._depth = 0
        # How many values there are in a node, what its aliases repeat included.
        self._size: dict[int, int] = {}
        self._repeated = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        is_alias = self.check_event(yaml.AliasEvent)
        mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise _refused(f"nested more than {MAX_DEPTH} deep", mark)
        node = super().compose_node(parent, index)
        self._depth -= 1
        if not is_alias:
            self._size[id(node)] = 1 + sum(self._size[id(part)] for part in _parts(node))
            return node
        if id(node) not in self._size:
            raise _refused("a section contains itself (&name ... *name)", mark)
        self._repeated += self._size[id(node)]
        if self._repeated > MAX_REPEATED:
            raise _refused(f"aliases (*name) repeat more than {MAX_REPEATED:,} values", mark)
        return node

    def compose_scalar_node(self, anchor: Any) -> Any:
        return _checked(super().compose_scalar_node(anchor))

    def compose_sequence_node(self, anchor: Any) -> Any:
        return _checked(super().compose_sequence_node(anchor))

    def compose_mapping_node(self, anchor: Any) -> Any:
        node = _checked(super().compose_mapping_node(anchor))
        seen: dict[str, int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _refused("a key is a list or has keys itself", key.start_mark)
            if key.tag == f"{_TAG}merge":
                continue
            key.tag = f"{_TAG}str"
            line = key.start_mark.line + 1
            if key.value in seen:
                first = seen[key.value]
                self.twice.append(f"line {line}: key '{key.value}' was given in line {first}")
            seen.setdefault(key.value, line)
        return node


class _Dumper(yaml.SafeDumper):
    """Writes text in quotes where `_Loader` would take it for something else."""


def _parts(node: Any) -> list[Any]:
    if isinstance(node, yaml.MappingNode):
        return [part for pair in node.value for part in pair]
    return node.value if isinstance(node, yaml.SequenceNode) else []


def _refused(problem: str, mark: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=mark)


def _checked(node: Any) -> Any:
    """The node. Raises MarkedYAMLError for a tag, or a value, that is refused."""
    if node.tag not in _TYPES:
        raise _refused(f"{node.tag.replace(_TAG, '!!')} is not taken here", node.start_mark)
    if isinstance(node, yaml.ScalarNode):
        kind = node.tag.removeprefix(_TAG)
        pattern = _PLAIN.get(kind)
        if pattern is not None and re.fullmatch(pattern, node.value) is None:
            raise _refused(f"'{node.value[:40]}' is no {kind}", node.start_mark)
        if kind in ("seq", "map"):
            raise _refused(f"'{node.value[:40]}' is no {kind}", node.start_mark)
        if "\0" in node.value or not _is_text(node.value):
            raise _refused(f"{node.value[:40]!a} has a character that is no text", node.start_mark)
        if kind == "int" and len(node.value.lstrip("+-0ox")) > 18:
            shown = node.value[:20]
            raise _refused(f"{shown}... has more than 18 digits", node.start_mark)
    elif node.tag not in (f"{_TAG}seq", f"{_TAG}map"):
        raise _refused(f"is no {node.tag.removeprefix(_TAG)}", node.start_mark)
    return node


def _is_text(value: str) -> bool:
    try:
        value.encode()
    except UnicodeEncodeError:
        return False
    return True


def _whole_number(_: _Loader, node: Any) -> int:
    base = {"0o": 8, "0x": 16}.get(node.value[:2], 10)
    return int(node.value, base)


def _number(_: _Loader, node: Any) -> float:
    return float(node.value.lower().replace(".inf", "inf").replace(".nan", "nan"))


_Loader.add_constructor(f"{_TAG}int", _whole_number)
_Loader.add_constructor(f"{_TAG}float", _number)

for _class in (_Loader, _Dumper):
    # Those of YAML 1.1 are left out.
    _class.yaml_implicit_resolvers = {}
    for _name, _pattern in _PLAIN.items():
        _class.add_implicit_resolver(_TAG + _name, re.compile(rf"(?:{_pattern})\Z"), None)
