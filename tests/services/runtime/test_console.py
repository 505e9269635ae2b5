"""Console of a process: lines as text or JSON, the status line of a terminal, and a reader that ends."""

from __future__ import annotations

import io
import json
import re
from datetime import UTC, datetime, timedelta

import pytest

from services.runtime.console import ERASE, Console, Level, fold

DEGRADED = "health: degraded (the estimates are too old)"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def tell(console: Console, text: str = DEGRADED) -> None:
    console.tell(Level.WARNING, "health", text, t_ns=81_300_000_000, fields={"health": "degraded"})


@pytest.mark.parametrize(
    ("out", "written"),
    [
        (
            Terminal(),
            f"{ERASE}controller: nominal{ERASE}controller: waiting for applied\ncontroller: nominal"
            f"{ERASE}controller: degraded\n",
        ),
        (io.StringIO(), "controller: waiting for applied\n"),
    ],
    ids=["terminal", "pipe"],
)
def test_on_a_terminal_alone_a_status_is_shown_and_lines_go_above_it(out: io.StringIO, written: str) -> None:
    console = Console("controller", out=out)
    console.show("nominal")
    console.say("waiting for applied")
    console.show("degraded")
    console.close()
    console.close()
    assert out.getvalue() == written


def test_a_change_has_its_time_to_the_millisecond_on_one_line() -> None:
    out = io.StringIO()
    tell(Console("controller", out=out), "unknown field `a\nb\x1b[2J`")
    pattern = r"controller: (\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z)  unknown field `a\\nb\\x1b\[2J`\n"
    match = re.fullmatch(pattern, out.getvalue())
    assert match is not None, out.getvalue()
    assert abs(datetime.now(UTC) - datetime.fromisoformat(match[1])) < timedelta(seconds=60)


def test_as_json_each_line_is_one_object_also_on_a_terminal() -> None:
    out = Terminal()
    console = Console("controller", as_json=True, out=out)
    console.say("waiting for\nan estimate")
    console.show("nominal")
    tell(console)
    console.close()
    note, change = map(json.loads, out.getvalue().splitlines())
    assert datetime.fromisoformat(note.pop("time")) <= datetime.fromisoformat(change.pop("time"))
    said = {"t_ns": None, "level": "info", "process": "controller", "kind": "note", "text": "waiting for\nan estimate"}
    assert note == {**said, "fields": {}}
    told = {"t_ns": 81_300_000_000, "level": "warning", "process": "controller", "kind": "health", "text": DEGRADED}
    assert change == {**told, "fields": {"health": "degraded"}}


def test_a_reader_that_ends_stops_nothing() -> None:
    class Broken(io.StringIO):
        def flush(self) -> None:
            raise BrokenPipeError

    console = Console("controller", out=Broken())
    console.say("waiting for applied")
    tell(console)


def test_without_a_stream_it_writes_to_standard_error(capsys: pytest.CaptureFixture[str]) -> None:
    Console("router").say("ready")
    assert capsys.readouterr().err == "router: ready\n"


def test_a_text_breaks_where_a_clause_ends_and_else_between_words() -> None:
    assert fold("short: one, two; three.", 80) == "short: one, two; three."
    assert fold("first part: second, third; the fourth part", 30).splitlines() == [
        "first part: second, third;",
        "    the fourth part",
    ]
    words = "a clause that has no end " * 4
    assert all(len(line) <= 30 for line in fold(words, 30).splitlines())
    assert fold(words, 30).split() == words.split()
    path = "/folder" * 9  # stays whole
    assert fold(f"see {path}: full", 30, indent=2).splitlines() == ["see", f"  {path}:", "  full"]
