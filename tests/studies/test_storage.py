"""Where studies are kept: what survives, what is refused, and that Optuna reads it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import optuna
import pytest
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend

from egolane_pgm.tuning.search import Settings, n_complete, search, search_in_memory
from egolane_pgm.tuning.storage import (
    JOURNAL_NAME,
    open_storage,
    open_study,
    storage_errors,
)
from egolane_pgm.types import InputError
from tests.kits.tuning_kit import bowl, plain_space, told

SPACE = plain_space()
IDENTITY = {"space": {"searched": {"x0": [0.0, 1.0]}}, "seed": 0}


def settings(trials: int) -> Settings:
    return Settings(("accuracy",), "evolution", trials, 0)


def study_in(place: Path | str, trials: int = 30, identity: Any = IDENTITY) -> optuna.Study:
    """A study in a journal below a folder, or in a database."""
    url, folder = (place, Path()) if isinstance(place, str) else (None, place)
    return open_study(open_storage(url, folder), "drive", settings(trials), identity)


@pytest.fixture(params=["journal", "sqlite"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Path | str:
    return tmp_path if request.param == "journal" else f"sqlite:///{tmp_path}/study.db"


def test_a_study_goes_on_to_a_larger_total_as_if_it_had_not_stopped(place: Path | str) -> None:
    whole = told(search_in_memory(SPACE, bowl, settings(65)).trials)
    for trials in (33, 65):
        search(study_in(place), SPACE, bowl, settings(trials))
    assert told(study_in(place).trials) == whole


def test_optuna_reads_the_journal_and_copies_it_to_a_database(tmp_path: Path) -> None:
    search(study_in(tmp_path), SPACE, bowl, settings(20))
    journal = JournalStorage(JournalFileBackend(str(tmp_path / JOURNAL_NAME)))
    study = optuna.load_study(study_name=None, storage=journal)
    assert study.study_name == "drive"
    assert study.metric_names == ["accuracy"]
    assert study.user_attrs["identity"] == IDENTITY
    base = f"sqlite:///{tmp_path}/study.db"
    optuna.copy_study(from_study_name="drive", from_storage=journal, to_storage=base)
    copy = optuna.load_study(study_name="drive", storage=base)
    assert told(copy.trials) == told(study.trials)
    assert copy.trials[3].datetime_start == study.trials[3].datetime_start


def test_known_points_are_tried_once_however_often_a_study_is_opened(tmp_path: Path) -> None:
    start = {"x0": 0.3, "x1": 0.3, "x2": 0.3}
    for _ in range(3):
        made = open_study(open_storage(None, tmp_path), "drive", settings(9), IDENTITY, [start])
    search(made, SPACE, bowl, settings(9))
    assert [t.params for t in made.trials].count(start) == 1
    assert made.best_trial.number == 0


def test_a_file_that_is_no_journal_or_database_is_one_clear_line(tmp_path: Path) -> None:
    for name in (JOURNAL_NAME, "study.db"):
        (tmp_path / name).write_text("this is no database\n" * 100)
    with pytest.raises(InputError, match=r"study\.journal: cannot be used as Optuna's"):
        open_storage(None, tmp_path)
    with pytest.raises(InputError, match="file is not a database"):
        open_storage(f"sqlite:///{tmp_path}/study.db", tmp_path)


def test_the_half_line_of_a_process_that_was_killed_is_cut_off(tmp_path: Path) -> None:
    search(study_in(tmp_path), SPACE, bowl, settings(5))
    journal = tmp_path / JOURNAL_NAME
    whole = journal.read_bytes()
    journal.write_bytes(whole + whole[:40])
    search(study_in(tmp_path), SPACE, bowl, settings(7))
    assert journal.read_bytes().startswith(whole + b'{"op_code"')
    assert n_complete(study_in(tmp_path)) == 7


@pytest.mark.parametrize("address", ["nosuch://h/d", "sqlite:////no/such/place/x.db"])
def test_a_storage_that_cannot_be_opened_is_one_clear_line(address: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"storage: {address}: ") as caught:
        open_storage(address, tmp_path)
    assert "\n" not in str(caught.value)


def test_a_database_without_its_driver_says_what_to_install(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"needs the package oracledb: pip install oracledb"):
        open_storage("oracle+oracledb://h/d", tmp_path)


def test_an_error_of_the_score_is_none_of_the_storage(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), storage_errors(None):
        search(study_in(tmp_path), SPACE, lambda _: [1 / 0], settings(9))


def test_a_study_of_that_name_that_no_search_began_is_refused(tmp_path: Path) -> None:
    study = optuna.create_study(study_name="drive", storage=open_storage(None, tmp_path))
    study.add_trial(optuna.trial.create_trial(value=0.5))
    with pytest.raises(InputError, match="holds another study of this name"):
        study_in(tmp_path)


def test_a_place_that_cannot_be_written_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be created: Not a directory"):
        open_storage(None, tmp_path / "file" / "x")
