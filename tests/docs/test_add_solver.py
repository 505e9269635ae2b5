"""The page "How to add a solver": its example, built from the page alone, plans like OSQP.

The changed files stand in a folder of their own; the modules are loaded from there.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, Estimate, Vehicle, references
from ltv_mpc.messages import Plan, PlanOrigin
from tests.docs.pages import blocks, prose
from tests.docs.test_add_sensor import apply

PAGE, PACKAGE = "docs/add-solver.md", "ltv_mpc.control.solvers"


def load(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Import a module from the changed files, under its own name."""
    part = folder / name.replace(".", "/")
    file = part / "__init__.py" if part.is_dir() else part.with_suffix(".py")
    spec = importlib.util.spec_from_file_location(name, file, submodule_search_locations=None)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, name, module)
    spec.loader.exec_module(module)


def plan(solver: str) -> Plan:
    """Return the first plan of a vehicle that is off its point."""
    controller = Controller(
        Vehicle.load("paper"), references.Point(north_m=0.0, east_m=0.0), ControllerConfig(solver=solver)
    )
    return controller.plan(Estimate.at_rest(north_m=-0.4, east_m=0.3, heading_rad=0.5))


def test_the_solver_of_the_page_plans_like_osqp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for block in blocks(PAGE):
        apply(block.text, tmp_path)
    expected = plan("osqp")
    load(f"{PACKAGE}.piqp_solver", tmp_path, monkeypatch)
    original = sys.modules[PACKAGE]
    load(PACKAGE, tmp_path, monkeypatch)
    changed = sys.modules[PACKAGE].SOLVERS
    monkeypatch.setitem(original.SOLVERS, "piqp-native", changed["piqp-native"])
    found = plan("piqp-native")
    assert found.origin is PlanOrigin.SOLVED
    assert found.solve.iterations > 1
    np.testing.assert_allclose(found.thrust_N, expected.thrust_N, atol=0.05)


def test_the_page_is_short() -> None:
    assert len(" ".join(text for _, text in prose(PAGE)).split()) <= 400
