"""A password in an address that stands where none belongs: neither said nor stored."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from egolane_pgm.types import InputError, without_passwords
from tests.kits.drives import command, contents, write_drive

SECRET = "hunter2XYZ"
ADDRESSES = (
    f"postgresql://me:{SECRET}@host/db",
    f"http://me:{SECRET}@127.0.0.1:9/a/b.csv",
    f"mysql+pymysql://:{SECRET}@host:3306/db?x=1",
    f"postgresql://host/db?user=me&password={SECRET}",
)


def experiment(folder: Path, content: object) -> str:
    """A YAML file with these keys beside those of a drive."""
    keys = {"name": "x", "n_lanes": 3, "recording": {"path": "lines.csv"}}
    made = folder / "made.yaml"
    made.write_text(yaml.safe_dump({**keys, **content}))  # type: ignore[dict-item]
    return made.name


def fleet(folder: Path, column: str, cell: str) -> str:
    """A table with one drive."""
    cells = {"recording": "lines.csv", "n_lanes": "3", column: cell}
    text = ",".join(cells) + "\n" + ",".join(f'"{each}"' for each in cells.values()) + "\n"
    (folder / "fleet.csv").write_text(text)
    return "fleet.csv"


RUN = ("run", "experiment.yaml", "--no-figures", "--json", "said.json")
FLEET = ("run", "experiment.yaml", "--out", "fleet", "--json", "said.json", "--fleet")

#: The words of a command, of an address and a folder with a drive.
PLACES: dict[str, Callable[[str, Path], tuple[str, ...]]] = {
    "a command": lambda a, _: (a,),
    "an option": lambda a, _: ("run", "experiment.yaml", f"--{a}"),
    "an experiment": lambda a, _: ("run", a),
    "another experiment": lambda a, _: (*RUN, a),
    "a recording": lambda a, _: (*RUN, "--recording", a),
    "a truth": lambda a, _: (*RUN, "--ground-truth", a),
    "a camera": lambda a, _: (*RUN, "--camera", a),
    "a detector": lambda a, _: (*RUN, "--detector", a),
    "a number": lambda a, _: (*RUN, "--n-lanes", a),
    "a description": lambda a, _: (*RUN, "--set", f"description=see {a}"),
    "a name": lambda a, _: (*RUN, "--set", f"name={a}"),
    "a graph": lambda a, _: (*RUN, "--set", f"graph={a}"),
    "a topic": lambda a, _: (*RUN, "--set", f"recording.topic={a}"),
    "a parameter": lambda a, _: (*RUN, "--set", f"parameters.sigma1={a}"),
    "an unknown parameter": lambda a, _: (*RUN, "--set", f"parameters.dsn={a}"),
    "no assignment": lambda a, _: (*RUN, "--set", a),
    "a key": lambda a, f: ("run", experiment(f, {a: 1})),
    "a path in YAML": lambda a, f: ("run", experiment(f, {"recording": {"path": a}})),
    "an include": lambda a, f: ("run", experiment(f, {"include": a})),
    "a list": lambda a, f: ("run", experiment(f, {"learned_on": [a], "fit": a})),
    "a text in YAML": lambda a, f: ("run", experiment(f, {"description": a}), "--json", "-"),
    "a checked YAML": lambda a, f: ("validate", experiment(f, {"graph": a, "evidence": a})),
    "a fleet": lambda a, _: (*FLEET, a),
    "a cell": lambda a, f: (*FLEET, fleet(f, "recording", a)),
    "a tag": lambda a, f: (*FLEET, fleet(f, "tag.from", a)),
    "a drive's name": lambda a, f: (*FLEET, fleet(f, "name", a)),
    "a drive's key": lambda a, f: (*FLEET, fleet(f, "description", a)),
    "a column": lambda a, f: (*FLEET, fleet(f, a, "1")),
    "a storage": lambda a, _: ("tune", "experiment.yaml", "--storage", a),
    "a range": lambda a, _: ("tune", "experiment.yaml", "--param", f"sigma1={a}"),
    "a mirror": lambda a, _: ("data", "fetch", "--base-url", a, "--folder", "data"),
    "a graph to show": lambda a, _: ("show", f"graph:{a}"),
    "a result": lambda a, _: ("report", a),
    "results": lambda a, _: ("compare", a, a),
    "a bag": lambda a, _: ("convert", a, "out.csv"),
    "a map": lambda a, _: ("map", a),
}


def without_addresses(folder: Path) -> list[str]:
    """The files below a folder in which the password stands."""
    return [name for name, content in contents(folder).items() if SECRET.encode() in content]


@pytest.mark.parametrize("place", PLACES)
def test_a_password_in_a_wrong_place_is_neither_said_nor_stored(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_drive(tmp_path, 20)
    for address in ADDRESSES:
        words = PLACES[place](address, tmp_path)
        given = set(without_addresses(tmp_path))
        result = command(*words)
        assert SECRET not in result.output, (words, result.output)
        assert set(without_addresses(tmp_path)) <= given, words


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("tcp://127.0.0.1:8786 and http://host:8787/status", None),
        ("http://host:8080", None),
        ("tcp://[::1]:8786", None),
        ("sqlite:///C:/x.db, 12:30:00, a:b", None),
        ("postgresql:/u:PW@h/d", "postgresql:/u:***@h/d"),
        ("'mysql://u:p@ss/w:rd@[::1]:33/d'", "'mysql://u:***@[::1]:33/d'"),
        ("cut off: redis://:PWPWPW", "cut off: redis://:***"),
        ("host=a password=PW user=b", "host=a password=*** user=b"),
    ],
)
def test_what_is_hidden_of_an_address(text: str, said: str | None) -> None:
    assert without_passwords(text) == (said or text)
    assert str(InputError(text)) == (said or text)


def test_there_are_more_than_a_hundred_places() -> None:
    assert len(list(itertools.product(PLACES, ADDRESSES))) > 100
