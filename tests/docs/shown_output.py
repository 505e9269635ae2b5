"""Comparison of the output that a page shows with what its commands print."""

from __future__ import annotations

import re
from collections import deque
from typing import NamedTuple

NUMBER = re.compile(r"-?\d+(\.\d+)?")


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
