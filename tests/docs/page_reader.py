"""Reader of a page: does what its blocks say, and finds each output that the page shows in the real one."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections import deque
from pathlib import Path
from typing import NamedTuple

from tests.docs.pages import Block, Command, commands

NUMBER = re.compile(r"-?\d+(\.\d+)?")
SEVERAL_TERMINALS = "ltv-mpc router"
"""Part of a block whose commands run side by side."""


class PrintedLine(NamedTuple):
    """Line of the output of a command."""

    text: str
    exact: bool  # the same on every machine and in every run: a page shows its numbers to the last digit

    def is_shown_as(self, line: str) -> bool:
        """Return True if the line of a page equals this whole line; without ``exact`` its numbers may differ."""
        return line.rstrip() == self.text.rstrip() if self.exact else shape(line) == shape(self.text)


def shape(line: str) -> str:
    """Return a line with # for each number and one space for several: a column is as wide as its numbers."""
    return " ".join(NUMBER.sub("#", line).split())


def printed_lines(output: str, *, exact: bool) -> list[PrintedLine]:
    """Return the lines of an output that are not empty."""
    return [PrintedLine(line, exact) for line in output.splitlines() if line.strip()]


def take_shown(shown: str, printed: deque[PrintedLine]) -> str | None:
    """Remove the printed lines up to the last one that a block of a page shows, which may leave lines out.

    Returns the first line of the block that is not printed after those above it; None if all are.
    """
    for line in filter(str.strip, shown.splitlines()):
        while printed and not printed[0].is_shown_as(line):
            printed.popleft()
        if not printed:
            return line
        printed.popleft()
    return None


def edited(text: str, difference: str) -> str:
    """Return a text after a change: a block of language ``diff`` that replaces one line, after its unchanged lines."""
    lines = difference.splitlines()
    (old,), (new,) = ([line[1:] for line in lines if line[0] == sign] for sign in "-+")
    after = text.index("".join(f"{line[1:]}\n" for line in lines if line[0] == " "))
    at = text.index(old, after)
    return f"{text[:at]}{new}{text[at + len(old) :]}"


class PageReader(ABC):
    """Working folder of a reader, and the output after the last line that the page shows."""

    def __init__(self, folder: Path) -> None:
        self.printed: deque[PrintedLine] = deque()
        self._folder = folder
        self._last: Command | None = None

    def read(self, block: Block) -> None:
        """Save a file, run the commands of a block, or find the shown lines in the output."""
        if block.language == "text":
            missing = take_shown(block.text, self.printed)
            assert missing is None, f"{block.place}: not printed: {missing}"
        elif block.language == "diff":
            self._edit(block)
        elif block.language in ("toml", "python"):
            file = re.match(r"# (\S+)\n", block.text)
            assert file is not None, f"{block.place}: the first line must be a comment with the file's name"
            (self._folder / file[1]).write_text(block.text)
            if block.language == "python":
                self.run(Command(block.place, ("python", file[1])))
        elif SEVERAL_TERMINALS in block.text:
            self.run_side_by_side(block)
        else:
            for command in commands(block):
                if command.words[0] != ".":
                    self.run(command)
                    self._last = command

    def _edit(self, block: Block) -> None:
        """Change a line of the file of the last command, run the command again, which fails, and change it back."""
        assert self._last is not None
        path = self._folder / self._last.words[-1]
        text = path.read_text()
        path.write_text(edited(text, block.text))
        self.run(self._last, code=2)
        path.write_text(text)

    @abstractmethod
    def run(self, command: Command, code: int = 0) -> None:
        """Run a command until it ends with this exit code."""

    @abstractmethod
    def run_side_by_side(self, block: Block) -> None:
        """Run the commands of a block for several terminals."""
