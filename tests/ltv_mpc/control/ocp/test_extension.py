"""Terms and limits of a user: every solver feels them, and the plan keeps them."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, Estimate, Limit, Motion, Term, Vehicle, references
from ltv_mpc.control.ocp import assembly, limits
from ltv_mpc.control.ocp.extension import Extensions
from ltv_mpc.messages import Array, PlanOrigin
from tests.ltv_mpc.control.flights import fly
from tests.ltv_mpc.control.problems import SOLVER_NAMES, Form, motion

PAPER = Vehicle.load("paper")
POINT = references.Point(north_m=20.0, east_m=3.0)


class TotalThrust(Limit):
    """Both thrusters deliver at most 20 N together."""

    low, high, unit = (-20.0,), (20.0,), (62.5,)

    def values(self, motion: Motion) -> Array:
        return motion.states[:, 8:10].sum(axis=1, keepdims=True)


class YawRate(Term):
    """A yaw rate costs."""

    def residuals(self, motion: Motion) -> Array:
        return np.sqrt(3000.0 * motion.lengths)[:, None] * motion.states[:, 5:6]


class Crosswise(Term):
    """A residual that is not linear, with slopes of its own."""

    def residuals(self, motion: Motion) -> Array:
        return np.column_stack([motion.states[:, 2] * motion.states[:, 4], motion.states[:, 0] - motion.target[:, 0]])

    def slopes(self, motion: Motion) -> Array:
        slopes = np.zeros((len(motion.states), 2, 10))
        slopes[:, 0, 2], slopes[:, 0, 4], slopes[:, 1, 0] = motion.states[:, 4], motion.states[:, 2], 1.0
        return slopes


def flown(solver: str, terms: list[Term | Limit], cycles: int = 12) -> Array:
    """Return the plans' commands (cycles, N+1, 2) on the way to a point."""
    controller = Controller(PAPER, POINT, ControllerConfig(solver=solver), terms=terms)
    _, plans = fly(controller, Estimate.at_rest(depth_m=0.0), cycles)
    return np.array([plan.thrust_N[:, :2] for plan in plans])


@pytest.mark.parametrize("solver", SOLVER_NAMES)
def test_a_limit_is_kept_in_every_plan_of_every_solver(solver: str) -> None:
    assert np.abs(flown("osqp", [], 3).sum(axis=2)).max() > 100.0
    total = np.abs(flown(solver, [TotalThrust()]).sum(axis=2))
    assert total.max() <= 20.0 + 0.01
    assert total.max() > 19.9  # and used


def test_thrusts_above_a_limit_come_down_at_the_slew_limit() -> None:
    """It is soft: there is always a solution."""
    controller = Controller(PAPER, POINT, terms=[TotalThrust()])
    before = msgspec.structs.replace(Controller(PAPER, POINT).plan(Estimate.at_rest(depth_m=0.0)), cycle_t_ns=0)
    controller.prediction.sent.add(before)
    plan = controller.plan(Estimate.at_rest(depth_m=0.0), t_ns=1_200_000_000)
    total = np.abs(plan.thrust_N[:, :2].sum(axis=1))
    assert plan.origin is PlanOrigin.SOLVED
    assert total[0] > 60.0
    assert (total[4:] <= 20.01).all()


@pytest.mark.parametrize("term", [YawRate(), Crosswise(), TotalThrust()], ids=lambda term: type(term).__name__)
def test_slopes_and_cost_belong_together(term: Term | Limit) -> None:
    """The problem's gradient is the slope of the cost, and the rows are that of the values, by differences."""
    N = 5
    form, (lin, target) = Form(np.arange(N + 1.0)), motion(1, N)
    wanted = np.column_stack([target, np.zeros(N + 1)])
    scale = assembly.scales(PAPER)[:10]
    of = Extensions([term], np.ones(N), wanted)
    p = assembly.empty(N, of.rows)
    assembly.fill(form.constants, lin, wanted, p)
    before = p.h.copy()
    of.add(p, limits.ROWS, lin.X, lin.U, scale)
    z, h = np.random.default_rng(0).normal(size=(N + 1, 12)), 1e-6

    def along(step: float) -> Motion:
        states = np.hstack([lin.X[1:], lin.U[1:]]) + step * z[1:, :10] * scale
        return Motion(states, np.ones(N), wanted[:-1, :2])

    if isinstance(term, Term):
        slope = (term.cost(along(h)) - term.cost(along(-h))) / (2.0 * h)
        assert np.sum((p.h - before) * z) == pytest.approx(slope, rel=1e-5)
        return
    slopes = (term.values(along(h)) - term.values(along(-h))) / (2.0 * h) / term.unit
    np.testing.assert_allclose(np.einsum("kri,ki->kr", p.G[1:, limits.ROWS :], z[1:]), slopes, atol=1e-6)
    np.testing.assert_allclose(p.high[1:, limits.ROWS :] * term.unit, 20.0 - term.values(along(0.0)))
