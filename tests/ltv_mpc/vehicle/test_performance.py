"""Performance, against closed forms without lag and slew, and against an independent integrator."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ltv_mpc import Vehicle
from ltv_mpc.vehicle.performance import performance, straight_thrusts, top_speed, turning_thrusts
from tests.ltv_mpc.vehicles import changed

PAPER = Vehicle.load("paper")
SURFACE = Vehicle.load("surface")


def lateral(port: dict[str, float], starboard: dict[str, float]) -> Vehicle:
    """Return the paper's vehicle with other values of its lateral thrusters."""
    sides = (("port", port), ("starboard", starboard))
    return changed(PAPER, {f"thruster.{side}.{key}": value for side, of in sides for key, value in of.items()})


INSTANT = {"lag_s": 0.0, "slew_N_per_s": 1e6}
PROMPT = lateral(INSTANT, INSTANT)


def test_at_top_speed_drag_equals_thrust() -> None:
    assert performance(PAPER).top_speed_ahead_mps == pytest.approx(math.sqrt(125.0 / 500.0))
    can = performance(SURFACE)
    assert can.top_speed_ahead_mps == pytest.approx(2 * 119.7 / 77.6)
    assert can.top_speed_astern_mps == pytest.approx(2 * 66.7 / 77.6)


def test_both_dampings_count() -> None:
    both = changed(PAPER, {"surge.linear_damping_kgps": 100.0})
    # 500 V^2 + 100 V = 125
    assert performance(both).top_speed_ahead_mps == pytest.approx((-100.0 + math.sqrt(1e4 + 2.5e5)) / 1000.0)


def test_straight_thrusts_of_unequal_arms_have_no_moment() -> None:
    uneven = lateral({"arm_m": 0.1}, {"arm_m": 0.2})
    F = straight_thrusts(uneven, ahead=True)
    np.testing.assert_allclose(F, [62.5, 31.25])
    assert top_speed(uneven, F) == pytest.approx(math.sqrt(93.75 / 500.0))
    middle = lateral({"arm_m": 0.0}, {})
    assert straight_thrusts(middle, ahead=False) == pytest.approx([-62.5, 0.0])


def test_at_the_turning_rate_drag_equals_the_moment() -> None:
    """Equal masses and thrusts: turning on the spot, without surge or sway. 200 r^2 + 15 r = 25."""
    rate = (-15.0 + math.sqrt(15.0**2 + 4 * 200 * 25.0)) / 400.0
    can = performance(PAPER)
    assert can.turning_rate_starboard_radps == pytest.approx(rate, rel=1e-6)
    assert can.turning_rate_port_radps == pytest.approx(-rate, rel=1e-6)


def test_a_turn_with_weak_reverse_thrust_agrees_with_an_integrator() -> None:
    """The vehicle moves ahead as it turns, and drifts outwards; compared with an integrator of this test."""
    weak = Vehicle.load("weak-reverse")
    assert turning_thrusts(weak, starboard=True) == pytest.approx([62.5, -15.6])

    def rates(_t: float, y: np.ndarray) -> list[float]:
        u, v, r = y
        return [
            (62.5 - 15.6 - 500 * u * abs(u) + 500 * v * r) / 500,
            (-800 * v * abs(v) - 500 * u * r) / 500,
            (0.2 * (62.5 + 15.6) - 15 * r - 200 * r * abs(r)) / 179.049,
        ]

    settled = solve_ivp(rates, (0.0, 400.0), [0.0, 0.0, 0.0], rtol=1e-9, atol=1e-9).y[:, -1]
    assert abs(settled[0]) > 0.05
    assert performance(weak).turning_rate_starboard_radps == pytest.approx(settled[2], rel=1e-5)


def test_stopping_without_lag_is_the_closed_form() -> None:
    """u' = -(F + D u^2) / M from V with F = D V^2: s = M / (2 D) ln 2 to standstill, 0.02 V of it left out.

    The commands are linear over a step of 50 ms: half of that later than at once.
    """
    can = performance(PROMPT)
    assert can.stopping_distance_m == pytest.approx(500 / (2 * 500) * math.log(2 / (1 + 0.02**2)), rel=0.05)
    assert can.stopping_time_s == pytest.approx(2.0 * (math.pi / 4 - math.atan(0.02)) + 0.025, abs=0.051)


def test_stopping_includes_lag_and_slew() -> None:
    """62.5 N to -62.5 N at 100 N/s, then 0.3 s of lag, by an independent integrator."""

    def rates(t: float, y: np.ndarray) -> list[float]:
        _, u, F = y
        return [u, (2 * F - 500 * u * abs(u)) / 500, (max(62.5 - 100 * t, -62.5) - F) / 0.3]

    def slow(_t: float, y: np.ndarray) -> float:
        return y[1] - 0.01

    slow.terminal = True
    end = solve_ivp(rates, (0.0, 20.0), [0.0, 0.5, 62.5], events=slow, rtol=1e-9, atol=1e-9, max_step=0.02)
    can = performance(PAPER)
    assert can.stopping_time_s == pytest.approx(end.t[-1], abs=0.06)
    assert can.stopping_distance_m == pytest.approx(end.y[0, -1], rel=0.01)
    assert can.stopping_distance_m > 2.0 * performance(PROMPT).stopping_distance_m


def test_surge_follows_tanh_and_sway_decays_by_quadratic_drag() -> None:
    can = performance(PROMPT)
    # u = V tanh(t / 2 s);  1/v = 1/v0 + D t / M
    assert can.surge_s == pytest.approx(2.0 * math.atanh(1 - math.exp(-1)) + 0.025, abs=0.051)
    assert can.sway_s == pytest.approx((math.e - 1) * 500 / (800 * 0.05), abs=0.06)
    assert can.thruster_s == pytest.approx(0.05)
    assert performance(PAPER).surge_s > can.surge_s + 0.3


def test_a_quarter_turn_without_drag_accelerates_for_half_of_it() -> None:
    """The turn is theta = N t^2 / (4 I), from rest to rest."""
    free = changed(PROMPT, {"yaw.linear_damping_Nms": 1e-3, "yaw.quadratic_damping_kgm2": 0.0})
    assert performance(free).turn_90deg_s == pytest.approx(math.sqrt(4 * 179.049 * math.pi / 2 / 25.0), rel=0.03)
    assert performance(PAPER).turn_90deg_s > performance(PROMPT).turn_90deg_s + 0.3


def test_figures_that_do_not_exist_are_none() -> None:
    free = ("surge.linear_damping_kgps", "surge.quadratic_damping_kgpm", "yaw.linear_damping_Nms")
    can = performance(changed(PAPER, dict.fromkeys((*free, "yaw.quadratic_damping_kgm2"), 0.0)))
    assert can.top_speed_ahead_mps is None
    assert can.turning_rate_port_radps is None
    assert can.stopping_distance_m is None
    one_way = lateral({"min_N": 0.0}, {"min_N": 0.0})
    assert performance(one_way).top_speed_astern_mps == 0.0
