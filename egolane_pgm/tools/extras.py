"""Packages that only some have: those of the extras in pyproject.toml."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from egolane_pgm.types import InputError


@contextlib.contextmanager
def needed(what: str, extra: str) -> Iterator[None]:
    """Around imports of an extra's packages. Where one is not installed, this raises InputError:
    `what` needs the package, and how to install the extra.

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
