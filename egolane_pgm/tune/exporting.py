"""A study of a PostgreSQL database as one file: SQLite or a journal, as Optuna reads them."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egolane_pgm.results import check_place
from egolane_pgm.tune._connection import Link
from egolane_pgm.tune.postgres import frozen_trials, list_studies
from egolane_pgm.types import InputError, suggestion

if TYPE_CHECKING:
    import psycopg
    from optuna.trial import FrozenTrial


def export_study(link: Link, name: str, path: Path) -> int:
    """Write a study to a SQLite file (.db) or a journal (.journal), as a whole or not at all;
    returns how many trials it has. Running trials are left out.

    Raises InputError for another extension, a file that is there or cannot be written, a study that
    is not there.
    """
    if path.suffix not in (".db", ".journal"):
        raise InputError(f"{path}: an export ends in .db (SQLite) or .journal")
    if path.exists():
        raise InputError(f"{path}: is there already; name another file, or remove that one")
    if not path.parent.is_dir():
        raise InputError(f"{path}: cannot be written: no folder {path.parent}")
    names = [listed.name for listed in list_studies(link)]
    if name not in names:
        raise InputError(
            f"storage {link.address.shown}: no study {name}{suggestion(name, names)}; `egolane"
            " studies` lists them"
        )
    study_id, directions, ranges, attributes = _description(link, name)
    trials = frozen_trials(link, study_id, ranges)
    for number, trial in enumerate(trials):
        trial.number = number  # Without gaps where trials are running still.
    check_place(path)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".export.") as folder:
        if path.suffix == ".db":
            made = _to_sqlite(Path(folder), name, directions, attributes, trials)
        else:
            made = _to_journal(Path(folder), name, directions, attributes, trials)
        os.replace(made, path)
    return len(trials)


def _description(link: Link, name: str) -> tuple[int, list[Any], dict[str, Any], dict[str, Any]]:
    """Id, directions, search space (in the order of the points) and attributes of a study."""
    from optuna.distributions import json_to_distribution

    def read(c: psycopg.Connection[Any]) -> tuple[Any, ...]:
        row = c.execute("SELECT study_id FROM studies WHERE study_name = %s", [name]).fetchone()
        assert row is not None
        return (
            row[0],
            c.execute(
                "SELECT lower(direction::text) FROM study_directions WHERE study_id = %s"
                " ORDER BY objective",
                row,
            ).fetchall(),
            c.execute(
                "SELECT key, value_json FROM study_user_attributes WHERE study_id = %s", row
            ).fetchall(),
        )

    study_id, directions, rows = link.once(read)
    attributes = {key: json.loads(text) for key, text in rows}
    ranges = {k: json_to_distribution(json.dumps(r)) for k, r in attributes["space"].items()}
    return study_id, [row[0] for row in directions], ranges, attributes


def _to_sqlite(
    folder: Path,
    name: str,
    directions: Sequence[Any],
    attributes: Mapping[str, Any],
    trials: Sequence[FrozenTrial],
) -> Path:
    from egolane_pgm.tune.storage import SqliteStore

    with SqliteStore(folder, name, attributes.get("identity", {}), directions) as store:
        for key, value in attributes.items():
            store.study.set_user_attr(key, value)
        store.write(trials)
    return store.path


def _to_journal(
    folder: Path,
    name: str,
    directions: Sequence[Any],
    attributes: Mapping[str, Any],
    trials: Sequence[FrozenTrial],
) -> Path:
    import optuna

    from egolane_pgm.tune.storage import JOURNAL_NAME, journal_storage

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(
        study_name=name, storage=journal_storage(folder), directions=list(directions)
    )
    for key, value in attributes.items():
        study.set_user_attr(key, value)
    study.add_trials(trials)
    return folder / JOURNAL_NAME
