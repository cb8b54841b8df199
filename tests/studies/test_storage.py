"""Where studies are kept: what survives, what is refused, and that Optuna reads it."""

from __future__ import annotations

from pathlib import Path

import optuna
import pytest

from egolane_pgm.experiment import FitSettings
from egolane_pgm.studies.search import new_study, search
from egolane_pgm.studies.storage import JOURNAL_NAME, open_storage
from egolane_pgm.types import InputError
from tests.kits.studies import bowl, plain_space, search_in_memory, tried

SPACE = plain_space()


def settings(trials: int) -> FitSettings:
    return FitSettings(objective=("accuracy",), sampler="evolution", trials=trials, seed=0)


def study_in(storage: str, trials: int = 30) -> optuna.Study:
    return new_study(settings(trials), storage=open_storage(storage), study_name="drive")


def test_a_study_goes_on_to_a_larger_total_as_if_it_had_not_stopped(tmp_path: Path) -> None:
    storage = str(tmp_path / JOURNAL_NAME)
    whole = tried(search_in_memory(SPACE, bowl, settings(40)).trials)
    for trials in (20, 40):
        search(study_in(storage), SPACE, bowl, settings(trials))
    assert tried(study_in(storage).trials) == whole


def test_a_journal_that_lost_the_end_of_its_last_line_goes_on(tmp_path: Path) -> None:
    journal = tmp_path / JOURNAL_NAME
    search(study_in(str(journal)), SPACE, bowl, settings(2))
    *_, last = (whole := journal.read_bytes()).splitlines(keepends=True)
    for lost in range(1, len(last) + 1):
        journal.write_bytes(whole[:-lost])
        study_in(str(journal)).ask()
        assert len(study_in(str(journal)).trials) == 3
        assert journal.read_bytes().startswith(whole[: -len(last)])


@pytest.mark.parametrize(
    ("storage", "said"),
    [
        ("{folder}/damaged", "damaged: cannot be used"),
        ("sqlite:///{folder}/damaged", "damaged: cannot be used: file is not a database"),
        ("nosuch://h/d", "storage: nosuch://h/d: "),
        ("sqlite:////no/such/place/x.db", "storage: sqlite:////no/such/place/x.db: "),
        ("{folder}/link", "{folder}/link: is a link; name another path"),
        ("{folder}/damaged/x", "damaged: cannot be created: File exists"),
        ("oracle+oracledb://h/d", "cannot be used: No module named 'oracledb'"),
    ],
)
def test_a_storage_that_cannot_be_opened_is_one_line(
    storage: str, said: str, tmp_path: Path
) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "outside")
    (tmp_path / "damaged").write_text("this is no database\n" * 100)
    with pytest.raises(InputError) as caught:
        open_storage(storage.format(folder=tmp_path))
    assert said.format(folder=tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)
