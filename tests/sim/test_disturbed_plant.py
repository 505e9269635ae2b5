"""A disturbance acts on the vehicle as its force, for as long as it says."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.messages import Disturbance, Truth
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.vehicle.parameters import Vehicle
from sim.plant import STEP_NS, Plant
from sim.scenario import Scenario, with_overrides
from sim.water import make
from tests.ltv_mpc.plans import plan_of
from tests.sim.worlds import S

VEHICLE = Vehicle.load("paper")
M = VEHICLE.coefficients()


def plant_of(*settings: str) -> Plant:
    scenario = with_overrides(Scenario.load("descent"), ["water.sd_mps=0", "plant.depth_m=20", *settings])
    return Plant(scenario, VEHICLE, make(scenario.water, 0))


def steady(thrust_N: tuple[float, float, float]) -> ReceivedMessage:
    ramp = np.minimum(np.arange(41) * 30.0 / np.abs(thrust_N).max(), 1.0)
    return ReceivedMessage(plan_of(0, np.outer(ramp, thrust_N)), 5, 0, 0)


def run(plant: Plant, until_ns: int, *, disturbance: Disturbance | None = None, at_ns: int = 0, plan=None):
    """Return the truths by time."""
    truth = {}
    for t in range(0, until_ns + 1, STEP_NS):
        inbox = [] if plan is None or t else [plan]
        if disturbance is not None and t == at_ns:
            inbox.append(ReceivedMessage(disturbance, 9, 0, t))
        truth |= {x.t_ns: x for x in plant.step(t, inbox) if isinstance(x, Truth)}
    return truth


def test_a_short_push_changes_the_momentum_by_its_impulse():
    """f dt = M dv along each axis of the body, m dt = I dr; damping of a vehicle at rest is of second order."""
    push = Disturbance(end_t_ns=S // 10, force_N=(40.0, -30.0, 20.0), yaw_moment_Nm=15.0)
    heading = 0.7
    moved = run(plant_of("plant.heading_rad=0.7"), S // 10, disturbance=push)[S // 10]
    still = run(plant_of("plant.heading_rad=0.7"), S // 10)[S // 10]  # it rises by its buoyancy
    ahead = 40.0 * math.cos(heading) - 30.0 * math.sin(heading)
    to_starboard = -30.0 * math.cos(heading) - 40.0 * math.sin(heading)
    expected = (0.1 * ahead / M.mass_surge, 0.1 * to_starboard / M.mass_sway, 0.1 * 20.0 / M.mass_heave)
    gained = np.subtract(moved.water_velocity_mps, still.water_velocity_mps)
    assert gained.tolist() == pytest.approx(expected, rel=0.03)
    assert moved.yaw_rate_radps == pytest.approx(0.1 * 15.0 / M.inertia_yaw, rel=0.05)


def test_lost_thrust_moves_the_vehicle_as_one_whose_propellers_give_less():
    """The plant's own factor on thrust, which goes through its integrator, is the other way to the same motion."""
    lost = Disturbance(end_t_ns=60 * S, thrust_scale=(0.5, 0.6, 0.5))
    thrust = (40.0, 25.0, 30.0)
    weaker = "plant.mismatch.thrust=0.5", "plant.mismatch.starboard_thrust=1.2"
    here = run(plant_of(), 8 * S, disturbance=lost, plan=steady(thrust))
    there = run(plant_of(*weaker), 8 * S, plan=steady(thrust))
    for t in (2 * S, 5 * S, 8 * S):
        np.testing.assert_allclose(here[t].position_m, there[t].position_m, atol=2e-4)
        np.testing.assert_allclose(here[t].thrust_N, there[t].thrust_N, rtol=1e-2)
    full = run(plant_of(), 8 * S, plan=steady(thrust))
    assert np.linalg.norm(np.subtract(full[8 * S].position_m, here[8 * S].position_m)) > 0.5


def test_it_ends_when_it_says_and_leaves_no_bit_changed_before_it_comes():
    push = Disturbance(end_t_ns=3 * S, force_N=(50.0, 0.0, 0.0))
    here, there = run(plant_of(), 6 * S, disturbance=push, at_ns=2 * S), run(plant_of(), 6 * S)
    assert all(msgspec.json.encode(here[t]) == msgspec.json.encode(there[t]) for t in there if t <= 2 * S)
    speed = {t: here[t].water_velocity_mps[0] for t in here}
    assert speed[3 * S] > speed[2 * S + STEP_NS] > 0.0
    assert speed[3 * S + STEP_NS] < speed[3 * S]


def test_a_new_one_takes_the_old_ones_place():
    plant = plant_of()
    run(plant, S // 10, disturbance=Disturbance(end_t_ns=60 * S, force_N=(50.0, 0.0, 0.0)))
    nothing = Disturbance(end_t_ns=60 * S)
    (before, *_) = plant.step(S // 10 + STEP_NS, [ReceivedMessage(nothing, 9, 1, S // 10 + STEP_NS)])
    (after, *_) = plant.step(S // 10 + 2 * STEP_NS, [])
    assert after.water_velocity_mps[0] <= before.water_velocity_mps[0]
