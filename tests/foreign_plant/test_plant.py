"""The foreign craft has its messages by itself."""

from __future__ import annotations

import ast
import sys

from tests.foreign_plant.flight import HERE


def test_the_plant_imports_nothing_of_this_project_but_the_equations_of_a_hull() -> None:
    imported = set()
    for node in ast.walk(ast.parse((HERE / "plant.py").read_text())):
        if isinstance(node, ast.Import):
            imported |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            imported |= {f"{node.module}.{alias.name}" for alias in node.names}
    ours = {"msgpack", "numpy", "zenoh", "benchmarks.strangers.rigid_body"}
    assert {name for name in imported if name.partition(".")[0] not in sys.stdlib_module_names} == ours
