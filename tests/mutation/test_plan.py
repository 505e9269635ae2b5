"""Mutation plan: every file and every test that it names exists."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
GROUPS = tomllib.loads((ROOT / "tests/mutation/plan.toml").read_text(encoding="utf-8"))["group"]
SURVIVORS = tomllib.loads((ROOT / "tests/mutation/survivors.toml").read_text(encoding="utf-8"))["survivor"]


def missing(names: Iterable[str]) -> list[str]:
    """Return the paths and the node ids ``path::test`` that do not exist."""
    found = []
    for name in names:
        path, _, test = name.partition("::")
        if not (ROOT / path).exists():
            found.append(name)
        elif test:
            body = ast.parse((ROOT / path).read_text(encoding="utf-8")).body
            if test not in {node.name for node in body if isinstance(node, ast.FunctionDef)}:
                found.append(name)
    return found


def test_every_file_of_the_plan_exists_and_is_in_one_group() -> None:
    files = [file for group in GROUPS for file in group["files"]]
    assert missing(files) == []
    assert len(files) == len(set(files))
    assert {entry["file"] for entry in SURVIVORS} <= set(files)


def test_every_test_of_the_plan_exists() -> None:
    assert missing(test for group in GROUPS for test in group["tests"]) == []
