"""A vehicle that is weak astern does not stay stern-to off its place for ever."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from ltv_mpc import Controller, ControllerConfig, Vehicle, references
from ltv_mpc.control.config import Weights
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.scaling import characteristic_scales
from ltv_mpc.control.terminal_check import MAX_TAIL_TIMES, TerminalCheck, check_terminal, closing_speed
from tests.ltv_mpc.control.flights import at_rest, fly, track

PAPER, WEAK = Vehicle.load("paper"), Vehicle.load("weak-reverse")
STAGE_S = 0.3


def numbers(vehicle: Vehicle) -> Constants:
    return Constants.of(vehicle, Weights(), np.arange(5.0))


def ends(vehicle: Vehicle, off_m: float, heading: float, flow_mps: float, target_mps: float = 0.0) -> TerminalCheck:
    """Of a trajectory that ends ``off_m`` east of its target, in a current to the east."""
    X, C, target = np.zeros((5, 8)), np.zeros((5, 2)), np.zeros((5, 2))
    X[-1, 1], X[-1, 4] = off_m, heading
    C[-1, 1], target[-1, 1] = flow_mps, target_mps
    return check_terminal(X, C, target, numbers(vehicle))


@pytest.mark.parametrize("seed", range(8))
def test_the_closing_speed_is_the_largest_that_the_vehicle_has_the_speed_for(seed):
    rng = np.random.default_rng(seed)
    way, towards, size = rng.uniform((-math.pi, -math.pi, 0.0), (math.pi, math.pi, 0.6))
    e = np.array([math.cos(way), math.sin(way)])
    b = size * np.array([math.cos(towards), math.sin(towards)])
    s = np.linspace(-1.2, 1.2, 24_001)
    able = np.hypot(*(e[:, None] * s + b[:, None])) <= 0.5
    wanted = s[able].max() if able.any() else 0.5 - size
    assert closing_speed(*e, *b, 0.5) == pytest.approx(wanted, abs=2e-4)


WEST, EAST = -math.pi / 2, math.pi / 2


@pytest.mark.parametrize(
    ("vehicle", "off_m", "heading", "flow_mps", "target_mps", "stuck"),
    [
        (WEAK, 1.2, EAST, 0.25, 0.0, True),  # stern-to: astern it makes 0.25 m/s
        (WEAK, 1.2, EAST, 0.10, 0.0, False),  # and so it gets there
        (WEAK, 1.2, WEST, 0.25, 0.0, False),  # bow-to
        (WEAK, 0.3, EAST, 0.25, 0.0, False),  # as good as there
        (PAPER, 1.2, EAST, 0.50, 0.0, True),  # nobody holds that
        (WEAK, 1.2, EAST, 0.0, -0.25, True),  # the target runs away as fast
        (WEAK, 1.2, EAST, 0.25, 0.25, False),  # or goes with the water
    ],
)
def test_stuck_is_who_is_off_and_cannot_come_nearer_that_way_round(
    vehicle, off_m, heading, flow_mps, target_mps, stuck
):
    assert ends(vehicle, off_m, heading, flow_mps, target_mps).stuck is stuck


@pytest.mark.parametrize(("off_m", "flow_mps"), [(3.0, 0.1), (30.0, 0.3), (50.0, 0.45), (2.0, 0.55)])
def test_what_is_beyond_the_horizon_is_the_integral_of_the_squared_distance(off_m, flow_mps):
    found = ends(PAPER, off_m, WEST, flow_mps)
    V = characteristic_scales(PAPER).speed_mps
    until_s = MAX_TAIL_TIMES * characteristic_scales(PAPER).time_s
    integral, _ = quad(lambda t: max(off_m - (V - flow_mps) * t, 0.0) ** 2, 0.0, until_s, limit=500)
    assert found.tail_cost == pytest.approx(0.5 * Weights().position_per_m2 / STAGE_S * integral, rel=1e-3)


def test_a_vehicle_that_is_weak_astern_comes_round_and_holds_its_place():
    """In half its top speed, stern-to, 1.2 m off: astern it can just stay there, and to turn takes it 3 m further."""
    controller = Controller(WEAK, references.Point(north_m=0.0, east_m=0.0), ControllerConfig(horizon_s=21.9))
    way, _ = fly(controller, at_rest(0.0, 0.25, east_m=1.2, heading_rad=EAST), 300)
    heading = [estimate.heading_rad for estimate in way]
    assert max(np.hypot(estimate.north_m, estimate.east_m) for estimate in way[-30:]) < 0.01
    assert max(abs(math.remainder(psi - WEST, math.tau)) for psi in heading[-30:]) < 0.05
    turned = np.unwrap(heading)
    assert abs(turned[-1] - turned[0]) < 1.1 * math.pi  # the short way, once


def test_a_vehicle_that_is_weak_astern_turns_at_once_to_a_point_behind_it():
    """Astern it makes 0.09 m/s or nothing, and a plan that turns at its end would put the turn off."""
    controller = Controller(WEAK, references.Point(north_m=-10.0, east_m=0.0))
    way, _ = fly(controller, at_rest(0.0, 0.25), round(50.0 / STAGE_S))
    north, east = track(way).T
    assert np.hypot(north[-1] + 10.0, east[-1]) < 1.0
    assert np.abs(east).max() < 3.0
    assert north.min() > -11.0
