"""What a user may import, and what that brings along."""

from __future__ import annotations

import ltv_mpc

NAMES = """
__version__ Bathymetry Controller ControllerConfig CurrentProfile Estimate Fence Limit Motion Obstacle Obstacles Plan
PlanOrigin Run SolveStatus Term Vehicle advance build_qp references simulate solve_qp
"""


def test_the_public_names_are_these_each_is_there_and_tab_shows_them_alone():
    assert sorted(ltv_mpc.__all__) == dir(ltv_mpc) == sorted(NAMES.split())
    for name in NAMES.split():
        assert getattr(ltv_mpc, name) is not None
