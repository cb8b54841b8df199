"""`make crash`: kills each command before each of its calls that change a file, and looks at what
is left.

That is right where every file is absent, old and whole, or new and whole, a result directory as one
thing, and where the same command then goes on to what an undisturbed one writes and leaves nothing
else behind. A search draws a trial anew that was at work: it keeps those that were complete.
"""

from __future__ import annotations

import argparse
import functools
import importlib
import shutil
import signal
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from egolane_pgm.cli.main import COMMANDS as FILES
from egolane_pgm.results import git_state, versions
from egolane_pgm.tools.files import code_checksum
from tests.crash.commands import COMMANDS, STUDIES, Command, found, names, run, write_given
from tests.crash.points import Call, attempt, why_not


def killed(command: Command, given: Path, work: Path, few: int | None) -> Iterator[tuple[str, str]]:
    """Kill a command at its calls; yield each call, and what was wrong after it, "" for nothing.

    - few: so many calls only, spread over all of them.
    """
    for before in dict.fromkeys(("", command.before)):
        # Always in the same place: some files name it.
        place, kept = work / "place", work / ("old" if before else "empty")
        again = functools.partial(run, command.words, given, place)
        (place / "tmp").mkdir(parents=True)
        if before:
            _well(functools.partial(run, before, given, place))
        shutil.copytree(place, kept)
        old = found(place)
        calls = _well(again, place)
        new, left = found(place), names(place)
        for call in _spread(calls, few):
            shutil.rmtree(place)
            shutil.copytree(kept, place)
            ended = attempt(again, place, call)
            if ended.code == -signal.SIGKILL:
                what = "replacing" if before else "new"
                wrong = _wrong(command, again, place, (old, new, left))
                yield f"{what}: {call.text.replace(str(place), '')}", "; ".join(wrong)
        shutil.rmtree(place)


def _well(work: Any, folder: Path | None = None) -> Sequence[Call]:
    """The calls of a command that must end well."""
    ended = attempt(work, folder)
    if ended.code:
        raise SystemExit(f"tests.crash: a command that nobody disturbed failed: {ended.said}")
    return ended.calls


def _spread(calls: Sequence[Call], few: int | None) -> Sequence[Call]:
    if few is None or len(calls) <= few:
        return calls
    return [calls[round(k * (len(calls) - 1) / max(1, few - 1))] for k in range(few)]


def _wrong(
    command: Command,
    again: Any,
    place: Path,
    undisturbed: tuple[dict[str, Any], dict[str, Any], set[str]],
) -> list[str]:
    """What is wrong in a place where a command was killed, and after the same command `again`."""
    old, new, left = undisturbed
    try:
        there = found(place)
        wrong = [] if command.is_search else _half(there, old, new)
        ended = attempt(again)
        if ended.code:
            return [*wrong, f"does not go on: {ended.said}"]
        after = found(place)
    except Exception as error:
        return [f"left what cannot be read: {type(error).__name__}: {error}"]
    if command.is_search:
        wrong += _lost(there, after, new)
    else:
        wrong += [f"then {n} is another one" for n in new if after.get(n) != new[n]]
    wrong += [f"then {n} is missing" for n in sorted(left - names(place))]
    return wrong + [f"then {n} is left behind" for n in sorted(names(place) - left)]


def _half(there: Mapping[str, Any], old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """What is neither absent, nor old, nor new."""
    whole = {n.rpartition("/")[0] for n in {*old, *new} if n.endswith("/run.json")}
    units = {n: next((u for u in whole if n.startswith(f"{u}/")), n) for n in {*old, *new, *there}}
    wrong = []
    for unit in sorted(set(units.values())):
        mine, was, is_to_be = (
            {k: v for k, v in content.items() if units[k] == unit} for content in (there, old, new)
        )
        if mine not in (was, is_to_be):
            wrong.append(f"left {', '.join(sorted(mine)) or 'nothing'} for {unit}")
    return wrong


def _lost(there: Mapping[str, Any], after: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """The studies of a search that has gone on which do not have what they had, or are not done."""
    wrong = []
    for file in (n for n in new if n.endswith(STUDIES)):
        for study, trials in new[file].items():
            done = after[file].get(study, [])
            lost = [trial for trial in there.get(file, {}).get(study, []) if trial not in done]
            wrong += [f"then {study} has lost {trial}" for trial in lost]
            if len(done) != len(trials):
                wrong.append(f"then {study} has {len(done)} trials of {len(trials)}")
    return wrong


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.crash", description=__doc__)
    parser.add_argument("commands", nargs="*", metavar="COMMAND", help="; ".join(COMMANDS))
    parser.add_argument("--few", type=int, help="of each command so many calls only")
    options = parser.parse_args()
    if why_not():
        raise SystemExit(f"tests.crash: {why_not()}")
    # What every command does once in a process.
    for file, _ in FILES.values():
        importlib.import_module(f"egolane_pgm.cli.{file}")
    _ = git_state(), versions(), code_checksum()
    n_wrong = 0
    with tempfile.TemporaryDirectory() as place:
        given, work = Path(place).resolve() / "given", Path(place).resolve() / "work"
        given.mkdir()
        _well(functools.partial(write_given, given))
        print("| command | killed | whole | wrong |\n| --- | --: | --: | --: |", flush=True)
        for name in options.commands or COMMANDS:
            done = list(killed(COMMANDS[name], given, work, options.few))
            wrong = [f"{name}: {call}: {said}" for call, said in done if said]
            print(f"| {name} | {len(done)} | {len(done) - len(wrong)} | {len(wrong)} |", flush=True)
            print(*wrong, sep="\n", end="\n" * bool(wrong), flush=True)
            n_wrong += len(wrong)
            shutil.rmtree(work)
    raise SystemExit(n_wrong > 0)


main()
