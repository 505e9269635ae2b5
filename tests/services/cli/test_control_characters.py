"""Control characters of names, files and messages never reach a terminal."""

from __future__ import annotations

import dataclasses
import io
import json
import subprocess
import sys

import msgspec
import pytest
import typer
from rich.console import Console as RichConsole

from ltv_mpc.errors import printable
from services.cli.app import run
from services.reporting.terminal import RunScreen, progress_bar
from services.runtime.console import Console, PrintedStream
from tests.services.reporting.test_terminal import CONTROLLER, FULL, LOCALISATION
from tests.services.runtime.test_console import Terminal
from tests.services.words import status

HOSTILE = "\x1b]0;owned\x07\x1b[2J\x9b31m\r\x7f\u202eeman\u2066\ud800"


def is_safe(text: str) -> bool:
    return text.replace("\n", "").replace("\t", "").isprintable()


@pytest.mark.parametrize(
    "line",
    [
        ["sim", HOSTILE],
        ["sim", "--set", f"{HOSTILE}=1"],
        [HOSTILE],
        ["log", "info", "{folder}"],
        ["sim", "{folder}/scenario.toml"],
        ["vehicle", "check", "{folder}/vehicle.toml"],
        ["report", "{folder}/run.mcap"],
        ["certs", "new", "{folder}/certs"],
    ],
)
def test_a_command_prints_no_control_character(line, tmp_path, capsys) -> None:
    folder = tmp_path / HOSTILE.replace("\ud800", "\udcff")  # a byte that is no UTF-8
    folder.mkdir()
    (folder / "scenario.toml").write_text('"a\\u001b[2J\\u009b" = 1\n')
    (folder / "vehicle.toml").write_text('name = "a\\u001b[2J\\u009b\\u202e"\n[hull]\nlength_m = "\\u0007"\n')
    run([part.format(folder=folder) for part in line])
    printed = capsys.readouterr()
    assert printed.out + printed.err != ""
    assert is_safe(printed.out + printed.err), ascii(printed)


def test_a_document_in_json_means_the_same() -> None:
    stream = PrintedStream(io.StringIO())
    typer.echo(msgspec.json.encode({"x": HOSTILE[:-1] + "\U000e0001"}).decode(), file=stream)  # type: ignore[arg-type]
    text = stream.getvalue()
    assert is_safe(text)
    assert json.loads(text) == {"x": HOSTILE[:-1] + "\U000e0001"}
    assert printable("depth\t1\u00a0m \u3000 é\n") == "depth\t1\u00a0m \u3000 é\n"


@pytest.mark.parametrize("as_json", [False, True])
def test_a_process_prints_no_control_character_but_its_own(as_json: bool) -> None:
    out = io.StringIO()
    console = Console("mavlink", as_json=as_json, out=PrintedStream(out))  # type: ignore[arg-type]
    console.say(HOSTILE)
    console.tell("warning", "health", HOSTILE, t_ns=0, fields={"why": HOSTILE})  # type: ignore[arg-type]
    assert is_safe(out.getvalue())
    terminal = Terminal()
    console = Console("mavlink", out=PrintedStream(terminal))  # type: ignore[arg-type]
    console.show(HOSTILE)
    console.close()
    assert is_safe(terminal.getvalue().removeprefix("\r\x1b[2K"))


@pytest.mark.parametrize("plain", [False, True])
def test_a_screen_shows_no_control_character_and_no_markup_of_a_message(plain, monkeypatch) -> None:
    view = dataclasses.replace(
        FULL,
        phase=HOSTILE,
        controller=msgspec.structs.replace(CONTROLLER, health_why=HOSTILE),
        localisation=msgspec.structs.replace(LOCALISATION, why=HOSTILE),
        status={HOSTILE: status(HOSTILE, waiting_for=HOSTILE), "[/x]": status("[/x]", waiting_for="[/y]")},
        state={HOSTILE: "running", "[/x]": "running"},
    )
    if plain:
        monkeypatch.setenv("NO_COLOR", "1")
    else:
        monkeypatch.delenv("CI", raising=False)
    for period in ("REDRAW_S", "LINE_S"):
        monkeypatch.setattr(f"services.reporting.terminal.{period}", 0.0)
    out = io.StringIO()
    screen = RunScreen(HOSTILE, None, RichConsole(file=out, width=200, height=24, force_terminal=True))
    screen.wait(HOSTILE, 0.5)
    screen.say(HOSTILE)
    screen.update(view)
    screen.close()
    for sequence in (*"\x07\x9b\x7f\u202e\u2066\ud800", "\x1b]", "\x1b[2J"):
        assert sequence not in out.getvalue()
    assert "[/x]" in out.getvalue()


def test_a_bar_and_a_screen_draw_on_a_terminal_with_their_own_control_characters(monkeypatch) -> None:
    """Rich puts a stream of its own in front of the one that escapes."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", PrintedStream(terminal))
    monkeypatch.setenv("TERM", "xterm")
    for variable in ("NO_COLOR", "CI"):
        monkeypatch.delenv(variable, raising=False)
    with progress_bar("reading") as show:
        show(0.5)
    screen = RunScreen("a run", None)
    screen.update(FULL)
    screen.say("a note")
    screen.close()
    assert "\x1b[" in terminal.getvalue()
    assert "u001b" not in terminal.getvalue()


def test_a_process_that_fails_prints_no_control_character() -> None:
    code = "from services.runtime.console import escape_output\nescape_output()\nraise RuntimeError('a\\x1b[2J\\x9b')"
    failed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "\\u001b[2J\\u009b" in failed.stderr
    assert is_safe(failed.stderr)
