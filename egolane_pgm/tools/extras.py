"""Optional packages: the extras of pyproject.toml."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from egolane_pgm.types import InputError


@contextlib.contextmanager
def needed(what: str, extra: str) -> Iterator[None]:
    """Turn a failed import of an extra's package into an InputError with the pip command.

    >>> with needed("a page of results", "page"):
    ...     import no_bokeh
    Traceback (most recent call last):
    ...
    egolane_pgm.types.InputError: a page of results needs no_bokeh: pip install 'egolane-pgm[page]'
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        raise InputError(f"{what} needs {package}: pip install 'egolane-pgm[{extra}]'") from None
