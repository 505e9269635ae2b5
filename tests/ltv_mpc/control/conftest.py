"""QPs of the cycles of closed loops, and their optima."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from ltv_mpc import ControllerConfig
from ltv_mpc.control.config import ResolvedConfig, Weights
from ltv_mpc.control.lateral import LateralPlanner
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.messages import Array
from tests.ltv_mpc.control.flights import descend
from tests.ltv_mpc.control.problems import Form


class Cycle(NamedTuple):
    """Inputs of one cycle's QP."""

    form: Form
    lin: Linearisation
    target: Array
    stages: float  # since the last problem; NaN: unrelated to it


@pytest.fixture(scope="session")
def cycles() -> list[Cycle]:
    """Return over 200 problems of closed loops: descents, one from 2 m off with a wrong heading."""
    seen: list[Cycle] = []
    config = ResolvedConfig(horizon_s=5.1, weights=Weights())  # as the solvers that get these problems
    solve_qp = LateralPlanner._solve_qp

    def remembered(self, shift, *, last):  # type: ignore[no-untyped-def]
        copied = Linearisation(*map(np.copy, self._cycle.lin))  # the controller's own is used again
        seen.append(Cycle(Form(config.knots), copied, np.array(self.target), shift))
        return solve_qp(self, shift, last=last)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(LateralPlanner, "_solve_qp", remembered)
        for seed, start in ((1, {}), (2, {}), (3, {"north_m": 2.0, "heading_rad": 3.0})):
            descend(seed, 70, ControllerConfig(horizon_s=5.1), **start)
    return seen


@pytest.fixture(scope="session")
def optima(cycles: list[Cycle]) -> list[Array]:
    """Return the commands (N+1, 2) of each cycle's optimum."""
    return [cycle.form.optimum(cycle.lin, cycle.target) for cycle in cycles]
