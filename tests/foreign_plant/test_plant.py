"""The foreign craft: it has its messages by itself, and is as slow as its data sheet says."""

from __future__ import annotations

import ast
import sys

import pytest

from tests.foreign_plant.flight import HERE
from tests.foreign_plant.plant import Hull


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


def test_its_hull_is_as_slow_and_as_slow_to_turn_as_its_data_sheet_says() -> None:
    def steady(*command_N: float) -> list[float]:
        hull = Hull()
        for _ in range(2500):
            hull.step(command_N)
        return hull.x[7:13].tolist()

    assert steady(42.0, 42.0)[0] == pytest.approx(1.5, abs=0.01)
    assert 0.3 < steady(42.0, -38.0)[5] <= 0.4
    assert steady(0.0, 0.0) == [0.0] * 6
