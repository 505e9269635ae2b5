"""Results store of a batch: JSON lines in one file of its folder, from which an interrupted batch continues.

DIR/results.jsonl
    {"settings": {...}}               what decides the results, the version too; others are refused
    {"key": "...", "result": ...}     one line a run, appended as it ends

A process that is killed while it writes leaves at most a last line that is cut: it is removed, and that run made again.
"""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import msgspec

from ltv_mpc.config import open_file
from ltv_mpc.errors import ConfigError, naming
from ltv_mpc.settings_schema import flat
from services.run import folder as run_folder

NAME = "results.jsonl"
MAX_DIFFERENCES = 3
"""Largest number of differing settings that an error names."""

MAX_LINE = 1 << 24
"""Largest length of a line (bytes): a damaged file may have no line ends."""


class ResultsStore:
    """Results by key, on disk."""

    def __init__(self, path: Path, file: BinaryIO, keys: set[str]) -> None:
        self.path, self.keys = path, keys
        self._file = file

    def append(self, key: str, result: Any) -> None:
        """Write a result: a struct, tuple or table, or several in each other."""
        self._file.write(_line({"key": key, "result": msgspec.to_builtins(result)}))
        self._file.flush()
        self.keys.add(key)

    def results(self) -> Iterator[tuple[str, Any]]:
        """Read all results so far, as plain values, in the order of their ends."""
        return read(self.path)[1]


@contextmanager
def open_store(folder: Path, settings: Mapping[str, Any], *, force: bool = False) -> Iterator[ResultsStore]:
    """Open the store in ``folder``, a new one or one of the same settings, for this process alone.

    ``force`` begins again, whatever is there. Raises ``ConfigError``.
    """
    path = folder / NAME
    if force or not path.exists():
        run_folder.open_folder(folder, force=force)
    if path.exists():
        open_file(path, what="results").close()  # nothing else than a regular file
    try:
        file = path.open("a+b")
    except OSError as error:
        raise _refusal(folder, f"cannot be written ({error.strerror})") from None
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise _refusal(folder, "another process runs this campaign") from None
        if force:
            file.truncate(0)
        file.seek(0)
        whole = sum(len(line) for line in file if line.endswith(b"\n"))
        file.truncate(whole)
        here = json.loads(_line({"settings": msgspec.to_builtins(settings)}))["settings"]
        if whole == 0:
            file.write(_line({"settings": here}))
            file.flush()
        there, results = read(path)
        if differences := _differences(flat(there), flat(here)):
            problem = f"holds another campaign or one of another version ({'; '.join(differences)})"
            raise _refusal(folder, f"{problem}: name another folder, or add --force")
        yield ResultsStore(path, file, {key for key, _ in results})


DAMAGE = TypeError, KeyError, RecursionError
"""Errors that a damaged line has, besides ``ValueError``."""


def read(path: Path) -> tuple[dict[str, Any], Iterator[tuple[str, Any]]]:
    """Read a store's settings and its results, also while another process writes it. Raises ``ConfigError``."""
    with open_file(path, what="results") as file, naming(f"results {path}", "", "cannot be read: ", OSError, *DAMAGE):
        settings: dict[str, Any] = json.loads(file.readline(MAX_LINE))["settings"]
    return settings, _results(path)


def _results(path: Path) -> Iterator[tuple[str, Any]]:
    with open_file(path, what="results") as file:
        for number, line in enumerate(islice(iter(partial(file.readline, MAX_LINE), b""), 1, None), 2):
            if not line.endswith(b"\n"):  # cut, or being written
                return
            with naming(f"results {path}", f"line {number}", "is damaged: ", *DAMAGE):
                one = json.loads(line)
                key, result = one["key"], one["result"]
            yield key, result


def _line(value: object) -> bytes:
    # json, not msgspec, which writes numbers that are not finite as null
    return json.dumps(value, separators=(",", ":")).encode() + b"\n"


def _differences(there: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    """List the settings in which two stores differ; a long text is named without its value."""
    found = []
    for key in (key for key in {**there, **here} if there.get(key) != here.get(key)):
        old, new = (json.dumps(values.get(key)) for values in (there, here))
        found.append(f"{key} = {old} there, {new} here" if len(old) + len(new) < 200 else key)
    return found[:MAX_DIFFERENCES]


def _refusal(folder: Path, problem: str) -> ConfigError:
    return ConfigError("option --out", "", problem, value=str(folder))
