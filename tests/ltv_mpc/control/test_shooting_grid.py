"""Stages that grow: the same problem, looked at more coarsely further ahead."""

from __future__ import annotations

import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, Estimate, PlanOrigin, Vehicle, references
from ltv_mpc.control.config import STAGE_NS, Weights
from ltv_mpc.control.ocp.assembly import cost
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.shooting_grid import knots, shift
from ltv_mpc.control.vertical import follow_depth

PAPER = Vehicle.load("paper")
GROWING = knots(17, 34.0)
LENGTHS = np.diff(GROWING)
N = 17


def test_a_horizon_of_as_many_stages_as_it_has_first_ones_is_equidistant():
    np.testing.assert_array_equal(knots(17, 17.0), np.arange(18.0))
    np.testing.assert_array_equal(knots(1, 1.0), [0.0, 1.0])


@pytest.mark.parametrize(("stages", "horizon"), [(17, 34.0), (17, 18.0), (9, 130.0), (2, 40.0)])
def test_the_far_stages_grow_by_one_factor_and_reach_the_horizon(stages, horizon):
    lengths, near = np.diff(knots(stages, horizon)), stages // 2
    assert lengths.sum() == pytest.approx(horizon)
    np.testing.assert_array_equal(lengths[:near], 1.0)
    factors = lengths[near:] / np.concatenate([[1.0], lengths[near:-1]])
    np.testing.assert_allclose(factors, factors[0])
    assert factors[0] > 1.0


@pytest.mark.parametrize("stages", [-1.0, 0.0, 0.4, 1.0, 1.7, 99.0])
def test_values_are_carried_over_in_time_and_the_last_ones_held(stages):
    old = np.random.default_rng(0).normal(size=(N + 1, 2))
    new = old.copy()
    shift(new, GROWING, stages)
    want = [np.interp(GROWING + stages, GROWING, old[:, i]) for i in range(2)]
    np.testing.assert_allclose(new, np.transpose(want))


def test_what_stays_the_same_costs_the_same_however_long_the_stages_are():
    """A vehicle at rest, 1 m off, under constant thrust; and a ramp of thrust, the last stage of it."""
    weights = Weights(terminal_position_per_m2=0.0, terminal_velocity_s2_per_m2=0.0, thrust=0.2, thrust_change=0.1)

    def costs(t, F):
        X, U, C = np.zeros((len(t), 8)), np.zeros((len(t), 2)), np.zeros((len(t), 2))
        X[:, 0] = 1.0
        U[:, 0] = F(t)
        return cost(X, U, C, np.zeros((len(t), 2)), Constants.of(PAPER, weights, t))

    steady = [costs(t, lambda t: np.full(len(t), 30.0)) for t in (GROWING, np.arange(35.0))]
    assert steady[0] == pytest.approx(steady[1]) == pytest.approx(34 * 0.5 * (1 + 0.2 * (30 / 62.5) ** 2))
    free = costs(GROWING, lambda t: 0.0 * t)
    ramp = costs(GROWING, lambda t: 0.5 * t) - free - 0.5 * 0.2 * (LENGTHS * (0.5 * GROWING[1:] / 62.5) ** 2).sum()
    assert ramp == pytest.approx(34 * 0.5 * 0.1 * (0.5 / 62.5) ** 2)


def test_the_vertical_law_acts_as_often_as_before():
    coarse = np.array([0.0, 1.0, 2.0, 4.0, 7.0])
    fine = np.arange(8.0)

    def depths(t):
        numbers = Constants.of(PAPER, Weights(), t)
        at, free = np.array([1.0, 0.0, 20.0, 20.0, 0.0]), np.array([-np.inf, np.inf, 0.3])
        return follow_depth(numbers, at, 1.5 + 0.06 * t, np.full(len(t), 0.2), free)

    (one, thrust, rate), (other, often, as_often) = depths(coarse), depths(fine)
    at = coarse.astype(int)
    np.testing.assert_allclose(one, other[at], atol=1e-12)
    np.testing.assert_allclose(thrust, often[at], atol=1e-9)
    assert rate == as_often


def test_a_plan_lasts_as_long_as_the_horizon_and_obeys_the_slew_limit_of_each_stage():
    config = ControllerConfig(horizon_s=10.2, max_stages=N)
    controller = Controller(PAPER, references.Point(north_m=0.0, east_m=0.0), config)
    plan = controller.plan(Estimate.at_rest(north_m=2.0, heading_rad=2.0))
    assert plan.origin is PlanOrigin.SOLVED
    np.testing.assert_array_equal(plan.t_ns - plan.t_ns[0], np.round(GROWING * STAGE_NS))
    steps = np.abs(np.diff(plan.thrust_N[:, :2], axis=0))
    assert (steps <= 100.0 * 0.3 * LENGTHS[:, None] + 1e-9).all()
    assert steps.max() > 30.1  # a long stage may change by more than a short one
