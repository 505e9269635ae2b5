"""The foreign craft: it is independent of this project, as slow as its data sheet says, and keeps its energy."""

from __future__ import annotations

import ast
import sys

import numpy as np
import pytest

from tests.foreign_plant.flight import HERE
from tests.foreign_plant.plant import Hull


def test_the_plant_imports_nothing_of_this_project() -> None:
    imported = set()
    for node in ast.walk(ast.parse((HERE / "plant.py").read_text())):
        if isinstance(node, ast.Import):
            imported |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            imported.add((node.module or "").partition(".")[0])
    assert imported - set(sys.stdlib_module_names) == {"msgpack", "zenoh"}


def test_its_hull_is_as_slow_and_as_slow_to_turn_as_its_data_sheet_says() -> None:
    def steady(*command_N: float) -> list[float]:
        hull = Hull()
        for _ in range(2500):
            hull.step(command_N)
        return hull.x[7:13]

    assert steady(42.0, 42.0)[0] == pytest.approx(1.5, abs=0.01)
    assert 0.3 < steady(42.0, -38.0)[5] <= 0.4
    assert steady(0.0, 0.0) == [0.0] * 6


def test_without_thrust_and_drag_its_hull_keeps_its_energy() -> None:
    """Coriolis forces and the coupled added mass do no work; the integrator loses none."""
    plant = sys.modules[Hull.__module__]
    hull = Hull()
    hull.linear = hull.quadratic = (0.0,) * 6
    hull.fin = hull.righting_Nm = 0.0
    hull.x[7:13] = [0.8, -0.2, 0.1, 0.1, -0.2, 0.3]

    def energy() -> float:
        u, v, w, p, q, r = hull.x[7:13]
        M = np.diag([plant.SURGE, plant.SWAY, plant.HEAVE, plant.ROLL, plant.PITCH, plant.YAW])
        M[1, 5] = M[5, 1] = plant.COUPLED
        nu = np.array([u, v, w, p, q, r])
        return float(nu @ M @ nu)

    before = energy()
    for _ in range(500):
        hull.step((0.0, 0.0))
    assert energy() == pytest.approx(before, rel=1e-6)
