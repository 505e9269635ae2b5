"""Errors of settings: each names the file, field, value and bound, and says what to do."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from unicodedata import category

MAX_VALUE_LENGTH = 60
"""Largest number of characters of a value in an error."""

UNPRINTABLE = frozenset(("Cc", "Cf", "Cn", "Co", "Cs", "Zl", "Zp"))
"""Categories of characters that ``printable`` escapes: control, format, unassigned, private, surrogate, separators."""


class ConfigError(ValueError):
    """Invalid setting, reported before anything starts.

    ``str(error)`` is one line: ``scenario descent.toml: [water] sd_mps = -0.04: must be >= 0``.

    Parameters
    ----------
    source : kind and name of the file or option, ``scenario descent.toml``.
    field : table and key, ``[water] sd_mps``; empty if the whole file is meant.
    problem : the bound, and what to do.
    value : the invalid value; None if there is none to show.
    """

    def __init__(self, source: str, field: str, problem: str, value: object = None) -> None:
        self.source = source
        self.field = field
        self.value = value
        self.problem = problem
        what = "" if value is None else format_value(value)
        where = " = ".join(x for x in (field, what) if x)
        super().__init__(one_line(": ".join(x for x in (source, where, problem) if x)))

    def __reduce__(self) -> tuple[object, ...]:
        """Return what another process makes the error of."""
        return type(self), (self.source, self.field, self.problem, self.value)


class SolverNotInstalled(ConfigError):
    """Name of a solver that is neither one of this project nor an installed backend of qpsolvers."""


@contextmanager
def naming(source: str, field: str = "", problem: str = "", *also: type[Exception]) -> Iterator[None]:
    """Turn each ``ValueError`` that is raised inside, which knows no file, into a ``ConfigError``.

    Parameters
    ----------
    source, field : as in ``ConfigError``.
    problem : text before that of the error.
    also : other kinds of errors that are turned.
    """
    kinds: tuple[type[Exception], ...] = (ValueError, *also)
    try:
        yield
    except ConfigError:
        raise
    except kinds as error:
        raise ConfigError(source, field, f"{problem}{error}") from None


def format_value(value: object) -> str:
    """Format a value as TOML writes it, shortened to ``MAX_VALUE_LENGTH`` characters."""
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
            text = "a number of more than 4300 digits"
    return text if len(text) <= MAX_VALUE_LENGTH else f"{text[: MAX_VALUE_LENGTH - 3]}..."


def with_reason(state: str, why: str) -> str:
    """Return a state with its reason, if there is one: "degraded: leak".

    Parameters
    ----------
    state : name of the state.
    why : the reason; empty if there is none.
    """
    return f"{state}: {why}" if why else state


def one_line(text: str) -> str:
    """Escape line breaks and control characters in text from outside, such as names of files and keys."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def printable(text: str) -> str:
    """Escape control characters and marks that change the direction of text, but no line break or tab.

    A terminal obeys them. The escapes are those of JSON, so that a document in JSON has the same meaning.
    """
    if text.replace("\n", "").isprintable():
        return text
    return "".join(_escape(c) if category(c) in UNPRINTABLE and c not in "\n\t" else c for c in text)


def _escape(character: str) -> str:
    units = character.encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{units[at : at + 4]}" for at in range(0, len(units), 4))
