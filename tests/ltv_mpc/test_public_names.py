"""What a user may import, and what that brings along."""

from __future__ import annotations

import ltv_mpc

NAMES = {
    "__version__",
    "Bathymetry",
    "Controller",
    "ControllerConfig",
    "CurrentProfile",
    "Estimate",
    "Fence",
    "Limit",
    "Motion",
    "Obstacle",
    "Obstacles",
    "Plan",
    "PlanOrigin",
    "Run",
    "SolveStatus",
    "Term",
    "Vehicle",
    "advance",
    "build_qp",
    "references",
    "simulate",
    "solve_qp",
}


def test_the_public_names_are_these_and_each_is_there():
    assert set(ltv_mpc.__all__) == NAMES
    for name in NAMES:
        assert getattr(ltv_mpc, name) is not None


def test_tab_shows_the_public_names_alone():
    assert set(dir(ltv_mpc)) == NAMES
