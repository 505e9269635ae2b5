"""The bias of the current: found where it shows, left alone where it does not, and worth having."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, CurrentProfile, Estimate, Vehicle, references
from ltv_mpc.control.config import Disturbance
from ltv_mpc.control.disturbance import CurrentBias
from ltv_mpc.control.nominal_model import as_estimate
from ltv_mpc.control.prediction import Prediction
from ltv_mpc.control.sent_commands import SentCommands

PAPER = Vehicle.load("paper")
ON = Disturbance(sd_mps=0.1)
OFF = Disturbance(sd_mps=0.0)
BY_ITSELF = Disturbance()
WATER = np.array([0.03, -0.025])


def flat(current) -> CurrentProfile:
    return CurrentProfile(depth_m=np.zeros(1), north_mps=current[:1].copy(), east_mps=current[1:].copy())


def held(disturbance: Disturbance, told: CurrentProfile | None, cycles: int = 200):
    """Station kept in WATER by a controller that is told ``told``: the bias at the end, mean |F|, mean distance."""
    config = ControllerConfig(disturbance=disturbance)
    controller = Controller(PAPER, references.Point(north_m=0.0, east_m=0.0), config)
    truth = msgspec.structs.replace(
        Estimate.at_rest(heading_rad=1.0),
        velocity_north_mps=WATER[0],
        velocity_east_mps=WATER[1],
        current=flat(WATER),
    )
    commands, vehicle = SentCommands(PAPER), Prediction(PAPER)
    force, off = [], []
    for _ in range(cycles):
        plan = controller.plan(msgspec.structs.replace(truth, current=told))
        commands.add(plan)
        truth = as_estimate(vehicle.state_at(truth, truth.t_ns + 300_000_000, commands), truth)
        force.append(np.abs(plan.thrust_N[0, :2]).mean())
        off.append(np.hypot(truth.north_m, truth.east_m))
    late = slice(cycles // 2, None)
    return controller._bias, float(np.mean(force[late])), float(np.mean(off[late]))


def test_an_unknown_current_is_found_and_then_costs_no_more_than_a_known_one():
    bias, force, off = held(ON, None)
    _, blind_force, blind_off = held(OFF, None)
    _, known_force, known_off = held(OFF, flat(WATER))
    np.testing.assert_allclose(bias.bias_mps, WATER, atol=0.005)
    assert off < 0.6 * blind_off
    assert off < known_off + 0.005
    assert force < 0.6 * blind_force
    assert force < known_force + 1.0


def test_by_itself_it_works_where_no_profile_is_told_and_rests_where_one_is():
    bias, _, off = held(BY_ITSELF, None)
    np.testing.assert_allclose(bias.bias_mps, WATER, atol=0.005)
    told, _, told_off = held(BY_ITSELF, flat(WATER + 0.01))
    np.testing.assert_array_equal(told.bias_mps, 0.0)
    assert off < told_off  # a profile that is 1 cm/s wrong is believed


def test_a_profile_that_comes_and_goes_is_no_step_of_the_bias():
    """What was learned without it is there again when it goes, and nothing is learned across it."""
    bias, commands, vehicle = CurrentBias(BY_ITSELF), SentCommands(PAPER), Prediction(PAPER)
    estimate = msgspec.structs.replace(Estimate.at_rest(), velocity_north_mps=0.2)
    for i in range(50):
        bias.correct(msgspec.structs.replace(estimate, t_ns=i * 300_000_000), vehicle, commands)
    learned = bias.bias_mps.copy()
    assert learned[0] > 0.05
    told = msgspec.structs.replace(estimate, t_ns=50 * 300_000_000, current=flat(WATER))
    assert bias.correct(told, vehicle, commands) is told
    again = bias.correct(msgspec.structs.replace(estimate, t_ns=51 * 300_000_000), vehicle, commands)
    assert again.current.north_mps[0] == learned[0]


def test_it_comes_on_top_of_the_profile_that_is_known():
    part = np.array([0.05, 0.02])
    bias, _, _ = held(ON, flat(part))
    np.testing.assert_allclose(part + bias.bias_mps, WATER, atol=0.005)


def test_where_the_profile_is_right_nothing_is_added():
    bias, _, _ = held(ON, flat(WATER))
    np.testing.assert_allclose(bias.bias_mps, 0.0, atol=0.002)


def drifting(seconds: float, steps: int, settings: Disturbance = ON, **changes: float):
    """A bias after ``steps`` estimates of a vehicle without thrust that is told of no current."""
    bias, commands, vehicle = CurrentBias(settings), SentCommands(PAPER), Prediction(PAPER)
    estimate = msgspec.structs.replace(Estimate.at_rest(), **changes)
    for i in range(steps):
        told = bias.correct(msgspec.structs.replace(estimate, t_ns=round(i * seconds * 1e9)), vehicle, commands)
    return bias, told


def test_a_vehicle_that_neither_moves_nor_is_pushed_says_nothing_of_the_water():
    bias, _ = drifting(0.3, 400, Disturbance(sd_mps=0.1, noise_mps=1.0))
    np.testing.assert_allclose(bias.bias_mps, 0.0, atol=1e-12)
    assert np.linalg.eigvalsh(bias.covariance).max() <= 0.1**2 * (1 + 1e-9)


def test_a_velocity_that_drag_should_have_taken_is_the_water_s():
    """0.2 m/s over ground that stays is the water's."""
    bias, told = drifting(0.3, 50, velocity_north_mps=0.2)
    assert bias.bias_mps[0] > 0.05
    assert abs(bias.bias_mps[1]) < 0.01
    assert told.current.north_mps[0] == pytest.approx(bias.bias_mps[0])


def test_over_a_long_silence_nothing_is_learned():
    bias, _ = drifting(2.5, 20, velocity_north_mps=0.2)
    np.testing.assert_array_equal(bias.bias_mps, 0.0)


def test_what_is_not_finite_is_not_believed_and_the_bias_stays_in_its_limits():
    bias, commands, vehicle = CurrentBias(ON), SentCommands(PAPER), Prediction(PAPER)
    first = Estimate.at_rest()
    bias.correct(first, vehicle, commands)
    broken = msgspec.structs.replace(first, t_ns=300_000_000, velocity_north_mps=float("nan"))
    bias.correct(broken, vehicle, commands)
    np.testing.assert_array_equal(bias.bias_mps, 0.0)
    tight = CurrentBias(Disturbance(sd_mps=0.1, max_mps=0.01))
    estimate = msgspec.structs.replace(first, velocity_north_mps=0.2)
    for i in range(50):
        tight.correct(msgspec.structs.replace(estimate, t_ns=i * 300_000_000), vehicle, commands)
    assert tight.bias_mps[0] == 0.01
