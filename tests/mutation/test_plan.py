"""Mutation plan: every file and every test that it names exists."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


def table(name: str) -> dict[str, Any]:
    return tomllib.loads((ROOT / f"tests/mutation/{name}.toml").read_text(encoding="utf-8"))


def test_every_file_and_every_test_of_the_plan_exists() -> None:
    groups = table("plan")["group"]
    files = [file for group in groups for file in group["files"]]
    assert len(files) == len(set(files))
    assert {entry["file"] for entry in table("survivors")["survivor"]} <= set(files)
    for name in [*files, *(test for group in groups for test in group["tests"])]:
        path, _, test = name.partition("::")
        assert (ROOT / path).exists(), name
        assert not test or f"\ndef {test}(" in (ROOT / path).read_text(encoding="utf-8"), name
