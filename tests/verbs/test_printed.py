"""What commands print: tables that fit the terminal, CSV and JSON that other programs read."""

from __future__ import annotations

import csv
import io
import json

import pytest

from tests.kits.drives import done, write_drive

#: Commands that print tables, on a short drive.
PRINTING = {
    "run": "run {one} --no-figures --out {out}",
    "run of a table": "run {one} --table {table} --out {out}",
    "compare": "compare {results} --of filter",
    "compare with detector": "compare {results} --of filter --detector",
    "learn": "learn {one} --folds 2 --out {out}",
    "label": "label {lines} --n-lanes 3 --ground-truth {truth} --out {out}",
    "tune": "tune {one} --trials 2 --folds 0 --out {out}",
}


@pytest.fixture(scope="module")
def words(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """The words of each command."""
    folder = tmp_path_factory.mktemp("printed")
    one = write_drive(folder / "a", name="a_drive_of_a_rather_long_name")
    (folder / "runs.csv").write_text("name,filter\nanother_drive,exact\none,assumed_density\n")
    done("run", one, "--table", folder / "runs.csv", "--out", folder / "results")
    place = {
        "one": one,
        "table": folder / "runs.csv",
        "results": folder / "results",
        "lines": folder / "a" / "lines.csv",
        "truth": folder / "a" / "ground_truth.txt",
    }
    return {
        name: text.format(**place, out=folder / name.replace(" ", "_")).split()
        for name, text in PRINTING.items()
    }


def lines_of(name: str, words: dict[str, list[str]], *more: str) -> list[str]:
    return done(*words[name], *more).stdout.splitlines()


@pytest.mark.parametrize("name", PRINTING)
def test_no_line_is_wider_than_the_terminal(
    name: str, words: dict[str, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    found = [line for line in lines_of(name, words) if str(words[name][-1]) not in line]
    assert max(map(len, found)) <= 80


@pytest.mark.parametrize("name", ["run", "run of a table", "compare"])
def test_csv_is_one_table_with_one_number_in_a_cell(name: str, words: dict[str, list[str]]) -> None:
    text = done(*words[name], "--format", "csv").stdout
    header, *rows = csv.reader(io.StringIO(text))
    assert len(set(header)) == len(header)
    assert rows
    for row in rows:
        assert len(row) == len(header)
        assert not [cell for cell in row if "[" in cell or ".." in cell or cell == "-"]


@pytest.mark.parametrize("name", ["run", "run of a table", "compare"])
def test_json_alone_is_printed(name: str, words: dict[str, list[str]]) -> None:
    assert json.loads(done(*words[name], "--json", "-").stdout)


def test_latex_is_tables_alone(words: dict[str, list[str]]) -> None:
    text = "\n".join(lines_of("run of a table", words, "--format", "latex"))
    assert r"another\_drive &" in text
    for table in text.split("\n\n"):
        assert table.startswith(r"\begin{tabular}")
        assert table.endswith(r"\end{tabular}")
