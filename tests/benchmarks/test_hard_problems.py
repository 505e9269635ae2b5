"""Cycles of hard problems with motion limits, all of which are solved."""

from __future__ import annotations

import pytest

from benchmarks.hard_problems import Job, one
from ltv_mpc.messages import SolveStatus

STALLED = (17, 21, 25, 28, 35, 39)
"""Problems in which an interior point that starts with small duals makes no progress."""

INEXACT = (233, 588, 828)
"""Problems in which OSQP leaves a first guess whose active rows are off by 1e-6, and does not return."""


@pytest.mark.parametrize("solver", ["osqp", "riccati"])
def test_problems_far_from_the_point_are_solved(solver: str) -> None:
    for seed in STALLED + INEXACT:
        solved = one(Job(seed, solver, None))
        assert set(solved.status) == {SolveStatus.SOLVED}, seed
        assert max(solved.iterations) <= 60, seed
