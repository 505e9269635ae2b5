"""What a campaign has found so far, in a folder that it goes on with where it was interrupted.

DIR/
    campaign.json     what is injected; a folder of other faults is refused
    seen.jsonl        a line a run: its name, and what was seen of its faults; written as runs end
    without-*.npz     errors of a seed without faults, that those of its runs are held against
    bus-*, node-*     runs of processes, as long as they last; those stay in which a promise was not kept
    faults.json       the whole, at the end
"""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import msgspec
import numpy as np

from ltv_mpc.errors import ConfigError
from services.faults.fault import Seen
from services.faults.judge import Errors
from services.run import folder as run_folder

ASKED, SEEN = "campaign.json", "seen.jsonl"


class Asked(msgspec.Struct, frozen=True, kw_only=True):
    """What decides which faults are injected."""

    classes: tuple[str, ...]
    in_lockstep: int
    in_processes: int
    seed: int
    quick: bool
    version: str  # of the code that injects and is injected into


class Line(msgspec.Struct, frozen=True):
    """One run."""

    name: str
    seen: list[Seen]


class Kept:
    """Runs by their names; a cut last line, of a run whose account was being written, is a run to be made again."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path / SEEN
        self._seen: dict[str, list[Seen]] = {}
        text = self._file.read_bytes() if self._file.exists() else b""
        whole, _, cut = text.rpartition(b"\n")
        for line in whole.splitlines():
            one = msgspec.convert(json.loads(line), Line)
            self._seen[one.name] = one.seen
        if cut:
            self._file.write_bytes(whole + b"\n" if whole else b"")

    def seen(self, name: str) -> list[Seen] | None:
        """Of a run; None: it is still to be made."""
        return self._seen.get(name)

    def add(self, name: str, seen: list[Seen]) -> None:
        """A run that has ended."""
        self._seen[name] = seen
        # json, not msgspec, which writes an infinite ratio (no estimate was left to measure) as none
        line = json.dumps(msgspec.to_builtins(Line(name, seen)), separators=(",", ":"))
        with self._file.open("a", encoding="utf-8") as file:
            file.write(line + "\n")

    def errors(self, name: str) -> Errors | None:
        """Of a run without faults; None: it is still to be made."""
        try:
            with np.load(self.path / f"{name}.npz") as arrays:
                return Errors(**arrays)
        except OSError:
            return None

    def all_errors(self) -> list[Errors]:
        """Of all runs without faults that have been made."""
        found = (self.errors(path.stem) for path in sorted(self.path.glob("without-*.npz")))
        return [errors for errors in found if errors is not None]

    def add_errors(self, name: str, errors: Errors) -> None:
        """Of a run without faults that has ended."""
        draft = self.path / f"{name}.npz.part"
        with draft.open("wb") as file:
            np.savez(file, **errors._asdict())
        draft.replace(self.path / f"{name}.npz")


def opened(path: Path, asked: Asked, *, force: bool) -> Kept:
    """The folder of this campaign, new or gone on with; ``force`` begins anew. Raises ``ConfigError``."""
    file = path / ASKED
    if file.exists() and not force:
        try:
            before = msgspec.json.decode(file.read_bytes(), type=Asked)
        except (OSError, ValueError) as error:
            raise ConfigError(f"{file}", "", f"is no campaign of faults: {error}") from None
        if before != asked:
            other = [name for name in Asked.__struct_fields__ if getattr(before, name) != getattr(asked, name)]
            problem = f"holds another campaign ({', '.join(other)}): name another folder, or add --force"
            raise ConfigError("option --out", "", problem, value=str(path))
        return Kept(path)
    run_folder.opened(path, force=force)
    for old in (path / SEEN, *path.glob("without-*.npz")):
        with contextlib.suppress(FileNotFoundError):
            old.unlink()
    file.write_bytes(msgspec.json.encode(asked))
    return Kept(path)
