"""Texts that a user can meet: the list is complete, and no text uses an old-fashioned word."""

from __future__ import annotations

import ast
import re

import pytest

from services.cli.app import app
from services.cli.overview import commands
from tests.docs import texts
from tests.docs.readability import UNIDIOMATIC, Source
from tests.docs.texts import Text

VALUE = re.compile(r"\{[^}]*\}")


@pytest.fixture(scope="module")
def listed() -> list[Text]:
    return texts.texts()


def test_the_list_holds_every_command_with_its_options(listed: list[Text]) -> None:
    helps = {text.text.partition(":")[0]: text.text.partition(": ")[2] for text in listed if text.kind == "help"}
    assert {f"ltv-mpc {name}" for _, name, _ in commands(app)} <= helps.keys()
    assert {"ltv-mpc sim --speed", "ltv-mpc qp export-c folder", "ltv-mpc ctl --connect"} <= helps.keys()
    assert all(helps.values()), "a command or an option without help"


def test_no_text_uses_an_unidiomatic_word(listed: list[Text]) -> None:
    assert [text for text in listed if UNIDIOMATIC.search(VALUE.sub("", text.text))] == []


def test_each_kind_of_text_is_found() -> None:
    code = '''
"""Module docstring with words."""
Plot(title="Depth", y=Axis(label="depth (m)"))
raise ConfigError(f"option {name}", "", "must be at least one")
problem = f"cannot be read: {error}"
text = f"{count} plans too late"
pattern = re.compile(r"not a text")
key = "sensor/imu"
'''
    source = Source("services/sample.py", code, ast.parse(code))
    assert [(text.kind, text.text) for text in texts.of_source(source)] == [
        ("plot", "Depth"),
        ("plot", "depth (m)"),
        ("error", "option {name}"),
        ("error", "must be at least one"),
        ("error", "cannot be read: {error}"),
        ("text", "{count} plans too late"),
    ]
