"""What goes wrong in words that say which file, field, value and bound, and what to do."""

from __future__ import annotations

import json

MAX_VALUE_LENGTH = 60


class ConfigError(ValueError):
    """A setting that is refused before anything starts.

    ``str(error)`` is one line for a person: ``scenario descent.toml: [water] sd_mps = -0.04: must be >= 0``
    """

    def __init__(self, source: str, field: str, problem: str, *, value: object = None) -> None:
        """``source`` names kind and file, ``field`` the table and key, ``problem`` the bound and what to do."""
        self.source = source
        self.field = field
        self.value = value
        self.problem = problem
        what = "" if value is None else format_value(value)
        where = " = ".join(x for x in (field, what) if x)
        super().__init__(one_line(": ".join(x for x in (source, where, problem) if x)))


def format_value(value: object) -> str:
    """``value`` as TOML writes it, shortened where it is long."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        text = json.dumps(value, ensure_ascii=False)
    elif isinstance(value, dict):
        text = "{...}" if value else "{}"
    else:
        try:
            text = str(value)
        except ValueError:  # an integer with more digits than Python prints
            text = "a number of thousands of digits"
    return text if len(text) <= MAX_VALUE_LENGTH else f"{text[: MAX_VALUE_LENGTH - 3]}..."


def one_line(text: str) -> str:
    """``text`` without line breaks and control characters: names of files and keys come from outside."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)
