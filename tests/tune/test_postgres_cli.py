"""`egolane tune --storage`, `--join` and `egolane studies` as users run them: a study of several
machines, what is refused before a trial is taken, and a password that nobody sees."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import optuna
import pytest
import yaml
from click.testing import CliRunner, Result
from hypothesis import given
from hypothesis import strategies as st
from pyarrow import parquet

import egolane_pgm
from egolane_pgm.cli.main import egolane
from egolane_pgm.tune.address import MASK, find_address, parse
from egolane_pgm.types import InputError
from tests.kits.postgres_kit import (
    GUARDED,
    PASSWORD,
    address_with_password,
    make_job,
    rows,
    start,
    wait_for,
)
from tests.kits.postgres_server import Server
from tests.kits.tuning_kit import BLOCKS, QUICKSTART

pytest_plugins = ["tests.kits.postgres_fixtures"]

EXAMPLES = Path(__file__).parents[2] / "examples"
SHORT = ("--in-sample-only", "--no-figures", "--workers", 2)


def invoke(*words: object) -> Result:
    return CliRunner().invoke(egolane, [str(word) for word in words])


def says(*words: object) -> str:
    """The output of a command that works."""
    result = invoke(*words)
    assert result.exit_code == 0, result.output
    return result.output


def refused(*words: object) -> str:
    result = invoke(*words)
    assert result.exit_code == 2, result.output
    lines = [line for line in result.stderr.splitlines() if not line.startswith("warning:")]
    assert len(lines) == 1
    return lines[0]


def experiment(folder: Path, name: str, **keys: Any) -> Path:
    """The simulated drive as files, and an experiment on them."""
    folder.mkdir(exist_ok=True)
    says("simulate", "quickstart", "--out", folder)
    content = yaml.safe_load((folder / "experiment.yaml").read_text())
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump({**content, "name": name, **keys}))
    return path


def machine_env(**more: str) -> dict[str, str]:
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PG", "EGOLANE_STORAGE"))}
    return {**kept, **more}


def command(*words: object) -> list[str]:
    code = "from egolane_pgm.cli.main import main; main()"
    return [sys.executable, "-c", code, *map(str, words)]


def test_a_study_with_its_nested_ones_is_shared_and_joined(
    server: Server, database: str, tmp_path: Path
) -> None:
    words = ("tune", QUICKSTART, "--trials", 30, "--blocks", BLOCKS, "--storage", database)
    first = says(*words, "--out", tmp_path, "--workers", 2, "--no-figures")
    assert "accuracy, held out" in first
    assert "held out: each block of the drive (or each recording)" in first
    total = 30 * (1 + BLOCKS)
    joined = says("tune", "--join", "quickstart", "--storage", database, "--workers", 1)
    assert f"quickstart: {total} asked, {total} finished, 0 running, 0 lost" in joined
    folder = tmp_path / "quickstart"
    document = json.loads((folder / "study.json").read_text())
    assert document["best"]["trials"] == 30
    assert [s["trials"] for s in document["held_out"]["studies"]] == [30] * BLOCKS
    second = f"quickstart without block 2 of {BLOCKS}"
    said = refused("tune", "--join", second, "--storage", database)
    assert said.endswith(f"study {second} is a part of quickstart; take that one")
    nested = optuna.load_study(study_name=second, storage=database)
    assert nested.best_params == document["held_out"]["studies"][1]["point"]
    table = parquet.read_table(folder / "trials.parquet").to_pylist()
    assert len(table) == 30
    listed = says("studies", "--storage", database, "--format", "csv").splitlines()
    assert len(listed) == 2 + BLOCKS
    assert listed[1].startswith("quickstart,30,30,0,0,")
    # Again: nothing is left to do, and the result is the same.
    says(*words, "--out", tmp_path / "again", "--workers", 1, "--no-figures")
    again = json.loads((tmp_path / "again" / "quickstart" / "study.json").read_text())
    assert again["held_out"] == document["held_out"]
    assert again["best"]["point"] == document["best"]["point"]


def test_a_machine_joins_with_the_recordings_alone_and_does_its_share(
    server: Server, database: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = experiment(tmp_path / "a", "drive")
    content = yaml.safe_load(path.read_text())
    for section in ("recording", "ground_truth"):
        content[section]["path"] = str(tmp_path / "a" / content[section]["path"])
    path.write_text(yaml.safe_dump(content))
    says("tune", path, "--trials", 8, *SHORT, "--storage", database, "--out", tmp_path / "o")
    # A second machine: the folder of the first is not there, the files are somewhere else.
    other = tmp_path / "b" / "deep" / "down"
    other.mkdir(parents=True)
    for name in ("lines.csv", "ground_truth.txt"):
        shutil.move(tmp_path / "a" / name, other / name)
    (tmp_path / "b" / "lines.csv").write_text("another file of that name\n")
    monkeypatch.setenv("EGOLANE_DATA", str(tmp_path / "b"))
    monkeypatch.setenv("EGOLANE_STORAGE", database)
    rows(server, database, "UPDATE egolane_studies SET asked = 40")
    assert "drive: 40 asked, 40 finished" in says("tune", "--join", "drive", "--workers", 2)
    link_rows = rows(server, database, "SELECT count(DISTINCT worker) FROM egolane_claims")
    assert link_rows[0][0] >= 2
    shutil.rmtree(tmp_path / "b" / "deep")
    assert "ground_truth.txt is not on this machine; set EGOLANE_DATA" in refused(
        "tune", "--join", "drive"
    )


def test_other_recordings_are_refused_before_a_trial_is_taken(
    server: Server, database: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = experiment(tmp_path / "a", "drive")
    says("tune", path, "--trials", 8, *SHORT, "--storage", database, "--out", tmp_path / "o")
    rows(server, database, "UPDATE egolane_studies SET asked = 40")
    monkeypatch.chdir(tmp_path / "a")
    text = Path("lines.csv").read_text()
    Path("lines.csv").write_text(text.replace("0.1", "0.2", 1))
    line = refused("tune", "--join", "drive", "--storage", database)
    assert "was begun with other data, search space or code" in line
    assert "identity.recordings.drive.data" in line
    assert "no trial was taken" in line
    again = refused("tune", path, "--trials", 99, *SHORT, "--storage", database, "--out", "o2")
    assert "identity.recordings.drive.data" in again
    assert rows(server, database, "SELECT asked, finished, running FROM egolane_studies") == [
        (40, 8, 0)
    ]


def test_other_code_and_another_search_space_are_refused(
    server: Server, database: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("own_files.yaml", "my_graph.py", "my_evidence.py"):
        shutil.copy(EXAMPLES / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    words = ("--trials", 8, *SHORT, "--storage", database)
    says("tune", "own_files.yaml", *words)
    assert "8 finished" in says("tune", "--join", "own_files", "--storage", database)
    graph = Path("my_graph.py")
    text = graph.read_text()
    graph.write_text(text + "\n# Another line.\n")
    line = refused("tune", "--join", "own_files", "--storage", database)
    assert "code.graph ./my_graph.py" in line
    assert "identity" not in line
    graph.write_text(text)
    assert "identity.space.fixed" in refused("tune", "own_files.yaml", *words, "-p", "sigma1=0.3")
    monkeypatch.setattr(egolane_pgm, "__version__", "9.9")
    line = refused("tune", "--join", "own_files", "--storage", database)
    assert f"code.egolane: {'0.1.0'}, here 9.9" in line
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    graph.unlink()
    assert "my_graph.py" in refused("tune", "--join", "own_files", "--storage", database)


def test_a_plan_of_another_version_is_refused(
    server: Server, database: str, tmp_path: Path
) -> None:
    says("tune", QUICKSTART, "--trials", 4, *SHORT, "--storage", database, "--out", tmp_path)
    query = "UPDATE study_user_attributes SET value_json = '{\"version\": 0}' WHERE key = 'plan'"
    rows(server, database, query)
    line = refused("tune", "--join", "quickstart", "--storage", database)
    assert "is described in version 0, this egolane reads 1" in line


def test_several_recordings_are_held_out_in_turn_and_joined(
    server: Server, database: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = yaml.safe_load(QUICKSTART.read_text())
    for k in (1, 2):
        content = {**first, "name": f"drive{k}"}
        content["recording"] = {**first["recording"], "seed": k}
        (tmp_path / f"{k}.yaml").write_text(yaml.safe_dump(content))
    group = {"name": "both", "experiments": ["1.yaml", "2.yaml"], "tuning": {"trials": 8}}
    (tmp_path / "group.yaml").write_text(yaml.safe_dump(group))
    words = ("--whole-recordings", "--no-figures", "--storage", database, "--workers", 1)
    says("tune", tmp_path / "group.yaml", *words, "--out", tmp_path / "o")
    document = json.loads((tmp_path / "o" / "both" / "study.json").read_text())
    assert [s["left_out"] for s in document["held_out"]["studies"]] == ["drive1", "drive2"]
    rows(server, database, "UPDATE egolane_studies SET asked = 16")
    monkeypatch.chdir(tmp_path)
    line = says("tune", "--join", "both", "--storage", database, "--workers", 1)
    assert "both: 48 asked, 48 finished" in line
    names = [row[0] for row in rows(server, database, "SELECT study_name FROM studies")]
    assert names == ["both", "both without recording drive1", "both without recording drive2"]


def test_two_machines_run_the_same_command_and_share_one_study(
    server: Server, database: str, tmp_path: Path
) -> None:
    def machine(out: Path) -> None:
        words = ("tune", QUICKSTART, "--trials", 60, "--in-sample-only", "--no-figures")
        assert "quickstart" in says(*words, "--workers", 1, "--out", out, "--storage", database)

    machines = [start(machine, tmp_path / str(k)) for k in range(2)]
    for process in machines:
        process.join(60)
    assert [process.exitcode for process in machines] == [0, 0]
    found = [json.loads((tmp_path / f"{k}/quickstart/study.json").read_text()) for k in range(2)]
    assert found[0]["best"]["point"] == found[1]["best"]["point"]
    assert rows(server, database, "SELECT count(*), min(finished) FROM egolane_studies") == [
        (1, 60)
    ]


def test_bad_words_are_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("EGOLANE_STORAGE", raising=False)
    url = "postgresql+psycopg://u@127.0.0.1:1/d"
    out = ("--out", tmp_path / "o")
    assert "--storage: is missing" in refused("studies")
    assert "--storage: is missing" in refused("tune", "--join", "x")
    assert "leave EXPERIMENTS away" in refused("tune", "--join", "x", "--storage", url, QUICKSTART)
    assert "leave --trials away" in refused(
        "tune", "--join", "x", "--storage", url, "--trials", "5"
    )
    assert "take --workers" in refused("tune", QUICKSTART, "--storage", url, "--jobs", 2, *out)
    assert "--grace: goes with --storage" in refused("tune", QUICKSTART, "--grace", 5, *out)
    assert "is not PostgreSQL" in refused("studies", "--storage", "sqlite:///x.db")
    assert "is no address" in refused("studies", "--storage", "what")
    assert "cannot be read" in refused(
        "studies", "--storage", url, "--password-file", tmp_path / "none"
    )
    file = tmp_path / "pass"
    file.write_text("hunter2\n")
    words = ("studies", "--storage", url, "--password-file", file)
    file.chmod(0o644)
    assert "chmod 600 it" in refused(*words)
    file.chmod(0o600)
    line = refused(*words)
    assert "host:port:database:user:password" in line
    assert "hunter2" not in line
    assert not (tmp_path / "o").exists()


def test_without_psycopg_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "psycopg", None)
    line = refused("studies", "--storage", "postgresql+psycopg://u@127.0.0.1:1/d")
    assert "pip install 'egolane-pgm[postgres]'" in line


def test_a_directory_of_a_study_without_a_storage_is_left_alone(
    server: Server, database: str, tmp_path: Path
) -> None:
    words = ("tune", QUICKSTART, "--trials", 8, "--in-sample-only", "--no-figures")
    says(*words, "--out", tmp_path, "--jobs", 1)
    line = refused(*words, "--out", tmp_path, "--storage", database)
    assert "was begun without --storage" in line


@given(
    user=st.text("abcXYZ09_-", min_size=1, max_size=8),
    password=st.text(min_size=4, max_size=20).filter(lambda text: "\0" not in text),
)
def test_no_address_shows_its_password(user: str, password: str) -> None:
    from urllib.parse import quote

    try:
        coded = quote(password, safe="")
    except UnicodeEncodeError:
        return
    for url in (
        f"postgresql+psycopg://{user}:{coded}@host:99/base?sslmode=require",
        f"postgresql://{user}@host:99/base?sslmode=require&password={coded}",
    ):
        address = parse(url)
        assert address.parameters["password"] == password
        assert address.parameters["sslmode"] == "require"
        bare = address.shown.replace(f":{MASK}@", "@")
        assert bare == f"postgresql+psycopg://{user}@host:99/base?sslmode=require"
        assert repr(password)[1:-1] not in repr(address).replace(user, "").replace("base", "")
        assert coded not in address.hide(f"could not connect to {url!r} at all")


def test_a_password_that_is_not_escaped_is_not_repeated() -> None:
    for url in ("postgresql+psycopg://u:hunter2@x@host/base", "postgresql//u:hunter2@host"):
        with pytest.raises(InputError) as caught:
            parse(url)
        assert "hunter2" not in str(caught.value)
        assert caught.value.__context__ is None or caught.value.__suppress_context__


def test_an_option_goes_before_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EGOLANE_STORAGE", "postgresql://e@there/base")
    assert find_address(None).parameters["host"] == "there"
    assert find_address("postgresql://o@here/base").parameters["user"] == "o"


def test_a_password_is_in_no_output_no_result_and_no_list_of_processes(
    server: Server, shared: str, name: str, tmp_path: Path
) -> None:
    url = address_with_password(shared)
    make_job(shared, f"{name}_tables")
    path = tmp_path / "x.yaml"
    content = yaml.safe_load(QUICKSTART.read_text())
    path.write_text(yaml.safe_dump({**content, "name": name}))
    words = ("tune", path, "--trials", 3000, *SHORT, "--out", tmp_path / "o", "--storage", url)
    claimed = (
        "SELECT count(DISTINCT worker) FROM egolane_claims JOIN egolane_studies USING (study_id)"
        f" WHERE job = '{name}'"
    )
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command(*words), env=machine_env(), stdout=pipe, stderr=pipe, text=True
    ) as running:
        wait_for(lambda: running.poll() is not None or rows(server, shared, claimed)[0][0] == 2, 60)
        own = Path(f"/proc/{running.pid}/task/{running.pid}/children").read_text().split()
        lists = [Path(f"/proc/{pid}/cmdline").read_bytes() for pid in (running.pid, *own)]
        end = f"UPDATE egolane_studies SET asked = finished + running WHERE job = '{name}'"
        rows(server, shared, end)
        out, err = running.communicate(timeout=60)
    assert running.returncode == 0, err
    assert len(lists) == 3
    assert all(f"--storage\0postgresql+psycopg://{GUARDED}:***".encode() in w for w in lists)
    written = [p.read_bytes() for p in (tmp_path / "o").rglob("*") if p.is_file()]
    assert len(written) > 3
    kept = rows(server, shared, "SELECT string_agg(value_json, ' ') FROM study_user_attributes")
    for secret in (PASSWORD, url.split(":")[2].rpartition("@")[0]):
        assert secret not in out + err + kept[0][0]
        assert not any(secret.encode() in content for content in (*lists, *written))


@pytest.mark.parametrize("way", ["environment", "password file", "PGPASSFILE"])
def test_a_password_is_taken_from_where_nobody_sees_it(
    way: str, server: Server, shared: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_job(shared, "somebody")
    bare = shared.replace("egolane@", f"{GUARDED}@")
    file = tmp_path / "pgpass"
    escaped = PASSWORD.replace("\\", "\\\\").replace(":", "\\:")
    file.write_text(f"*:*:*:{GUARDED}:{escaped}\n")
    file.chmod(0o600)
    words: tuple[object, ...] = ("studies",)
    if way == "environment":
        monkeypatch.setenv("EGOLANE_STORAGE", address_with_password(shared))
    elif way == "password file":
        words += ("--storage", bare, "--password-file", file)
    else:
        monkeypatch.setenv("EGOLANE_STORAGE", bare)
        monkeypatch.setenv("PGPASSFILE", str(file))
    output = says(*words)
    assert "| somebody " in output
    assert PASSWORD not in output
    monkeypatch.delenv("PGPASSFILE", raising=False)
    assert "check user and password" in refused("studies", "--storage", bare)


def test_a_wrong_password_is_not_shown(server: Server, shared: str) -> None:
    line = refused("studies", "--storage", address_with_password(shared).replace("s3c", "hunter2"))
    assert "hunter2" not in line
    assert "check user and password" in line
