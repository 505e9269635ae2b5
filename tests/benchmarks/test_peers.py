"""Short form of ``python -m benchmarks.peers``: each tool solves what the controller solves; others are left out."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from benchmarks.peers.__main__ import OURS, compare
from ltv_mpc.control.config import STAGE_NS
from ltv_mpc.control.linearisation import roll_out
from ltv_mpc.vehicle.dynamics import rates
from ltv_mpc.vehicle.flow import substeps
from ltv_mpc.vehicle.parameters import Vehicle

H = STAGE_NS * 1e-9
P = Vehicle.load("paper").coefficients()._replace(added_munk=20.0, yaw_moment=1.5)

# What the peers' own packages warn of is theirs.
pytestmark = pytest.mark.filterwarnings("ignore")


def test_every_installed_tool_solves_all_cycles_and_drives_as_closely_as_the_controller() -> None:
    lines = compare(8, 4, 1, Console(quiet=True)).splitlines()
    rows = [line.split(" | ") for line in lines if " | QP | " in line or " | NLP | " in line]
    assert len(rows) >= len(OURS)
    ours = np.array(rows[0][5].split(", "), dtype=float)
    for name, kind, _, _, thrust_off_N, off_m, unsolved, *_ in rows:
        assert unsolved == "0", name
        assert kind == "NLP" or float(thrust_off_N) < 0.05, name
        np.testing.assert_allclose(np.array(off_m.split(", "), dtype=float), ours, rtol=0.1, atol=2e-3, err_msg=name)


def test_the_symbolic_motion_is_the_controllers() -> None:
    ca: Any = pytest.importorskip("casadi")
    symbolic = import_module("benchmarks.peers.symbolic")
    draw = np.random.default_rng(0)
    for _ in range(20):
        X, F, c, cr = draw.normal(size=8), draw.normal(0, 30, 2), draw.normal(size=2), draw.normal(size=2)
        expected = rates(*X[2:6], *F, *c, *cr, P)
        np.testing.assert_allclose(symbolic.rates(ca.DM(X[:6]), F, c, cr, P).full().ravel(), expected, rtol=1e-12)
    u, C = draw.normal(0, 20, (2, 2)), draw.normal(0, 0.1, (2, 2))
    X = np.array([0.1, 0.2, 0.3, 0.02, 1.0, 0.1, 3.0, -4.0])
    expected = roll_out(X, u, C, np.array([H]), P)[1]
    np.testing.assert_allclose(symbolic.stage(H, substeps(H), P)(X, *u, *C).full().ravel(), expected, atol=1e-12)
