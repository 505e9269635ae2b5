"""Standard streams of a process whose text cannot control a terminal. It is imported before each command."""

from __future__ import annotations

import sys
from typing import Any, TextIO


class PrintedStream:
    """Standard stream that escapes the control characters of what is printed (``printable``).

    What draws with control characters, as rich and a status line do, escapes its texts and writes to ``drawn(stream)``.
    """

    def __init__(self, stream: TextIO) -> None:
        self.rich_proxied_file = stream  # by this name rich finds it

    def write(self, text: str) -> int:
        """Write a text; return its length."""
        if not text.replace("\n", "").isprintable():
            from ltv_mpc.errors import printable

            text = printable(text)
        return self.rich_proxied_file.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rich_proxied_file, name)


def drawn(stream: Any) -> Any:
    """Return the stream behind a ``PrintedStream``."""
    return getattr(stream, "rich_proxied_file", stream)


def escape_output() -> None:
    """Make a ``PrintedStream`` of standard output and standard error."""
    for name in ("stdout", "stderr"):
        setattr(sys, name, PrintedStream(drawn(getattr(sys, name))))
