"""Console of a process: its lines on standard error, as text or as JSON, and a status line on a terminal.

    text    controller: waiting for an estimate, or a clock
            controller: 2026-11-24T14:31:02.105Z  health: degraded (the estimates are too old)
    JSON    {"t_ns": 81300000000, "time": "2026-11-24T14:31:02.105Z", "level": "warning", "process": "controller",
            "kind": "health", "text": "health: degraded (the estimates are too old)", "fields": {"health": ...}}

A change has its time; other lines have it in JSON alone. The status line is replaced in place. Where standard error is
no terminal there is none: it would flood a log, and ``controller/status`` has the same.
"""

from __future__ import annotations

import contextlib
import enum
import json
import re
import shutil
import sys
import textwrap
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any, Protocol, TextIO, cast

from ltv_mpc.errors import one_line, printable

ERASE = "\r\x1b[2K"


WIDTH = 80


def fold(text: str, width: int = WIDTH, *, indent: int = 4) -> str:
    """Break a text into lines that end where a clause ends, or between words if a clause is longer than a line.

    A longer word, such as a path or an address, stays whole. All lines but the first are indented.
    """
    lines: list[str] = []
    margin = " " * indent
    wrapper = textwrap.TextWrapper(width, subsequent_indent=margin, break_long_words=False, break_on_hyphens=False)
    for clause in re.split(r"(?<=[.,;:]) (?! )", text):
        if lines and len(lines[-1]) + 1 + len(clause) <= width:
            lines[-1] += f" {clause}"
            continue
        wrapper.initial_indent = margin if lines else ""
        lines += wrapper.wrap(clause)
    return "\n".join(lines)


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """Format a number of things: ``1 run``, ``2 runs``."""
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"


def figure(value: float | None, unit: str = "", *, digits: str, none: str = "-", scale: float = 1.0) -> str:
    """Format a number with its unit, ``none`` if it is missing; ``scale`` converts it to the unit."""
    return none if value is None else f"{scale * value:{digits}} {unit}".rstrip()


def columns(rows: Sequence[Sequence[str]], *, numbers: bool = False) -> list[str]:
    """Align cells in columns, to the left; with ``numbers`` all but the first column to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.rjust(width) if numbers and i else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


class PrintedStream:
    """Standard stream that escapes the control characters of what is printed (``printable``).

    What draws with control characters, as rich and a status line do, escapes its texts and writes to ``drawn(stream)``.
    """

    def __init__(self, stream: TextIO) -> None:
        self.rich_proxied_file = stream  # by this name rich finds it

    def write(self, text: str) -> int:
        """Write a text; return its length."""
        self.rich_proxied_file.write(printable(text))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rich_proxied_file, name)


def drawn(stream: Any) -> Any:
    """Return the stream behind a ``PrintedStream``."""
    return getattr(stream, "rich_proxied_file", stream)


def escape_output() -> None:
    """Make a ``PrintedStream`` of standard output and standard error."""
    for name in ("stdout", "stderr"):
        setattr(sys, name, PrintedStream(drawn(getattr(sys, name))))


class Level(enum.StrEnum):
    """Importance of a line."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


class Tell(Protocol):
    """Function that prints a change: its kind in one word, its text, its vehicle time, and its values by name."""

    def __call__(self, level: Level, kind: str, text: str, *, t_ns: int, fields: dict[str, str | int]) -> None: ...


class Console:
    """Writer of all lines of one process. It continues without a reader: a log collector that ends stops no vehicle."""

    def __init__(self, name: str, *, as_json: bool = False, out: TextIO | None = None) -> None:
        """``out``: the stream; None: standard error, whatever that is when a line is written."""
        self._name = name
        self._as_json = as_json
        self._given = out
        self._shown = ""  # status line on the terminal

    def say(self, text: str) -> None:
        """Print a line that stays."""
        if self._as_json:
            self._write_json(Level.INFO, "note", text, None, {})
        else:
            self._write_line(text)

    def tell(self, level: Level, kind: str, text: str, *, t_ns: int, fields: dict[str, str | int]) -> None:
        """Print a change (``Tell``)."""
        if self._as_json:
            self._write_json(level, kind, text, t_ns, fields)
        else:
            self._write_line(f"{_utc()}  {text}")

    def show(self, status: str) -> None:
        """Show a status line in place of the last one, on a terminal."""
        if not self._as_json and self._out.isatty():
            self._shown = one_line(f"{self._name}: {status}")
            self._write(f"{ERASE}{self._shown}")

    def close(self) -> None:
        """Leave the terminal's cursor on a new line."""
        if self._shown:
            self._shown = ""
            self._write("\n")

    @property
    def _out(self) -> TextIO:
        return cast(TextIO, drawn(sys.stderr if self._given is None else self._given))

    def _write_line(self, text: str) -> None:
        line = one_line(f"{self._name}: {text}")
        if self._out.isatty():
            line = fold(line, shutil.get_terminal_size().columns)
        self._write(f"{ERASE if self._shown else ''}{line}\n{self._shown}")

    def _write_json(self, level: Level, kind: str, text: str, t_ns: int | None, fields: dict[str, str | int]) -> None:
        line = {"t_ns": t_ns, "time": _utc(), "level": level, "process": self._name, "kind": kind, "text": text}
        self._write(printable(json.dumps({**line, "fields": fields})) + "\n")

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError):
            self._out.write(text)
            self._out.flush()


def tenfold(count: int) -> int:
    """Return the largest of 1, 10, 100, ... that a count has reached, or 0. A growing count is printed at each."""
    return 10 ** (len(str(count)) - 1) if count else 0


def _utc() -> str:
    """Return the wall time to the millisecond, in ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
