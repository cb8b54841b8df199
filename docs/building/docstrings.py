"""Docstrings as Markdown: lists of `name (T,): meaning` and examples become lists and code."""

from __future__ import annotations

import re
from typing import Any

import griffe

#: A line that begins an item of a list without a dash.
_ITEM = re.compile(r"^[a-z_][\w, ]*( \([^)]*\))?(, [\w, ]+( \([^)]*\))?)*: \S")


def as_markdown(text: str) -> str:
    """A cleaned docstring as Markdown."""
    paragraphs = []
    for paragraph in text.split("\n\n"):
        lines = paragraph.split("\n")
        if lines[0].startswith(">>> "):
            paragraphs.append("```pycon\n" + paragraph + "\n```")
        elif _ITEM.match(lines[0]):
            paragraphs.append(
                "\n".join(f"- {line}" if _ITEM.match(line) else line for line in lines)
            )
        else:
            paragraphs.append(paragraph)
    return "\n\n".join(paragraphs)


class Docstrings(griffe.Extension):
    """Turn docstrings into Markdown for mkdocstrings."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring:
            obj.docstring.value = as_markdown(obj.docstring.value)
